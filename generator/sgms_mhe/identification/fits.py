"""The nonlinear fit: break-away distances and the rise towards low speed, everything linear solved for at each point.

    y = sum_k L_k chi(D_k, beta, v_s) + sum_j b_j C_j,    L_k >= 0

An acceleration has the encoder's noise, of variance s^2, and y the machine's mass m times that. Plain least
squares would make the mass too small; the part of noise alone is taken off their sum over n rows (errors in variables),

    J = sum r^2 - n s^2 (m + b)^2

Gauss-Newton with damping in log D_k, beta and log v_s, on the part unexplained by the linear columns (variable
projection). Derivatives are those of the emitted C.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from sgms_mhe.identification.elements import NO_RISE, Law, Stribeck, least_distance, run_elements
from sgms_mhe.identification.records import ElementMotion
from sgms_mhe.identification.terms import HELD, LATE, TIMING, Term
from sgms_mhe.machine.axis import FASTEST_STRIBECK
from sgms_mhe.model.effects.base import LARGEST_RISE
from sgms_mhe.recordings.evidence import (
    UNSEEN_ERROR,
    FitLoss,
    cross_loss,
    misread_forces,
    noise_floor,
    robust_covariance,
)
from sgms_mhe.recordings.least_squares import Box, Quadratic, minimise, solve_nonnegative
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array, Mask

LONGEST: Final = 0.7
"""Largest change of a logarithm, and of the Stribeck ratio over 1 + itself, in one step."""
ENOUGH: Final = 1e-5
"""Share of the sum of squares that a step must gain to be followed by another."""
ITERATIONS: Final = 30
TRIES: Final = 6
"""Dampings that are tried for a step: where elements turn round all the time the sum of squares is rough."""
WIDER: Final = 4.0
"""Beyond the grid's largest distance, as a factor, distances are not followed."""
FINER: Final = 100.0
"""Below its smallest: that an element breaks away before an encoder sees it must not make it break away late."""
STRIBECK: Final = (1e-4, 5.0)
"""Stribeck velocities that a fit follows, over the fastest speed: beyond that, the intervals say what is open."""
MOST_NOISE: Final = 0.5
"""Share of what a column has alone that is taken for noise, at most: more would make its number anything."""
NOTHING: Final = 1e-200
"""Sum of squares of a column of zeros, so that its inverse is finite."""
UNTOLD: Final = 1e-14
"""Of the largest eigenvalue of the information: less is rounding."""


@dataclass(frozen=True, eq=False)
class RecordView:
    """The records at one rate: coarse for choices, fine for the numbers that are reported.

    Attributes:
        rows: all of them.
        motions: of each log.
        noise: of a row [N].
        limits: smallest and largest break-away distance [m].
        steps_inertia: see `Records`; None: no steps of an encoder show.
        misread, thinned: see `Records`.
    """

    rows: Recording
    motions: tuple[ElementMotion, ...]
    noise: float
    limits: tuple[float, float]
    steps_inertia: Array | None = None
    misread: tuple[tuple[ElementMotion, ...], ...] = ()
    thinned: tuple[tuple[ElementMotion, ...], ...] = ()


@dataclass(frozen=True, eq=False)
class Shape:
    """Nonlinear numbers: the law, break-away distances (k) [m], the Stribeck effect (None: none)."""

    law: Law
    distances: Array
    rise: Stribeck | None


@dataclass(frozen=True, eq=False)
class AxisFit(FitLoss):
    """An axis fitted to records.

    Attributes:
        shape: law, distances and rise found.
        levels: of the elements (k) [N].
        terms: other linear ones.
        coefficients: of all columns of the terms (c).
        jacobian: derivatives (m, p) in log D (k), levels (k), beta and log v_s where there is a rise, coefficients (c).
        prior: information of priors (p), in units of the sum of squares.
    """

    shape: Shape
    levels: Array
    terms: tuple[Term, ...]
    coefficients: Array
    jacobian: Array
    prior: Array

    @property
    def coulomb(self) -> float:
        """Sum of the levels [N]."""
        return float(self.levels.sum())

    @property
    def elements(self) -> Array:
        """Deflections over their levels (m, k)."""
        count = len(self.levels)
        return np.asarray(self.jacobian[:, count : 2 * count])

    def sliding(self, velocity: Array) -> Array:
        """Force of the elements over the level they slip at, at these velocities (m) [m/s]: -1 to 1 (m)."""
        rise, coulomb = self.shape.rise or NO_RISE, self.coulomb
        level = coulomb * (1.0 + rise.ratio * np.exp(-((velocity / rise.velocity) ** 2)))
        force = self.elements @ self.levels
        return np.clip(force / level, -1.0, 1.0) if coulomb > 0.0 else np.zeros_like(force)

    def place(self, name: str) -> slice:
        """Return the place of a term's columns in the Jacobian; empty where it is not there."""
        start = self.jacobian.shape[1] - len(self.coefficients)
        for term in self.terms:
            width = term.columns.shape[1]
            if term.name == name and name:
                return slice(start, start + width)
            start += width
        return slice(0, 0)

    def coefficient(self, name: str) -> Array:
        """Coefficients of a term; none where it is not there."""
        place, first = self.place(name), self.jacobian.shape[1] - len(self.coefficients)
        return self.coefficients[place.start - first : place.stop - first] if place.stop else self.coefficients[:0]


