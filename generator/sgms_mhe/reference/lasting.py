"""Factors on stated variances for errors of the model that stay, from innovations and estimates (docs/faults.md)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sgms_mhe.reference.readings import Innovation
from sgms_mhe.support.arrays import Array

BLOCK = 50
"""Intervals with motion of a block."""
MOST = 100.0
"""A block's square counts no more than so many times what it is on average."""
FORGETS = 0.001
"""Share that a mean over updates forgets with one."""
DOUBTED = 2.0
"""Factor, over the one that the axis is known for, beyond which the measurements contradict the model."""


@dataclass
class InnovationColour:
    """Mean over blocks of the squared sum of innovations, each block weighed with its information.

    Attributes:
        first: information of the mean before any block, the measurements of one; independent innovations make 1.
        known: that mean.
        length: intervals after which a block ends.
        block: the block's intervals so far.
    """

    first: float
    known: float = 1.0
    length: int = BLOCK
    block: list[Sequence[Innovation]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.squares, self.information = self.known * self.first, self.first

    def take(self, interval: Sequence[Innovation]) -> None:
        """Take the innovations of an interval in."""
        self.block.append(interval)
        if len(self.block) < self.length:
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
        return max(1.0, self.squares / self.information)


class ParameterWander:
    """Squared move of each parameter over a block of updates, over the variance the block takes from it.

    An estimate that knows its variance moves, from one block's end to the next, with the variance before, and the
    drift's, less that after. Blocks count with that share of the variance: an unknown number moves much at once.

    Args:
        drift: random walk of theta per update (n_p), 1 sigma.
        length: updates after which a block ends.
    """

    def __init__(self, drift: Array, length: int = BLOCK) -> None:
        self._growth, self._length = BLOCK * drift**2, length
        self._theta: Array | None = None
        self._variance: Array | None = None
        self._updates = 0
        self.squares, self.share = np.ones_like(drift), np.ones_like(drift)

    def take(self, theta: Array, variance: Array) -> None:
        """Take an estimate (n_p) and its variance in."""
        self._updates += 1
        if self._theta is None or self._variance is None:
            self._theta, self._variance = theta.copy(), variance.copy()
            return
        if self._updates < self._length:
            return
        self._updates = 0
        before = self._variance + self._growth
        taken = np.maximum(0.0, before - variance)
        keep = 1.0 - BLOCK * FORGETS
        self.squares = keep * self.squares + np.minimum((theta - self._theta) ** 2, MOST * taken) / before
        self.share = keep * self.share + taken / before
        self._theta, self._variance = theta.copy(), variance.copy()

    @property
    def factor(self) -> Array:
        """Factor on each variance (n_p), >= 1."""
        return np.maximum(1.0, self.squares / self.share)


class LastingErrors:
    """Both of them along the updates of a record.

    Args:
        drift: random walk of theta per update (n_p), 1 sigma.
        measurements: in an interval.
        colour: factor the axis is known for.
        enabled: whether variances are scaled at all.
        length: intervals after which a block ends; its numbers count as those of BLOCK.
    """

    def __init__(
        self, drift: Array, measurements: int, *, colour: float = 1.0, enabled: bool, length: int = BLOCK
    ) -> None:
        colour = colour if enabled else 1.0
        self._enabled, self._doubted = enabled, DOUBTED * colour
        self._colour = InnovationColour(float(BLOCK * measurements), colour, length)
        self._wander = ParameterWander(drift, length)

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
        return bool(np.any(self.spread > self._doubted))
