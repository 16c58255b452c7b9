"""The nonlinear fit: break-away distances and the rise towards low speed, everything linear solved for at each point.

    y = sum_k L_k chi(D_k, beta, v_s) + sum_j b_j C_j,    L_k >= 0

Gauss-Newton with damping in log D_k, beta and log v_s, on what the linear columns cannot make up for (variable
projection). Derivatives are those of the emitted C.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.identification.elements import NO_RISE, Law, Stribeck, least_distance, run_elements
from sgms_mhe.identification.linear import solve_bounded
from sgms_mhe.identification.records import Motion
from sgms_mhe.identification.terms import Term
from sgms_mhe.recordings.evidence import cross_loss
from sgms_mhe.recordings.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FIRST_DAMPING: Final = 1e-3
LEAST_DAMPING: Final = 1e-7
MOST_DAMPING: Final = 1e4
FACTOR: Final = 10.0
LONGEST: Final = 0.7
"""Largest change of a logarithm, and of the Stribeck ratio over 1 + itself, in one step."""
ENOUGH: Final = 1e-5
"""Share of the sum of squares that a step must gain to be followed by another."""
ITERATIONS: Final = 30
MOST_RISE: Final = 20.0
WIDER: Final = 4.0
"""Beyond the grid's ends, as a factor, distances are not followed."""
STRIBECK: Final = (1e-4, 0.5)
"""Stribeck velocities that a record can tell, over its fastest speed."""


@dataclass(frozen=True, eq=False)
class View:
    """The records at one rate: coarse for choices, fine for the numbers that are reported.

    Attributes:
        rows: all of them.
        motions: of each log.
        noise: of a row [N].
        limits: smallest and largest break-away distance [m].
    """

    rows: Recording
    motions: tuple[Motion, ...]
    noise: float
    limits: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Shape:
    """What is not linear: the law, break-away distances (k) [m], the rise (None: none)."""

    law: Law
    distances: Array
    rise: Stribeck | None


@dataclass(frozen=True, eq=False)
class AxisFit:
    """An axis fitted to records.

    Attributes:
        shape: law, distances and rise found.
        levels: of the elements (k) [N].
        terms: what else is linear.
        coefficients: of all columns of the terms (c).
        residual: measured minus model (m) [N].
        slopes: derivatives (m, p) in log D (k), levels (k), beta and log v_s where there is a rise, coefficients (c).
        prior: information of priors (p), in units of the sum of squares.
        loss, cross, rows: per block: sum of squares, the same predicted without its fold, rows.
    """

    shape: Shape
    levels: Array
    terms: tuple[Term, ...]
    coefficients: Array
    residual: Array
    slopes: Array
    prior: Array
    loss: Array
    cross: Array
    rows: Array

    @property
    def coulomb(self) -> float:
        """Sum of the levels [N]."""
        return float(self.levels.sum())

    @property
    def elements(self) -> Array:
        """Deflections over their levels (m, k)."""
        count = len(self.levels)
        return np.asarray(self.slopes[:, count : 2 * count])

    @property
    def rms(self) -> float:
        """RMS of the residual on used rows [N]."""
        return math.sqrt(float(self.loss.sum() / self.rows.sum()))

    @property
    def cross_rms(self) -> float:
        """RMS by cross-validation [N]."""
        return math.sqrt(max(0.0, float(self.cross.sum() / self.rows.sum())))

    def place(self, name: str) -> slice:
        """Where the columns of a term stand among the slopes; empty where it is not there."""
        start = self.slopes.shape[1] - len(self.coefficients)
        for term in self.terms:
            width = term.columns.shape[1]
            if term.name == name and name:
                return slice(start, start + width)
            start += width
        return slice(0, 0)

    def coefficient(self, name: str) -> Array:
        """Coefficients of a term; none where it is not there."""
        place, first = self.place(name), self.slopes.shape[1] - len(self.coefficients)
        return self.coefficients[place.start - first : place.stop - first] if place.stop else self.coefficients[:0]


@dataclass(frozen=True, eq=False)
class _Point:
    shape: Shape
    levels: Array
    coefficients: Array
    residual: Array
    nonlinear: Array
    linear: Array
    cost: float


@dataclass(frozen=True, eq=False)
class _Problem:
    view: View
    terms: tuple[Term, ...]
    seen: Mask
    columns: Array
    positive: Mask
    information: Array

    def at(self, shape: Shape) -> _Point:
        """The model at a shape, its linear part solved for on the rows seen."""
        rise = shape.rise or NO_RISE
        runs = run_elements(self.view.motions, shape.law, shape.distances, rise)
        linear = np.column_stack([*(run.chi for run in runs), self.columns])
        count = len(runs)
        positive = np.concatenate((np.ones(count, dtype=np.bool_), self.positive))
        information = np.concatenate((np.zeros(count), self.information))
        X, y = linear.compress(self.seen, axis=0), self.view.rows.friction[self.seen]
        b = solve_bounded(X.T @ X, X.T @ y, positive, information)
        residual = self.view.rows.friction - linear @ b
        nonlinear = [b[k] * run.slopes[:, 0] for k, run in enumerate(runs)]
        if shape.rise is not None:
            nonlinear += [np.sum([b[k] * run.slopes[:, j] for k, run in enumerate(runs)], axis=0) for j in (1, 2)]
        seen = residual[self.seen]
        cost = float(seen @ seen + information @ b**2)
        return _Point(shape, b[:count], b[count:], residual, np.column_stack(nonlinear), linear, cost)

    def step(self, here: _Point, damping: float) -> Array:
        """Change of log D, beta, log v_s that a quadratic model of the cost asks for.

        What stands at its limit and would leave it stays: the others would be changed to go with a change that it
        does not make.
        """
        N = here.nonlinear.compress(self.seen, axis=0)
        held = np.concatenate((here.levels, np.where(self.positive, here.coefficients, 1.0))) == 0.0
        X = here.linear.compress(self.seen, axis=0).compress(~held, axis=1)
        scale = np.sqrt(np.sum(X**2, axis=0)) + 1e-300
        X = X / scale
        gram = X.T @ X + 1e-9 * np.eye(X.shape[1])
        projected = N - X @ np.linalg.solve(gram, X.T @ N)
        H = projected.T @ projected
        g = projected.T @ here.residual[self.seen]
        diagonal = np.diag(H) + 1e-12 * max(float(np.diag(H).max(initial=0.0)), 1e-300)
        below, above = _at_limits(here.shape, self.view)
        moves = np.flatnonzero(~(below & (g < 0.0)) & ~(above & (g > 0.0)))
        step = np.zeros(len(g))
        step[moves] = np.linalg.solve((H + damping * np.diag(diagonal))[np.ix_(moves, moves)], g[moves])
        return step


