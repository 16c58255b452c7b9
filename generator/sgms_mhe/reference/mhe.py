"""Moving horizon estimation from the dense residual and Jacobian of the whole window (docs/estimation.md)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from sgms_mhe.reference.least_squares import solve_bounded, triangular_factor
from sgms_mhe.reference.linearised import Linearised, Outputs
from sgms_mhe.reference.problem import CLEARLY, NOT_FINITE, NodeRecord, Progress, UpdateStatus, estimates
from sgms_mhe.reference.readings import Gaussian, MeasurementResult, Scaling, fold
from sgms_mhe.reference.window import (
    NoiseFactors,
    Taken,
    Window,
    integrate,
    linearise,
    predict,
    take_interval,
    window_of,
)
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.arrays import Array, Mask


class StoredIntervals(NamedTuple):
    """Affine maps of n intervals, oldest first, each as it was made.

    Attributes:
        x: node at the start an interval was linearised at (n, n_x).
        theta: parameters it was linearised at (n, n_p).
        intervals: the maps.
    """

    x: Array
    theta: Array
    intervals: Linearised

    @classmethod
    def of(cls, x: Array, theta: Array, intervals: Linearised) -> StoredIntervals:
        """Intervals from the nodes x (n, n_x), all linearised there and at theta (n_p)."""
        return cls(x, np.tile(theta, (len(x), 1)), intervals)

    def moves(self, x: Array, theta: Array) -> Array:
        """Move of each end when nodes and parameters go from the linearisations' to (x, theta): (n, n_x)."""
        _, A, B, _ = self.intervals
        return np.asarray(np.einsum("kij,kj->ki", A, x - self.x) + np.einsum("kij,kj->ki", B, theta - self.theta))

    def at(self, x: Array, theta: Array) -> Linearised:
        """The affine maps, written about (x, theta)."""
        x1, A, B, (y, C, D) = self.intervals
        y = y + np.einsum("krj,kj->kr", C, x - self.x) + np.einsum("krj,kj->kr", D, theta - self.theta)
        return Linearised(x1 + self.moves(x, theta), A, B, Outputs(y, C, D))

    def renew(self, k: int, fresh: StoredIntervals) -> StoredIntervals:
        """With interval k as it is in `fresh`, which is that interval alone."""
        return self.part(0, k).append(fresh).append(self.part(k + 1, len(self.x)))

    def append(self, newest: StoredIntervals) -> StoredIntervals:
        """With further intervals at the newer end."""
        x, theta = np.concatenate([self.x, newest.x]), np.concatenate([self.theta, newest.theta])
        return StoredIntervals(x, theta, Linearised.join_parts([self.intervals, newest.intervals]))

    def part(self, first: int, last: int) -> StoredIntervals:
        """Intervals first to last - 1."""
        which = slice(first, last)
        return StoredIntervals(self.x[which], self.theta[which], self.intervals.part(which))


