"""Noise of a measured signal, told from the signal itself."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

MEDIAN_OF_NORMAL: Final = 0.6745
"""Median size of a normal variable over its standard deviation."""


ORDERS: Final = (3, 5, 7)
"""Differences that tell noise from motion: of motion the higher ones hold less, of white noise they say the same."""


def position_noise(position: NDArray[np.float64]) -> float:
    """Standard deviation of the noise in a position (n) [its unit]; 0 where too few samples are there.

    The median size of differences over that of white noise, sqrt(C(2 k, k)) standard deviations for order k: a motion
    is smooth over a few samples where it is slow, and most of a record is. Where it is not, differences of a higher
    order say less; the least counts. Missing samples are NaN.
    """
    found = []
    for order in ORDERS:
        difference = np.abs(np.diff(position, n=order))
        difference = difference[np.isfinite(difference)]
        if len(difference):
            found.append(float(np.median(difference)) / (MEDIAN_OF_NORMAL * math.sqrt(math.comb(2 * order, order))))
    return min(found, default=0.0)
