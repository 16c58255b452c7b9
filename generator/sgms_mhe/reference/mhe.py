"""Moving horizon estimation from the dense residual and Jacobian of the whole window (docs/estimation.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from sgms_mhe.reference.least_squares import solve_bounded, triangular_factor
from sgms_mhe.reference.linearised import Linearised, Outputs
from sgms_mhe.reference.problem import NOT_FINITE, Progress, Record, Status, estimates
from sgms_mhe.signals.estimates import Estimates

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arrival:
    """Mean and covariance of (x, theta) at the oldest node of the window, from all that lies before it."""

    mean: Array
    covariance: Array


@dataclass(frozen=True)
class Window:
    """One update's problem, linearised at (x, theta): n intervals, n + 1 nodes, the oldest one `first`."""

    first: int
    x: Array
    theta: Array
    intervals: Linearised
    outputs: Outputs


class Kept(NamedTuple):
    """Affine maps of n intervals, oldest first, as they were made; each state's row has a point of its own.

    Attributes:
        x: node at the start of the interval that a state's row was linearised at (n, n_x, n_x).
        theta: parameters that it was linearised at (n, n_x, n_p).
        x1: where the state ended there (n, n_x).
        A: its sensitivities to the node at the start, there (n, n_x, n_x).
        B: its sensitivities to the parameters, there (n, n_x, n_p).
    """

    x: Array
    theta: Array
    x1: Array
    A: Array
    B: Array

    @classmethod
    def of(cls, x: Array, theta: Array, intervals: Linearised) -> Kept:
        """Intervals from the nodes x (n, n_x), all rows linearised there and at theta (n_p)."""
        n, n_x = x.shape
        return cls(np.tile(x[:, None, :], (1, n_x, 1)), np.tile(theta, (n, n_x, 1)), *intervals)

    @classmethod
    def none(cls, n_x: int, n_p: int) -> Kept:
        """No interval yet."""
        empty = Linearised(np.empty((0, n_x)), np.empty((0, n_x, n_x)), np.empty((0, n_x, n_p)))
        return cls.of(np.empty((0, n_x)), np.empty(n_p), empty)

    def moves(self, x: Array, theta: Array) -> Array:
        """Move of each end when nodes and parameters go from the linearisations' to (x, theta): (n, n_x)."""
        by_x = np.einsum("kij,kij->ki", self.A, x[:, None, :] - self.x)
        return np.asarray(by_x + np.einsum("kij,kij->ki", self.B, theta - self.theta))

    def at(self, x: Array, theta: Array) -> Linearised:
        """The affine maps, written about (x, theta)."""
        return Linearised(self.x1 + self.moves(x, theta), self.A, self.B)

    def renewed(self, k: int, states: tuple[int, ...], fresh: Kept) -> Kept:
        """With the rows of some states of interval k as they are in `fresh`, which is that interval alone."""
        renewed = Kept(*(array.copy() for array in self))
        for array, new in zip(renewed, fresh, strict=True):
            array[k, states] = new[0, states]
        return renewed

    def with_newer(self, newest: Kept) -> Kept:
        """With further intervals at the newer end."""
        return Kept(*(np.concatenate(pair) for pair in zip(self, newest, strict=True)))

    def part(self, first: int, last: int) -> Kept:
        """Intervals first to last - 1."""
        return Kept(*(array[first:last] for array in self))


