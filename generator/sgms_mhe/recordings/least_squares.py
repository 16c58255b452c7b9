"""Least squares of fits: an exact step over a box, and the damped Gauss-Newton (Levenberg-Marquardt) that takes it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear, nnls

from sgms_mhe.support.arrays import TINY, Array, Mask

Box = tuple[Array, Array]
"""Least and largest step (p)."""

FIRST_DAMPING: Final = 1e-4
LEAST_DAMPING: Final = 1e-8
DAMPED_AGAIN: Final = 1e-3
"""Damping, at least, times MORE_DAMPING, after a step that gained nothing."""
MORE_DAMPING: Final = 30.0
GOOD: Final = 0.25
"""Share of the promised gain that a good step makes."""
AFTER_GOOD: Final = 0.1
AFTER_POOR: Final = 3.0
TRIES: Final = 3
"""Dampings that are tried for a step."""
RIDGE: Final = 1e-12
"""Of the largest diagonal term: keeps a step finite in a direction without excitation."""
COMMON_RIDGE: Final = 1e-8
"""Of the diagonal of normal equations: columns that are the same to so many digits share what they explain."""


class Point(Protocol):
    """A model at some numbers, and its cost: the sum of squares with its prior, inf where it is not finite."""

    @property
    def cost(self) -> float:
        """Sum of squares and prior."""


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Quadratic model of a cost about a point: cost - 2 g's + s'(H + diag(binding)) s of a step s.

    Attributes:
        H: X'X (p, p).
        g: X'e less the prior's pull (p).
        binding: information of the prior, a part of the cost (p).
        diagonal: scale of the damping (p).
    """

    H: Array
    g: Array
    binding: Array
    diagonal: Array


P = TypeVar("P", bound=Point)


class Problem(Protocol[P]):
    """A sum of squares to be minimised."""

    @property
    def count(self) -> int:
        """Residual rows."""

    def quadratic(self, here: P) -> Quadratic:
        """Return the quadratic model about a point."""

    def after(self, here: P, step: Array) -> P:
        """Return the point a step (p) leads to."""


def minimise(
    problem: Problem[P], here: P, box: Callable[[P], Box], iterations: int, enough: float, tries: int = TRIES
) -> P:
    """Minimise a sum of squares by Gauss-Newton steps, each exact over its box, damped where they gain nothing.

    Args:
        problem: the sum of squares.
        here: where it starts, its cost finite.
        box: of the step from a point.
        iterations: steps, at most.
        enough: a step that promises less than the noise of so many rows is not worth an evaluation.
        tries: dampings for a step.
    """
    damping = FIRST_DAMPING
    for _ in range(iterations):
        found = _step(problem, here, box(here), damping, enough, tries)
        if found is None:
            break
        better, promised, damping = found
        gain, least = here.cost - better.cost, enough * here.cost / problem.count
        here = better
        damping = max(LEAST_DAMPING, damping * AFTER_GOOD) if gain > GOOD * promised else damping * AFTER_POOR
        if gain < least:
            break
    return here


def _step(
    problem: Problem[P], here: P, box: Box, damping: float, enough: float, tries: int
) -> tuple[P, float, float] | None:
    """Return the next point, the gain that was promised and the damping it took; None where no step gains."""
    model = problem.quadratic(here)
    H, g, binding, diagonal = model.H, model.g, model.binding, model.diagonal
    least = enough * here.cost / problem.count
    for _ in range(tries):
        A = H + np.diag(binding + damping * diagonal + RIDGE * max(1e-30, float(diagonal.max())))
        step = solve_box(A, g, *box)
        promised = float(2.0 * g @ step - step @ (H @ step) - binding @ step**2)
        if not promised >= least:
            break
        there = problem.after(here, step)
        if there.cost < here.cost:
            return there, promised, damping
        damping = max(damping, DAMPED_AGAIN) * MORE_DAMPING
    return None


def solve_box(A: Array, g: Array, lower: Array, upper: Array) -> Array:
    """Return argmin s'As/2 - g's subject to lower <= s <= upper.

    Where the free minimum leaves the box, it is bounded least squares of the Cholesky factor, |R s - R^-T g|^2, by
    the active-set method of Stark and Parker (1995). Clipping to the box instead can promise a negative gain.

    Args:
        A: symmetric, positive definite (n, n).
        g: (n).
        lower, upper: ends of the box (n), lower <= 0 <= upper, infinite where there is none.

    Returns:
        s (n).

    Raises:
        numpy.linalg.LinAlgError: A is not positive definite.
    """
    scale = 1.0 / np.sqrt(np.diag(A))
    R = np.linalg.cholesky(A * np.outer(scale, scale)).T
    q = solve_triangular(R, g * scale, trans="T")
    free = scale * solve_triangular(R, q)
    if np.all((free >= lower) & (free <= upper)):
        return np.asarray(free)
    moves = np.flatnonzero(upper > lower)
    s = lower.copy()
    if len(moves):
        fixed = np.where(upper > lower, 0.0, lower) / scale
        box = lower[moves] / scale[moves], upper[moves] / scale[moves]
        found = lsq_linear(R[:, moves], q - R @ fixed, box, method="bvls", tol=1e-12, max_iter=20 * len(moves))
        inside = np.clip(scale[moves] * found.x, lower[moves], upper[moves])
        s[moves] = np.select([found.active_mask < 0, found.active_mask > 0], [lower[moves], upper[moves]], inside)
    return s


def solve_nonnegative(gram: Array, moment: Array, positive: Mask, information: Array) -> Array:
    """Return argmin |y - X b|^2 + sum_j information_j b_j^2 with b_j >= 0 where positive: convex, no start decides it.

    Args:
        gram: X'X (p, p).
        moment: X'y (p).
        positive: coefficients that are at least 0 (p).
        information: of the prior (p).

    Returns:
        b (p); 0 where a column is.
    """
    diagonal = np.diag(gram)
    scale = np.where(diagonal > TINY, 1.0 / np.sqrt(np.maximum(diagonal, TINY)), 0.0)
    A = gram * np.outer(scale, scale) + np.diag(information * scale**2 + COMMON_RIDGE + (scale == 0.0))
    # Free coefficients first: the rest of the triangle is then a problem of its own, |R s - q| of the others alone.
    order, free = np.argsort(positive, kind="stable"), int(np.sum(~positive))
    R = np.linalg.cholesky(A[np.ix_(order, order)]).T
    q = solve_triangular(R, (moment * scale)[order], trans="T")
    s = nnls(R[free:, free:], q[free:])[0] if free < len(q) else q[free:]  # without a column it ends the process
    b = np.empty_like(q)
    b[order] = np.append(solve_triangular(R[:free, :free], q[:free] - R[:free, free:] @ s), s)
    return np.asarray(b * scale)
