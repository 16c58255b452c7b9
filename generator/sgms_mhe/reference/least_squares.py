"""Dense linear least squares with bounds on some unknowns, proven optimal by its KKT conditions."""

import numpy as np
import osqp
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear
from scipy.sparse import csc_matrix

from sgms_mhe.support.arrays import Array, Mask

# A multiplier has the wrong sign when it exceeds this part of what its column could produce.
KKT_TOLERANCE = 1e-11
LARGEST_CORRECTION = 60


def triangular_factor(J: Array, r: Array) -> tuple[Array, Array]:
    """(R, b) of the orthogonal condensing of J d + r: min |J d + r| is R d = b."""
    n = J.shape[1]
    R: Array = np.asarray(np.linalg.qr(np.column_stack([J, r]), mode="r"))
    return R[:n, :n], -R[:n, n]


def solve(J: Array, r: Array) -> Array:
    """argmin |J d + r|^2 by an orthogonal factorisation; J has full column rank."""
    R, b = triangular_factor(J, r)
    return np.asarray(solve_triangular(R, b))


def solve_bounded(J: Array, r: Array, lower: Array, upper: Array, guess: Mask | None = None) -> tuple[Array, Mask]:
    """argmin |J d + r|^2 subject to lower <= d <= upper, and which unknowns stand at a bound.

    OSQP proposes the active set; an equality-constrained solve makes it exact, and the answer is returned only when its
    KKT conditions hold. `guess` is an active set worth trying first.

    Raises:
        ArithmeticError: no candidate satisfied the KKT conditions.
    """
    free = solve(J, r)
    if np.all((free >= lower) & (free <= upper)) or not np.all(np.isfinite(free)):
        return free, np.zeros(len(free), dtype=np.bool_)
    candidates = [] if guess is None else [np.where(free > upper, upper, np.where(free < lower, lower, np.nan))]
    if guess is not None:
        candidates[0][~guess] = np.nan
    for candidate in candidates:
        found = _refine(J, r, lower, upper, candidate, corrections=0)
        if found is not None:
            return found
    for propose in (_osqp, _bvls):
        fixed = propose(J, r, lower, upper)
        found = _refine(J, r, lower, upper, fixed, corrections=LARGEST_CORRECTION)
        if found is not None:
            return found
    raise ArithmeticError("bounded least squares: no active set satisfies the KKT conditions")


def _refine(
    J: Array, r: Array, lower: Array, upper: Array, fixed: Array, corrections: int
) -> tuple[Array, Mask] | None:
    """Solve with the unknowns of `fixed` (NaN: free) fixed, correct the active set, and prove the answer.

    None where an active set came back or corrections ran out.
    """
    norms = np.linalg.norm(J, axis=0)
    fixed = fixed.copy()
    seen: set[bytes] = set()
    for _ in range(corrections + 1):
        active = np.isfinite(fixed)
        d = np.where(active, fixed, 0.0)
        if not active.all():
            d[~active] = solve(J[:, ~active], r + J[:, active] @ d[active])
        residual = J @ d + r
        gradient = J.T @ residual / (norms * max(float(np.linalg.norm(residual)), 1e-300))
        wrong = np.where(active & (fixed == lower), -gradient, np.where(active & (fixed == upper), gradient, 0.0))
        if np.any(outside := (d < lower) | (d > upper)):
            fixed = np.where(outside, np.where(d < lower, lower, upper), fixed)
        elif wrong.max() > KKT_TOLERANCE:
            fixed[int(np.argmax(wrong))] = np.nan
        else:
            return d, active
        key = np.nan_to_num(fixed, nan=1e300).tobytes()
        if key in seen:
            return None
        seen.add(key)
    return None


def _osqp(J: Array, r: Array, lower: Array, upper: Array) -> Array:
    """Values of the unknowns that OSQP leaves at a bound, NaN elsewhere; columns scaled to unit length."""
    norms = np.linalg.norm(J, axis=0)
    scaled = J / norms
    rows = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    selection = csc_matrix((np.ones(len(rows)), (np.arange(len(rows)), rows)), shape=(len(rows), J.shape[1]))
    problem = osqp.OSQP()
    problem.setup(
        csc_matrix(np.triu(scaled.T @ scaled)),
        scaled.T @ r,
        selection,
        lower[rows] * norms[rows],
        upper[rows] * norms[rows],
        verbose=False,
        eps_abs=1e-12,
        eps_rel=1e-12,
        max_iter=20000,
        polishing=True,
    )
    result = problem.solve(raise_error=False)
    fixed = np.full(J.shape[1], np.nan)
    if result.x is None or not np.all(np.isfinite(result.x)):
        return fixed
    # A positive multiplier belongs to an upper bound.
    multiplier = np.asarray(result.y)
    threshold = 1e-9 * max(1.0, float(np.max(np.abs(multiplier), initial=0.0)))
    fixed[rows] = np.where(multiplier > threshold, upper[rows], np.where(multiplier < -threshold, lower[rows], np.nan))
    return fixed


def _bvls(J: Array, r: Array, lower: Array, upper: Array) -> Array:
    result = lsq_linear(J, -r, (lower, upper), method="bvls", tol=1e-14, max_iter=10 * J.shape[1])
    return np.where(result.active_mask < 0, lower, np.where(result.active_mask > 0, upper, np.nan))
