"""Reference MHE, EKF and smoother: the Kalman filter on a linear model, bounds by enumeration, statuses."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from reference_cases import friction_at_samples, linear_model, moving, simulate, variant, with_integrator
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.reference import (
    NodeRecord,
    ReferenceIntegrator,
    UpdateStatus,
    estimate_model,
    estimate_reference,
    run_mhe,
)
from sgms_mhe.reference.ekf import into_bounds
from sgms_mhe.reference.least_squares import solve, solve_bounded
from sgms_mhe.reference.mhe import StoredIntervals, dense_problem, renew
from sgms_mhe.reference.readings import Gaussian
from sgms_mhe.reference.window import NoiseFactors, Window, integrate, linearise
from sgms_mhe.signals.chain import Signals

Array = NDArray[np.float64]
THETA = np.array([1.3, 0.8, 0.9])


def noise(**changes: Any) -> dict[str, Any]:
    return {"noise": variant().estimator.noise.model_dump() | {"parameter_drift": 0.0, "self_scaling": False} | changes}


def linear_record(model: Model, updates: int = 40) -> Signals:
    """Noisy friction of the linear model at its nodes."""
    rng = np.random.default_rng(11)
    motion = moving(np.sin(0.37 * np.arange(5 * updates + 1)) + 0.4, rate=100.0)
    nodes = simulate(ReferenceIntegrator(model), motion, THETA)
    clean = friction_at_samples(model, motion, nodes, THETA)
    return dataclasses.replace(motion, friction=clean + 0.5 * rng.standard_normal(len(motion)))


def kalman_filter(model: Model, signals: Signals, first: int = 0) -> tuple[Array, Array, Array]:
    """Textbook filter over (x, theta) from the affine maps themselves; estimates, covariances, per node."""
    record = NodeRecord(model, signals, ReferenceIntegrator(model))
    n_x, n = model.n_x, model.n_x + model.n_p
    weights = record.weights

    def transition(k: int, s: Array) -> Array:
        return np.concatenate([record.integrator.intervals(record.plan, k, s[None, :n_x], s[n_x:]).x1[0], s[n_x:]])

    def output(k: int, s: Array) -> float:
        return float(record.integrator.outputs(s[None, :n_x], record.w[k : k + 1], s[n_x:]).y[0])

    zero, unit = np.zeros(n), np.eye(n)
    s = np.concatenate([np.zeros(n_x), np.ones(model.n_p)])
    P = np.diag(np.concatenate([weights.initial_state, weights.parameter]) ** 2)
    Q = np.diag(np.concatenate([weights.sigma_x**2, np.zeros(model.n_p)]))
    means, covariances = [], []
    for k in range(record.updates + 1):
        if k > 0:
            F = np.column_stack([transition(k - 1, e) - transition(k - 1, zero) for e in unit])
            s, P = F @ s + transition(k - 1, zero), F @ P @ F.T + Q
        if k >= first and record.valid[k]:
            H = np.array([output(k, e) - output(k, zero) for e in unit])[None]
            S = (H @ P @ H.T).item() + weights.sigma_y**2
            gain = (P @ H.T)[:, 0] / S
            s, P = s + gain * (record.y[k] - (H @ s).item() - output(k, zero)), P - np.outer(gain, gain) * S
        means.append(s)
        covariances.append(P)
    return np.array(means), np.array(covariances), np.array(record.w)


@pytest.mark.parametrize("horizon", [1, 2, 5, 20])
@pytest.mark.parametrize("gaps", [False, True])
def test_mhe_is_the_kalman_filter_on_a_linear_model(horizon: int, gaps: bool) -> None:
    model = linear_model(horizon=horizon, **noise())
    signals = linear_record(model)
    if gaps:
        valid = signals.valid.copy()
        valid[[0, 35, 40, 45, 100, 130]] = False
        signals = dataclasses.replace(signals, valid=valid)
    result = estimate_model(model, signals, "mhe")
    means, covariances, _ = kalman_filter(model, signals)
    scale = np.abs(means).max()
    np.testing.assert_allclose(result.extra["x"], means[1:, :3], rtol=0.0, atol=1e-10 * scale)
    np.testing.assert_allclose(result.extra["theta"], means[1:, 3:], rtol=0.0, atol=1e-10 * scale)
    std = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))[1:, 3:]
    np.testing.assert_allclose(result.extra["theta_std"], std, rtol=1e-9)
    np.testing.assert_array_equal(result.status & UpdateStatus.FILLING, np.arange(1, 41) < horizon)
    missing = np.isin(5 * np.arange(1, 41), [35, 40, 45, 100, 130]) if gaps else np.zeros(40, dtype=bool)
    np.testing.assert_array_equal(result.status & UpdateStatus.MISSING != 0, missing)


def test_kept_linearisations_are_exact_on_a_linear_model() -> None:
    signals = linear_record(linear_model())
    every, auto, newest = (
        estimate_model(linear_model(horizon=6, relinearise=mode), signals, "mhe") for mode in ("all", "auto", "newest")
    )
    for other in (auto, newest):
        np.testing.assert_allclose(other.extra["x"], every.extra["x"], rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(other.extra["theta"], every.extra["theta"], rtol=0.0, atol=1e-10)


def kept_at(record: NodeRecord, x: Array, theta: Array) -> StoredIntervals:
    return StoredIntervals.of(x, theta, integrate(record, record.plan, 0, x, theta))


def slow_record(model: Model) -> tuple[NodeRecord, Array]:
    """A motion through which all elements stick, so that an end moves as far as the start; nodes of six intervals."""
    motion = moving(2e-5 * np.sin(2.0 * np.pi * 4.0 * np.arange(601) / 10000.0))
    record = NodeRecord(model, motion, ReferenceIntegrator(model))
    return record, simulate(record.integrator, motion, np.ones(4))[:6]


def assert_renewed(
    renewed: StoredIntervals, kept: StoredIntervals, fresh: StoredIntervals, interval: int | None
) -> None:
    """One interval is that of `fresh`; all others, or all if it is None, are untouched."""
    is_new = np.arange(6) == interval
    for ours, before, new in zip(arrays(renewed), arrays(kept), arrays(fresh), strict=True):
        np.testing.assert_array_equal(ours[is_new], new[is_new])
        np.testing.assert_array_equal(ours[~is_new], before[~is_new])


def arrays(kept: StoredIntervals) -> list[Array]:
    return [kept.x, kept.theta, *kept.intervals[:3], *kept.intervals.inner]


def test_an_interval_that_moved_too_far_is_linearised_anew() -> None:
    model = build_model(with_integrator(variant(), scheme="rk4"))
    record, x = slow_record(model)
    theta = np.ones(4)
    kept = kept_at(record, x, theta)
    moved = x.copy()
    moved[3, 2] += 1.1 * record.weights.move[2]
    moved[2, 1] += 0.9 * record.weights.move[1]
    # Parameters have moved too, though by too little to count.
    near = theta + 1e-6
    renewed = renew(record, 0, kept, moved, near)
    fresh = kept_at(record, moved, near)
    assert_renewed(renewed, kept, fresh, 3)
    assert not np.array_equal(renewed.intervals.x1, kept.intervals.x1)
    # Each interval moves on from where it was linearised, its readings with it.
    further, beyond = moved + 1e-3, near + 1e-3
    about = renewed.at(further, beyond)
    for k in range(6):
        own, point, parameters = (fresh, moved[k], near) if k == 3 else (kept, x[k], theta)
        x1, A, B = (part[k] for part in own.intervals[:3])
        np.testing.assert_allclose(about.x1[k], x1 + A @ (further[k] - point) + B @ (beyond - parameters), atol=1e-15)
    y, C, D = (part[3] for part in fresh.intervals.inner)
    assert len(y) == 9
    np.testing.assert_allclose(about.inner.y[3], y + C @ (further[3] - moved[3]) + D @ (beyond - near), atol=1e-14)
    np.testing.assert_array_equal(about.A, renewed.intervals.A)
    # Less than the allowance everywhere: nothing to do.
    assert_renewed(renew(record, 0, renewed, moved, near), renewed, fresh, None)


def test_the_interval_that_moved_most_is_linearised_anew() -> None:
    model = build_model(with_integrator(variant(), scheme="rk4"))
    record, x = slow_record(model)
    theta = np.ones(4)
    kept = kept_at(record, x, theta)
    steps = np.zeros((6, 4))
    for (k, i), step in {(1, 2): 6.0, (3, 3): -7.0, (2, 2): 4.0, (1, 0): -3.0, (4, 1): 2.0, (4, 0): 1.5}.items():
        steps[k, i] = step
    steps[5, 3] = 0.9
    moved = x + steps * record.weights.move
    np.testing.assert_allclose(kept.moves(moved, theta) / record.weights.move, steps, atol=1e-6)
    fresh = kept_at(record, moved, theta)
    # One at an update; those that wait are next.
    for interval in (3, 1, 2, 4, None):
        renewed = renew(record, 0, kept, moved, theta)
        assert_renewed(renewed, kept, fresh, interval)
        kept = renewed


def test_of_intervals_that_have_moved_about_as_far_the_newest_is_linearised_anew() -> None:
    model = build_model(with_integrator(variant(), scheme="rk4"))
    record, x = slow_record(model)
    theta = np.ones(4)
    kept = kept_at(record, x, theta)
    steps = np.zeros((6, 4))
    steps[[0, 2, 4], 1] = 3.07, 3.02, 3.0
    fresh = kept_at(record, x + steps * record.weights.move, theta)
    for interval in (0, 4, 2, None):
        renewed = renew(record, 0, kept, x + steps * record.weights.move, theta)
        assert_renewed(renewed, kept, fresh, interval)
        kept = renewed


def test_ekf_is_the_kalman_filter_on_a_linear_model() -> None:
    model = linear_model(**noise())
    signals = linear_record(model)
    result = estimate_model(model, signals, "ekf")
    # The filter starts with a prediction: the measurement at node 0 is not used.
    means, covariances, _ = kalman_filter(model, signals, first=1)
    np.testing.assert_allclose(result.extra["x"], means[1:, :3], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(result.extra["theta"], means[1:, 3:], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(
        result.extra["theta_std"], np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))[1:, 3:], rtol=1e-10
    )
    assert not np.any(result.status & UpdateStatus.FILLING)


def test_smoother_ends_where_the_kalman_filter_ends() -> None:
    model = linear_model(**noise())
    signals = linear_record(model)
    result = estimate_model(model, signals, "smoother")
    means, covariances, _ = kalman_filter(model, signals)
    np.testing.assert_allclose(result.extra["x"][-1], means[-1, :3], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(result.extra["theta"], np.tile(means[-1, 3:], (40, 1)), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(result.extra["theta_std"][0], np.sqrt(np.diag(covariances[-1]))[3:], rtol=1e-8)


def test_a_window_over_everything_is_the_smoother() -> None:
    # The nonlinear friction model: the smoother's solution is stationary for the dense problem of one long window.
    model = build_model(axis("rk4", horizon=25, **noise()))
    motion = moving(2e-3 * np.sin(2.0 * np.pi * 4.0 * np.arange(2501) / 10000.0))
    nodes = simulate(ReferenceIntegrator(model), motion, np.array([1.2, 0.8, 1.1, 0.95]))
    friction = friction_at_samples(model, motion, nodes, np.array([1.2, 0.8, 1.1, 0.95]))
    signals = dataclasses.replace(
        motion, friction=friction + 0.1 * np.random.default_rng(4).standard_normal(len(friction))
    )
    smoothed = estimate_model(model, signals, "smoother")
    record = NodeRecord(model, signals, ReferenceIntegrator(model))
    theta = smoothed.extra["theta"][0]
    x = np.vstack([smoothed.extra["x_first"], smoothed.extra["x"]])
    window = Window(
        first=0,
        x=x,
        theta=theta,
        intervals=record.integrator.intervals(record.plan, 0, x[:-1], theta),
        outputs=record.integrator.outputs(x, record.w, theta),
    )
    J, r = dense_problem(record, window, Gaussian(*record.weights.prior), NoiseFactors.of(record))
    gradient = J.T @ r / (np.linalg.norm(J, axis=0) * np.linalg.norm(r))
    assert np.abs(gradient).max() < 1e-8
    std = np.sqrt(np.diag(np.linalg.inv(J.T @ J))[-4:])
    np.testing.assert_allclose(smoothed.extra["theta_std"][0], std, rtol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_bounded_solution_is_the_best_of_all_active_sets(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(15):
        J, r = rng.standard_normal((n + 3, n)) * 10.0 ** rng.uniform(-2, 2, n), rng.standard_normal(n + 3)
        lower = np.where(rng.uniform(size=n) < 0.3, -np.inf, -rng.uniform(0.0, 0.2, n))
        upper = np.where(rng.uniform(size=n) < 0.3, np.inf, rng.uniform(0.0, 0.2, n))
        best, best_cost = np.zeros(n), np.inf
        for choice in itertools.product(*([np.nan, low, high] for low, high in zip(lower, upper, strict=True))):
            fixed = np.array(choice)
            if np.any(np.isinf(fixed)):
                continue
            free = np.isnan(fixed)
            d = np.where(free, 0.0, fixed)
            if free.any():
                d[free] = np.linalg.lstsq(J[:, free], -(r + J[:, ~free] @ d[~free]))[0]
            cost = float(np.sum((J @ d + r) ** 2))
            if np.all((d >= lower) & (d <= upper)) and cost < best_cost:
                best, best_cost = d, cost
        found, active = solve_bounded(J, r, lower, upper)
        np.testing.assert_allclose(found, best, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(active, (best == lower) | (best == upper))
        # A guess, right or wrong, changes nothing.
        for guess in (active, ~active):
            np.testing.assert_allclose(solve_bounded(J, r, lower, upper, guess)[0], best, rtol=1e-9, atol=1e-12)


def test_bounded_window_is_optimal() -> None:
    bounds = {"stiffness": [0.95, 1.02]}
    model = linear_model(horizon=6, bounds=bounds, **noise())
    signals = linear_record(model)
    record = NodeRecord(model, signals, ReferenceIntegrator(model))
    result = run_mhe(record)
    theta = result.extra["theta"]
    assert theta.min() >= 0.95 and theta.max() <= 1.02
    at_bound = np.any((theta == 0.95) | (theta == 1.02), axis=1)
    assert at_bound.sum() > 20
    np.testing.assert_array_equal(result.status & UpdateStatus.BOUND != 0, at_bound)
    # The last window that starts from the prior, solved by another method. The model is linear: any point will do.
    window = linearise(record, 0, np.zeros((6, 3)), np.ones(3))
    J, r = dense_problem(record, window, Gaussian(*record.weights.prior), NoiseFactors.of(record))
    lower, upper = np.full(J.shape[1], -np.inf), np.full(J.shape[1], np.inf)
    lower[-3:], upper[-3:] = -0.05, 0.02
    other = lsq_linear(J, -r, (lower, upper), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(theta[5], 1.0 + other[-3:], atol=1e-9)
    np.testing.assert_allclose(result.extra["x"][5], (window.x[-1] + other[-6:-3]), atol=1e-9)


def test_ekf_bounds_minimise_the_posterior() -> None:
    rng = np.random.default_rng(8)
    root = rng.standard_normal((5, 5))
    P, mean = root @ root.T + 0.1 * np.eye(5), rng.standard_normal(5)
    lower, upper = mean[2:] + np.array([0.3, -1.0, -2.0]), mean[2:] + np.array([1.0, -0.2, 2.0])
    found = into_bounds(mean, P, lower, upper)
    information = np.linalg.inv(P)
    gradient = information @ (found - mean)
    np.testing.assert_allclose(gradient[:2], 0.0, atol=1e-10)
    for j in range(3):
        slack = gradient[2 + j]
        assert lower[j] <= found[2 + j] <= upper[j]
        assert abs(slack) < 1e-10 or (slack > 0.0 and found[2 + j] == lower[j]) or found[2 + j] == upper[j]


# --- friction ----------------------------------------------------------------------------------------------------


def axis(scheme: str = "flow", **estimator: Any) -> Machine:
    """An axis whose friction is measured at the nodes alone."""
    return with_integrator(variant(sampling={"measurement_rate": 100.0}, estimator=estimator), scheme=scheme)


def record_of(machine: Machine, velocity: Array, theta: Array, seed: int = 0) -> Signals:
    model = build_model(machine)
    motion = moving(velocity)
    friction = friction_at_samples(model, motion, simulate(ReferenceIntegrator(model), motion, theta), theta)
    return dataclasses.replace(
        motion, friction=friction + 0.05 * np.random.default_rng(seed).standard_normal(len(friction))
    )


def sweep(seconds: float) -> Array:
    time = np.arange(round(seconds * 10000) + 1) / 10000.0
    return np.asarray(3e-3 * np.sin(2.0 * np.pi * 3.0 * time) * (1.0 + 0.5 * np.sin(2.0 * np.pi * 0.7 * time)))


@pytest.mark.slow
def test_stiffness_is_found_and_its_uncertainty_is_honest() -> None:
    theta = np.array([1.25, 0.8, 1.15, 0.95])
    machine = axis()
    signals = record_of(machine, sweep(4.0), theta)
    nominal = np.array(machine.friction.stiffness)
    for kind in ("mhe", "ekf", "smoother"):
        result = estimate_reference(machine, signals, kind)
        error = (result.parameters[-1] - theta * nominal) / result.std[-1]
        assert np.abs(error).max() < 3.0
        assert result.std[-1][3] / nominal[3] < 0.15
        truth = signals.friction[100::100]
        assert np.std(result.friction_N - truth) < 0.12
        assert result.parameter_names == ("stiffness_1", "stiffness_2", "stiffness_3", "stiffness_4")
        assert result.z_m.shape == (len(result), 4)


@pytest.mark.parametrize("update", ["riccati", "fixed"])
def test_statuses(update: str) -> None:
    machine = axis(horizon=3, arrival_cost={"update": update})
    velocity = np.concatenate([[0.0], np.repeat([2e-3, 0.0, -2e-3, 1.5, 2e-3, 2e-3], 100)])
    signals = record_of(machine, velocity, np.ones(4))
    valid = signals.valid.copy()
    valid[300] = False
    result = estimate_reference(machine, dataclasses.replace(signals, valid=valid))
    assert [UpdateStatus(int(s)) & ~UpdateStatus.BOUND for s in result.status] == [
        UpdateStatus.FILLING,
        UpdateStatus.FILLING | UpdateStatus.HOLD,
        UpdateStatus.MISSING,
        UpdateStatus.SPEED,
        UpdateStatus(0),
        UpdateStatus(0),
    ]


def test_parameters_do_not_drift_at_standstill() -> None:
    machine = axis(horizon=5)
    velocity = np.concatenate([sweep(0.5), np.zeros(3000)])
    signals = record_of(machine, velocity, np.array([1.1, 0.9, 1.0, 1.0]))
    result = estimate_reference(machine, dataclasses.replace(signals, valid=np.arange(len(velocity)) <= 5000))
    # From here on the window stands still and holds no measurement.
    still = result.parameters[56:]
    np.testing.assert_allclose(still, np.tile(still[0], (len(still), 1)), rtol=1e-12)
    std = result.std[56:]
    np.testing.assert_allclose(std, np.tile(std[0], (len(std), 1)), rtol=1e-9)
    assert np.all(result.status[50:] == UpdateStatus.HOLD | UpdateStatus.MISSING)


@pytest.mark.parametrize(("horizon", "interval"), [(1, 1), (4, 4), (20, 20), (24, 20)])
def test_the_horizon_says_how_often_theta_drifts(horizon: int, interval: int) -> None:
    assert axis(horizon=horizon).estimator.drift_interval == interval


@pytest.mark.parametrize(
    ("horizon", "interval", "restart"), [(1, 1, 0), (4, 4, 0), (11, 11, 0), (22, 20, 0), (11, 11, 16), (1, 1, 26)]
)
@pytest.mark.parametrize("relinearise", ["all", "newest"])
@pytest.mark.parametrize("drift", [0.01, 0.15])
def test_drift_enters_in_batches(horizon: int, interval: int, restart: int, relinearise: str, drift: float) -> None:
    weights = variant().estimator.noise.model_dump() | {"parameter": 0.3, "parameter_drift": drift}
    machine = axis("rk4", horizon=horizon, relinearise=relinearise, noise=weights)
    measured = restart + 10
    updates = measured + 2 * horizon + 14
    # Two intervals of three move; what is not finite ends with the node `restart`.
    moves = np.arange(updates) % 3 != 1
    speeds = np.where(moves, 2e-3, 0.0)
    velocity = np.concatenate([[0.0], np.repeat(speeds, 100)])
    signals = record_of(machine, velocity, np.ones(4))
    if restart:
        velocity[100 * restart - 99 : 100 * restart] = 1e200
    valid = np.arange(len(velocity)) <= 100 * measured
    result = estimate_reference(machine, dataclasses.replace(signals, velocity=velocity, valid=valid))
    assert np.flatnonzero(result.status == -2).tolist() == ([restart - 1] if restart else [])
    np.testing.assert_array_equal(result.status[measured:] & UpdateStatus.HOLD == 0, moves[measured:])
    # From the first window without a measurement on, its deviations of theta are those of the arrival cost.
    variance = np.square(result.extra["theta_std"])
    growths = 0
    for update in range(measured + horizon + 1, updates):
        # The shift after this update: how many there have been, and the intervals of the last ones.
        shift = update - restart - horizon + 1
        owed = np.sum(moves[update - horizon + 1 - interval : update - horizon + 1]) if shift % interval == 0 else 0
        growth = np.minimum(owed * drift**2, 0.3**2 - variance[update - 1])
        np.testing.assert_allclose(variance[update] - variance[update - 1], growth, rtol=0.0, atol=1e-10)
        growths += owed > 0
    assert growths >= horizon // interval
    assert np.all(result.extra["theta_std"] <= 0.3 * (1.0 + 1e-9))
    if drift == 0.15:
        np.testing.assert_allclose(result.extra["theta_std"][-1], 0.3)


def test_no_parameter_gets_less_certain_than_its_prior() -> None:
    machine = axis(horizon=2, noise=variant().estimator.noise.model_dump() | {"parameter_drift": 0.2})
    signals = record_of(machine, sweep(1.0), np.ones(4))
    for kind in ("mhe", "ekf"):
        result = estimate_reference(machine, dataclasses.replace(signals, valid=np.zeros(len(signals), bool)), kind)
        assert np.all(result.extra["theta_std"] <= machine.estimator.noise.parameter * (1.0 + 1e-9))


@pytest.mark.parametrize("kind", ["mhe", "ekf"])
def test_a_solution_that_is_not_finite_keeps_the_last_good_estimate(kind: str) -> None:
    machine = axis("rk4", horizon=4)
    velocity = sweep(0.3)
    signals = record_of(machine, velocity, np.ones(4))
    velocity = velocity.copy()
    velocity[1201:1300] = 1e200
    result = estimate_reference(machine, dataclasses.replace(signals, velocity=velocity), kind)
    assert result.status[12] == -2
    np.testing.assert_array_equal(result.parameters[12], result.parameters[11])
    np.testing.assert_array_equal(result.extra["x"][12], result.extra["x"][11])
    filling = [bool(s & UpdateStatus.FILLING) for s in result.status[13:20]]
    assert filling == ([True] * 3 + [False] * 4 if kind == "mhe" else [False] * 7)
    assert np.all(np.isfinite(result.friction_N)) and np.all(result.status[13:] >= 0)


def test_fixed_arrival_cost_is_centred_on_the_last_estimate() -> None:
    machine = with_integrator(
        variant("etel_xy_paper", estimator={"horizon": 3, "bounds": {}}), scheme="rk4", substeps=100
    )
    model = build_model(machine)
    signals = record_of(machine, sweep(0.1), np.array([1.1, 0.9, 1.0, 1.0]))
    record = NodeRecord(model, signals, ReferenceIntegrator(model))
    result = run_mhe(record)
    # Window 3 (nodes 0 .. 3) from the prior: its node 1 and theta are the centre of window 4.
    x, theta = np.zeros((1, 4)), np.ones(4)
    for node in range(1, 4):
        window = linearise(record, 0, x, theta)
        d = solve(*dense_problem(record, window, Gaussian(*record.weights.prior), NoiseFactors.of(record)))
        x, theta = window.x + d[:-4].reshape(-1, 4), theta + d[-4:]
        np.testing.assert_allclose(result.extra["x"][node - 1], x[-1], atol=1e-12)
    centre = np.concatenate([x[1], theta])
    arrival = Gaussian(centre, np.diag(np.repeat([0.1, 0.05], 4) ** 2))
    d = solve(*dense_problem(record, linearise(record, 1, x[1:], theta), arrival, NoiseFactors.of(record)))
    np.testing.assert_allclose(result.extra["theta"][3], theta + d[-4:], atol=1e-12)


def test_progress_and_short_records() -> None:
    machine = axis()
    calls: list[tuple[int, int]] = []
    signals = record_of(machine, sweep(0.03), np.ones(4))
    result = estimate_reference(machine, signals, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 3), (2, 3), (3, 3)]
    np.testing.assert_allclose(result.time_s, [0.01, 0.02, 0.03])
    np.testing.assert_array_equal(result.friction_measured_N, signals.friction[100::100])
    short = signals.part(slice(50))
    for kind in ("mhe", "ekf", "smoother"):
        empty = estimate_reference(machine, short, kind)
        assert len(empty) == 0
        assert empty.z_m.shape == (0, 4)
