"""Friction compensation: what the C feeds forward against the law integrated here once more, its switches, the loop."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from c_packages import PROBES, machine, scheme, written
from sgms_bench.compensation.loop import LoopCompensation, LoopedEstimator
from sgms_bench.compensation.running import actuation_delay, axis_config, compare_compensations, run_axis, truth_of
from sgms_bench.compensation.tracking import EKF, MHE, NONE, STATIC, TRUE, measure, rests
from sgms_bench.studies.tracking import tracking_rows
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import replay_definitions
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig, Controller
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion, Trajectory, circle, make_trajectory
from sgms_mhe.reference import UpdateStatus
from sgms_mhe.signals.chain import chain_delay, settle_samples, signals_from_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.toolchain import shared_library

Array = NDArray[np.float64]
RATE = 1e4
SAMPLES = 500
KAPPA = np.array([120e3, 25e3, 7.1e3, 7.9e3])
NU = np.array([0.067, 0.056, 0.047, 0.83])
LEVEL, VISCOUS, BETA, STRIBECK = 4.0, 20.0, 0.12, 1e-3


class Drive:
    """One package through its public functions, as a controller calls them."""

    def __init__(self, settings: Machine, folder: Path) -> None:
        package = written(emit_package(settings, selftest=False), folder)
        sources = [package / f"{settings.name}.c", PROBES / "estimator_probe.c"]
        flags = ["-std=c99", "-O0", "-ffp-contract=off", *replay_definitions(settings.name)]
        self.machine = settings
        self.c = ctypes.CDLL(str(shared_library(sources, [package], flags)))
        number, memory = ctypes.c_double, ctypes.c_void_p
        self.c.probe_size.restype = ctypes.c_size_t
        for name in ("tick", "sample"):
            function = getattr(self.c, f"probe_{name}")
            function.restype, function.argtypes = number, [memory, number, number]
        self.c.probe_ahead.argtypes = [memory, number, number]
        self.c.probe_share.restype = self.c.probe_insert.restype = number

    def new(self) -> Any:
        memory = ctypes.create_string_buffer(self.c.probe_size())
        self.c.probe_init(memory)
        return memory

    def insert(self, memory: Any, signals: Array) -> float:
        return float(self.c.probe_insert(memory, np.ascontiguousarray(signals).ctypes.data_as(ctypes.c_void_p), 1))

    def run(self, memory: Any, position: Array, force: Array, velocity: Array | None = None) -> Array:
        """What tick returns, sample by sample; `velocity`: of the set-point ahead."""
        back = np.empty(len(position))
        for k, (q, u) in enumerate(zip(position.tolist(), force.tolist(), strict=True)):
            if velocity is not None:
                self.c.probe_ahead(memory, float(velocity[k]), 0.0)
            back[k] = self.c.probe_tick(memory, q, u)
        return back

    def estimate(self, memory: Any) -> tuple[Array, int]:
        numbers = np.empty(int(self.c.probe_numbers()))
        return numbers, int(self.c.probe_estimate(memory, numbers.ctypes.data_as(ctypes.c_void_p)))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Drive]:
    built: dict[str, Drive] = {}

    def build(**changes: Any) -> Drive:
        key = repr(changes)
        if key not in built:
            # The filter compiles in a tenth of the time, and the compensation is the same.
            settings = override_machine(machine(estimator={"kind": "ekf"}), changes)
            built[key] = Drive(settings, tmp_path_factory.mktemp("drive"))
        return built[key]

    return build


# --- ahead ------------------------------------------------------------------------------------------------------
# Until the first update the estimator is the model alone, from relaxed elements at nominal parameters on. So what it
# returns can be computed here from the motion: equation (1) along it, then over the lag, then over the delay.


def rate_of_chi(chi: Array, v: float) -> Array:
    """d(chi)/dt of equation (1)."""
    level = 1.0 + BETA * np.exp(-((v / STRIBECK) ** 2))
    r = chi / level
    window = 1.0 - 0.5 * np.tanh(35.0 * (r + 0.9)) + 0.5 * np.tanh(35.0 * (r - 0.9))
    gate = 0.5 + 0.5 * np.tanh(35.0 * r * v / STRIBECK)
    return np.asarray(KAPPA / (NU * LEVEL) * (v - window * gate * abs(v) * r))


def moved(chi: Array, v: float, duration: float, steps: int = 12) -> Array:
    """chi after `duration` at velocity v: classical Runge-Kutta."""
    h = duration / steps
    for _ in range(steps):
        a = rate_of_chi(chi, v)
        b = rate_of_chi(chi + 0.5 * h * a, v)
        c = rate_of_chi(chi + 0.5 * h * b, v)
        chi = chi + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate_of_chi(chi + h * c, v))
    return chi


def friction_at(chi: Array, v: float) -> float:
    return float(LEVEL * (NU * chi).sum() + VISCOUS * v)


@dataclass(frozen=True)
class Motions:
    """A motion with reversals, its signals behind the chain, chi (n, 4) along these."""

    position: Array
    velocity: Array
    delayed_position: Array
    chi: Array

    @property
    def force(self) -> Array:
        return np.zeros(len(self.position))


def motions_of(position: Array) -> Motions:
    count = len(position)
    log = Log(time_s=np.arange(count) / RATE, position_m=position, force_N=np.zeros(count), rate=RATE, source="motion")
    signals = signals_from_log(log, machine())
    chi = np.zeros((count, 4))
    for k in range(1, count):
        chi[k] = moved(chi[k - 1], float(signals.velocity[k]), 1.0 / RATE)
    return Motions(position, signals.velocity, signals.position, chi)


@pytest.fixture(scope="module")
def motion() -> Motions:
    time = np.arange(SAMPLES) / RATE
    # Twice to and fro within the interval; the second turn is tighter, and the start is smooth.
    return motions_of(
        80e-6 * np.sin(2 * np.pi * 55.0 * time * (1.0 + 12.0 * time)) * np.minimum(1.0, (time / 4e-3) ** 2)
    )


def ahead_of(motion: Motions, k: int, delay: float, velocity: float) -> float:
    """Friction when the answer to sample k acts."""
    lag = chain_delay(machine())
    over_lag = (motion.position[k] - motion.delayed_position[k]) / lag
    chi = moved(motion.chi[k], over_lag, lag, 100)
    return friction_at(moved(chi, velocity, delay, 60) if delay else chi, velocity)


DELAY = 400e-6
CHECKED = np.arange(40, SAMPLES - 10, 7)


@pytest.fixture(scope="module")
def told(motion: Motions) -> Array:
    """The set-point's mean velocity over the delay, from each sample on."""
    return (np.roll(motion.position, -4) - motion.position) / DELAY