@dataclass(frozen=True, eq=False)
class _AxisPoint:
    shape: Shape
    levels: Array
    coefficients: Array
    residual: Array
    nonlinear: Array
    elements: Array
    gram: Array
    cost: float


@dataclass(frozen=True, eq=False)
class _AxisProblem:
    view: RecordView
    terms: tuple[Term, ...]
    seen: Mask
    columns: Array
    positive: Mask
    information: Array
    noise: Array
    known: Array

    def at(self, shape: Shape) -> _AxisPoint:
        """The model at a shape, its linear part solved for on the rows seen."""
        rise = shape.rise or NO_RISE
        runs = run_elements(self.view.motions, shape.law, shape.distances, rise)
        elements, count = runs.chi, len(shape.distances)
        positive = np.concatenate((np.ones(count, dtype=np.bool_), self.positive))
        information = np.concatenate((np.zeros(count), self.information))
        E, (C, y, own, target) = elements.compress(self.seen, axis=0), self._beside
        mixed = E.T @ C
        gram, aim = np.block([[E.T @ E, mixed], [mixed.T, own]]), np.concatenate((E.T @ y, target))
        noise = np.minimum(self.count * self.noise, MOST_NOISE * _own_information(gram, self.noise)[count:])
        aim[count:] += noise * self.known
        b = solve_nonnegative(gram, aim, positive, information - np.concatenate((np.zeros(count), noise)))
        residual = self.view.rows.friction - elements @ b[:count] - self.columns @ b[count:]
        slopes = b[:count, None] * runs.jacobian
        of_rise = slopes[..., 1:].sum(axis=1) if shape.rise is not None else self.columns[:, :0]
        seen = residual[self.seen]
        cost = float(seen @ seen + information @ b**2 - noise @ (self.known + b[count:]) ** 2)
        bent = np.column_stack((slopes[..., 0], of_rise))
        return _AxisPoint(shape, b[:count], b[count:], residual, bent, elements, gram, cost)

    @cached_property
    def _beside(self) -> tuple[Array, Array, Array, Array]:
        """Columns and friction on the rows seen, and their products with the columns: no shape changes them."""
        C, y = self.columns.compress(self.seen, axis=0), self.view.rows.friction[self.seen]
        return C, y, C.T @ C, C.T @ y

    @cached_property
    def count(self) -> int:
        """Residual rows."""
        return int(self.seen.sum())

    def quadratic(self, here: _AxisPoint) -> Quadratic:
        """Return the quadratic model of the cost in log D, beta, log v_s, the linear part solved for."""
        N, E, C = here.nonlinear.compress(self.seen, axis=0), here.elements.compress(self.seen, axis=0), self._beside[0]
        fixed = np.concatenate((here.levels, np.where(self.positive, here.coefficients, 1.0))) == 0.0
        square = np.diag(here.gram)
        scale = np.where(fixed | (square < NOTHING), 0.0, 1.0 / np.sqrt(np.maximum(square, NOTHING)))
        gram = here.gram * np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
        b = scale[:, None] * np.linalg.solve(gram, scale[:, None] * np.concatenate((E.T @ N, C.T @ N)))
        projected = N - E @ b[: E.shape[1]] - C @ b[E.shape[1] :]
        H = projected.T @ projected
        # The linear part is at its optimum: the cost changes with the nonlinear one alone.
        return Quadratic(H, N.T @ here.residual[self.seen], np.zeros(len(H)), np.diag(H))

    def box(self, here: _AxisPoint) -> Box:
        """Return the least and largest change of log D, beta, log v_s: no longer a step, and within the limits."""
        shape, view = here.shape, self.view
        low, high = distance_limits(shape.law, shape.rise, view)
        lower, upper = np.log(low / shape.distances), np.log(high / shape.distances)
        longest = np.full(len(lower), LONGEST)
        if shape.rise is not None:
            slow, fast = stribeck_limits(view)
            ratio, speed = shape.rise.ratio, shape.rise.velocity
            lower = np.append(lower, (-ratio, math.log(slow / speed)))
            upper = np.append(upper, (LARGEST_RISE - ratio, math.log(fast / speed)))
            longest = np.append(longest, (LONGEST * (1.0 + ratio), LONGEST))
        return np.minimum(0.0, np.maximum(lower, -longest)), np.maximum(0.0, np.minimum(upper, longest))

    def after(self, here: _AxisPoint, step: Array) -> _AxisPoint:
        """Return the model after a step of log D, beta, log v_s."""
        shape, count = here.shape, len(here.shape.distances)
        rise = shape.rise
        if rise is not None:
            rise = Stribeck(rise.ratio + float(step[count]), rise.velocity * math.exp(step[count + 1]))
        return self.at(_within(Shape(shape.law, shape.distances * np.exp(step[:count]), rise), self.view))