def run_mhe(record: NodeRecord, progress: Progress | None = None) -> Estimates:
    """One Gauss-Newton iteration per update, window by window."""
    weights, model = record.weights, record.model
    n_x, n_p, updates = model.n_x, model.n_p, record.updates
    is_riccati = model.machine.estimator.arrival_cost.update == "riccati"

    relinearise = model.machine.estimator.relinearise
    kept: StoredIntervals | None = None
    # Since theta last drifted: shifts of the window, and those of them whose interval had moved.
    shifts = owed = 0
    prior, arrival = Gaussian(*weights.prior), record.first
    x, theta = arrival.mean[None, :n_x], arrival.mean[n_x:]
    std = weights.parameter
    active = np.zeros(n_p, dtype=np.bool_)
    scaling, newest, scales = record.scaling, MeasurementResult.none(), NoiseFactors.of(record)
    lasting = record.start_lasting(drifts=is_riccati)
    results = np.empty((updates, n_x)), np.empty((updates, n_p)), np.empty((updates, n_p))
    statuses, readings = np.empty(updates, dtype=np.int64), []
    for node in range(1, updates + 1):
        # x holds the nodes of the last solution that stay in the window.
        first = node - len(x)
        if relinearise == "all":
            window = linearise(record, first, x, theta)
        else:
            if relinearise == "auto" and kept is not None:
                kept = renew(record, first, kept, x[:-1], theta)
            fresh = StoredIntervals.of(x[-1:], theta, integrate(record, record.plan, node - 1, x[-1:], theta))
            kept = fresh if kept is None else kept.append(fresh)
            window = window_of(record, first, x, theta, kept.at(x, theta))
        is_full = len(x) == weights.horizon
        scaling.interval = []
        status = record.status(node) | (0 if is_full else UpdateStatus.FILLING)
        try:
            taken = take_newest(record, window, arrival, scaling, scales)
            solution = None if taken is None else _solve(record, window, arrival, scales, active)
        except np.linalg.LinAlgError:
            solution = None
        if taken is None or solution is None:
            # Keep the last good estimate and start again from it with the prior's covariance.
            status = NOT_FINITE
            x, arrival = x[-1:], Gaussian(np.concatenate([x[-1], theta]), prior.covariance)
            kept, scaling, newest = None, Scaling(weights.self_scaling), MeasurementResult.none()
            lasting = record.start_lasting(drifts=is_riccati)
            scales.end[node] = np.inf  # the measurement that came with it is not to be trusted
            shifts = owed = 0
        else:
            x, theta, deviation, active = solution
            newest = taken.newest(newest)
            if record.moves(node - 1):
                lasting.take(scaling.interval, theta, deviation**2)
            std = deviation * np.sqrt(lasting.spread)
            status |= UpdateStatus.BOUND if active.any() else 0
            status |= UpdateStatus.DOUBT if scaling.doubts or lasting.doubts else 0
            if is_full:
                x, kept = x[1:], kept and kept.part(1, len(kept.x))
                if is_riccati:
                    shifts, owed = shifts + 1, owed + record.moves(window.first)
                    is_due = shifts == weights.drift_interval
                    arrival = arrival_update(record, arrival, window, scales, owed if is_due else 0)
                    if is_due:
                        shifts = owed = 0
                else:
                    spread = np.concatenate([weights.sigma_x, weights.parameter])
                    arrival = Gaussian(np.concatenate([x[0], theta]), np.diag(spread**2))
        for store, value in zip(results, (x[-1], theta, std), strict=True):
            store[node - 1] = value
        statuses[node - 1] = status
        readings.append(newest)
        if progress is not None:
            progress(node, updates)
    return estimates(record, *results, statuses, readings)


def renew(record: NodeRecord, first: int, kept: StoredIntervals, x: Array, theta: Array) -> StoredIntervals:
    """Linearise the interval anew at (x, theta) whose end has moved most, if that is too far.

    Of n intervals, at the nodes x (n, n_x) where they start. From the newest on; an older one that has moved about as
    far is none that has moved more.
    """
    moved = np.max(np.abs(kept.moves(x, theta)) / record.weights.move, axis=1, initial=0.0)
    k, farthest = None, 1.0
    for i in reversed(range(len(moved))):
        if moved[i] > farthest:
            k, farthest = i, CLEARLY * moved[i]
    if k is None:
        return kept
    start = x[k : k + 1]
    return kept.renew(k, StoredIntervals.of(start, theta, integrate(record, record.kept_plan, first + k, start, theta)))


