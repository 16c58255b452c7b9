"""Joint extended Kalman filter over (x, theta), in covariance form (docs/estimation.md)."""

import numpy as np

from sgms_mhe.reference.least_squares import solve_bounded
from sgms_mhe.reference.problem import NOT_FINITE, NodeRecord, Progress, UpdateStatus, estimates
from sgms_mhe.reference.readings import Gaussian, MeasurementResult, Scaling
from sgms_mhe.reference.window import linearise, take_interval
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.arrays import Array


def run_ekf(record: NodeRecord, progress: Progress | None = None) -> Estimates:
    """Update with the measurements inside of an interval, predict through it, update with the one at its end."""
    weights, model = record.weights, record.model
    n_x, n_p, updates = model.n_x, model.n_p, record.updates
    belief, prior = record.first, weights.prior[1]
    scaling, newest, lasting = record.scaling, MeasurementResult.none(), record.start_lasting()
    std = weights.parameter
    results = np.empty((updates, n_x)), np.empty((updates, n_p)), np.empty((updates, n_p))
    statuses, readings = np.empty(updates, dtype=np.int64), []
    for node in range(1, updates + 1):
        scaling.interval = []
        status = record.status(node)
        window = linearise(record, node - 1, belief.mean[None, :n_x], belief.mean[n_x:])
        with np.errstate(all="ignore"):
            taken = take_interval(record, window, belief, scaling, drift=int(record.moves(node - 1)))
            new = Gaussian(taken.belief.mean, 0.5 * (taken.belief.covariance + taken.belief.covariance.T))
        if is_sound(record, new):
            belief, newest = new, taken.newest(newest)
            variance = np.diag(belief.covariance)[n_x:]
            if np.any((belief.mean[n_x:] < weights.lower) | (belief.mean[n_x:] > weights.upper)):
                belief = Gaussian(into_bounds(*belief, weights.lower, weights.upper), belief.covariance)
                status |= UpdateStatus.BOUND
            if record.moves(node - 1):
                lasting.take(scaling.interval, belief.mean[n_x:], variance)
            std = np.sqrt(variance * lasting.spread)
            status |= UpdateStatus.DOUBT if scaling.doubts or lasting.doubts else 0
        else:
            status, belief = NOT_FINITE, Gaussian(belief.mean, prior)
            scaling, newest = Scaling(weights.self_scaling), MeasurementResult.none()
            lasting = record.start_lasting()
        for store, value in zip(results, (belief.mean[:n_x], belief.mean[n_x:], std), strict=True):
            store[node - 1] = value
        statuses[node - 1] = status
        readings.append(newest)
        if progress is not None:
            progress(node, updates)
    return estimates(record, *results, statuses, readings)


def is_sound(record: NodeRecord, belief: Gaussian) -> bool:
    """Return True if a belief of (x, theta) is finite and one that an axis can have."""
    mean, P = belief
    is_finite = bool(np.all(np.isfinite(mean)) and np.all(np.isfinite(P)) and np.all(np.diag(P) > 0.0))
    return is_finite and record.weights.is_plausible(mean[: record.model.n_x])


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