def _own_information(gram: Array, noise: Array) -> Array:
    """Sum of squares of each column (p) that the others do not explain; 0 of columns without noise (the last ones)."""
    own, first = np.zeros(len(gram)), len(gram) - len(noise)
    if not noise.any():
        return own
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), NOTHING))
    inverse = np.linalg.inv(gram * np.outer(scale, scale) + 1e-9 * np.eye(len(gram)))
    noisy = first + np.flatnonzero(noise)
    own[noisy] = 1.0 / (np.diag(inverse)[noisy] * scale[noisy] ** 2)
    return own


def noise_share(view: RecordView, fit: AxisFit) -> float:
    """Return the encoder's noise in the mass's column over its part unexplained by other columns, squared sums."""
    noise = np.concatenate([np.full(term.columns.shape[1], term.noise) for term in fit.terms])
    if not noise.any():
        return 0.0
    used = view.rows.used
    X = np.column_stack((fit.elements, fit.jacobian[:, -len(noise) :])).compress(used, axis=0)
    own = _own_information(X.T @ X, noise)[-len(noise) :]
    return float(np.max(np.sum(used) * noise[noise > 0.0] / own[noise > 0.0]))


def largest_noise_bias(view: RecordView, fit: AxisFit, name: str) -> float:
    """Return the largest size of a term of one column the encoder's noise in the measured friction can make.

    By Cauchy and Schwarz: that noise over the part of the term's no other column explains, root mean squares.
    """
    used, place = view.rows.used, fit.place(name)
    moved = view.rows.machine.plant.moved + float(fit.coefficient("mass").sum())
    X = fit.jacobian.compress(used, axis=0)
    mask = np.zeros(X.shape[1])
    mask[place] = 1.0
    own = float(_own_information(X.T @ X, mask)[place.start])
    return moved * math.sqrt(view.rows.acceleration_noise * float(np.sum(used)) / own)


def fit_axis(
    view: RecordView, terms: Sequence[Term], start: Shape, seen: Mask | None = None, iterations: int = ITERATIONS
) -> AxisFit:
    """Fit elements and terms to records from a shape on.

    Args:
        view: records at some rate.
        terms: linear ones beside the elements.
        start: law, distances, rise; missing ones are not looked for.
        seen: rows the fit sees (m); None: all used ones.
        iterations: at most.
    """
    widths, columns = [t.columns.shape[1] for t in terms], np.column_stack([t.columns for t in terms])
    each = zip(*((t.positive, t.deviation, t.noise, t.known) for t in terms), strict=True)
    positive, deviation, noise, known = (np.repeat(values, widths) for values in each)
    seen, information = view.rows.used if seen is None else seen, (view.noise / deviation) ** 2
    problem = _AxisProblem(view, tuple(terms), seen, columns, positive, information, noise, known)
    here = problem.at(_within(start, view))
    return _finish(problem, minimise(problem, here, problem.box, iterations, ENOUGH * problem.count, TRIES))


def hold_shape(view: RecordView, fit: AxisFit) -> AxisFit:
    """Return a fit whose cross-validation holds its shape: one that turns within a sample has steep slopes in that."""
    linear = np.any(fit.jacobian != 0.0, axis=0)
    linear[: len(fit.levels)] = False
    linear[2 * len(fit.levels) : len(linear) - len(fit.coefficients)] = False
    return replace(fit, cross=cross_loss(view.rows, fit.jacobian[:, linear], fit.residual, fit.prior[linear]))


