"""Innovations of an estimator as a judge of its weights: their likelihood, and the noise that they support."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.status import FLAGS, has_measurement
from sgms_mhe.support.arrays import Array, Mask

MOST_RATIO: Final = 25.0
"""Test ratio that a measurement counts with at the most: beyond, it is a fault."""
LEAST_UPDATES: Final = 100
"""Updates with a measurement in motion that it takes to tell weights apart."""
BLOCK: Final = 50
"""Updates in motion over which an estimator sums innovations up."""
MOST_SIZE: Final = 3.0
"""Innovation over its predicted deviation that counts in such a sum, at the most."""
NOISE_FITS: Final = (0.1, 3.0)
"""Noise that innovations speak for, over the stated one, within which there is nothing to say: room is no mistake."""


def innovation_loss(estimates: Estimates, counted: Mask) -> tuple[Array, float]:
    """Loss (log S + e^2 / S) / 2 of every counted update (u), and their mean test ratio; a refused one is the worst."""
    refused = estimates.status[counted] < 0
    ratio = np.maximum(estimates.test_ratio[counted], 1e-12)
    variance = np.maximum(estimates.innovation_N[counted] ** 2, 1e-300) / ratio
    ratio = np.where(refused, MOST_RATIO, np.minimum(ratio, MOST_RATIO))
    loss: Array = 0.5 * (np.log(variance) + ratio)
    return loss, float(ratio.mean())


def moving_updates(estimates: Estimates) -> Mask:
    """Updates (u) that took a measurement in while the axis moved, the first of them left out."""
    left_out = FLAGS["filling"] | FLAGS["hold"] | FLAGS["speed"]
    counted: Mask = has_measurement(estimates.status) & (estimates.status & left_out == 0)
    counted &= np.isfinite(estimates.test_ratio) & (estimates.innovation_N != 0.0)
    counted[: min(len(counted), 10)] = False
    return counted


def find_colour(records: Sequence[Estimates]) -> float:
    """Return the mean square of a block's sum of innovations over their number; 1, of independent ones, at least.

    As the estimator finds it (docs/faults.md), of the newest measurement of each update.
    """
    sums = []
    for estimates in records:
        counted = moving_updates(estimates)
        size = np.copysign(np.minimum(np.sqrt(estimates.test_ratio), MOST_SIZE), estimates.innovation_N)[counted]
        sums.append(size[: len(size) // BLOCK * BLOCK].reshape(-1, BLOCK).sum(axis=1))
    square = np.concatenate(sums) ** 2
    return max(1.0, float(square.mean()) / BLOCK) if len(square) else 1.0


def stated_noise(estimates: Estimates) -> float:
    """Measurement noise that the innovations speak for over the one that the machine file states; NaN: cannot tell.

    By their median, which faults do not move: of a normal number's square it is 0.455.
    """
    counted = moving_updates(estimates)
    if int(counted.sum()) < LEAST_UPDATES:
        return math.nan
    return math.sqrt(float(np.median(estimates.test_ratio[counted])) / 0.455)
