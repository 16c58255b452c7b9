"""Measurements one after the other: innovation, test ratio, and the noise each is taken with (docs/weights.md)."""

from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np

from sgms_mhe.support.arrays import Array

FAST, SLOW = 0.1, 0.003
"""Weight of the newest test ratio in the two means of them."""
MOST = 1000.0
"""A test ratio counts no more than this in the means."""
FREE = 9.0
"""A test ratio of three standard deviations, squared: what is beyond it weighs a measurement down at once."""


DOUBTED_FAST, DOUBTED_SLOW = 5.0, 2.0
"""Means of the test ratios beyond which the measurements contradict the predictions."""


class Gaussian(NamedTuple):
    """Mean (n,) and covariance (n, n) of the estimated numbers."""

    mean: Array
    covariance: Array


class MeasurementResult(NamedTuple):
    """Result of a measurement.

    Attributes:
        innovation: measurement minus its prediction [N].
        test_ratio: its square over its predicted variance.
        scale: factor on the stated standard deviation it was taken with.
    """

    innovation: float
    test_ratio: float
    scale: float

    @classmethod
    def none(cls) -> Self:
        """Before the first one."""
        return cls(0.0, 0.0, 1.0)


class Innovation(NamedTuple):
    """An innovation a measurement was taken with.

    Attributes:
        standard: over its predicted standard deviation, three of these at most.
        need: factor on its predicted variance, >= 1.
    """

    standard: float
    need: float


@dataclass
class Scaling:
    """The two means of the test ratios, from which the noise of the next measurement follows.

    `interval` holds the innovations since it was emptied.
    """

    enabled: bool
    fast: float = 1.0
    slow: float = 1.0
    interval: list[Innovation] = field(default_factory=list)

    @property
    def doubts(self) -> bool:
        """Return True if the measurements contradict the predictions."""
        return self.fast > DOUBTED_FAST or self.slow > DOUBTED_SLOW

    def variance_factor(self, test_ratio: float) -> float:
        """How many times larger than predicted the innovation's variance has to be for this measurement, >= 1."""
        counted = min(test_ratio, MOST)
        self.fast += FAST * (counted - self.fast)
        self.slow += SLOW * (counted - self.slow)
        if not self.enabled:
            return 1.0
        return max(1.0, test_ratio / FREE * max(1.0, self.fast), self.fast, self.slow)


def take_reading(
    belief: Gaussian, C: Array, innovation: float, stated: float, scaling: Scaling, noise: float = 1.0
) -> tuple[Gaussian, MeasurementResult]:
    """Fold a scalar measurement, C (n,) its sensitivity, with the noise its innovation asks for.

    `noise`: factor on the stated deviation before that is known.
    """
    sigma = noise * stated
    spread = float(C @ belief.covariance @ C)
    predicted = spread + sigma**2
    test_ratio = innovation**2 / predicted
    need = scaling.variance_factor(test_ratio)
    largest = np.sqrt(FREE)
    scaling.interval.append(Innovation(float(np.clip(innovation / np.sqrt(predicted), -largest, largest)), need))
    # The variance of the measurement at which the innovation's is `need` times the predicted one.
    variance = sigma**2 + (need - 1.0) * predicted
    return fold(belief, C, innovation, variance), MeasurementResult(
        innovation, test_ratio, float(np.sqrt(variance)) / stated
    )


def fold(belief: Gaussian, C: Array, innovation: float, variance: float) -> Gaussian:
    """Kalman update of a scalar measurement in Joseph's form, which keeps the covariance positive definite."""
    mean, P = belief
    gain = P @ C / (C @ P @ C + variance)
    keep = np.eye(len(mean)) - np.outer(gain, C)
    return Gaussian(mean + gain * innovation, keep @ P @ keep.T + variance * np.outer(gain, gain))