def dense_problem(record: NodeRecord, window: Window, arrival: Gaussian, scales: NoiseFactors) -> tuple[Array, Array]:
    """Jacobian J and residual r of the window, so that the step d of (x_0, ..., x_n, theta) minimises |J d + r|^2.

    Rows: arrival cost, then per node its measurement (if valid) and per interval the valid measurements inside of it
    and its defect (paper, equations 10, 12).
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

    def add_measurements(at_node: slice, outputs: Outputs, y: Array, sigma: Array) -> None:
        rows = np.zeros((len(y), columns))
        rows[:, at_node], rows[:, at_theta] = outputs.C, outputs.D
        jacobians.append(rows / sigma[:, None])
        residuals.append((outputs.y - y) / sigma)

    for k in range(nodes):
        at_node, node = slice(k * n_x, (k + 1) * n_x), window.first + k
        if record.valid[node] and np.isfinite(scales.end[node]):
            at_end = window.outputs.part(slice(k, k + 1))
            add_measurements(at_node, at_end, record.y[node : node + 1], weights.sigma_y * scales.end[node : node + 1])
        if k + 1 < nodes:
            inside = record.inner_valid[node]
            sigma = weights.sigma_y * scales.inner[node][inside]
            inner = Outputs(*(array[k][inside] for array in window.intervals.inner))
            add_measurements(at_node, inner, record.inner_y[node][inside], sigma)
            block = np.zeros((n_x, columns))
            block[:, at_node], block[:, at_theta] = -window.intervals.A[k], -window.intervals.B[k]
            block[:, (k + 1) * n_x : (k + 2) * n_x] = np.eye(n_x)
            jacobians.append(block / record.sigma_x[node][:, None])
            residuals.append((window.x[k + 1] - window.intervals.x1[k]) / record.sigma_x[node])
    return np.vstack(jacobians), np.concatenate(residuals)


def take_newest(
    record: NodeRecord, window: Window, arrival: Gaussian, scaling: Scaling, scales: NoiseFactors
) -> Taken | None:
    """Measurements of the newest interval, each predicted from all before it; None where that is not finite.

    Their weights go to `scales`.
    """
    n_x, n_p = record.model.n_x, record.model.n_p
    J, r = dense_problem(record, window.before_newest, arrival, scales)
    if not (np.all(np.isfinite(J)) and np.all(np.isfinite(r))):
        return None
    R, b = triangular_factor(J, r)
    n = n_x + n_p
    spread = np.linalg.inv(R[-n:, -n:])
    newest = window.newest
    mean = np.concatenate([newest.x[0], newest.theta]) + spread @ b[-n:]
    taken = take_interval(record, newest, Gaussian(mean, spread @ spread.T), scaling)
    scales.inner[newest.first], scales.end[newest.first + 1] = taken.inner_scales, taken.end_scale
    return taken


def _solve(
    record: NodeRecord, window: Window, arrival: Gaussian, scales: NoiseFactors, active: Mask
) -> tuple[Array, Array, Array, Mask] | None:
    """(x, theta, std of theta, bounds active) of one update; None where it is not finite."""
    weights = record.weights
    nodes, n_x = window.x.shape
    n_p = len(window.theta)
    J, r = dense_problem(record, window, arrival, scales)
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


def arrival_update(record: NodeRecord, arrival: Gaussian, window: Window, scales: NoiseFactors, owed: int) -> Gaussian:
    """Kalman update and prediction of (x, theta) over the interval that leaves, linearised as the window was.

    Covariance form: measurements of the oldest node and inside of its interval (Joseph), prediction with state noise,
    then the drift of theta that is pending for so many intervals.
    """
    weights, n_x, first = record.weights, window.x.shape[1], window.first
    point = np.concatenate([window.x[0], window.theta])
    mean, P = arrival
    outputs, inner = window.outputs, window.intervals.inner
    rows = [(outputs.y[0], outputs.C[0], outputs.D[0], record.y[first], record.valid[first], scales.end[first])]
    inside = record.inner_y[first], record.inner_valid[first], scales.inner[first]
    rows += zip(*(array[0] for array in inner), *inside, strict=True)
    for predicted, by_x, by_theta, y, valid, scale in rows:
        if valid and np.isfinite(scale):
            C = np.concatenate([by_x, by_theta])
            innovation = float(y - predicted - C @ (mean - point))
            mean, P = fold(Gaussian(mean, P), C, innovation, (weights.sigma_y * scale) ** 2)
    mean, P = predict(window, 0, Gaussian(mean, P))
    growth = np.concatenate([record.sigma_x[first] ** 2, weights.drift_variance(np.diag(P)[n_x:], owed)])
    P = P + np.diag(growth)
    return Gaussian(mean, 0.5 * (P + P.T))