def _finish(problem: _AxisProblem, point: _AxisPoint) -> AxisFit:
    rows, count, N = problem.view.rows, len(point.levels), point.nonlinear
    extra = N.shape[1] - count
    jacobian = np.column_stack((N[:, :count], point.elements, N[:, count:], problem.columns))
    prior = np.concatenate((np.zeros(2 * count + extra), problem.information))
    told = ~problem.positive | (point.coefficients != 0.0)
    interior = np.concatenate((np.full(count, True), point.levels != 0.0, np.full(extra, True), told))
    return AxisFit(
        shape=point.shape,
        levels=point.levels,
        terms=problem.terms,
        coefficients=point.coefficients,
        residual=point.residual,
        jacobian=jacobian,
        prior=prior,
        loss=rows.sum_blocks(point.residual**2),
        cross=cross_loss(rows, jacobian[:, interior], point.residual, prior[interior]),
        rows=rows.sum_blocks(np.ones(len(rows.time))),
    )


def _within(shape: Shape, view: RecordView) -> Shape:
    """The shape within the records' resolution, distances in order."""
    rise = shape.rise
    if rise is not None:
        slow, fast = stribeck_limits(view)
        rise = Stribeck(min(max(rise.ratio, 0.0), LARGEST_RISE), min(max(rise.velocity, slow), fast))
    return Shape(shape.law, np.sort(np.clip(shape.distances, *distance_limits(shape.law, rise, view))), rise)


def distance_limits(law: Law, rise: Stribeck | None, view: RecordView) -> tuple[float, float]:
    """Return the smallest and largest break-away distance [m] that a fit follows."""
    low, high = view.limits
    low = max(
        low / FINER, *(least_distance(law, rise or NO_RISE, motion.rate / motion.steps) for motion in view.motions)
    )
    return low, max(low, high * WIDER)


def stribeck_limits(view: RecordView) -> tuple[float, float]:
    """Return the smallest and largest Stribeck velocity [m/s] that a fit follows: no larger than a machine file's."""
    slow, fast = STRIBECK
    return slow * view.rows.extents.speed, min(fast * view.rows.extents.speed, FASTEST_STRIBECK)


def covariance(view: RecordView, fit: AxisFit) -> Array:
    """Covariance (p, p) of log D (k), levels (k), beta and log v_s where there is a rise, and the coefficients.

    Noise and the model's error (`robust_covariance`): its RMS beyond the noise floor, or UNSEEN_ERROR of that,
    which it may hide. And the effect of the encoder's steps and the samples' distance on the numbers: the elements' way
    between them comes out too smooth at every reversal alike, which no average over blocks sees; other lines, and every
    second sample, do as much once more. And the effect of a timing error larger than that of sampling:
    it stands for something else. 0 where a level or a coefficient is fixed at 0.
    """
    rows = view.rows
    interior = np.any(fit.jacobian != 0.0, axis=0)
    X = fit.jacobian[:, interior]
    scale = np.sqrt(np.maximum(np.sum(X[rows.used] ** 2, axis=0) + fit.prior[interior], NOTHING))
    X = X / scale
    H = X[rows.used].T @ X[rows.used] + np.diag(fit.prior[interior] / scale**2)
    values, vectors = np.linalg.eigh(H)
    # Numbers that the records do not tell apart have a variance that says so, not none.
    inverse = np.asarray((vectors / np.maximum(values, UNTOLD * values.max())) @ vectors.T)
    wrong = measure_wrong(view, fit)
    result = np.zeros((len(interior), len(interior)))
    inner = robust_covariance(rows, X, fit.residual, H, inverse, wrong)
    held = fit.place(HELD)
    if held.stop and interior[held].all():
        own = int(np.count_nonzero(interior[: held.start]))
        shift = inverse[own] / inverse[own, own] * _measure_excess(rows, fit) * scale[own]
        inner += np.outer(shift, shift)
    for forces in (encoder_forces(view, fit), [friction_change(view, fit, motions) for motions in view.thinned]):
        for force in forces:
            shift = inverse @ (X[rows.used].T @ force[rows.used])
            inner += np.outer(shift, shift) / len(forces)
    result[np.ix_(interior, interior)] = inner / np.outer(scale, scale)
    return result