def fit_axis(
    view: View, terms: Sequence[Term], start: Shape, seen: Mask | None = None, iterations: int = ITERATIONS
) -> AxisFit:
    """Fit elements and terms to records from a shape on.

    Args:
        view: records at some rate.
        terms: what is linear beside the elements.
        start: law, distances, rise; what it has not is not looked for.
        seen: rows that the fit sees (m); None: all used ones.
        iterations: at most.
    """
    deviation = np.concatenate([np.full(t.columns.shape[1], t.deviation) for t in terms])
    problem = _Problem(
        view,
        tuple(terms),
        view.rows.used if seen is None else seen,
        np.column_stack([t.columns for t in terms]),
        np.concatenate([np.full(t.columns.shape[1], t.positive) for t in terms]),
        (view.noise / deviation) ** 2,
    )
    here = problem.at(_within(start, view))
    damping = FIRST_DAMPING
    for _ in range(iterations):
        better = None
        while better is None and damping <= MOST_DAMPING:
            shape = _moved(here.shape, problem.step(here, damping), view)
            there = problem.at(shape)
            if there.cost < here.cost:
                better = there
            else:
                damping *= FACTOR
        if better is None:
            break
        gain, here = here.cost - better.cost, better
        damping = max(LEAST_DAMPING, damping / FACTOR)
        if gain < ENOUGH * here.cost:
            break
    return _finished(problem, here)


def _finished(problem: _Problem, point: _Point) -> AxisFit:
    rows, count = problem.view.rows, len(point.levels)
    extra = point.nonlinear.shape[1] - count
    slopes = np.column_stack(
        (point.nonlinear[:, :count], point.linear[:, :count], point.nonlinear[:, count:], point.linear[:, count:])
    )
    prior = np.concatenate((np.zeros(2 * count + extra), problem.information))
    held = np.concatenate((np.zeros(count, dtype=np.bool_), point.levels == 0.0, np.zeros(extra, dtype=np.bool_),
                           problem.positive & (point.coefficients == 0.0)))  # fmt: skip
    loose = ~held
    return AxisFit(
        shape=point.shape,
        levels=point.levels,
        terms=problem.terms,
        coefficients=point.coefficients,
        residual=point.residual,
        slopes=slopes,
        prior=prior,
        loss=rows.sum_blocks(point.residual**2),
        cross=cross_loss(rows, slopes[:, loose], point.residual, prior[loose]),
        rows=rows.sum_blocks(np.ones(len(rows.time))),
    )


def _moved(shape: Shape, step: Array, view: View) -> Shape:
    count = len(shape.distances)
    limited = np.clip(step, -LONGEST, LONGEST)
    rise = shape.rise
    if rise is not None:
        most = LONGEST * (1.0 + rise.ratio)
        ratio = rise.ratio + float(np.clip(step[count], -most, most))
        rise = Stribeck(ratio, rise.velocity * math.exp(limited[count + 1]))
    return _within(Shape(shape.law, shape.distances * np.exp(limited[:count]), rise), view)


def _within(shape: Shape, view: View) -> Shape:
    """The shape within what the records can tell, distances in order."""
    rise = shape.rise
    if rise is not None:
        slow, fast = _speeds(view)
        rise = Stribeck(min(max(rise.ratio, 0.0), MOST_RISE), min(max(rise.velocity, slow), fast))
    return Shape(shape.law, np.sort(np.clip(shape.distances, *_distances(shape.law, rise, view))), rise)


def _at_limits(shape: Shape, view: View) -> tuple[Mask, Mask]:
    """Which of log D, beta, log v_s of a shape within what the records can tell stand at its lower and upper end."""
    low, high = (np.full(len(shape.distances), end) for end in _distances(shape.law, shape.rise, view))
    here = shape.distances
    if shape.rise is not None:
        slow, fast = _speeds(view)
        here = np.append(here, (shape.rise.ratio, shape.rise.velocity))
        low, high = np.append(low, (0.0, slow)), np.append(high, (MOST_RISE, fast))
    return here <= low, here >= high


def _distances(law: Law, rise: Stribeck | None, view: View) -> tuple[float, float]:
    """Smallest and largest break-away distance [m] that a fit follows."""
    low, high = view.limits
    low = max(
        low / WIDER,
        *(least_distance(law, rise or NO_RISE, motion.rate / motion.steps) for motion in view.motions),
    )
    return low, max(low, high * WIDER)


def _speeds(view: View) -> tuple[float, float]:
    """Smallest and largest Stribeck velocity [m/s] that a fit follows."""
    slow, fast = STRIBECK
    return slow * view.rows.extents.speed, fast * view.rows.extents.speed
