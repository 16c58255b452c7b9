"""Noise of a measured signal, told from the signal itself."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

MEDIAN_OF_NORMAL: Final = 0.6745
"""Median size of a normal variable over its standard deviation."""


def position_noise(position: NDArray[np.float64]) -> float:
    """Standard deviation of the noise in a position (n) [its unit]; 0 where too few samples are there.

    The median size of third differences over that of white noise, sqrt(1 + 9 + 9 + 1) standard deviations: a motion is
    smooth over four samples where it is slow, and most of a record is. Missing samples are NaN.
    """
    third = np.abs(np.diff(position, n=3))
    third = third[np.isfinite(third)]
    return float(np.median(third)) / (MEDIAN_OF_NORMAL * math.sqrt(20.0)) if len(third) else 0.0