def coordinates(fit: AxisFit, terms: Sequence[Term]) -> Array:
    """Return the numbers of a fit in the order of a covariance (p), a sum for each column of these terms."""
    rise = fit.shape.rise
    bent = () if rise is None else (rise.ratio, math.log(rise.velocity))
    sizes = [fit.coefficient(term.name).reshape(-1, term.columns.shape[1]).sum(axis=0) for term in terms]
    return np.concatenate((np.log(fit.shape.distances), fit.levels, bent, *sizes))


def measure_wrong(view: RecordView, fit: AxisFit) -> float:
    """Return the RMS of a fit's error [N]: beyond the noise floor, or a share of that, which may hide it."""
    floor = noise_floor(view.rows, fit.residual)
    return max(math.sqrt(max(0.0, fit.cross_rms**2 - floor**2)), UNSEEN_ERROR * floor)


def _measure_excess(rows: Recording, fit: AxisFit) -> float:
    """Return the excess of a fit's second difference of the force over that of a sample and a delay [s^2]."""
    late, held = (float(np.abs(fit.coefficient(name)).sum()) for name in (LATE, HELD))
    return max(0.0, held - 0.5 * (TIMING * rows.machine.sampling.step + late) ** 2)


def encoder_forces(view: RecordView, fit: AxisFit) -> list[Array]:
    """Return the forces the encoder's steps leave in a residual (m) [N], of each misread way; none: no steps.

    As of a diagnosis: mass times the acceleration they make, and friction along the trajectory they make.
    """
    if view.steps_inertia is None:
        return []
    return misread_forces(view.steps_inertia, [friction_change(view, fit, motions) for motions in view.misread])


def friction_change(view: RecordView, fit: AxisFit, motions: Sequence[ElementMotion]) -> Array:
    """Return the friction of a fit along other ways of all logs, less that along their own (m) [N]."""
    shape, viscous = fit.shape, float(fit.coefficient("viscous").sum())
    runs = run_elements(motions, shape.law, shape.distances, shape.rise or NO_RISE, jacobian=False)
    faster = [
        other.to_rows(other.pick_samples(other.velocity)) - own.to_rows(own.pick_samples(own.velocity))
        for other, own in zip(motions, view.motions, strict=True)
    ]
    return np.asarray((runs.chi - fit.elements) @ fit.levels + viscous * np.concatenate(faster))


@dataclass(frozen=True)
class NumberEstimate:
    """A number and its standard deviation; where it is the mean over records, `spread` is that of theirs about it."""

    value: float
    std: float
    spread: float = 0.0

    @property
    def relative(self) -> float:
        """Standard deviation over the value's size; inf where that is 0."""
        return self.std / abs(self.value) if self.value != 0.0 else math.inf


def quantities(fit: AxisFit, cov: Array) -> dict[str, NumberEstimate]:
    """The friction law's numbers with their deviations, named as in a machine file.

    `coulomb`, `viscous`, `stribeck_ratio`, `stribeck_velocity`, `stiffness_k`, `fraction_k`; missing ones
    are left out. Where all levels are 0 shares have no meaning and are NaN.
    """
    count, level = len(fit.levels), fit.coulomb
    p = len(cov)
    found: dict[str, NumberEstimate] = {}

    def add(name: str, value: float, gradient: Array) -> None:
        found[name] = NumberEstimate(value, math.sqrt(max(float(gradient @ cov @ gradient), 0.0)))  # NaN stays

    total = np.zeros(p)
    total[count : 2 * count] = 1.0
    add("coulomb", level, total)
    for k, (own, distance) in enumerate(zip(fit.levels.tolist(), fit.shape.distances.tolist(), strict=True)):
        stiffness = np.zeros(p)
        stiffness[k], stiffness[count + k] = -own / distance, 1.0 / distance
        add(f"stiffness_{k + 1}", own / distance, stiffness)
        if level > 0.0:
            share = -own / level**2 * total
            share[count + k] += 1.0 / level
            add(f"fraction_{k + 1}", own / level, share)
        else:
            found[f"fraction_{k + 1}"] = NumberEstimate(math.nan, math.nan)
    rise = fit.shape.rise
    if rise is not None:
        for place, name, value, unit in (
            (2 * count, "stribeck_ratio", rise.ratio, 1.0),
            (2 * count + 1, "stribeck_velocity", rise.velocity, rise.velocity),
        ):
            add(name, value, unit * np.eye(p)[place])
    for name in ("viscous", "mass"):
        column = fit.place(name)
        if column.stop:
            add(name, float(fit.coefficient(name)[0]), np.eye(p)[column.start])
    return found
