"""Damped Gauss-Newton (Levenberg-Marquardt) within bounds, of a compiled model along a recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.compiling import CompiledFit
from sgms_mhe.diagnosis.groups import Column
from sgms_mhe.recordings.box import solve_box
from sgms_mhe.recordings.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FIRST_DAMPING: Final = 1e-4
LEAST_DAMPING: Final = 1e-8
DAMPED_AGAIN: Final = 1e-3  # at least, times MORE_DAMPING, after a step that was none
MORE_DAMPING: Final = 30.0
GOOD: Final = 0.25  # share of the promised gain that a good step makes
AFTER_GOOD: Final = 0.1
AFTER_POOR: Final = 3.0
TRIES: Final = 3
RIDGE: Final = 1e-12  # of the largest diagonal term
AT_BOUND: Final = 1e-9
MACHINE_STEP: Final = 0.5
"""Change of the machine's numbers in a step, at most [nominal or present value]: derivatives hold no farther."""
UNSTABLE: Final = 1e6
"""Derivative from which no integration step was short enough [largest friction]: a state that diverges shows in its
derivatives first."""


class FitError(RuntimeError):
    """A model that cannot be fitted to this record: it is not finite where its fit starts."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the free parameters before the record (free).

    Attributes:
        information: in units of the sum of squares; damps a step.
        binding: the same of the machine's own numbers, 0 of effects under test; part of the cost.
        centre: theta that it holds to.
    """

    information: Array
    binding: Array
    centre: Array


