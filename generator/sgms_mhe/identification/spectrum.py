"""The convex start: how the level of friction is spread over break-away distances, from no guess at all.

Stop operators of a grid of break-away distances D run along the measured motion,

    s <- clip(s + dq, -D, D),    column s / D

and nonnegative least squares of the measured friction on these columns and the other linear terms gives a level for
each. A rise towards low speed is a stop times exp(-(v / v_s)^2), v_s out of a short list.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.identification.elements import NO_RISE, Stribeck, run_elements
from sgms_mhe.identification.records import Records
from sgms_mhe.identification.terms import Term
from sgms_mhe.model.effects.base import LARGEST_RISE
from sgms_mhe.recordings.least_squares import solve_nonnegative
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.parallel import run_parallel

SMALLEST: Final = 20e-9
"""Smallest break-away distance [m], where the encoder tells that much."""
RESOLVED: Final = 3.0
"""Smallest break-away distance over the scatter of position readings."""
LARGEST: Final = 0.25
"""Largest break-away distance over the travel: an element that breaks away later is a spring to this record."""
PER_DECADE: Final = 7.0
"""Distances of the grid."""
RISING: Final = 6
"""One distance of so many also gets a rise towards low speed."""
SPEEDS: Final = (1e-3, 0.3)
"""Stribeck velocities tried, over the fastest speed."""
SPEED_RATIO: Final = 2.5
LAST: Final = 0.03
"""Share of all levels that says how far elements reach."""
BOTH_WAYS: Final = 0.1
"""Share of rows in either direction from which what rises towards low speed is friction; one way it is any force."""
NEGLIGIBLE: Final = 2e-3
"""Share of all levels below which an entry of the spectrum is none."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Levels over break-away distances, and the terms fitted beside them.

    Attributes:
        distances, levels: those that are not 0 (k) [m], (k) [N].
        rise: towards low speed; None: none.
        coefficients: of all columns of the terms (c).
        sliding: force of the elements over their level, -1 to 1 (m).
        loss: sum of squares that fits without a fold leave on it [N^2].
    """

    distances: Array
    levels: Array
    rise: Stribeck | None
    coefficients: Array = field(default_factory=lambda: np.zeros(0))
    sliding: Array = field(default_factory=lambda: np.zeros(0))
    loss: float = math.inf

    @property
    def reach(self) -> float:
        """Distance [m] beyond which next to nothing breaks away; 0 where there is nothing."""
        beyond = np.cumsum(self.levels[::-1])[::-1]
        far = self.distances[beyond > LAST * self.levels.sum()]
        return float(far.max(initial=0.0))


def distance_grid(records: Records, per_decade: float = PER_DECADE) -> Array:
    """Break-away distances [m] that the records can tell of, geometric."""
    low = max(SMALLEST, RESOLVED * records.resolution)
    high = max(2.0 * low, LARGEST * records.rows.extents.travel)
    return np.geomspace(low, high, max(2, 1 + math.ceil(per_decade * math.log10(high / low))))


def find_spectrum(records: Records, terms: Sequence[Term], noise: float, grid: Array) -> Spectrum:
    """Nonnegative least squares over a grid of distances (g) [m]; `noise` [N] weighs the priors of terms."""
    rows = records.rows
    used = rows.used
    chi = run_elements(records.coarse, "switching", grid, NO_RISE, jacobian=False).chi
    stop = chi[used]
    columns = np.column_stack([term.columns for term in terms])[used]
    positive = np.concatenate([np.full(term.columns.shape[1], term.positive) for term in terms])
    deviation = np.concatenate([np.full(term.columns.shape[1], term.deviation) for term in terms])
    sums = _Sums.of(stop, columns, rows.friction[used], rows.fold[rows.block[used]])
    speeds = rows.extents.speed * np.geomspace(*SPEEDS, 1 + math.ceil(math.log(SPEEDS[1] / SPEEDS[0], SPEED_RATIO)))

    def tried_at(speed: float | None) -> tuple[float, float | None, Array]:
        weight = None if speed is None else np.exp(-((rows.velocity[used] / speed) ** 2))
        grams, rising = sums.grams(weight)
        nonnegative = np.concatenate((np.ones(stop.shape[1] + rising, dtype=np.bool_), positive))
        information = np.concatenate((np.zeros(stop.shape[1] + rising), (noise / deviation) ** 2))
        loss, coefficients = _cross_validated(grams, nonnegative, information)
        return loss, speed, coefficients

    tried = run_parallel([partial(tried_at, speed) for speed in (None, *speeds.tolist())])
    loss, speed, coefficients = min(tried, key=lambda entry: entry[0])
    levels, rise = coefficients[: len(grid)], None
    if speed is not None:
        rising = np.zeros(len(grid))
        rising[::RISING] = coefficients[len(grid) : len(grid) + len(rising[::RISING])]
        if min(np.mean(rows.velocity[used] > 0.0), np.mean(rows.velocity[used] < 0.0)) > BOTH_WAYS:
            # Friction may be gone at high speed: what rises then says where elements break away.
            levels = np.maximum(levels, rising / LARGEST_RISE)
        total = float(levels.sum())
        ratio = min(float(rising.sum()), LARGEST_RISE * total) / max(total, 1e-300)
        rise = Stribeck(ratio, speed) if ratio > 0.0 else None
    kept = levels > NEGLIGIBLE * levels.sum()
    sliding = chi @ levels / max(float(levels.sum()), 1e-300)
    return Spectrum(grid[kept], levels[kept], rise, coefficients[-columns.shape[1] :], sliding, loss)


def cluster(spectrum: Spectrum, count: int) -> tuple[Array, Array]:
    """Distances (k) and levels (k) of at most `count` clusters: neighbours that are nearest merge first.

    Distance is Ward's: the growth of the sum of squares of log D about the clusters' means, weighted by levels.
    """
    logs, levels = list(np.log(spectrum.distances)), list(spectrum.levels)
    while len(logs) > count:
        costs = [
            levels[i] * levels[i + 1] / (levels[i] + levels[i + 1]) * (logs[i + 1] - logs[i]) ** 2
            for i in range(len(logs) - 1)
        ]
        i = int(np.argmin(costs))
        total = levels[i] + levels[i + 1]
        logs[i : i + 2] = [(levels[i] * logs[i] + levels[i + 1] * logs[i + 1]) / total]
        levels[i : i + 2] = [total]
    return np.exp(np.array(logs)), np.array(levels)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Products of columns with each other, fold by fold; those that no speed changes are made once.

    Attributes:
        fixed: stops, other columns and the measured friction (m, g + c + 1), the rows of a fold behind one another.
        stops: g.
        order: where these rows were before (m).
        folds: where each fold's rows are.
        own: products of the fixed columns (folds, g + c + 1, g + c + 1).
    """

    fixed: Array
    stops: int
    order: NDArray[np.int64]
    folds: tuple[slice, ...]
    own: tuple[Array, ...]

    @classmethod
    def of(cls, stop: Array, columns: Array, y: Array, fold: NDArray[np.int64]) -> Self:
        """Return those of stops (m, g), other columns (m, c) and friction (m) [N]."""
        order = np.argsort(fold, kind="stable")
        edges = [0, *(np.flatnonzero(np.diff(fold[order])) + 1).tolist(), len(fold)]
        folds = tuple(slice(*ends) for ends in pairwise(edges))
        fixed = np.column_stack((stop, columns, y))[order]
        return cls(fixed, stop.shape[1], order, folds, tuple(fixed[f].T @ fixed[f] for f in folds))

    def grams(self, weight: Array | None) -> tuple[list[Array], int]:
        """Products of stops, of some of them times `weight` (m), of other columns and last the friction, by fold.

        Also how many rise; none where there is no weight.
        """
        if weight is None:
            return list(self.own), 0
        g = self.stops
        rising = self.fixed[:, :g:RISING] * weight[self.order, None]
        grams = []
        for fold, own in zip(self.folds, self.own, strict=True):
            beside, square = rising[fold].T @ self.fixed[fold], rising[fold].T @ rising[fold]
            upper = np.concatenate((own[:g, :g], beside[:, :g].T, own[:g, g:]), axis=1)
            middle = np.concatenate((beside[:, :g], square, beside[:, g:]), axis=1)
            lower = np.concatenate((own[g:, :g], beside[:, g:].T, own[g:, g:]), axis=1)
            grams.append(np.concatenate((upper, middle, lower)))
        return grams, rising.shape[1]


def _cross_validated(grams: Sequence[Array], positive: NDArray[np.bool_], information: Array) -> tuple[float, Array]:
    """Sum of squares that fits without a fold leave on it, and the coefficients of all rows.

    `grams`: products of the columns and the friction behind them, by fold.
    """
    whole = np.sum(grams, axis=0)
    loss = float(whole[-1, -1])
    for i, gram in enumerate(grams):
        # Sums of the others, not a difference: that of a column seen in one fold alone would be rounding.
        others = np.sum([*grams[:i], *grams[i + 1 :]], axis=0)
        b = solve_nonnegative(others[:-1, :-1], others[:-1, -1], positive, information)
        loss += float(b @ gram[:-1, :-1] @ b - 2.0 * b @ gram[:-1, -1])
    return loss, solve_nonnegative(whole[:-1, :-1], whole[:-1, -1], positive, information)