@pytest.fixture(scope="module")
def expected(motion: Motions, told: Array) -> Array:
    """Friction at the instants of the forces that answer the samples CHECKED."""
    return np.array([ahead_of(motion, int(k), DELAY, float(told[k])) for k in CHECKED])


def long_interval(**changes: Any) -> dict[str, Any]:
    """A table `sampling` whose first update comes after the motion."""
    return {"update_rate": 10.0, **changes}


AHEAD: dict[str, tuple[dict[str, Any], float]] = {
    "flow": ({"sampling": long_interval()}, 2e-5),
    "rk4": ({"sampling": long_interval(**scheme("rk4"))}, 2e-3),
    "mhe": ({"sampling": long_interval(), "estimator": {"kind": "mhe", "horizon": 2}}, 2e-5),
    "single": ({"sampling": long_interval(), "code": {"precision": "single"}}, 5e-4),
}


@pytest.mark.parametrize("variant", AHEAD)
def test_friction_ahead_is_the_law_over_lag_and_delay(
    variant: str, motion: Motions, told: Array, expected: Array, drive: Callable[..., Drive]
) -> None:
    changes, tolerance = AHEAD[variant]
    c = drive(**changes, compensation={"delay": DELAY})
    found = c.run(c.new(), motion.position, motion.force, told)[CHECKED]
    assert np.ptp(expected) > 3.5, "the motion turns the friction round"
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance)
    # The friction there is not what it was at the filtered sample: the propagation is what is tested.
    behind = [friction_at(motion.chi[k], float(motion.velocity[k])) for k in CHECKED]
    assert np.abs(expected - behind).max() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, DELAY])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_shortcuts_ahead_cost_no_accuracy(precision: str, delay: float, drive: Callable[..., Drive]) -> None:
    """Sliding, slowing down through the gate's speed, creeping to and fro at and below it."""
    time = np.arange(900) / RATE
    slide = 1.2e-3 * np.sin(np.minimum(np.pi * time / 0.06, 0.5 * np.pi)) ** 2
    creep = (
        4e-6 * np.sin(2 * np.pi * 22.0 * (time - 0.03) * (1.0 + 6.0 * time)) * np.clip((time - 0.03) / 0.02, 0.0, 1.0)
    )
    motion = motions_of(slide + creep)
    velocity = np.diff(motion.position, append=motion.position[-1]) * RATE
    c = drive(sampling=long_interval(), code={"precision": precision}, compensation={"delay": delay})
    found = c.run(c.new(), motion.position, motion.force, velocity)
    checked = np.arange(40, 890, 2)
    slow = np.abs(motion.velocity[checked]) < 0.36 * STRIBECK
    assert 0.2 < slow.mean() < 0.8
    expected = [ahead_of(motion, int(k), delay, float(velocity[k])) for k in checked]
    assert np.max(expected) > LEVEL, "it slides"
    np.testing.assert_allclose(found[checked], expected, rtol=0.0, atol=1e-4 if precision == "double" else 6e-4)