@dataclass(frozen=True, eq=False)
class Point:
    """A model at theta (n_p): residual (m) [N], slopes d(model)/d(theta) (m, n_p), cost (inf: not finite there)."""

    theta: Array
    residual: Array
    slopes: Array
    cost: float


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Sum of squared residuals on the rows seen, and the prior.

    Attributes:
        model: its compiled code.
        recording: measured friction, in line with the model.
        seen: rows that count (m).
        free: parameters that are fitted (n_p).
        prior: of those.
    """

    model: CompiledFit
    recording: Recording
    seen: Mask
    free: Mask
    prior: Prior

    def at(self, theta: Array) -> Point:
        """The model at theta (n_p)."""
        recording, free, prior = self.recording, self.free, self.prior
        scale = max(_largest(recording.friction), recording.machine.friction.coulomb)
        largest = UNSTABLE * scale
        y, slopes = self.model.run(recording, theta)
        residual = recording.friction - y
        if not _largest(residual) < largest:
            return Point(theta, residual, np.empty((0, 0)), math.inf)
        seen = residual[self.seen]
        cost = float(seen @ seen) + float(prior.binding @ (theta[free] - prior.centre) ** 2)
        # A state that its steps are too long for shows in its derivatives first.
        if slopes is None or not math.isfinite(cost) or not _largest(slopes) < largest:
            return Point(theta, residual, np.empty((0, 0)), math.inf)
        return Point(theta, residual, slopes, cost)

    def descend(self, theta: Array, iterations: int, enough: float) -> Point:
        """Minimise from theta (n_p), with at most `iterations` steps.

        A step that promises less than the noise of `enough` rows is not worth an evaluation.

        Raises:
            FitError: not finite at theta.
        """
        free, columns, recording = self.free, self.model.columns, self.recording
        lower, upper = (bound[free] for bound in bounds(columns, recording))
        limit = np.array([_step_limit(c, t, recording) for c, t in zip(columns, theta, strict=True)])[free]
        theta = theta.copy()
        theta[free] = np.clip(theta[free], lower, upper)
        here = self.at(theta)
        if not math.isfinite(here.cost):
            raise FitError("the model is not finite where its fit starts")
        if not free.any():
            return here
        damping = FIRST_DAMPING
        for _ in range(iterations):
            present = here.theta[free]
            box = np.maximum(-limit, lower - present), np.minimum(limit, upper - present)
            better, promised, damping = self._step(here, box, damping, enough)
            if better is None:
                break
            gain, least = here.cost - better.cost, enough * here.cost / int(self.seen.sum())
            here = better
            damping = max(LEAST_DAMPING, damping * AFTER_GOOD) if gain > GOOD * promised else damping * AFTER_POOR
            if gain < least:
                break
        return here

    def _step(
        self, here: Point, box: tuple[Array, Array], damping: float, enough: float
    ) -> tuple[Point | None, float, float]:
        """The next point, what it had promised, and the damping that it took; None where no step gains."""
        free, prior = self.free, self.prior
        X = here.slopes.compress(self.seen, axis=0).compress(free, axis=1)  # a third of what masks take
        H = X.T @ X
        g = X.T @ here.residual[self.seen] - prior.binding * (here.theta[free] - prior.centre)
        diagonal = np.diag(H) + prior.information
        least = enough * here.cost / len(X)
        promised = 0.0
        for _ in range(TRIES):
            A = H + np.diag(prior.binding + damping * diagonal + RIDGE * max(1e-30, float(diagonal.max())))
            step = solve_box(A, g, *box)
            theta = self._moved(here.theta, step)
            promised = float(2.0 * g @ step - step @ (H @ step) - prior.binding @ step**2)
            if not promised >= least:
                break
            there = self.at(theta)
            if there.cost < here.cost:
                return there, promised, damping
            damping = max(damping, DAMPED_AGAIN) * MORE_DAMPING
        return None, promised, damping

    def _moved(self, theta: Array, step: Array) -> Array:
        """theta (n_p) after a step of what is free (free).

        Where the force is linear in s and s p, the step is one of s and s p: p + dp s / (s + ds). One along p alone
        would follow a curved valley to a place far outside the travel.
        """
        columns = self.model.columns
        moved = theta.copy()
        moved[self.free] += step
        for i in np.flatnonzero(self.free):
            column = columns[i]
            if not column.times:
                continue
            size = self.model.index(column.group, column.times)
            before, after = (columns[size].si(float(t[size])) for t in (theta, moved))
            if after != 0.0:
                moved[i] = min(max(theta[i] + (moved[i] - theta[i]) * before / after, column.lower), column.upper)
        return moved


def _largest(values: Array) -> float:
    """The largest magnitude (NaN where there is one); without an array of all of them, which takes longer to fill."""
    return max(float(values.max()), -float(values.min()))


def _step_limit(column: Column, theta: float, recording: Recording) -> float:
    """Largest change of theta in one step, beyond which derivatives do not hold."""
    if not column.group.is_extra or column.step is None:
        return MACHINE_STEP * max(1.0, abs(theta))
    scale = abs(column.scale)
    return column.step(column.si(theta), scale, recording.extents) / scale


def bounds(columns: Sequence[Column], recording: Recording) -> tuple[Array, Array]:
    """Bounds of theta: those of the definitions, and nothing that the record cannot tell from something simpler."""
    lower, upper = np.array([c.lower for c in columns]), np.array([c.upper for c in columns])
    for i, column in enumerate(columns):
        if column.least is not None:
            lower[i] = max(lower[i], column.theta(column.least(recording.extents)))
        if column.most is not None:
            upper[i] = min(upper[i], column.theta(column.most(recording.extents)))
            if column.group.kind == "base":  # the machine file's own value stays allowed
                upper[i] = max(lower[i], column.machine_theta, upper[i])
    return lower, upper


def held_at_bounds(columns: Sequence[Column], at: Point, seen: Mask, recording: Recording) -> Mask:
    """Parameters at a bound that the rows seen (m) push them against (n_p)."""
    descent = at.slopes[seen].T @ at.residual[seen]
    lower, upper = bounds(columns, recording)
    near = AT_BOUND * np.maximum(1.0, np.abs(at.theta))
    return np.asarray(((at.theta <= lower + near) & (descent < 0.0)) | ((at.theta >= upper - near) & (descent > 0.0)))