def run_mhe(record: Record, progress: Progress | None = None) -> Estimates:
    """One Gauss-Newton iteration per update, window by window."""
    weights, model = record.weights, record.model
    n_x, n_p, updates = model.n_x, model.n_p, record.updates
    is_riccati = model.machine.estimator.arrival_cost.update == "riccati"

    relinearise = model.machine.estimator.relinearise
    kept = Kept.none(n_x, n_p)
    # Since theta last drifted: shifts of the window, and those of them whose interval had moved.
    shifts = owed = 0
    arrival = prior = Arrival(*weights.prior)
    x, theta = prior.mean[None, :n_x], prior.mean[n_x:]
    std = weights.parameter
    active = np.zeros(n_p, dtype=np.bool_)
    results = np.empty((updates, n_x)), np.empty((updates, n_p)), np.empty((updates, n_p))
    statuses = np.empty(updates, dtype=np.int64)
    for node in range(1, updates + 1):
        # x holds the nodes of the last solution that stay in the window.
        first = node - len(x)
        if relinearise == "all":
            window = linearise(record, first, x, theta)
        else:
            if relinearise == "auto":
                kept = renew(record, first, kept, x[:-1], theta)
            kept = kept.with_newer(Kept.of(x[-1:], theta, integrate(record, node - 1, x[-1:], theta)))
            window = window_of(record, first, x, theta, kept.at(x, theta))
        is_full = len(x) == weights.horizon
        status = record.status(node) | (0 if is_full else Status.FILLING)
        try:
            solution = _solve(record, window, arrival, active)
        except np.linalg.LinAlgError:
            solution = None
        if solution is None:
            # Keep the last good estimate and start again from it with the prior's covariance.
            status = NOT_FINITE
            x, arrival = x[-1:], Arrival(np.concatenate([x[-1], theta]), prior.covariance)
            kept = Kept.none(n_x, n_p)
            shifts = owed = 0
        else:
            x, theta, std, active = solution
            status |= Status.BOUND if active.any() else 0
            if is_full:
                x, kept = x[1:], kept.part(1, len(kept.x))
                if is_riccati:
                    shifts, owed = shifts + 1, owed + record.moves(window.first)
                    is_due = shifts == weights.drift_interval
                    arrival = arrival_update(record, arrival, window, owed if is_due else 0)
                    if is_due:
                        shifts = owed = 0
                else:
                    spread = np.concatenate([weights.sigma_x, weights.parameter])
                    arrival = Arrival(np.concatenate([x[0], theta]), np.diag(spread**2))
        for store, value in zip(results, (x[-1], theta, std), strict=True):
            store[node - 1] = value
        statuses[node - 1] = status
        if progress is not None:
            progress(node, updates)
    return estimates(record, *results, statuses)


def linearise(record: Record, first: int, x: Array, theta: Array) -> Window:
    """Integrate from every node of x; the newest node starts where the newest interval leads."""
    return window_of(record, first, x, theta, integrate(record, first, x, theta))


def integrate(record: Record, first: int, x: Array, theta: Array) -> Linearised:
    """Intervals from the nodes x, the first of them from node `first`."""
    with np.errstate(all="ignore"):
        return record.integrator.intervals(record.plan, first, x, theta)