def test_without_a_delay_the_friction_is_that_of_the_newest_position(
    motion: Motions, drive: Callable[..., Drive]
) -> None:
    c = drive(sampling=long_interval())
    found = c.run(c.new(), motion.position, motion.force, np.zeros(SAMPLES))
    checked = np.arange(40, SAMPLES, 9)
    expected = [ahead_of(motion, int(k), 0.0, 0.0) for k in checked]
    np.testing.assert_allclose(found[checked], expected, rtol=0.0, atol=2e-5)


def test_merged_samples_lose_no_displacement(motion: Motions, drive: Callable[..., Drive]) -> None:
    """Steps of ten samples: what no step has taken in yet moves the elements too."""
    merged = drive(sampling=long_interval(**scheme("flow", substeps=100)))
    plain = drive(sampling=long_interval())
    # One way, up to the elements' slip: nothing may depend on where in a step the sample is.
    steady = 1e-3 * np.arange(SAMPLES) / RATE
    found, expected = (c.run(c.new(), steady, motion.force, np.full(SAMPLES, 1e-3)) for c in (merged, plain))
    assert np.abs(found - expected)[60:].max() < 2e-3
    # A turn in the middle of a step is rounded off, by the way made in a step from rest and no more.
    omega, amplitude, step = 2 * np.pi * 10.0, 100e-6, 10 / RATE
    turning = amplitude * (1.0 - np.cos(omega * np.arange(SAMPLES) / RATE))
    found, expected = (c.run(c.new(), turning, motion.force, np.zeros(SAMPLES)) for c in (merged, plain))
    assert np.abs(found - expected)[60:].max() < KAPPA.sum() * 0.5 * amplitude * omega**2 * step**2


def test_own_signal_chain_has_no_lag(motion: Motions, drive: Callable[..., Drive]) -> None:
    c = drive(sampling=long_interval(), compensation={"delay": DELAY})
    memory = c.new()
    for k in range(300):
        v = float(motion.velocity[k])
        found = c.insert(memory, np.array([motion.delayed_position[k], v, 0.0, 0.0, 0.0]))
        if k in (60, 150, 299):
            expected = friction_at(moved(motion.chi[k], v, DELAY, 200), v)
            assert found == pytest.approx(expected, abs=2e-5)


def test_measured_velocity_is_carried_to_the_instant_of_the_force(drive: Callable[..., Drive]) -> None:
    """Without a set-point the chain's delay must not show: at constant acceleration velocity is exact."""
    acceleration, viscous = 0.4, 1e8  # so much that nothing else counts
    c = drive(friction={"viscous": viscous}, sampling=long_interval(), compensation={"delay": DELAY})
    time = np.arange(SAMPLES) / RATE
    found = c.run(c.new(), 0.5 * acceleration * time**2, 0.0 * time) / viscous
    settled = slice(60, None)
    np.testing.assert_allclose(found[settled], acceleration * (time + DELAY)[settled], rtol=2e-5)


