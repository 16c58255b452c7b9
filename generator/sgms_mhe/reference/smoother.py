"""Full-information smoother: Gauss-Newton over all nodes of a record, iterated to convergence (docs/estimation.md).

The bound no causal estimator beats: the same cost as the moving horizon's, with the initial prior, constant parameters
and the whole record in the window.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, vstack
from scipy.sparse.linalg import splu

from sgms_mhe.reference.least_squares import solve_bounded
from sgms_mhe.reference.problem import NodeRecord, Progress, UpdateStatus, estimates
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.arrays import Array, Mask

MOST_ITERATIONS = 200
# Converged: no unknown's gradient exceeds this part of the product of its column and the residual ...
GRADIENT_TOLERANCE = 1e-9
# ... or a step promises less than this part of the cost.
COST_TOLERANCE = 1e-14
FIRST_DAMPING = 1e-3
SMALLEST_DAMPING = 1e-8
LARGEST_DAMPING = 1e12


@dataclass(frozen=True)
class _SmootherProblem:
    """Cost, Jacobian by the states and by theta, residual, at one point."""

    cost: float
    J_x: csc_matrix
    J_t: Array
    r: Array


def run_smoother(record: NodeRecord, progress: Progress | None = None) -> Estimates:
    """Smooth a record; every row of the result holds the same parameters and the state at its own node."""
    weights, model = record.weights, record.model
    n_x, updates = model.n_x, record.updates
    theta = np.ones(model.n_p)
    if updates == 0:
        nothing = np.empty((0, model.n_p))
        return estimates(record, np.empty((0, n_x)), nothing, nothing, np.empty(0, dtype=np.int64))
    x = _simulate(record, theta)
    problem = _linearise(record, x, theta)
    if not np.isfinite(problem.cost):
        raise ArithmeticError("smoother: the model's own motion along the record is not finite")
    damping, growth = 0.0, 4.0
    is_active = np.zeros(model.n_p, dtype=np.bool_)
    for iteration in range(MOST_ITERATIONS):
        if _is_stationary(problem, is_active):
            break
        dx, dtheta, is_active = _step(record, problem, theta, damping)
        linear = problem.J_x @ dx.ravel() + problem.J_t @ dtheta + problem.r
        promised = problem.cost - float(linear @ linear)
        if promised <= COST_TOLERANCE * problem.cost:
            break
        new_x, new_theta = x + dx, np.clip(theta + dtheta, weights.lower, weights.upper)
        new = _linearise(record, new_x, new_theta)
        ratio = (problem.cost - new.cost) / promised
        if ratio > 0.0:
            x, theta, problem = new_x, new_theta, new
            # Nielsen's rule: a cost that falls as promised damps the next step less.
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
            damping, growth = (damping if damping > SMALLEST_DAMPING else 0.0), 2.0
        else:
            damping, growth = max(growth * damping, FIRST_DAMPING), 2.0 * growth
        if progress is not None:
            progress(iteration + 1, MOST_ITERATIONS)
        if damping > LARGEST_DAMPING:
            break
    _, _, information = _condense(problem, 0.0)
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    status = np.array([record.status(node) for node in range(1, updates + 1)], dtype=np.int64)
    status |= int(UpdateStatus.BOUND) if is_active.any() else 0
    rows = (updates, 1)
    result = estimates(record, x[1:].reshape(updates, n_x), np.tile(theta, rows), np.tile(std, rows), status)
    # The state at sample 0 has no row: the first update is at node 1.
    return replace(result, extra={**result.extra, "x_first": x[0]})


def _is_stationary(problem: _SmootherProblem, is_active: Mask) -> bool:
    length = float(np.sqrt(problem.cost))
    columns = np.sqrt(np.asarray(problem.J_x.multiply(problem.J_x).sum(axis=0)).ravel())
    by_states = np.abs(problem.J_x.T @ problem.r) / np.maximum(columns * length, 1e-300)
    by_theta = np.abs(problem.J_t.T @ problem.r) / (np.linalg.norm(problem.J_t, axis=0) * max(length, 1e-300))
    return bool(max(by_states.max(), np.max(by_theta[~is_active], initial=0.0)) < GRADIENT_TOLERANCE)


def _simulate(record: NodeRecord, theta: Array) -> Array:
    x = np.zeros((record.updates + 1, record.model.n_x))
    for k in range(record.updates):
        x[k + 1] = record.integrator.intervals(record.plan, k, x[k : k + 1], theta).x1[0]
    return x


def _linearise(record: NodeRecord, x: Array, theta: Array) -> _SmootherProblem:
    weights = record.weights
    n_x, n_p, nodes = record.model.n_x, record.model.n_p, record.updates + 1
    valid = np.flatnonzero(record.valid)
    sigma, inner_sigma = weights.sigma_y * record.noise, weights.sigma_y * record.inner_noise
    with np.errstate(all="ignore"):
        intervals = record.integrator.intervals(record.plan, 0, x[:-1], theta)
        outputs = record.integrator.outputs(x, record.w, theta)
        r = np.concatenate(
            [
                x[0] / weights.initial_state,
                (theta - 1.0) / weights.parameter,
                ((outputs.y - record.y) / sigma)[valid],
                ((intervals.inner.y - record.inner_y) / inner_sigma)[record.inner_valid],
                ((x[1:] - intervals.x1) / record.sigma_x).ravel(),
            ]
        )
    if not np.all(np.isfinite(r)):
        return _SmootherProblem(np.inf, csc_matrix((0, 0)), np.empty((0, n_p)), r)
    width = nodes * n_x
    first = csc_matrix((1.0 / weights.initial_state, (np.arange(n_x), np.arange(n_x))), shape=(n_x, width))
    measured = _block_diagonal((outputs.C / sigma[:, None])[:, None, :], width)[valid]
    # Measurements inside an interval see the node where it starts.
    inner = _block_diagonal(intervals.inner.C / inner_sigma[:, :, None], width)[record.inner_valid.ravel()]
    scale = 1.0 / record.sigma_x.ravel()
    ends = csr_matrix((scale, (np.arange(width - n_x), np.arange(n_x, width))), shape=(width - n_x, width))
    defects = ends - _block_diagonal(intervals.A / record.sigma_x[:, :, None], width)
    J_x = vstack([first, csc_matrix((n_p, width)), measured, inner, defects], format="csc")
    J_t = np.vstack(
        [
            np.zeros((n_x, n_p)),
            np.diag(1.0 / weights.parameter),
            (outputs.D / sigma[:, None])[valid],
            (intervals.inner.D / inner_sigma[:, :, None])[record.inner_valid],
            -(intervals.B / record.sigma_x[:, :, None]).reshape(-1, n_p),
        ]
    )
    return _SmootherProblem(float(r @ r), J_x, J_t, r)


def _block_diagonal(blocks: Array, width: int) -> csr_matrix:
    """Blocks (n, rows, columns) along the diagonal of a matrix with so many columns."""
    n, rows, columns = blocks.shape
    row, column = np.arange(n * rows).reshape(n, rows, 1), np.arange(n * columns).reshape(n, 1, columns)
    at = tuple(np.broadcast_to(index, blocks.shape).ravel() for index in (row, column))
    return csr_matrix((blocks.ravel(), at), shape=(n * rows, width))


def _condense(problem: _SmootherProblem, damping: float) -> tuple[Array, Array, Array]:
    """States as a function of theta's step, dx = d0 + D dtheta, and theta's information without the states."""
    normal = (problem.J_x.T @ problem.J_x).tocsc()
    if damping > 0.0:
        normal = normal + damping * diags(normal.diagonal(), format="csc")
    right = -problem.J_x.T @ np.column_stack([problem.r, problem.J_t])
    solution = splu(normal).solve(right)
    d0, D = solution[:, 0], solution[:, 1:]
    rest = problem.J_x @ D + problem.J_t
    information = problem.J_t.T @ rest
    return d0, D, 0.5 * (information + information.T)


def _step(record: NodeRecord, problem: _SmootherProblem, theta: Array, damping: float) -> tuple[Array, Array, Mask]:
    weights = record.weights
    d0, D, information = _condense(problem, damping)
    gradient = problem.J_t.T @ (problem.J_x @ d0 + problem.r)
    information = information + damping * np.diag(np.diag(information))
    R = np.asarray(np.linalg.cholesky(information).T, dtype=np.float64)
    dtheta, is_active = solve_bounded(R, np.linalg.solve(R.T, gradient), weights.lower - theta, weights.upper - theta)
    return (d0 + D @ dtheta).reshape(record.updates + 1, -1), dtheta, is_active
