"""Joint extended Kalman filter over (x, theta), in covariance form (docs/estimation.md)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.reference.least_squares import solve_bounded
from sgms_mhe.reference.mhe import linearise, measurement_update
from sgms_mhe.reference.problem import NOT_FINITE, Progress, Record, Status, estimates
from sgms_mhe.signals.estimates import Estimates

Array = NDArray[np.float64]


def run_ekf(record: Record, progress: Progress | None = None) -> Estimates:
    """Predict through every interval and update with the measurement at its end."""
    weights, model = record.weights, record.model
    n_x, n_p, updates = model.n_x, model.n_p, record.updates
    mean, P = weights.prior
    prior = P
    std = weights.parameter
    results = np.empty((updates, n_x)), np.empty((updates, n_p)), np.empty((updates, n_p))
    statuses = np.empty(updates, dtype=np.int64)
    for node in range(1, updates + 1):
        status = record.status(node)
        window = linearise(record, node - 1, mean[None, :n_x], mean[n_x:])
        F = np.eye(n_x + n_p)
        F[:n_x, :n_x], F[:n_x, n_x:] = window.intervals.A[0], window.intervals.B[0]
        drift = weights.drift_variance(np.diag(P)[n_x:], int(record.moves(node - 1)))
        with np.errstate(all="ignore"):
            new = np.concatenate([window.x[1], window.theta])
            P_new = F @ P @ F.T + np.diag(np.concatenate([weights.sigma_x**2, drift]))
            if record.valid[node]:
                # The output is linearised at the prediction, where the newest node of the window stands.
                C = np.concatenate([window.outputs.C[1], window.outputs.D[1]])
                innovation = float(record.y[node] - window.outputs.y[1])
                new, P_new = measurement_update(new, P_new, C, innovation, weights.sigma_y)
        P_new = 0.5 * (P_new + P_new.T)
        is_finite = np.all(np.isfinite(new)) and np.all(np.isfinite(P_new)) and np.all(np.diag(P_new) > 0.0)
        if is_finite and weights.is_plausible(new[:n_x]):
            mean, P = new, P_new
            std = np.sqrt(np.diag(P)[n_x:])
            if np.any((mean[n_x:] < weights.lower) | (mean[n_x:] > weights.upper)):
                mean = into_bounds(mean, P, weights.lower, weights.upper)
                status |= Status.BOUND
        else:
            status, P = NOT_FINITE, prior
        for store, value in zip(results, (mean[:n_x], mean[n_x:], std), strict=True):
            store[node - 1] = value
        statuses[node - 1] = status
        if progress is not None:
            progress(node, updates)
    return estimates(record, *results, statuses)


def into_bounds(mean: Array, P: Array, lower: Array, upper: Array) -> Array:
    """Minimum of the posterior quadratic of (x, theta) over the box of theta."""
    n_p = len(lower)
    R = np.linalg.inv(np.linalg.cholesky(P))
    low, high = np.full(len(mean), -np.inf), np.full(len(mean), np.inf)
    low[-n_p:], high[-n_p:] = lower - mean[-n_p:], upper - mean[-n_p:]
    step, _ = solve_bounded(R, np.zeros(len(mean)), low, high)
    new = mean + step
    new[-n_p:] = np.clip(new[-n_p:], lower, upper)
    return new