def test_set_point_serves_one_sample(motion: Motions, drive: Callable[..., Drive]) -> None:
    c = drive(sampling=long_interval(), compensation={"delay": DELAY})
    told, silent = c.new(), c.new()
    c.run(silent, motion.position[:100], motion.force[:100])
    c.run(told, motion.position[:100], motion.force[:100])
    c.c.probe_ahead(told, -5e-3, 0.0)
    for k in range(100, 103):
        a, b = (c.c.probe_tick(m, float(motion.position[k]), 0.0) for m in (told, silent))
        assert (a != b) == (k == 100)
    for bad in ((np.nan, 0.0), (0.0, np.inf), (1e12, 0.0)):
        c.c.probe_ahead(told, *bad)
        a, b = (c.c.probe_tick(m, float(motion.position[110]), 0.0) for m in (told, silent))
        assert a == b


# --- effects ----------------------------------------------------------------------------------------------------


STEPS: dict[str, dict[str, Any]] = {"sample": {}, "ten samples": scheme("flow", substeps=100)}


@pytest.mark.parametrize("step", STEPS)
def test_position_dependent_forces_are_those_of_the_position_ahead(
    step: str, motion: Motions, drive: Callable[..., Drive]
) -> None:
    v = 20e-3
    ripple = {"name": "force_ripple", "pitch_m": 1e-4, "amplitude_N": 0.8, "phase_rad": 0.7}
    settings = {"sampling": long_interval(**STEPS[step]), "compensation": {"delay": DELAY}}
    plain, rippled = drive(**settings), drive(**settings, effects=[ripple])
    told = np.full(SAMPLES, v)
    found = [c.run(c.new(), motion.position, motion.force, told)[40:] for c in (plain, rippled)]
    expected = 0.8 * np.sin(2 * np.pi / 1e-4 * (motion.position + v * DELAY) + 0.7)[40:]
    np.testing.assert_allclose(found[1] - found[0], expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("step", STEPS)
def test_forces_in_time_are_those_of_the_instant_ahead(step: str, motion: Motions, drive: Callable[..., Drive]) -> None:
    disturbance = {"name": "periodic_disturbance", "frequency_Hz": 90.0, "amplitude_N": 0.8, "phase_rad": 0.7}
    settings = {"sampling": long_interval(**STEPS[step]), "compensation": {"delay": DELAY}}
    plain, disturbed = drive(**settings), drive(**settings, effects=[disturbance])
    expected = 0.8 * np.sin(2 * np.pi * 90.0 * (np.arange(SAMPLES) / RATE + DELAY) + 0.7)
    found = [c.run(c.new(), motion.position, motion.force, np.zeros(SAMPLES)) for c in (plain, disturbed)]
    np.testing.assert_allclose(found[1] - found[0], expected, rtol=0.0, atol=1e-9)
    # Signals without a lag need none made up for.
    rows = np.column_stack((motion.position, motion.velocity, np.zeros((SAMPLES, 3))))[:60]
    now = [[c.insert(memory, row) for row in rows] for c in (plain, disturbed) for memory in (c.new(),)]
    np.testing.assert_allclose(np.subtract(now[1], now[0]), expected[:60], rtol=0.0, atol=1e-9)


LATE: list[dict[str, Any]] = [
    {"name": "mass_mismatch", "mass_kg": 2.0},
    {"name": "structural_resonance", "frequency_Hz": 150.0, "damping_ratio": 0.02, "mass_kg": 3.0},
    {"name": "force_delay", "delay_s": 4e-4},
    {"name": "actuator_lag", "time_constant_s": 5e-4},
]


def test_what_answers_the_drive_itself_is_not_fed_back(motion: Motions, drive: Callable[..., Drive]) -> None:
    """A lag, a delay or a hanging mass is no friction: fed forward it would feed back."""
    plain, late = drive(sampling=long_interval()), drive(sampling=long_interval(), effects=LATE)
    noise = np.random.default_rng(3).normal(0.0, 5.0, SAMPLES)
    found = [c.run(c.new(), motion.position, noise, np.zeros(SAMPLES)) for c in (plain, late)]
    np.testing.assert_allclose(found[1], found[0], rtol=0.0, atol=1e-9)
    # The set-point's acceleration, where it is told, is what the heavier mass needs on top of the machine file's.
    inertia = []
    for c in (plain, late):
        memory = c.new()
        c.c.probe_ahead(memory, 0.0, 0.7)
        inertia.append(c.c.probe_tick(memory, 0.0, 0.0))
    assert inertia[1] - inertia[0] == pytest.approx(2.0 * 0.7, abs=1e-9)


COUPLED: dict[str, dict[str, float]] = {
    "dwell_dependence": {},
    "hose_hysteresis": {},
    "backlash": {"gap_m": 2e-6},
    "encoder_periodic_error": {},
}


@pytest.mark.parametrize("name", COUPLED)
def test_effects_with_states_go_ahead_with_the_elements(name: str, drive: Callable[..., Drive]) -> None:
    """The friction ahead is the one that the model reaches a lag later, when the same motion goes on.

    Not to the last digit: the lag counts as one move at its mean velocity.
    """
    effects = [{"name": name, **COUPLED[name]}]
    c = drive(sampling=long_interval(), effects=effects)
    rate = 60
    time = np.arange(SAMPLES) / RATE
    position = 40e-6 * np.sin(2 * np.pi * 25.0 * time) ** 3
    signals = signals_from_log(
        Log(time_s=time, position_m=position, force_N=0.0 * time, rate=RATE, source="wave"), c.machine
    )
    ahead = c.run(c.new(), position, 0.0 * time, np.gradient(position) * RATE)
    memory = c.new()
    now = np.array(
        [c.insert(memory, np.array([signals.position[k], signals.velocity[k], 0.0, 0.0, 0.0])) for k in range(SAMPLES)]
    )
    late = chain_delay(c.machine) * RATE
    expected = np.interp(np.arange(SAMPLES) + late, np.arange(SAMPLES), now)
    part = slice(rate, SAMPLES - 20)
    rough = np.abs(now - expected)[part].max()
    assert rough > 0.3, "otherwise there is nothing to see"
    assert np.abs(ahead - expected)[part].max() < 0.12 * rough
    assert np.sqrt(np.mean((ahead - expected)[part] ** 2)) < 0.1 * np.sqrt(np.mean((now - expected)[part] ** 2))


# --- switches ---------------------------------------------------------------------------------------------------


def moves() -> Trajectory:
    """Moves to and fro, 0.3 s at rest, and another move."""
    path = Motion(RATE)
    path.wait(0.05)
    for target in (4e-4, -2e-4, 1e-4):
        path.move_to(target, 4e-3, 0.5, 50.0)
    path.wait(0.3)
    path.move_by(2e-4, 4e-3, 0.5, 50.0)
    path.wait(0.02)
    return path.trajectory("moves")


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate_axis(machine(), moves(), AxisConfig(seed=5)).log


def ticked(c: Drive, log: Log) -> Array:
    return c.run(c.new(), log.position_m, log.force_N)


def test_off_feeds_nothing_and_estimates_the_same(log: Log, drive: Callable[..., Drive]) -> None:
    on, off = drive(), drive(compensation={"enabled": False})
    memories = [c.new() for c in (on, off)]
    found = [c.run(m, log.position_m, log.force_N) for c, m in zip((on, off), memories, strict=True)]
    assert not found[1].any() and np.abs(found[0]).max() > 3.0
    assert off.c.probe_share(memories[1]) == 0.0
    (a, s), (b, t) = on.estimate(memories[0]), off.estimate(memories[1])
    np.testing.assert_array_equal(a, b)
    assert s == t


def test_ramp_up_and_down(log: Log, drive: Callable[..., Drive]) -> None:
    full = ticked(drive(), log)
    c = drive(compensation={"ramp": 0.02})
    memory, back, share = c.new(), np.empty(1200), np.empty(1200)
    for k in range(1200):
        if k in (500, 600):
            c.c.probe_compensate(memory, int(k == 600))
        back[k] = c.c.probe_tick(memory, float(log.position_m[k]), float(log.force_N[k]))
        share[k] = c.c.probe_share(memory)
    step = 1.0 / (0.02 * RATE)
    expected = np.concatenate((np.minimum(step * np.arange(1, 501), 1.0), 1.0 - step * np.arange(1, 101)))
    expected = np.concatenate((expected, np.minimum(expected[-1] + step * np.arange(1, 601), 1.0)))
    np.testing.assert_allclose(share, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(back, share * full[:1200], rtol=1e-12, atol=0.0)


def test_limit(log: Log, drive: Callable[..., Drive]) -> None:
    full = ticked(drive(), log)
    assert full.max() > 2.0 and full.min() < -2.0
    np.testing.assert_array_equal(ticked(drive(compensation={"limit": 1.5}), log), np.clip(full, -1.5, 1.5))


def test_hold_at_standstill(log: Log, drive: Callable[..., Drive]) -> None:
    """What is fed forward stands still to the last bit, lets go without a step, and goes back to the estimate."""
    loose, tight = (ticked(drive(**changes), log) for changes in ({}, {"compensation": {"hold": 1e-5}}))
    again = rests(moves())[0][1]
    still = slice(again - 1500, again)
    assert np.ptp(tight[still]) == 0.0
    assert np.ptp(loose[still]) > 0.02
    held = abs(tight[again - 1] - loose[again - 1])
    steps = [np.abs(np.diff(x[again - 1 :])).max() for x in (loose, tight)]
    assert steps[1] < steps[0] + 0.02 * held
    arrived = slice(len(tight) - 320, len(tight) - 220)  # before the axis stands again
    np.testing.assert_allclose(tight[arrived], loose[arrived], rtol=0.0, atol=0.1 * held)
    assert held > 5e-3


def test_set_point_that_starts_lets_go(log: Log, drive: Callable[..., Drive]) -> None:
    c = drive(compensation={"hold": 1e-5})
    memory, n = c.new(), rests(moves())[0][1] - 300
    held = c.run(memory, log.position_m[:n], log.force_N[:n])
    assert np.ptp(held[-500:]) == 0.0
    rest = (log.position_m[n : n + 5], log.force_N[n : n + 5])
    assert np.ptp(c.run(memory, *rest, np.full(5, 0.9e-5))) == 0.0
    back = c.run(memory, *rest, np.full(5, 2e-5))
    assert (np.diff(np.append(held[-1], back)) != 0.0).all()


def test_lost_position_ramps_to_zero_and_back(log: Log, drive: Callable[..., Drive]) -> None:
    c = drive(compensation={"ramp": 0.02})
    settle = settle_samples(c.machine)
    memory = c.new()
    position = log.position_m.copy()
    position[1000:1400] = np.nan
    back = c.run(memory, position[:1000], log.force_N[:1000])
    shares = []
    for k in range(1000, 1800):
        back = np.append(back, c.c.probe_tick(memory, float(position[k]), float(log.force_N[k])))
        shares.append(c.c.probe_share(memory))
    assert np.isfinite(back).all()
    assert shares[settle - 1] == 1.0, "a short gap is bridged"
    assert 0.0 < shares[settle + 150] < 1.0 and shares[settle + 205] == 0.0 and back[1399] == 0.0
    assert shares[-1] == 1.0


def test_lost_samples_ramp_to_zero_and_back(log: Log, drive: Callable[..., Drive]) -> None:
    c = drive(compensation={"ramp": 0.02})
    memory = c.new()
    for k in range(1200):
        c.c.probe_sample(memory, float(log.position_m[k]), float(log.force_N[k]))
        late = 800 <= k < 840  # the slow task is late once
        if c.c.probe_due(memory) and not late:
            c.c.probe_feedback(memory)
            c.c.probe_prepare(memory)
        if k == 839:
            assert c.c.probe_share(memory) == pytest.approx(1.0 - 39 / 200)
    assert c.c.probe_share(memory) == 1.0


@pytest.mark.parametrize("on_doubt", ["keep", "ramp"])
def test_doubt_leaves_the_force_on_or_ramps_it(on_doubt: str, log: Log, drive: Callable[..., Drive]) -> None:
    """A force of 100 N that no friction explains: only where the machine file says so does the share fall."""
    c = drive(compensation={"ramp": 0.02, "on_doubt": on_doubt})
    memory, share, doubted = c.new(), np.empty(1200), np.zeros(1200, dtype=bool)
    for k in range(1200):
        c.c.probe_tick(memory, float(log.position_m[k]), float(log.force_N[k]) + 100.0 * (k >= 600))
        share[k] = c.c.probe_share(memory)
        doubted[k] = c.estimate(memory)[1] >= 0 and bool(c.estimate(memory)[1] & UpdateStatus.DOUBT)
    late = np.flatnonzero(doubted)[1:]
    assert share[599] == 1.0 and late[0] < 1000
    steps = np.diff(share)[late - 1][share[late - 1] > 0.0]
    assert np.all(share[late] == 1.0) if on_doubt == "keep" else np.all(steps < 0.0) and share[late].min() == 0.0


@pytest.mark.parametrize("precision", ["double", "single"])
def test_bad_input_never_reaches_the_drive(precision: str, log: Log, drive: Callable[..., Drive]) -> None:
    c = drive(code={"precision": precision}, compensation={"limit": 6.0, "delay": 3e-4, "hold": 1e-5})
    bad = [np.nan, np.inf, -np.inf, 1e300, -4e6, 1e9, 3.9e6, -3.9e6]
    rng = np.random.default_rng(11)
    memory = c.new()
    back = np.empty(4000)
    for k in range(4000):
        q, u = float(log.position_m[k % 2000]), float(log.force_N[k % 2000])
        if k % 23 == 0:
            c.c.probe_ahead(memory, float(rng.choice(bad)), float(rng.choice(bad)))
        if k % 17 == 0:
            q = float(rng.choice(bad))
        if k % 19 == 0:
            u = float(rng.choice(bad))
        back[k] = c.c.probe_tick(memory, q, u)
    assert np.isfinite(back).all() and np.abs(back).max() <= 6.0
    # Once the inputs are good again, so is what comes out.
    c.c.probe_reset(memory)
    again = c.run(memory, log.position_m, log.force_N)
    fresh = ticked(drive(compensation={"limit": 6.0, "delay": 3e-4, "hold": 1e-5}), log)
    assert np.abs(again - fresh)[-1000:].max() < 0.6


def test_instances_do_not_disturb_each_other(log: Log, motion: Motions, drive: Callable[..., Drive]) -> None:
    c = drive(compensation={"limit": 6.0, "delay": 3e-4, "hold": 1e-5})
    pairs = ((log.position_m[:SAMPLES], log.force_N[:SAMPLES]), (motion.position, motion.force))
    alone = [c.run(c.new(), *pair) for pair in pairs]
    memories = [c.new(), c.new()]
    together = np.array(
        [
            [c.c.probe_tick(m, float(q[k]), float(u[k])) for m, (q, u) in zip(memories, pairs, strict=True)]
            for k in range(SAMPLES)
        ]
    )
    np.testing.assert_array_equal(together.T, np.array(alone))


@pytest.mark.parametrize(
    ("key", "value"), [("delay", -1e-3), ("delay", 1.0), ("ramp", -0.1), ("limit", 0.0), ("hold", -1.0), ("late", 1.0)]
)
def test_table_is_checked(key: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"compensation\.{key}"):
        machine(compensation={key: value})


# --- the loop ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compensated() -> Machine:
    return load_machine("etel_xy_compensation")


@pytest.fixture(scope="module")
def circles(compensated: Machine) -> Any:
    return compare_compensations(compensated, ["circle"], duration_s=3.0)


@pytest.mark.parametrize("row", ["circle, x", "circle, y", "circle, contour"])
@pytest.mark.parametrize("method", [EKF, MHE])
def test_peaks_after_reversals_shrink(circles: Any, row: str, method: str) -> None:
    """Parameters 30 % off at the start, drifting by 25 %: the first reversals count too."""
    peak = {name: circles.measures[row, name].peak_m for name in (method, NONE, STATIC, TRUE)}
    assert len(circles.measures[row, method].peaks_m) >= 3
    assert peak[method] < 0.09 * peak[NONE]
    assert peak[method] < 0.12 * peak[STATIC]
    assert circles.measures[row, method].worst_m < 0.2 * circles.measures[row, NONE].worst_m
    # What no observer beats, and far from what it leaves: the comparison has room.
    assert peak[TRUE] < 0.2 * peak[method]
    assert peak[NONE] > 3e-7


def test_a_force_of_a_place_is_fed_forward(compensated: Machine) -> None:
    """On an axis with cogging that its machine file has not."""
    as_the_file, followed = tracking_rows("cogging 0.3 N / 2 mm", "circle", 6.0)
    for method in (EKF, MHE):
        assert followed[f"{method} RMS"] < 0.6 * as_the_file[f"{method} RMS"]
        assert followed[f"{method} peak"] < 0.7 * as_the_file[f"{method} peak"]


def test_settling_after_a_move(compensated: Machine) -> None:
    found = compare_compensations(compensated, ["step_and_settle"], duration_s=0.1)
    times = {method: found.measures["step_and_settle", method].settling_s for method in (NONE, MHE, TRUE)}
    assert len(times[NONE]) == 12
    assert times[NONE].min() > 0.02
    assert times[MHE].mean() < 0.3 * times[NONE].mean()
    assert times[TRUE].max() <= times[MHE].max()


def test_single_precision_in_the_loop(compensated: Machine) -> None:
    x, _ = circle(RATE, laps=1)
    found = []
    for precision in ("double", "single"):
        settings = override_machine(compensated, {"code": {"precision": precision}, "estimator": {"kind": "ekf"}})
        run = run_axis(settings, LoopedEstimator(settings), x, truth_of(settings), EKF, config=axis_config(settings, 0))
        found.append(float(np.sqrt(np.mean(run.error_m**2))))
    assert found[1] == pytest.approx(found[0], rel=0.05)


def stand(compensated: Machine, hold: float) -> tuple[float, float]:
    """Spread of error [m] and fed-forward force [N] over the last half second at rest."""
    path = Motion(RATE)
    path.wait(0.05)
    path.move_by(4e-3, 0.3, 3.0, 100.0)
    path.wait(0.8)
    trajectory = path.trajectory("stand")
    settings = override_machine(compensated, {"compensation": {"hold": hold}, "estimator": {"kind": "ekf"}})
    truth, config = truth_of(settings, drift=0.0), axis_config(settings, 0)
    run = run_axis(settings, LoopedEstimator(settings), trajectory, truth, EKF, config=config)
    return float(np.ptp(run.error_m[-5000:])), float(np.ptp(run.compensation_N[-5000:]))


def test_hold_ends_the_hunting_at_standstill(compensated: Machine) -> None:
    """An observer in the loop integrates, so it hunts about a standstill; a hold above the encoder's noise ends it."""
    assert stand(compensated, 0.0)[0] > 1e-8
    error, force = stand(compensated, compensated.compensation.hold)
    assert force == 0.0 and error < 1e-9


def test_set_point_is_not_needed(compensated: Machine) -> None:
    x, _ = circle(RATE, laps=1)
    estimator = LoopedEstimator(compensated)
    peaks = [
        measure(
            run_axis(
                compensated,
                estimator,
                x,
                truth_of(compensated),
                MHE,
                config=axis_config(compensated, 0),
                set_point=known,
            ),
            5e-8,
        ).peak_m
        for known in (True, False)
    ]
    assert peaks[1] < 1.3 * peaks[0]


def test_series_fed_forward_is_what_a_callback_feeds(compensated: Machine) -> None:
    x, _ = circle(RATE, laps=1)
    x = Trajectory("part", RATE, x.position_m[:4000])
    force = np.sin(np.arange(4000) / 100.0)
    loop = LoopCompensation(LoopedEstimator(compensated), 4000, force=force)
    values = iter(force.tolist())
    native = simulate_axis(compensated, x, compensation=loop.native)
    called = simulate_axis(compensated, x, compensation=lambda *_: next(values))
    np.testing.assert_array_equal(native.log.position_m, called.log.position_m)
    with pytest.raises(ValueError, match="shape"):
        LoopCompensation(LoopedEstimator(compensated), 100, force=force)


def test_inertia_fed_forward_in_time_leaves_no_error(compensated: Machine) -> None:
    trajectory = make_trajectory("step_and_settle", RATE, duration_s=0.4)
    plain: dict[str, Any] = {"parameters": {"coulomb": 1e-6, "viscous": 0.0}}
    worst = []
    for lead in (0.0, actuation_delay(compensated)):
        config = replace(axis_config(compensated, 0), controller=Controller.pid(20.0, 80.0, feedforward_lead_s=lead))
        run = simulate_axis(compensated, trajectory, config, **plain)
        assert run.truth is not None
        worst.append(float(np.abs(run.truth.position_m - trajectory.position_m)[1000:3000].max()))
    assert worst[1] < 0.05 * worst[0]
