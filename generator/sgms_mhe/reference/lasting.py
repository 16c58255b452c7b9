"""Factors on stated variances for errors of the model that stay, from innovations and estimates (docs/faults.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.reference.readings import MOST as MOST_RATIO
from sgms_mhe.reference.readings import Innovation

Array = NDArray[np.float64]

BLOCK = 50
"""Intervals of a block of innovations."""
MOST = 100.0
"""The square of a block's sum over its number counts no more."""
FREE = 1.5
"""Innovations that are independent make a mean over blocks of up to so much."""
FORGETS = 0.0005
"""Share that a mean over updates forgets with one."""
DOUBTED = 2.0
"""Factor beyond which the measurements contradict the model."""


@dataclass
class InnovationColour:
    """Mean over blocks of the squared sum of innovations, each block weighed with its information.

    Attributes:
        first: information of the mean before any block, the measurements of one; independent innovations make 1.
        block: the block's intervals so far.
    """

    first: float
    block: list[Sequence[Innovation]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.squares = self.information = self.first

    def take(self, interval: Sequence[Innovation]) -> None:
        """Take the innovations of an interval in."""
        self.block.append(interval)
        if len(self.block) < BLOCK:
            return
        innovations = [innovation for part in self.block for innovation in part]
        self.block = []
        if innovations:
            information = sum(1.0 / innovation.need for innovation in innovations)
            total = sum(innovation.standard for innovation in innovations)
            keep = 1.0 - BLOCK * FORGETS
            self.squares = keep * self.squares + information * min(total**2 / len(innovations), MOST)
            self.information = keep * self.information + information

    @property
    def factor(self) -> float:
        """Factor on all variances, >= 1."""
        return max(1.0, self.squares / self.information / FREE)


@dataclass
class ParameterWander:
    """Mean square of theta about its own slow mean, over its variance.

    That mean weighs theta with its information: what was unknown at first counts for little.
    """

    mean: Array
    weight: Array
    ratio: Array
    updates: float = 0.0

    @classmethod
    def none(cls, n_p: int) -> ParameterWander:
        """Before any update."""
        return cls(np.zeros(n_p), np.zeros(n_p), np.zeros(n_p))

    def take(self, theta: Array, variance: Array) -> None:
        """Take an estimate (n_p) in."""
        self.weight = (1.0 - FORGETS) * self.weight + 1.0 / variance
        self.mean = self.mean + (theta - self.mean) / (variance * self.weight)
        self.updates = (1.0 - FORGETS) * self.updates + 1.0
        counted = np.minimum((theta - self.mean) ** 2 / variance, MOST_RATIO)
        self.ratio = self.ratio + (counted - self.ratio) / self.updates

    @property
    def factor(self) -> Array:
        """Factor on each variance (n_p), >= 1."""
        return np.maximum(1.0, self.ratio)


class LastingErrors:
    """Both of them along the updates of a record.

    Args:
        n_p: parameters.
        measurements: in an interval.
        enabled: whether variances are scaled at all.
    """

    def __init__(self, n_p: int, measurements: int, *, enabled: bool) -> None:
        self._enabled = enabled
        self._colour, self._wander = InnovationColour(float(BLOCK * measurements)), ParameterWander.none(n_p)

    def take(self, interval: Sequence[Innovation], theta: Array, variance: Array) -> None:
        """Take an update with motion in: its innovations, its estimate and the variances of that (n_p)."""
        if self._enabled:
            self._colour.take(interval)
            self._wander.take(theta, variance)

    @property
    def spread(self) -> Array:
        """Factor on the variance of each parameter (n_p), >= 1."""
        return self._colour.factor * self._wander.factor

    @property
    def doubts(self) -> bool:
        """Return True if a variance would have to be so much larger that the model is contradicted."""
        return bool(np.any(self.spread > DOUBTED))