def renew(record: Record, first: int, kept: Kept, x: Array, theta: Array) -> Kept:
    """Linearise anew at (x, theta) the blocks of intervals whose ends have moved too far, those that moved most.

    Of n intervals, at the nodes x (n, n_x) where they start; at most as many blocks as an interval has, or two.
    """
    blocks = record.integrator.blocks
    moved = np.abs(kept.moves(x, theta)) / record.weights.move
    by_block = np.stack([np.max(moved[:, block.states], axis=1) for block in blocks], axis=1)
    most_first = np.argsort(-by_block, axis=None, kind="stable")[: max(2, len(blocks))]
    chosen = [(int(i) // len(blocks), int(i) % len(blocks)) for i in most_first if by_block.flat[i] > 1.0]
    for k in {k for k, _ in chosen}:
        start = x[k : k + 1]
        fresh = Kept.of(start, theta, integrate(record, first + k, start, theta))
        states = sorted({state for interval, b in chosen if interval == k for state in blocks[b].states})
        kept = kept.renewed(k, tuple(states), fresh)
    return kept


def window_of(record: Record, first: int, x: Array, theta: Array, intervals: Linearised) -> Window:
    """The problem about (x, theta) and the end of the newest interval, outputs linearised there."""
    with np.errstate(all="ignore"):
        nodes = np.vstack([x, intervals.x1[-1:]])
        outputs = record.integrator.outputs(nodes, record.w[first : first + len(nodes)], theta)
    return Window(first, nodes, theta, intervals, outputs)


def dense_problem(record: Record, window: Window, arrival: Arrival) -> tuple[Array, Array]:
    """Jacobian J and residual r of the window, so that the step d of (x_0, ..., x_n, theta) minimises |J d + r|^2.

    Rows: arrival cost, then per node its measurement (if valid) and per interval its defect (paper, equations 10, 12).
    """
    weights = record.weights
    nodes, n_x = window.x.shape
    n_p = len(window.theta)
    columns = nodes * n_x + n_p
    at_theta = slice(nodes * n_x, columns)

    # R_a' R_a is the inverse of the covariance.
    R_a = np.linalg.inv(np.linalg.cholesky(arrival.covariance))
    J_a = np.zeros((n_x + n_p, columns))
    J_a[:, :n_x], J_a[:, at_theta] = R_a[:, :n_x], R_a[:, n_x:]
    jacobians, residuals = [J_a], [R_a @ (np.concatenate([window.x[0], window.theta]) - arrival.mean)]
    for k in range(nodes):
        at_node = slice(k * n_x, (k + 1) * n_x)
        if record.valid[window.first + k]:
            row = np.zeros((1, columns))
            row[0, at_node], row[0, at_theta] = window.outputs.C[k], window.outputs.D[k]
            jacobians.append(row / weights.sigma_y)
            residuals.append((window.outputs.y[k : k + 1] - record.y[window.first + k]) / weights.sigma_y)
        if k + 1 < nodes:
            block = np.zeros((n_x, columns))
            block[:, at_node], block[:, at_theta] = -window.intervals.A[k], -window.intervals.B[k]
            block[:, (k + 1) * n_x : (k + 2) * n_x] = np.eye(n_x)
            jacobians.append(block / weights.sigma_x[:, None])
            residuals.append((window.x[k + 1] - window.intervals.x1[k]) / weights.sigma_x)
    return np.vstack(jacobians), np.concatenate(residuals)


def _solve(
    record: Record, window: Window, arrival: Arrival, active: NDArray[np.bool_]
) -> tuple[Array, Array, Array, NDArray[np.bool_]] | None:
    """(x, theta, std of theta, bounds active) of one update; None where it is not finite."""
    weights = record.weights
    nodes, n_x = window.x.shape
    n_p = len(window.theta)
    J, r = dense_problem(record, window, arrival)
    if not (np.all(np.isfinite(J)) and np.all(np.isfinite(r))):
        return None
    R, b = triangular_factor(J, r)
    step = np.asarray(solve_triangular(R, b))
    # theta is last, so the last rows of the factor are its information.
    R_t = R[-n_p:, -n_p:]
    std = np.sqrt(np.sum(np.linalg.inv(R_t) ** 2, axis=1))
    theta = window.theta + step[-n_p:]
    is_active = np.zeros(n_p, dtype=np.bool_)
    if np.any((theta < weights.lower) | (theta > weights.upper)):
        lower, upper = np.full(len(step), -np.inf), np.full(len(step), np.inf)
        lower[-n_p:], upper[-n_p:] = weights.lower - window.theta, weights.upper - window.theta
        guess = np.concatenate([np.zeros(nodes * n_x, dtype=np.bool_), active])
        step, is_held = solve_bounded(J, r, lower, upper, guess)
        is_active = is_held[-n_p:]
        theta = np.clip(window.theta + step[-n_p:], weights.lower, weights.upper)
    x = window.x + step[:-n_p].reshape(nodes, n_x)
    # An older node that is not finite is found by the next update.
    if not (weights.is_plausible(x[-1]) and np.all(np.isfinite(theta)) and np.all(np.isfinite(std))):
        return None
    return x, theta, std, is_active


def arrival_update(record: Record, arrival: Arrival, window: Window, owed: int) -> Arrival:
    """Kalman update and prediction of (x, theta) over the interval that leaves, linearised as the window was.

    Covariance form: measurement of the oldest node (Joseph), prediction with state noise, then the drift of theta that
    is owed for so many intervals.
    """
    weights, n_x = record.weights, window.x.shape[1]
    point = np.concatenate([window.x[0], window.theta])
    mean, P = arrival.mean, arrival.covariance
    if record.valid[window.first]:
        C = np.concatenate([window.outputs.C[0], window.outputs.D[0]])
        innovation = record.y[window.first] - window.outputs.y[0] - C @ (mean - point)
        mean, P = measurement_update(mean, P, C, float(innovation), weights.sigma_y)
    F = np.eye(len(mean))
    F[:n_x, :n_x], F[:n_x, n_x:] = window.intervals.A[0], window.intervals.B[0]
    image = np.concatenate([window.intervals.x1[0], window.theta])
    mean, P = image + F @ (mean - point), F @ P @ F.T
    growth = np.concatenate([weights.sigma_x**2, weights.drift_variance(np.diag(P)[n_x:], owed)])
    P = P + np.diag(growth)
    return Arrival(mean, 0.5 * (P + P.T))


def measurement_update(mean: Array, P: Array, C: Array, innovation: float, sigma: float) -> tuple[Array, Array]:
    """Kalman update of a scalar measurement in Joseph's form, which keeps P positive definite."""
    gain = P @ C / (C @ P @ C + sigma**2)
    keep = np.eye(len(mean)) - np.outer(gain, C)
    return mean + gain * innovation, keep @ P @ keep.T + sigma**2 * np.outer(gain, gain)
