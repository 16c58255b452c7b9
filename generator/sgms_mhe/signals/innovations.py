"""Innovations of an estimator as a judge of its weights: their likelihood, and the noise they support."""

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


def counted_innovations(estimates: Estimates, counted: Mask) -> tuple[Array, Array]:
    """Innovations of counted updates (u) [N], and the variances predicted of them; a refused one is far off.

    None is further off than `MOST_RATIO` says.
    """
    refused = estimates.status[counted] < 0
    innovation, ratio = estimates.innovation_N[counted], np.maximum(estimates.test_ratio[counted], 1e-12)
    variance = np.maximum(innovation**2, 1e-300) / ratio
    size = np.where(refused, MOST_RATIO, np.minimum(ratio, MOST_RATIO))
    return np.copysign(np.sqrt(size * variance), innovation), variance


def innovation_loss(innovation: Array, variance: Array) -> Array:
    """Loss (log S + e^2 / S) / 2 of every innovation (u)."""
    return np.asarray(0.5 * (np.log(variance) + np.minimum(innovation**2 / variance, MOST_RATIO)))


def integrate_innovations(innovation: Array, variance: Array, updates: int) -> tuple[Array, Array]:
    """Errors of a motion that the model predicts from where it was so many updates before, and their variances.

    The sum over the innovations since, each by the updates it has moved the axis: the second integral, over
    period^2 / mass. Independent innovations have the variance; correlated ones make the error larger.
    """
    weights = np.arange(1.0, updates + 1.0)
    return np.convolve(innovation, weights, "valid"), np.convolve(variance, weights**2, "valid")


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
    """Measurement noise the innovations speak for over the one that the machine file states; NaN: cannot tell.

    By their median, which faults do not move: of a normal number's square it is 0.455.
    """
    counted = moving_updates(estimates)
    if int(counted.sum()) < LEAST_UPDATES:
        return math.nan
    return math.sqrt(float(np.median(estimates.test_ratio[counted])) / 0.455)
