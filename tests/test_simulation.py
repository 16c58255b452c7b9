"""The simulated axis: friction laws, mechanics, sensors and effects against physics worked out here once more."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from sgms_mhe.configuration import load_machine
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition
from sgms_mhe.plant.axis_config import AxisConfig, Controller
from sgms_mhe.plant.native import COMPENSATION, loaded_library
from sgms_mhe.plant.simulation import Truth, linear_drift, simulate_axis
from sgms_mhe.plant.trajectories import Motion, Trajectory, hysteresis, make_trajectory
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]

LAWS = ("sgms", "maxwell_slip")
ALPHA = 1e-3  # smoothing tolerance of zeta = 0.9, lambda = 35
MASS = 20.0
KAPPA = np.array([120e3, 25e3, 7.1e3, 7.9e3])
NU = np.array([0.067, 0.056, 0.047, 0.83])


def clean(**options: Any) -> AxisConfig:
    return AxisConfig(**{"encoder_resolution_m": 0.0, "force_noise_N": 0.0, **options})


def prescribed(**options: Any) -> AxisConfig:
    return clean(control="prescribed", **options)


def truth_of(machine: Machine, trajectory: Trajectory, config: AxisConfig, **options: Any) -> Truth:
    truth = simulate_axis(machine, trajectory, config, **options).truth
    assert truth is not None
    return truth


def ramp(distance: float, velocity: float, rate: float = 1e4) -> Trajectory:
    """Constant velocity from the first sample on."""
    n = round(distance / velocity * rate)
    return Trajectory("ramp", rate, np.linspace(0.0, distance, n + 1))


def stribeck(v: float) -> float:
    return float(4.0 * (1.0 + 0.12 * np.exp(-((v / 1e-3) ** 2))))


# --- friction laws ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
def test_presliding_stiffness_is_the_sum_of_the_elements(machine: Machine, law: str) -> None:
    truth = truth_of(machine, ramp(5e-7, 1e-6), prescribed(law=law))
    elastic = truth.friction_N - 20.0 * truth.velocity_m_s
    np.testing.assert_allclose(elastic[1:] / truth.position_m[1:], KAPPA.sum(), rtol=1e-9)


@pytest.mark.parametrize("velocity", [1e-4, 1e-3, 2e-3, 0.02, 0.1, 1.0, -0.5, -2e-3])
@pytest.mark.parametrize("law", LAWS)
def test_steady_sliding_force_is_the_stribeck_curve(machine: Machine, law: str, velocity: float) -> None:
    truth = truth_of(machine, ramp(float(np.copysign(8e-3, velocity)), velocity), prescribed(law=law, substeps=1))
    level = stribeck(velocity)
    # The gate etaB is open to 1e-3 at a tenth of the Stribeck velocity, and to rounding beyond.
    tolerance = 2.0 * ALPHA * level if law == "sgms" else 1e-9
    expected = np.copysign(level, velocity) + 20.0 * velocity
    assert truth.friction_N[-1] == pytest.approx(expected, abs=tolerance)
    np.testing.assert_allclose(np.abs(truth.deflection_m[-1]), NU * level / KAPPA, rtol=2.0 * ALPHA)


@pytest.mark.parametrize("law", LAWS)
def test_hysteresis_loops_close(machine: Machine, law: str) -> None:
    # Non-local memory: after an inner loop the force comes back to where it left the outer one.
    amplitude = 60e-6
    config = prescribed(law=law, substeps=1)
    truth = truth_of(machine, hysteresis(1e4, amplitude, 0.5).repeat(34.0), config)
    elastic = truth.friction_N - 20.0 * truth.velocity_m_s
    half = len(elastic) // 2
    period = len(hysteresis(1e4, amplitude, 0.5).position_m)
    np.testing.assert_allclose(elastic[half : half + period], elastic[half - period : half], atol=2e-3)
    motion = Motion(1e4)
    speed = (1e-4, 1e-2, 10.0)
    for target in (2e-4, 0.5e-4, 1.5e-4, 0.5e-4, 2e-4):
        motion.move_to(target, *speed)
    truth = truth_of(machine, motion.trajectory("inner"), config)
    elastic = truth.friction_N - 20.0 * truth.velocity_m_s
    at_lower_turn = np.flatnonzero(truth.position_m == 0.5e-4)
    smoothing = 0.03 if law == "sgms" else 1e-3
    assert elastic[at_lower_turn[0]] == pytest.approx(elastic[at_lower_turn[-1]], abs=smoothing)


def test_maxwell_slip_is_exact_in_displacement(machine: Machine) -> None:
    trajectory = make_trajectory("paper", 1e4, duration_s=6.0)
    truth = truth_of(machine, trajectory, prescribed(law="maxwell_slip"), parameters={"stribeck_ratio": 0.0})
    limit = NU * 4.0 / KAPPA
    z = np.zeros(4)
    expected = np.empty_like(truth.deflection_m)
    for k, step in enumerate(np.diff(trajectory.position_m, prepend=0.0)):
        z = np.clip(z + step, -limit, limit)
        expected[k] = z
    np.testing.assert_allclose(truth.deflection_m, expected, atol=1e-16)


def smoothed_rate(z: Array, v: float) -> Array:
    """Equation (1), written out."""
    zs = NU * stribeck(v) / KAPPA
    r = z / zs
    window = 1.0 - 0.5 * np.tanh(35.0 * (r + 0.9)) + 0.5 * np.tanh(35.0 * (r - 0.9))
    gate = 0.5 + 0.5 * np.tanh(35.0 * r * v / 1e-3)
    return np.asarray(v - window * gate * abs(v) * r, dtype=np.float64)


@pytest.mark.parametrize("velocity", [2e-5, 5e-4, 2e-3, 0.05, 1.0])
def test_smoothed_law_solves_its_equation(machine: Machine, velocity: float) -> None:
    # Winding up, reversing and winding up again at constant speeds, against a general-purpose solver.
    path, n = 2.2 * NU.max() * 4.5 / KAPPA.min(), 2000
    rate, stride = n * velocity / path, path / n
    slow = replace_rate(machine, rate)
    up, down = np.arange(n + 1) * stride, n * stride - np.arange(1, n + 1) * stride
    trajectory = Trajectory("wind", rate, np.concatenate((up, down)))
    truth = truth_of(slow, trajectory, prescribed(substeps=1))
    z, speed = np.zeros(4), stride * rate
    for k, v in ((n, speed), (2 * n, -speed)):
        found = solve_ivp(lambda t, z, v=v: smoothed_rate(z, v), (0, n / rate), z, "DOP853", rtol=1e-11, atol=1e-18)
        z = found.y[:, -1]
        np.testing.assert_allclose(truth.deflection_m[k] * KAPPA, z * KAPPA, atol=2e-6)


def replace_rate(machine: Machine, rate: float) -> Machine:
    return replace(machine, sampling=machine.sampling.model_copy(update={"rate": rate}))


@pytest.mark.parametrize("name", ["paper", "mixed"])
def test_laws_agree_within_the_smoothing(machine: Machine, name: str) -> None:
    # Of 4.5 N. The window softens an element from 0.9 of its level on, and a level that rises as motion slows down is
    # followed late: both belong to the smoothed law.
    trajectory = make_trajectory(name, 1e4)
    smoothed, switched = (truth_of(machine, trajectory, prescribed(law=law)).friction_N for law in LAWS)
    assert np.abs(smoothed - switched).max() < 0.35
    assert np.sqrt(np.mean((smoothed - switched) ** 2)) < 0.16


def test_laws_meet_where_the_smoothing_vanishes(machine: Machine) -> None:
    # With a constant level: one that falls is reached at once by the switching law, over a path of zs by the smoothed.
    trajectory = make_trajectory("paper", 1e4, duration_s=6.0)
    flat = {"stribeck_ratio": 0.0}
    switched = truth_of(machine, trajectory, prescribed(law="maxwell_slip"), parameters=flat).friction_N

    def difference(width: float) -> float:
        sharp = flat | {"zeta": 1.0 - width, "lambda": 3.5 / width, "gamma": 3.5 / width}
        smoothed = truth_of(machine, trajectory, prescribed(substeps=1), parameters=sharp).friction_N
        return float(np.sqrt(np.mean((smoothed - switched) ** 2)))

    differences = [difference(width) for width in (0.1, 0.02, 0.004)]  # to the sharpest that a machine file may have
    assert differences[1] < 0.2 * differences[0]
    assert differences[2] < 0.2 * differences[1]
    assert differences[2] < 2.5e-3


def test_micro_viscous_force_is_the_rate_of_deflection(machine: Machine) -> None:
    trajectory = make_trajectory("paper", 1e4, duration_s=5.0)
    sigma = np.array([30.0, 20.0, 10.0, 40.0])
    plain = truth_of(machine, trajectory, prescribed())
    damped = truth_of(machine, trajectory, prescribed(), parameters={"micro_viscous": tuple(sigma)})
    expected = [sigma @ smoothed_rate(z, v) for z, v in zip(plain.deflection_m, plain.velocity_m_s, strict=True)]
    np.testing.assert_allclose(damped.friction_N - plain.friction_N, expected, atol=1e-9)


# --- mechanics --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
def test_forces_balance(machine: Machine, law: str) -> None:
    run = simulate_axis(machine, make_trajectory("mixed", 1e4), clean(law=law))
    truth = run.truth
    assert truth is not None
    np.testing.assert_allclose(run.log.force_N - MASS * truth.acceleration_m_s2, truth.friction_N, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(run.log.force_N, truth.force_N)
    assert not truth.effect_force_N.any()


def test_motion_is_the_integral_of_the_acceleration(machine: Machine) -> None:
    truth = truth_of(machine, make_trajectory("mixed", 1e4), clean())
    h = 1e-4
    steps = np.diff(truth.velocity_m_s) - 0.5 * h * (truth.acceleration_m_s2[1:] + truth.acceleration_m_s2[:-1])
    assert np.abs(steps).max() < 1e-6
    steps = np.diff(truth.position_m) - 0.5 * h * (truth.velocity_m_s[1:] + truth.velocity_m_s[:-1])
    assert np.abs(steps).max() < 3e-10


@pytest.mark.parametrize("law", LAWS)
def test_energy_balances(machine: Machine, law: str) -> None:
    # Work of the drive = kinetic energy + energy in the springs + dissipation, which never shrinks.
    truth = truth_of(machine, make_trajectory("paper", 1e4), clean(law=law))
    mean_force = 0.5 * (truth.force_N[1:] + truth.force_N[:-1])
    work = np.concatenate(([0.0], np.cumsum(mean_force * np.diff(truth.position_m))))
    stored = 0.5 * MASS * truth.velocity_m_s**2 + 0.5 * truth.deflection_m**2 @ KAPPA
    dissipated = work - stored
    assert np.diff(dissipated).min() > -2e-10
    path = np.sum(np.abs(np.diff(truth.position_m)))
    assert 0.4 * 4.0 * path < dissipated[-1] < 4.48 * path


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("name", "friction", "order"), [("paper", 3e-6, 1.9), ("mixed", 1e-4, 1.8)])
def test_halving_the_step_converges(machine: Machine, law: str, name: str, friction: float, order: float) -> None:
    trajectory = make_trajectory(name, 1e4, duration_s=8.0)
    coarse, default, fine, finest = (
        truth_of(machine, trajectory, clean(law=law, substeps=n)).friction_N for n in (4, 8, 16, 32)
    )
    assert np.abs(default - finest).max() < friction
    assert np.log2(np.abs(coarse - fine).max() / np.abs(default - fine).max() - 1.0 + 1e-9) > order - 1.0
    assert np.log2(np.abs(coarse - default).max() / np.abs(default - fine).max()) > order


def test_stiff_and_fast_axis_is_still_accurate(machine: Machine) -> None:
    trajectory = make_trajectory("trapezoids", 1e4)
    options: dict[str, Any] = {"scale": {"stiffness": 6.0}}
    default, fine = (truth_of(machine, trajectory, clean(substeps=n), **options).friction_N for n in (None, 64))
    assert np.abs(default - fine).max() < 5e-4


def test_loop_follows_its_reference(machine: Machine) -> None:
    trajectory = make_trajectory("mixed", 1e4)
    truth = truth_of(machine, trajectory, AxisConfig())
    error = truth.position_m - trajectory.position_m
    assert np.abs(error).max() < 6e-6
    assert np.sqrt(np.mean(error**2)) < 1.5e-6


def test_controllers(machine: Machine) -> None:
    trajectory = make_trajectory("step_and_settle", 1e4, duration_s=0.6)
    pid = Controller.pid(MASS, 80.0)
    # Of a cascade of gains K, G with integral time T and velocity feed-forward: P = G (K + 1/T), I = G K / T, D = G.
    gain = pid.derivative
    cascade = Controller(gain * (100.0 + 1.0 / 0.02), gain * 100.0 / 0.02, gain, 800.0, 1.0, MASS)
    followed = truth_of(machine, trajectory, clean(controller=cascade))
    assert np.abs(followed.position_m - trajectory.position_m).max() < 1e-5
    # Without it the axis lags its reference by v / K.
    lagging = truth_of(machine, trajectory, clean(controller=replace(cascade, velocity_feedforward=0.0, integral=0.0)))
    assert np.abs(lagging.position_m - trajectory.position_m).max() > 1e-4


def test_slow_loop_of_the_benchmark_axis_is_stable() -> None:
    emps = load_machine("emps")
    trajectory = make_trajectory("trapezoids", emps.sampling.rate, max_velocity=0.12)
    truth = truth_of(emps, trajectory, AxisConfig())
    assert np.abs(truth.position_m - trajectory.position_m).max() < 5e-4


def test_force_limit(machine: Machine) -> None:
    motion = Motion(1e4)
    motion.move_to(0.35, 1.0, 10.0, 400.0)
    motion.wait(0.7)
    truth = truth_of(machine, motion.trajectory("move"), clean(max_force_N=205.0))
    assert 204.9 < np.abs(truth.force_N).max() <= 205.0
    # The integral does not wind up: the axis comes to rest where it should.
    assert abs(truth.position_m[-1] - 0.35) < 5e-6


def test_current_loop_lag_is_between_command_and_log(machine: Machine) -> None:
    trajectory = make_trajectory("trapezoids", 1e4)
    for bandwidth in (300.0, float("inf")):
        run = simulate_axis(machine, trajectory, clean(current_loop_Hz=bandwidth))
        assert run.truth is not None
        np.testing.assert_array_equal(run.log.force_N, run.truth.force_N)


# --- sensors ----------------------------------------------------------------------------------------------------


def test_encoder_and_force_noise(machine: Machine) -> None:
    config = AxisConfig(encoder_resolution_m=5e-9, encoder_noise_m=0.0, force_noise_N=0.4, seed=5)
    run = simulate_axis(machine, make_trajectory("paper", 1e4), config)
    assert run.truth is not None
    counts = run.log.position_m / 5e-9
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert np.abs(run.log.position_m - run.truth.position_m).max() <= 2.5e-9 * (1 + 1e-6)
    noise = run.log.force_N - run.truth.force_N
    assert noise.std() == pytest.approx(0.4, rel=0.01)
    assert abs(noise.mean()) < 0.005
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.01
    assert np.mean(np.abs(noise) < 0.4) == pytest.approx(0.6827, abs=0.005)


def test_encoder_noise_acts_in_the_loop(machine: Machine) -> None:
    config = AxisConfig(encoder_resolution_m=0.0, encoder_noise_m=2e-9, force_noise_N=0.0)
    run = simulate_axis(machine, make_trajectory("paper", 1e4, duration_s=5.0), config)
    assert run.truth is not None
    assert (run.log.position_m - run.truth.position_m).std() == pytest.approx(2e-9, rel=0.02)
    assert run.truth.force_N[100:2000].std() > 0.01


def test_a_seed_is_a_run(machine: Machine) -> None:
    trajectory = make_trajectory("mixed", 1e4, duration_s=2.0)
    config = AxisConfig(encoder_noise_m=1e-9, seed=3)
    first, again, other = (simulate_axis(machine, trajectory, c).log for c in (config, config, replace(config, seed=4)))
    np.testing.assert_array_equal(first.force_N, again.force_N)
    np.testing.assert_array_equal(first.position_m, again.position_m)
    assert not np.array_equal(first.force_N, other.force_N)
    # The streams are apart: silence on the force changes nothing at the encoder.
    silent = simulate_axis(machine, trajectory, replace(config, force_noise_N=0.0)).log
    np.testing.assert_array_equal(first.position_m, silent.position_m)


def test_log_is_a_log(machine: Machine) -> None:
    log = simulate_axis(machine, make_trajectory("paper", 1e4, duration_s=0.5)).log
    assert len(log) == 5000
    assert log.rate == 1e4
    assert log.time_s[0] == 0.0
    np.testing.assert_allclose(np.diff(log.time_s), 1e-4, rtol=1e-9)


# --- true parameters --------------------------------------------------------------------------------------------


def test_parameters_replace_and_scale(machine: Machine) -> None:
    trajectory = ramp(5e-7, 1e-6)

    def slope(**options: Any) -> float:
        truth = truth_of(machine, trajectory, prescribed(), **options)
        return float((truth.friction_N[-1] - 20.0 * truth.velocity_m_s[-1]) / truth.position_m[-1])

    assert slope(scale={"stiffness": 1.5}) == pytest.approx(1.5 * KAPPA.sum())
    assert slope(scale={"stiffness": (1.0, 2.0, 1.0, 1.0)}) == pytest.approx(KAPPA.sum() + 25e3)
    assert slope(parameters={"stiffness_1": 1e5}, scale={"stiffness_1": 0.5}) == pytest.approx(KAPPA[1:].sum() + 5e4)


def test_drift_multiplies_over_time(machine: Machine) -> None:
    trajectory = ramp(0.2, 0.1)
    drifts = {"coulomb": linear_drift(0.5, 2.0), "viscous": lambda t: 1.0 + 0.3 * np.sin(2.0 * np.pi * t)}
    truth = truth_of(machine, trajectory, prescribed(), drift=drifts)
    t = np.floor(truth.time_s[2000:] / 0.01 + 1e-6) * 0.01
    expected = 4.0 * (1.0 + 0.25 * t) + 2.0 * (1.0 + 0.3 * np.sin(2 * np.pi * t))
    # At the first sample of a block the elements still are where the last block left them.
    found = truth.friction_N[2000:]
    inside = np.arange(len(t)) % 100 > 0
    np.testing.assert_allclose(found[inside], expected[inside], rtol=2 * ALPHA)
    # A multiplier of one changes nothing, in whatever blocks.
    plain = truth_of(machine, trajectory, clean())
    same = truth_of(machine, trajectory, clean(), drift={"mass": lambda t: 1.0}, drift_block_s=0.0037)
    np.testing.assert_array_equal(plain.friction_N, same.friction_N)
    # An array's entry by name, on top of the whole array.
    both = {"stiffness": lambda t: 2.0, "stiffness_2": lambda t: 3.0}
    truth = truth_of(machine, ramp(1e-7, 1e-6), prescribed(), drift=both)
    elastic = truth.friction_N[-1] - 20.0 * truth.velocity_m_s[-1]
    assert elastic / 1e-7 == pytest.approx(2.0 * KAPPA.sum() + 4.0 * KAPPA[1])


def test_compensation_is_in_the_loop(machine: Machine) -> None:
    trajectory = make_trajectory("paper", 1e4, duration_s=4.0)
    seen: list[tuple[float, float]] = []

    def constant(position: float, force: float) -> float:
        seen.append((position, force))
        return 3.0

    run = simulate_axis(machine, trajectory, AxisConfig(), compensation=constant)
    plain = simulate_axis(machine, trajectory, AxisConfig())
    np.testing.assert_array_equal(np.array(seen), np.column_stack((run.log.position_m, run.log.force_N)))
    assert run.truth is not None
    assert plain.truth is not None
    assert run.truth.position_m[20] > 1e-8
    assert abs(plain.truth.position_m[20]) < 1e-9
    # What the compensation knows, the controller need not: the exact friction takes the error away.
    known = iter(plain.truth.friction_N)
    better = simulate_axis(machine, trajectory, AxisConfig(), compensation=lambda *_: next(known))
    assert better.truth is not None

    def rms(truth: Truth) -> float:
        return float(np.sqrt(np.mean((truth.position_m - trajectory.position_m) ** 2)))

    assert rms(better.truth) < 0.35 * rms(plain.truth)
    compiled = COMPENSATION(lambda _, position, force: 3.0)
    again = simulate_axis(machine, trajectory, AxisConfig(), compensation=compiled)
    np.testing.assert_array_equal(again.log.force_N, run.log.force_N)


# --- effects ----------------------------------------------------------------------------------------------------

SWEEP = "sweep"


def sweep() -> Trajectory:
    """Fast and slow strokes with waits: something for every effect to act on."""
    motion = Motion(1e4, 0.01)
    motion.wait(0.1)
    motion.move_to(0.06, 0.3, 3.0, 100.0)
    motion.wait(0.1)
    motion.move_to(0.055, 0.02, 1.0, 50.0)
    motion.move_to(-0.03, 0.5, 5.0, 200.0)
    motion.wait(0.1)
    return motion.trajectory(SWEEP)


def as_the_effect_wants(machine: Machine, name: str) -> Machine:
    """The machine, or its rotary twin where it may not have the effect."""
    return machine if machine.plant.kind in effect_definition(name).kinds else load_machine("etel_xy_rotary")


def forces(machine: Machine, name: str, parameters: Mapping[str, float], **options: Any) -> tuple[Array, Truth]:
    """Change of the logged force by an effect under prescribed motion, and the truth with it."""
    machine = as_the_effect_wants(machine, name)
    plain = simulate_axis(machine, sweep(), prescribed(), **options)
    run = simulate_axis(machine, sweep(), prescribed(), hidden_effects=[(name, parameters)], **options)
    assert run.truth is not None
    return run.log.force_N - plain.log.force_N, run.truth


ADDED_FORCES: list[tuple[str, dict[str, float], Callable[[Truth], Array]]] = [
    ("constant_offset", {"force_N": 1.5}, lambda w: np.full_like(w.time_s, 1.5)),
    (
        "force_ripple",
        {"amplitude_N": 0.8, "pitch_m": 0.032, "phase_rad": 0.7},
        lambda w: 0.8 * np.sin(2 * np.pi * w.position_m / 0.032 + 0.7),
    ),
    ("position_spring", {"stiffness_N_m": 30.0, "centre_m": 0.02}, lambda w: 30.0 * (w.position_m - 0.02)),
    ("asymmetric_viscous", {"difference_N_s_m": 5.0}, lambda w: 5.0 * np.abs(w.velocity_m_s)),
    (
        "viscous_drift",
        {"ratio": 0.5, "time_constant_s": 0.4},
        lambda w: 20.0 * 0.5 * (1.0 - np.exp(-w.time_s / 0.4)) * w.velocity_m_s,
    ),
    ("mass_mismatch", {"mass_kg": 1.7}, lambda w: 1.7 * w.acceleration_m_s2),
    ("quadratic_drag", {"coefficient_N_s2_m2": 9.0}, lambda w: 9.0 * w.velocity_m_s * np.abs(w.velocity_m_s)),
    (
        "eddy_current_damping",
        {"damping_N_s_m": 12.0, "corner_velocity_m_s": 0.2},
        lambda w: 12.0 * w.velocity_m_s / (1.0 + (w.velocity_m_s / 0.2) ** 2),
    ),
    (
        "periodic_disturbance",
        {"amplitude_N": 0.5, "frequency_Hz": 17.0, "phase_rad": -0.4},
        lambda w: 0.5 * np.sin(2 * np.pi * 17.0 * w.time_s - 0.4),
    ),
    ("step_disturbance", {"force_N": -2.0, "time_s": 0.3}, lambda w: np.where(w.time_s >= 0.3 - 1e-9, -2.0, 0.0)),
    ("unbalance", {"amplitude_N": 1.2, "phase_rad": 0.4}, lambda w: 1.2 * np.sin(w.position_m + 0.4)),
    ("asymmetric_coulomb", {"ratio": 0.0}, lambda w: np.zeros_like(w.time_s)),
    ("load_dependent_friction", {"ratio": 0.0, "rise_ratio": 0.0}, lambda w: np.zeros_like(w.time_s)),
    ("drive_efficiency", {"efficiency_ratio": 1.0}, lambda w: np.zeros_like(w.time_s)),
    ("micro_viscous", {"damping_N_s_m": 0.0}, lambda w: np.zeros_like(w.time_s)),
]


@pytest.mark.parametrize(("name", "parameters", "expected"), ADDED_FORCES, ids=[entry[0] for entry in ADDED_FORCES])
def test_effect_adds_its_force(
    machine: Machine, name: str, parameters: dict[str, float], expected: Callable[[Truth], Array]
) -> None:
    change, truth = forces(machine, name, parameters)
    np.testing.assert_allclose(change, expected(truth), rtol=1e-9, atol=1e-9)


LEVELS: list[tuple[str, dict[str, float], Callable[[Truth], Array]]] = [
    ("asymmetric_coulomb", {"ratio": 0.1}, lambda w: 0.1 * np.sign(w.velocity_m_s)),
    (
        "position_dependent_friction",
        {"ratio": 0.2, "pitch_m": 0.05, "phase_rad": 0.3},
        lambda w: 0.2 * np.sin(2 * np.pi * w.position_m / 0.05 + 0.3),
    ),
    ("friction_drift", {"ratio": -0.3, "time_constant_s": 0.5}, lambda w: -0.3 * (1.0 - np.exp(-w.time_s / 0.5))),
]


@pytest.mark.parametrize(("name", "parameters", "relative"), LEVELS, ids=[entry[0] for entry in LEVELS])
@pytest.mark.parametrize("law", LAWS)
def test_effect_changes_the_level(
    machine: Machine, law: str, name: str, parameters: dict[str, float], relative: Callable[[Truth], Array]
) -> None:
    truth = truth_of(machine, sweep(), prescribed(law=law), hidden_effects=[(name, parameters)])
    sliding = np.abs(truth.velocity_m_s) > 0.1
    # A smoothed element follows its level over a path of the order of its deflection, here 0.4 mm.
    tolerance = 0.012 if law == "sgms" else 1e-3
    level = (truth.friction_N - 20.0 * truth.velocity_m_s) * np.sign(truth.velocity_m_s)
    np.testing.assert_allclose(level[sliding], 4.0 * (1.0 + relative(truth)[sliding]), rtol=tolerance)


def lost(torque: Array, velocity: Array, efficiency: float) -> Array:
    """What a drive takes beyond a torque, from what it gives out for what is put in on either side."""
    drives = torque * velocity > 0.0
    return np.abs(np.where(drives, torque / efficiency, torque * efficiency) - torque)


def meshed(torque: Array, velocity: Array, ratio: float, share: float) -> Array:
    """Return what a mesh adds to a level of 4 N m that carries a share of all friction too, by bisection."""
    low, high = np.zeros_like(torque), np.full_like(torque, 1e4)
    for _ in range(80):
        added = 0.5 * (low + high)
        carried = np.sign(velocity) * torque + share * (4.0 + added + 20.0 * np.abs(velocity))
        more = ratio * np.abs(carried) > added
        low, high = np.where(more, added, low), np.where(more, high, added)
    return low


LOAD_LEVELS: list[tuple[list[tuple[str, dict[str, float]]], Callable[[Array, Array], Array]]] = [
    ([("load_dependent_friction", {"ratio": 0.2, "rise_ratio": 0.0})], lambda torque, _: 0.2 * np.abs(torque)),
    (
        [("load_dependent_friction", {"ratio": 0.3, "rise_ratio": 0.0, "friction_ratio": 0.8})],
        lambda torque, v: meshed(torque, v, 0.3, 0.8),
    ),
    ([("drive_efficiency", {"efficiency_ratio": 0.6})], lambda torque, v: lost(torque, v, 0.6)),
    (
        [
            ("load_dependent_friction", {"ratio": 0.3, "rise_ratio": 0.0}),
            ("drive_efficiency", {"efficiency_ratio": 0.7}),
        ],
        lambda torque, v: 0.3 * np.abs(torque) + lost(torque, v, 0.7),
    ),
]


@pytest.mark.parametrize(("effects", "added"), LOAD_LEVELS, ids=["load", "mesh", "efficiency", "both"])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("control", ["prescribed", "position"])
def test_the_torque_transmitted_raises_the_level(
    control: str, law: str, effects: list[tuple[str, dict[str, float]]], added: Callable[[Array, Array], Array]
) -> None:
    """Where inertia and what acts on the load hardly change: there the level has come up to them."""
    machine = load_machine("etel_xy_rotary")
    outside = [("unbalance", {"amplitude_N": 9.0, "phase_rad": 0.3}), ("constant_offset", {"force_N": 2.0})]
    more = [
        ("mass_mismatch", {"mass_kg": 5.0}),
        ("force_ripple", {"amplitude_N": 3.0, "pitch_m": 0.1, "phase_rad": 0.0}),
    ]
    config = clean(law=law, control=control)
    # Stiff elements come up to a level within a millimetre.
    truth = truth_of(machine, sweep(), config, hidden_effects=[*outside, *more, *effects], scale={"stiffness": 50.0})
    v, a = truth.velocity_m_s, truth.acceleration_m_s2
    torque = 25.0 * a + 9.0 * np.sin(truth.position_m + 0.3) + 2.0  # no ripple: that is the motor's
    before = np.convolve(np.abs(np.gradient(torque)), np.ones(100))[: len(v)]
    steady = (np.abs(v) > 0.15) & (before < 0.2)
    assert np.ptp(torque[steady]) > 150.0 and steady.sum() > 500
    level = (truth.friction_N - 20.0 * v) * np.sign(v)
    np.testing.assert_allclose(level[steady], 4.0 + added(torque, v)[steady], rtol=0.02)


def test_force_constant_gain_and_delay(machine: Machine) -> None:
    def logged(name: str, **parameters: float) -> tuple[Array, Truth]:
        run = simulate_axis(machine, sweep(), prescribed(), hidden_effects=[(name, parameters)])
        assert run.truth is not None
        return run.log.force_N, run.truth

    force, truth = logged("force_constant_ripple", ratio=0.05, pitch_m=0.04, phase_rad=0.2)
    ripple = 1.0 + 0.05 * np.sin(2 * np.pi * truth.position_m / 0.04 + 0.2)
    np.testing.assert_allclose(force * ripple, truth.force_N, atol=1e-9)

    force, truth = logged("force_gain", gain=1.03)
    np.testing.assert_allclose(force, 1.03 * truth.force_N, rtol=1e-12)

    run = simulate_axis(machine, sweep(), clean(), hidden_effects=[("force_delay", {"delay_s": 3e-4})])
    assert run.truth is not None
    np.testing.assert_allclose(run.log.force_N[3:], run.truth.force_N[:-3], atol=1e-12)
    assert not run.log.force_N[:3].any()
    # Half a sample lies between two.
    run = simulate_axis(machine, sweep(), clean(), hidden_effects=[("force_delay", {"delay_s": 5e-5})])
    assert run.truth is not None
    middle = 0.5 * (run.truth.force_N[1:] + run.truth.force_N[:-1])
    np.testing.assert_allclose(run.log.force_N[1:], middle, atol=0.3)


def test_a_drive_that_obeys_late_logs_its_force_early(machine: Machine) -> None:
    effect = ("force_delay", {"delay_s": -3e-4})
    run = simulate_axis(machine, sweep(), clean(bandwidth_Hz=30.0), hidden_effects=[effect])
    assert run.truth is not None
    np.testing.assert_allclose(run.truth.force_N[3:], run.log.force_N[:-3], atol=1e-12)
    assert not run.truth.force_N[:3].any() and np.abs(run.log.force_N).max() > 5.0
    # Half a sample lies between two.
    effect = ("force_delay", {"delay_s": -5e-5})
    run = simulate_axis(machine, sweep(), clean(bandwidth_Hz=30.0), hidden_effects=[effect])
    assert run.truth is not None
    middle = 0.5 * (run.log.force_N[1:] + run.log.force_N[:-1])
    np.testing.assert_allclose(run.truth.force_N[1:], middle, atol=0.3)
    with pytest.raises(InputError, match="force_delay"):
        simulate_axis(machine, sweep(), prescribed(), hidden_effects=[effect])


def test_actuator_lag(machine: Machine) -> None:
    lag = 2e-3
    run = simulate_axis(
        machine, sweep(), clean(bandwidth_Hz=30.0), hidden_effects=[("actuator_lag", {"time_constant_s": lag})]
    )
    assert run.truth is not None
    true, logged = run.truth.force_N, run.log.force_N
    rate = np.diff(true) * 1e4 * lag
    mean = 0.5 * (logged - true)[1:] + 0.5 * (logged - true)[:-1]
    np.testing.assert_allclose(rate, mean, atol=0.15)
    assert np.abs(rate).max() > 5.0
    with pytest.raises(InputError, match="position"):
        simulate_axis(machine, sweep(), prescribed(), hidden_effects=[("actuator_lag", {"time_constant_s": lag})])


def test_encoder_periodic_error(machine: Machine) -> None:
    effect = ("encoder_periodic_error", {"amplitude_m": 50e-9, "pitch_m": 20e-6, "phase_rad": 1.0})
    run = simulate_axis(machine, sweep(), clean(), hidden_effects=[effect])
    assert run.truth is not None
    expected = 50e-9 * np.sin(2 * np.pi * run.truth.position_m / 20e-6 + 1.0)
    np.testing.assert_allclose(run.log.position_m - run.truth.position_m, expected, atol=1e-14)


def test_hose_hysteresis(machine: Machine) -> None:
    change, truth = forces(machine, "hose_hysteresis", {"stiffness_N_m": 100.0, "force_N": 0.6})
    start = truth.position_m - truth.position_m[0]
    first = (start > 0) & (truth.time_s < 0.35)
    np.testing.assert_allclose(change[first], 0.6 * (1 - np.exp(-100.0 * start[first] / 0.6)), atol=1e-9)
    assert change[-1] == pytest.approx(-0.6, abs=1e-5)


def test_structural_resonance(machine: Machine) -> None:
    effect = {"frequency_Hz": 60.0, "damping_ratio": 0.01, "mass_kg": 3.0}
    motion = Motion(1e4)
    motion.move_to(1e-3, 0.05, 5.0, 2000.0)
    motion.wait(1.0)
    run = simulate_axis(
        machine, motion.trajectory("kick"), prescribed(), hidden_effects=[("structural_resonance", effect)]
    )
    plain = simulate_axis(machine, motion.trajectory("kick"), prescribed())
    ringing = (run.log.force_N - plain.log.force_N)[-8192:]
    spectrum = np.abs(np.fft.rfft(ringing * np.hanning(8192), 65536))
    assert np.fft.rfftfreq(65536, 1e-4)[spectrum.argmax()] == pytest.approx(60.0, abs=0.5)
    # Amplitude falls by exp(-zeta omega t).
    early, late = np.abs(ringing[:1000]).max(), np.abs(ringing[5000:6000]).max()
    assert np.log(early / late) == pytest.approx(0.01 * 2 * np.pi * 60.0 * 0.5, rel=0.05)
    # A slow motion moves both masses as one.
    slow = Motion(1e4)
    slow.move_to(0.05, 0.1, 1.0, 1.0)
    run = simulate_axis(
        machine, slow.trajectory("slow"), prescribed(), hidden_effects=[("structural_resonance", effect)]
    )
    plain = simulate_axis(machine, slow.trajectory("slow"), prescribed())
    np.testing.assert_allclose(run.log.force_N, plain.log.force_N, atol=0.03)


@pytest.mark.parametrize("law", LAWS)
def test_backlash_frees_the_axis_over_the_gap(machine: Machine, law: str) -> None:
    gap = 200e-6
    motion = Motion(1e4)
    for target in (2e-3, -1e-3, 2e-3):
        motion.move_to(target, 2e-3, 0.1, 5.0)
    truth = truth_of(
        machine, motion.trajectory("reversals"), prescribed(law=law), hidden_effects=[("backlash", {"gap_m": gap})]
    )
    free = truth.friction_N == 0.0
    back = (truth.time_s > 1.2) & (truth.velocity_m_s < -1e-6)
    crossed = truth.position_m[free & back]
    assert np.ptp(crossed) == pytest.approx(gap, abs=2e-6)
    # It lets go where the elements are unloaded and slips as before on the other side.
    assert 2e-3 - 450e-6 < crossed.max() < 2e-3 - 250e-6
    assert truth.friction_N.min() < -3.9
    assert truth.friction_N.max() > 3.9


@pytest.mark.parametrize("law", LAWS)
def test_frictional_lag_keeps_the_level_of_the_past(machine: Machine, law: str) -> None:
    truth = truth_of(
        machine, ramp(0.4, 0.2), prescribed(law=law), hidden_effects=[("frictional_lag", {"time_constant_s": 0.05})]
    )
    for t in (0.04, 0.1, 0.2):
        k = round(t * 1e4)
        level = truth.friction_N[k] - 20.0 * truth.velocity_m_s[k]
        assert level == pytest.approx(4.0 * (1.0 + 0.12 * np.exp(-t / 0.05)), rel=4 * ALPHA)


def test_dwell_raises_break_away(machine: Machine) -> None:
    effect = ("dwell_dependence", {"ratio": 0.3, "time_constant_s": 0.5, "length_m": 1e-3})

    def peak(wait: float) -> float:
        motion = Motion(1e4)
        motion.move_to(0.05, 0.1, 2.0, 100.0)
        motion.wait(wait)
        n = len(motion.trajectory("").position_m)
        motion.move_to(0.06, 0.02, 1.0, 100.0)
        truth = truth_of(machine, motion.trajectory("dwell"), prescribed(law="maxwell_slip"), hidden_effects=[effect])
        return float((truth.friction_N - 20.0 * truth.velocity_m_s)[n : n + 1000].max())

    peaks = [peak(wait) for wait in (0.05, 0.3, 1.0, 4.0)]
    assert np.all(np.diff(peaks) > 0.05)
    # In sliding the contact is renewed over its length: d = 1 / (1 + v T / L).
    truth = truth_of(machine, ramp(0.2, 0.1), prescribed(law="maxwell_slip"), hidden_effects=[effect])
    assert truth.friction_N[-1] == pytest.approx(4.0 * (1 + 0.3 / (1 + 0.1 * 0.5 / 1e-3)) + 2.0, rel=1e-4)


def test_micro_viscous_effect_is_split_by_fraction(machine: Machine) -> None:
    trajectory = ramp(5e-7, 1e-6)
    effect = truth_of(machine, trajectory, prescribed(), hidden_effects=[("micro_viscous", {"damping_N_s_m": 50.0})])
    plain = truth_of(machine, trajectory, prescribed())
    np.testing.assert_allclose((effect.friction_N - plain.friction_N)[1:], 50.0 * NU.sum() * 1e-6, rtol=1e-6)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", sorted(loaded_library().effects))
def test_closed_loop_with_every_effect(machine: Machine, name: str, law: str) -> None:
    typical = {
        "amplitude_N": 1.0, "amplitude_m": 5e-8, "pitch_m": 0.032, "phase_rad": 0.5, "force_N": 1.0, "time_s": 0.2,
        "time_constant_s": 5e-4, "ratio": 0.1, "rise_ratio": 0.05, "stiffness_N_m": 50.0, "centre_m": 0.0,
        "difference_N_s_m": 3.0,
        "mass_kg": 2.0, "gain": 1.05, "delay_s": 2e-4, "coefficient_N_s2_m2": 5.0, "damping_N_s_m": 10.0,
        "corner_velocity_m_s": 0.3, "frequency_Hz": 300.0, "damping_ratio": 0.02, "gap_m": 5e-6, "length_m": 1e-5,
    }  # fmt: skip
    if name in ("friction_drift", "viscous_drift", "dwell_dependence"):
        typical["time_constant_s"] = 5e-3
    typical |= {"efficiency_ratio": 0.8, "order": 2.0, "sine_N": 0.5, "cosine_N": -0.3}
    typical |= {"inertia_ratio": 0.6, "friction_ratio": 0.5}
    lists = {
        "friction_curve": {
            "speed_m_s": (2e-3, 1e-2),
            "forward_N": (0.5, 0.3),
            "backward_N": (0.2, 0.4),
            "end_m_s": 0.05,
        },
        "learned_residual": {"place_cells": 1.0, "place_low_m": 0.0, "place_high_m": 2e-3, "force_N": (0.5,) * 4},
    }
    effect = (name, lists.get(name) or {parameter: typical[parameter] for parameter in loaded_library().effects[name]})
    machine = as_the_effect_wants(machine, name)
    trajectory = make_trajectory("mixed", 1e4, duration_s=3.0)
    run = simulate_axis(machine, trajectory, AxisConfig(law=law), hidden_effects=[effect])  # type: ignore[arg-type]
    truth = run.truth
    assert truth is not None
    assert np.abs(truth.position_m - trajectory.position_m).max() < 1e-4
    moving = MASS + {"mass_mismatch": 2.0, "structural_resonance": -2.0}.get(name, 0.0)
    balance = truth.force_N - truth.friction_N - truth.effect_force_N - moving * truth.acceleration_m_s2
    assert np.abs(balance).max() < 1e-10
    plain = simulate_axis(machine, trajectory, AxisConfig(law=law)).log  # type: ignore[arg-type]
    assert np.abs(run.log.force_N - plain.force_N).max() > 0.01


def test_plant_knows_every_effect_of_the_model() -> None:
    known = dict(loaded_library().effects)
    for name in EFFECT_NAMES:
        assert set(known[name]) == {parameter.name for parameter in effect_definition(name).parameters}


def test_machine_effects_are_part_of_the_plant() -> None:
    emps = load_machine("emps")
    trajectory = make_trajectory("trapezoids", emps.sampling.rate, max_velocity=0.1)
    truth = truth_of(emps, trajectory, prescribed())
    np.testing.assert_array_equal(truth.effect_force_N, -3.1648)
    truth = truth_of(emps, trajectory, prescribed(), scale={"constant_offset.force_N": 2.0})
    np.testing.assert_allclose(truth.effect_force_N, -6.3296)
    # The second of a name is numbered.
    more = [("constant_offset", {"force_N": 1.0})]
    truth = truth_of(emps, trajectory, prescribed(), hidden_effects=more, parameters={"constant_offset_2.force_N": 5.0})
    np.testing.assert_allclose(truth.effect_force_N, 5.0 - 3.1648)


# --- bad input --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"parameters": {"stifness": 1.0}}, "parameter"),
        ({"parameters": {"stiffness": (1.0, 2.0)}}, "stiffness"),
        ({"scale": {"coulomb": float("nan")}}, "coulomb"),
        ({"parameters": {"mass": -1.0}}, "mass"),
        ({"scale": {"coulomb": 0.0}}, "coulomb"),
        ({"scale": {"stiffness": (1.0, 1.0, -1.0, 1.0)}}, "stiffness_3"),
        ({"parameters": {"zeta": 1.0}}, "zeta"),
        ({"scale": {"lambda": 1e6}}, "lambda"),
        ({"parameters": {"micro_viscous": -1.0}}, "micro_viscous_1"),
        ({"drift": {"coulomb": linear_drift(-2.0, 0.01)}}, "coulomb"),
        ({"hidden_effects": [("gravity", {})]}, "effect"),
        ({"hidden_effects": [("constant_offset", {"amplitude_N": 1.0})]}, "parameters of constant_offset"),
        ({"hidden_effects": [("constant_offset", {"force_N": 1.0})] * 129}, "effect"),
        ({"hidden_effects": [("constant_offset", {"force_N": float("inf")})]}, "constant_offset.force_N"),
        ({"hidden_effects": [("mass_mismatch", {"mass_kg": -20.0})]}, "mass"),
        ({"hidden_effects": [("force_delay", {"delay_s": 1.0})]}, "force_delay.delay_s"),
        ({"hidden_effects": [("force_delay", {"delay_s": 0.1})]}, "force_delay.delay_s"),
        ({"hidden_effects": [("force_delay", {"delay_s": -0.1})]}, "force_delay.delay_s"),
    ],
)
def test_bad_parameters_are_named(machine: Machine, options: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as caught:
        simulate_axis(machine, ramp(1e-4, 1e-3), clean(), **options)
    assert caught.value.where == where


@pytest.mark.parametrize("ratio", [1.0, -1.0, 1.5, 1e3])
def test_level_without_a_direction_is_refused(machine: Machine, tmp_path: Path, ratio: float) -> None:
    # At 1 the level of one direction is zero, beyond it negative: no friction law goes on from there.
    allowed = "a number from -0.95 to 0.95"
    effect = ("asymmetric_coulomb", {"ratio": ratio})
    with pytest.raises(InputError) as hidden:
        simulate_axis(machine, ramp(1e-4, 1e-3), clean(), hidden_effects=[effect])
    assert (hidden.value.where, hidden.value.value) == ("asymmetric_coulomb.ratio", ratio)
    with pytest.raises(InputError) as scaled:
        smaller = ("asymmetric_coulomb", {"ratio": 0.5})
        factor = {"asymmetric_coulomb.ratio": 2.0 * ratio}
        simulate_axis(machine, ramp(1e-4, 1e-3), clean(), hidden_effects=[smaller], scale=factor)
    assert (scaled.value.where, scaled.value.value) == ("asymmetric_coulomb.ratio", ratio)
    path = tmp_path / "tilted.toml"
    path.write_text(f'extends = "etel_xy"\neffects = [{{ name = "asymmetric_coulomb", ratio = {ratio} }}]\n')
    with pytest.raises(InputError) as loaded:
        load_machine(path)
    assert (loaded.value.source, loaded.value.where) == (str(path), "effects[1].ratio")
    assert hidden.value.allowed == scaled.value.allowed == loaded.value.allowed == allowed


def test_resonance_that_the_substeps_do_not_resolve_is_refused(machine: Machine) -> None:
    hanging = {"damping_ratio": 0.02, "mass_kg": 1.0}
    with pytest.raises(InputError, match=r"frequency_Hz = 7000\.0: at most 6366\.2 Hz"):
        truth_of(
            machine,
            ramp(1e-4, 1e-3),
            clean(),
            hidden_effects=[("structural_resonance", {"frequency_Hz": 7000.0, **hanging})],
        )
    fastest = ("structural_resonance", {"frequency_Hz": 6366.0, **hanging})
    truth = truth_of(machine, make_trajectory("mixed", 1e4, duration_s=0.5), clean(), hidden_effects=[fastest])
    assert np.abs(truth.force_N).max() < 1e3


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "effect",
    [("position_spring", {"stiffness_N_m": -16e6, "centre_m": 0.0}), ("asymmetric_viscous", {"difference_N_s_m": 2e6})],
    ids=lambda effect: str(effect[0]),
)
def test_axis_that_runs_away_is_refused(machine: Machine, effect: tuple[str, dict[str, float]], law: str) -> None:
    trajectory = make_trajectory("mixed", 1e4, duration_s=1.0)
    with pytest.raises(InputError, match="runs away") as caught:
        truth_of(machine, trajectory, clean(law=law), hidden_effects=[effect])
    assert caught.value.where.startswith("sample ")


@pytest.mark.parametrize(
    ("scale", "friction"),
    [
        ({"coulomb": 1e-12}, 4e-12),
        ({"coulomb": 1e-12, "stiffness": 1e6}, 4e-12),
        ({"stiffness": 1e6, "lambda": 28.0}, 4.0),
    ],
)
def test_elements_that_slip_at_once_take_bounded_work(
    machine: Machine, scale: dict[str, float], friction: float
) -> None:
    # A sample is up to 1e12 deflections long here, some of it below the speed that opens the gate.
    motion = Motion(1e4)
    for target in (4e-6, 0.0):
        motion.move_to(target, 1e-3, 1.0, 1e3)
    truth = truth_of(machine, motion.trajectory("short"), prescribed(), scale={**scale, "viscous": 0.0})
    assert np.abs(truth.friction_N).max() <= 2.3 * friction
    assert np.isfinite(truth.deflection_m).all()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("law", "lugre"),
        ("control", "velocity"),
        ("bandwidth_Hz", 0.0),
        ("max_force_N", -1.0),
        ("encoder_resolution_m", float("nan")),
        ("force_noise_N", -0.1),
        ("substeps", 0),
        ("substeps", 1000),
        ("seed", -1),
    ],
)
def test_bad_configuration_is_named(field: str, value: Any) -> None:
    with pytest.raises(InputError) as caught:
        AxisConfig(**{field: value})
    assert caught.value.where == field


def test_rates_must_match(machine: Machine) -> None:
    with pytest.raises(InputError, match=r"sampling\.rate"):
        simulate_axis(machine, make_trajectory("paper", 5e3))
