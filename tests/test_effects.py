"""Every effect of the catalogue: against the base model, the emitted C, the simulated plant, and wrong input."""

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.structure import analyse
from sgms_mhe.evaluation.comparison import TOLERANCES
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Kind, Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects import (
    BASE_CAUSES,
    CAUSE_NAMES,
    EFFECT_NAMES,
    MOVES,
    Extents,
    MotionRecord,
    base_number,
    cause,
    effect_definition,
    effect_names,
    own_effects,
    reported_name,
    separating_moves,
)
from sgms_mhe.model.effects.checks import faults_of
from sgms_mhe.model.effects.excitation import MEASURES
from sgms_mhe.model.effects.search import Columns, Derivative, Harmonic, Step, Trials
from sgms_mhe.model.scales import scales_of
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.native import loaded_library
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion, Trajectory
from sgms_mhe.recordings.excitation import measure_excitation
from sgms_mhe.recordings.free_run import run_freely
from sgms_mhe.reference.integrator import ReferenceIntegrator
from sgms_mhe.reference.mhe import run_mhe
from sgms_mhe.reference.problem import NodeRecord
from sgms_mhe.signals.chain import Signals
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.toolchain import WARNING_FLAGS

Array = NDArray[np.float64]

RATE = 5000.0
# The compiler finds more of what it warns of where it optimises.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", *WARNING_FLAGS)
START = 3  # updates: where an effect is there from the first sample, the controller has to take it up first


@dataclass(frozen=True)
class Case:
    """An effect's parameters, and how far prediction and plant may be apart: RMS and largest [N].

    The base model is apart from the plant by 1e-3 N RMS, 8e-3 N at most: velocity is the mean over a sample.
    """

    parameters: dict[str, Any]
    rms_N: float = 2e-3
    largest_N: float = 1e-2


CASES = {
    "force_ripple": Case({"amplitude_N": 0.6, "pitch_m": 0.004, "phase_rad": 0.7}),
    "force_constant_ripple": Case({"ratio": 0.05, "pitch_m": 0.004, "phase_rad": 0.7}),
    "constant_offset": Case({"force_N": 0.5}),
    "position_spring": Case({"stiffness_N_m": 60.0, "centre_m": 0.002}),
    "hose_hysteresis": Case({"stiffness_N_m": 800.0, "force_N": 0.8}),
    "asymmetric_coulomb": Case({"ratio": 0.15}),
    "asymmetric_viscous": Case({"difference_N_s_m": 12.0}),
    "position_dependent_friction": Case({"ratio": 0.2, "pitch_m": 0.004, "phase_rad": 0.7}),
    "friction_drift": Case({"ratio": 0.3, "time_constant_s": 1.0}),
    "viscous_drift": Case({"ratio": 0.5, "time_constant_s": 1.0}),
    "mass_mismatch": Case({"mass_kg": 1.5}),
    "force_gain": Case({"gain": 1.07}),
    # Second order in the delay, and an element that breaks away within it.
    "force_delay": Case({"delay_s": 4e-4}, 1.5e-2, 0.1),
    # The command is a staircase whose steps the log shows only at their ends.
    "actuator_lag": Case({"time_constant_s": 5e-4}, 2e-2, 8e-2),
    "quadratic_drag": Case({"coefficient_N_s2_m2": 300.0}),
    "eddy_current_damping": Case({"damping_N_s_m": 15.0, "corner_velocity_m_s": 0.03}),
    # Second difference of the reading, over samples in which the angle moves by up to 0.06.
    "encoder_periodic_error": Case({"amplitude_m": 5e-7, "pitch_m": 1e-3, "phase_rad": 0.7}, 5e-2, 0.3),
    "structural_resonance": Case({"frequency_Hz": 60.0, "damping_ratio": 0.03, "mass_kg": 3.0}, 6e-3, 3e-2),
    "periodic_disturbance": Case({"amplitude_N": 0.4, "frequency_Hz": 13.0, "phase_rad": 0.7}),
    # A step at 1.2043 s, a millisecond wide, between two updates.
    "step_disturbance": Case({"force_N": 0.5, "time_s": 1.2043}),
    # Contact ends over 5 % of f_C and over 1/35 of the gap; the plant's at once.
    "backlash": Case({"gap_m": 2e-5}, 3e-2, 0.2),
    "frictional_lag": Case({"time_constant_s": 0.02}),
    "viscous_lag": Case({"time_constant_s": 0.02}),
    "dwell_dependence": Case({"ratio": 0.3, "time_constant_s": 0.3, "length_m": 1e-4}),
    "micro_viscous": Case({"damping_N_s_m": 30.0}, 3e-3, 2e-2),
    "unbalance": Case({"amplitude_N": 1.5, "phase_rad": 0.7}),
    # The level follows the acceleration, which changes within a sample.
    "load_dependent_friction": Case({"ratio": 0.1, "rise_ratio": 0.05}, 4e-3, 3e-2),
    "drive_efficiency": Case({"efficiency_ratio": 0.8}, 8e-3, 5e-2),
    "learned_residual": Case(
        {
            "speed_cells": 2,
            "speed_scale_m_s": 0.02,
            "speed_low_m_s": -0.03,
            "speed_high_m_s": 0.03,
            "speed_lag_s": 0.05,
            "travel_cells": 1,
            "travel_length_m": 1e-3,
            "force_N": [0.04 * ((7 * k) % 19 - 9) for k in range(20)],
        }
    ),
    "position_map": Case(
        {"pitch_m": 0.004, "order": [1, 2, 6], "sine_N": [0.5, 0.1, 0.15], "cosine_N": [0.2, -0.3, 0.05]}
    ),
    "friction_curve": Case(
        {
            "speed_m_s": [0.001, 0.004, 0.02],
            "forward_N": [0.4, 1.2, 0.8],
            "backward_N": [0.8, 0.6, -0.4],
            "end_m_s": 0.045,
        }
    ),
}


def trajectory(rate: float = RATE) -> Trajectory:
    """Two seconds of quick and slow moves, rests, reversals within and beyond break-away, and a swing."""
    motion = Motion(rate)
    motion.wait(0.02)
    motion.move_by(0.004, 0.03, 1.0, 60.0)
    motion.wait(0.15)
    motion.move_by(-0.002, 0.01, 0.5, 30.0)
    motion.move_by(0.0005, 0.002, 0.1, 5.0)
    motion.wait(0.3)
    motion.move_by(-0.0003, 0.002, 0.2, 10.0)
    motion.move_by(0.006, 0.05, 2.0, 100.0)
    motion.swing(3e-4, 8.0, 3)
    motion.move_by(-0.006, 0.02, 1.0, 60.0)
    return motion.trajectory("mixed")


@cache
def base(kind: Kind = "linear") -> Machine:
    """The machine that effects are added to, as an axis of either kind."""
    return override_machine(
        load_machine({"linear": "etel_xy", "rotary": "etel_xy_rotary"}[kind]),
        {
            "sampling": {"rate": RATE, "update_rate": 100.0, "integrator": {"scheme": "flow"}},
            "estimator": {"horizon": 3, "bounds": {}, "relinearise": "all"},
        },
    )


def extended(*effects: tuple[str, dict[str, float]], free: tuple[str, ...], **changes: Any) -> Machine:
    """The base machine that may have them with effects, stiffness and `free` estimated."""
    machine = base_for(*(name for name, _ in effects))
    units = machine.plant.units
    entries = [{"name": name, **units.keyed(parameters)} for name, parameters in effects]
    estimator = {"parameters": ["stiffness", *map(units.named, free)]}
    return override_machine(machine, {"effects": entries, "estimator": estimator, **changes})


def base_for(*names: str) -> Machine:
    """The base machine of the first kind that may have all of these effects."""
    kinds: tuple[Kind, ...] = ("linear", "rotary")
    return base(next(kind for kind in kinds if all(kind in effect_definition(name).kinds for name in names)))


@cache
def machine_of(name: str) -> Machine:
    free = tuple(f"{name}.{parameter}" for parameter in effect_definition(name).main)
    return extended((name, CASES[name].parameters), free=free)


@cache
def integrator_of(name: str) -> ReferenceIntegrator:
    return ReferenceIntegrator(build_model(machine_of(name)))


def simulated(machine: Machine, *, as_read: bool, noise_N: float = 0.0) -> Signals:
    """The plant's force along its true motion, or along the motion that its encoder reads."""
    config = AxisConfig(encoder_resolution_m=0.0, force_noise_N=noise_N)
    run = simulate_axis(machine, trajectory(machine.sampling.rate), config)
    assert run.truth is not None
    rate = machine.sampling.rate
    position = run.log.position_m if as_read else run.truth.position_m
    acceleration = run.truth.acceleration_m_s2
    if as_read:
        acceleration = np.diff(position, 2, prepend=position[:1], append=position[-1:]) * rate**2
    good = np.ones(len(position), dtype=bool)
    return Signals(
        time=run.log.time_s,
        position=position,
        velocity=np.diff(position, prepend=position[:1]) * rate,
        acceleration=acceleration,
        force=run.log.force_N,
        friction=run.log.force_N - machine.plant.moved * acceleration,
        valid=good,
        missing=~good,
    )


def deviation(integrator: ReferenceIntegrator, signals: Signals) -> Array:
    """Model alone along the motion minus the plant, at the updates [N]."""
    model = integrator.model
    record = NodeRecord(model, signals, integrator)
    theta = np.ones(model.n_p)
    x = np.zeros((record.updates + 1, model.n_x))
    for k in range(record.updates):
        x[k + 1] = integrator.intervals(record.plan, k, x[k : k + 1], theta).x1[0]
    return np.asarray(integrator.outputs(x, record.w, theta).y - record.y)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


# --- registry ---------------------------------------------------------------------------------------------------


def test_model_and_plant_know_the_same_effects() -> None:
    of_model = {name: tuple(p.name for p in effect_definition(name).parameters) for name in EFFECT_NAMES}
    assert of_model == dict(loaded_library().effects)
    assert set(CASES) == set(EFFECT_NAMES)
    assert len(EFFECT_NAMES) == 31


@pytest.mark.parametrize("name", CAUSE_NAMES)
def test_description_is_complete(name: str) -> None:
    described = cause(name)
    assert described.name == name and described.summary and described.excitation.text and described.confused_with
    assert set(described.confused_with) <= set(CAUSE_NAMES) - {name}
    for other in described.confused_with:
        assert separating_moves(name, other) and separating_moves(other, name) == separating_moves(name, other)[::-1]
    assert all(need.measure in MEASURES for need in described.excitation.needs)
    if name in BASE_CAUSES:
        return
    definition = effect_definition(name)
    assert definition.main
    assert all(p.size(scales_of(base())) > 0.0 for p in definition.parameters)
    assert not list(faults_of(definition, CAUSE_NAMES))
    states = build_model(machine_of(name)).states
    assert [s.name for s in states[4:]] == [f"{name}_{state}" for state in definition.states]
    assert [s.element for s in states] == [0, 1, 2, 3] + [None] * len(definition.states)


@pytest.mark.parametrize("name", sorted(BASE_CAUSES))
def test_wrong_numbers_free_base_parameters(name: str) -> None:
    freed = override_machine(base(), {"estimator": {"parameters": list(BASE_CAUSES[name].frees)}})
    assert {p.name for p in build_model(freed).parameters} == set(BASE_CAUSES[name].frees)
    columns = [p.column for p in build_model(freed).parameters]
    assert all(base_number(column) in BASE_CAUSES[name].numbers for column in columns)
    reported = [reported_name(column) for column in columns]
    assert len(set(reported)) == len(columns) and all(r.startswith(c) for r, c in zip(reported, columns, strict=True))


# --- what the diagnosis reads of a definition --------------------------------------------------------------------


@pytest.mark.parametrize("name", CAUSE_NAMES)
def test_causes_refer_to_causes(name: str) -> None:
    described = cause(name)
    others = set(CAUSE_NAMES) - {name}
    assert described.moves and set(described.moves) <= set(MOVES)
    assert set(described.excludes) <= others and all(name in cause(other).excludes for other in described.excludes)
    # A limit of an effect looks like it, and is not the effect again by way of its own limits.
    limits, reached = set(described.simpler.causes), set[str]()
    assert limits <= others
    while limits - reached:
        reached |= limits
        limits = {limit for other in limits for limit in cause(other).simpler.causes}
    assert name not in reached


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_declared_parameters_are_consistent(name: str) -> None:
    definition = effect_definition(name)
    parameters = {p.name: p for p in definition.parameters}
    sizes = [p for p in definition.parameters if p.is_size]
    assert sizes and all(p.lower <= p.none <= p.upper or p.none == 0.0 for p in sizes)
    # Some size is none by default, so that the default effect is none.
    assert any(p.none == p.default for p in sizes)
    assert all(p.role == "place" or p.is_optional for p in definition.parameters if p.frozen)
    assert all(p.name.endswith("_s") and definition.full_rate for p in definition.parameters if p.timing)
    assert not (definition.linear and (definition.states or definition.costly))
    extents = Extents(travel=0.2, speed=0.5, duration=10.0, end=12.0, rate=1000.0)
    for p in definition.parameters:
        nominal = p.default or p.scale
        assert p.step(nominal, p.scale, extents) > 0.0
        assert p.least is None or p.lower <= p.least(extents) <= p.upper
        assert p.most is None or p.lower <= p.most(extents) <= p.upper
    assert not definition.simpler.reached({key: p.default for key, p in parameters.items()}, extents) or (
        definition.simpler.causes
    )


def record_of(machine: Machine) -> MotionRecord:
    """Signals along the trajectory, with a friction that is Coulomb's alone."""
    moves = trajectory(machine.sampling.rate)
    direction = np.sign(moves.velocity_m_s)
    return MotionRecord(
        time=moves.time_s,
        position=moves.position_m,
        velocity=moves.velocity_m_s,
        acceleration=moves.acceleration_m_s2,
        force=machine.plant.moved * moves.acceleration_m_s2 + machine.friction.coulomb * direction,
        friction=machine.friction.coulomb * direction,
        level=machine.friction.coulomb * direction,
        damping=20.0,
        mass=machine.plant.moved,
        deflection=scales_of(machine).deflection,
        extents=Extents(
            float(np.ptp(moves.position_m)),
            float(np.abs(moves.velocity_m_s).max()),
            moves.duration_s,
            moves.duration_s,
            machine.sampling.rate,
        ),
    )


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_search_speaks_of_the_effects_own_parameters(name: str) -> None:
    definition, motion = effect_definition(name), record_of(base())
    known = {p.name for p in definition.parameters}
    match definition.search:
        case Columns() as kind:
            for given in kind.grid(motion):
                columns = kind.columns(motion, given)
                assert columns.shape[0] == len(motion.time) and np.isfinite(columns).all() and np.ptp(columns) >= 0.0
                found = kind.parameters(given, np.linspace(0.3, 0.1, columns.shape[1]))
                assert all(definition.parameter(parameter).holds(parameter) for parameter in found)
            assert kind.exact is None or definition.parameter(kind.exact).is_proportional
            assert kind.own_size is None or kind.own_size in known
        case Harmonic() as kind:
            assert definition.parameter(kind.size).is_proportional and definition.sine is kind
            assert definition.parameter(kind.period).role == "period"
            assert definition.parameter(kind.phase).role == "place"
            k = np.array([30.0, 300.0])
            factors, weights = kind.factors(motion, k), kind.weights(motion)
            assert len(factors) == len(weights)
            assert all(f.shape == k.shape for f in factors) and all(w.shape == motion.time.shape for w in weights)
        case Step() as kind:
            assert definition.parameter(kind.size).is_proportional and definition.parameter(kind.time).frozen
        case Derivative() as kind:
            assert kind.size is None or definition.parameter(kind.size).is_proportional
            assert all(set(given) <= known for given in kind.grid(motion))
        case Trials() as kind:
            assert all(len(given) == 1 and set(given) <= known for given in kind.grid(motion))


def test_harmonic_columns_are_the_effects_force() -> None:
    """A ripple's own force is the columns of its search, at any phase: size and phase come out again."""
    definition, motion = effect_definition("force_ripple"), record_of(base())
    kind = definition.sine
    assert kind is not None
    k = np.array([2.0 * math.pi / 0.002])
    wave = np.exp(1j * k[0] * motion.position) * sum(
        c[0] * w for c, w in zip(kind.factors(motion, k), kind.weights(motion), strict=True)
    )
    force = 0.7 * np.sin(k[0] * motion.position + 0.4)
    a, b = np.linalg.lstsq(np.column_stack((wave.imag, wave.real)), force, rcond=None)[0]
    assert math.hypot(a, b) == pytest.approx(0.7) and math.atan2(b, a) == pytest.approx(0.4)


def test_sines_are_reported_with_positive_size_and_a_phase_within_one_turn() -> None:
    tidy = effect_definition("force_ripple").tidy({"amplitude_N": -2.0, "pitch_m": 0.03, "phase_rad": 7.0})
    assert tidy["amplitude_N"] == 2.0 and tidy["pitch_m"] == 0.03
    assert tidy["phase_rad"] == pytest.approx(7.0 + math.pi - 4.0 * math.pi)
    spring = {"stiffness_N_m": -3.0, "centre_m": 9.0}
    assert effect_definition("position_spring").tidy(spring) == spring


def test_excitation_is_measured() -> None:
    found = measure_excitation(simulated(base(), as_read=False), base())
    assert set(found) == set(MEASURES)
    assert found["travel_m"] == pytest.approx(8.2e-3, rel=0.1)
    assert found["speed_m_s"] == pytest.approx(0.05, rel=0.02)
    assert found["standstill_s"] == pytest.approx(0.3, rel=0.1)
    assert found["both_directions"] > 0.2 and found["reversals"] >= 8.0
    excitation = effect_definition("force_ripple").excitation
    assert not excitation.unmet(found, {"pitch_m": 0.004})
    assert [need.measure for need in excitation.unmet(found, {"pitch_m": 0.032})] == ["travel_m"]
    zero, good = np.zeros(500), np.ones(500, dtype=bool)
    still = Signals(zero, zero, zero, zero, zero, zero, good, ~good)
    assert effect_definition("asymmetric_coulomb").excitation.unmet(measure_excitation(still, base()), {"ratio": 0.0})


# --- against the base model -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_effect_of_size_zero_is_the_base_model(name: str) -> None:
    without, with_effect = build_model(base_for(name)), build_model(extended((name, {}), free=()))
    rng = np.random.default_rng(3)
    for _ in range(20):
        chi, theta = rng.uniform(-1.0, 1.0, 4), rng.uniform(0.9, 1.1, 4)
        w = [
            0.01 * rng.normal(),
            10.0 ** rng.uniform(-5, -1) * rng.choice([-1, 1]),
            rng.normal(),
            5.0 * rng.normal(),
            2.0,
        ]
        at_rest = np.concatenate([chi, np.zeros(with_effect.n_x - 4)])
        for function, count in (("rhs", 4), ("output", 1)):
            expected = np.array(without.function(function)(chi, w, theta)).ravel()
            found = np.array(with_effect.function(function)(at_rest, w, theta)).ravel()[:count]
            np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13)


# --- against the emitted C --------------------------------------------------------------------------------------


def assert_c_agrees(machine: Machine, integrator: ReferenceIntegrator, signals: Signals) -> None:
    limit = TOLERANCES["double"]
    expected = run_mhe(NodeRecord(integrator.model, signals, integrator), None)
    found = CompiledEstimator(machine, flags=FLAGS).estimate(signals)
    np.testing.assert_array_equal(found.status, expected.status)
    assert np.all(expected.status >= 0)
    assert np.ptp(found.friction_N - expected.friction_N) <= limit.friction * np.ptp(expected.friction_N)
    spread = np.ptp(expected.z_m, axis=0)
    assert np.all(np.abs(found.z_m - expected.z_m) <= limit.deflection * spread)
    scale = np.abs([p.scale for p in integrator.model.parameters])
    assert np.all(np.abs(found.parameters - expected.parameters) <= limit.parameter * scale)
    np.testing.assert_allclose(found.std, expected.std, rtol=limit.deviation)


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_emitted_c_agrees_with_the_reference(name: str) -> None:
    machine = machine_of(name)
    signals = simulated(machine, as_read=name == "encoder_periodic_error", noise_N=0.05)
    assert_c_agrees(machine, integrator_of(name), signals)


# --- against the plant ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_prediction_matches_the_plant(name: str) -> None:
    signals = simulated(machine_of(name), as_read=name == "encoder_periodic_error")
    error = deviation(integrator_of(name), signals)[START:]
    without = deviation(base_integrator(base_for(name).plant.kind), signals)[START:]
    assert rms(error) < CASES[name].rms_N
    assert np.abs(error).max() < CASES[name].largest_N
    # The test would not see an effect that is missing altogether, were it small beside the tolerance.
    assert rms(without) > 5.0 * rms(error)


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_free_run_repeats_the_motion_of_the_plant(name: str) -> None:
    machine = machine_of(name)
    config = AxisConfig(encoder_resolution_m=0.0, force_noise_N=0.0)
    log = simulate_axis(machine, trajectory(), config, truth=False).log
    run, without = run_freely(machine, log), run_freely(base_for(name), log)
    assert run.rms < 2e-3 * np.ptp(log.position_m)
    assert without.rms > 5.0 * run.rms or name in ("force_delay", "actuator_lag", "encoder_periodic_error")
    assert not run.horizon.reached and run.horizon.seconds == pytest.approx(0.5 * len(log) / RATE, abs=1e-3)


def test_an_early_force_matches_the_plant() -> None:
    """Below zero the drive obeys later than the log says: expanded in what was logged, not in the model."""
    machine = extended(("force_delay", {"delay_s": -5e-4}), free=("force_delay.delay_s",))
    integrator, signals = ReferenceIntegrator(build_model(machine)), simulated(machine, as_read=False)
    error, without = deviation(integrator, signals)[START:], deviation(base_integrator(), signals)[START:]
    # As of a lag, the steps of the command.
    assert rms(error) < CASES["actuator_lag"].rms_N and np.abs(error).max() < CASES["actuator_lag"].largest_N
    assert rms(without) > 10.0 * rms(error)
    assert_c_agrees(machine, integrator, signals)


@cache
def base_integrator(kind: Kind = "linear") -> ReferenceIntegrator:
    return ReferenceIntegrator(build_model(base(kind)))


TOGETHER = ("encoder_periodic_error", "asymmetric_coulomb", "force_ripple", "hose_hysteresis", "structural_resonance",
            "force_constant_ripple", "force_delay", "force_gain", "dwell_dependence")  # fmt: skip


def test_many_effects_at_once() -> None:
    effects = [(name, CASES[name].parameters) for name in reversed(TOGETHER)]
    machine = extended(*effects, free=("force_ripple.amplitude_N", "hose_hysteresis.force_N", "force_gain.gain"))
    integrator = ReferenceIntegrator(build_model(machine))
    signals = simulated(machine, as_read=True)
    error, without = deviation(integrator, signals)[START:], deviation(base_integrator(), signals)[START:]
    assert rms(error) < 0.06 and rms(without) > 10.0 * rms(error)
    assert_c_agrees(machine, integrator, signals)


def test_two_effects_of_one_name() -> None:
    ripple = {"amplitude_N": 0.3, "phase_rad": 0.2}
    machine = extended(
        ("force_ripple", {**ripple, "pitch_m": 0.004}),
        ("force_ripple", {**ripple, "pitch_m": 0.0013}),
        free=("force_ripple.amplitude_N", "force_ripple_2.amplitude_N"),
    )
    integrator = ReferenceIntegrator(build_model(machine))
    assert rms(deviation(integrator, simulated(machine, as_read=False))[START:]) < 2e-3


def test_a_curve_that_follows_late_matches_the_plant() -> None:
    """A film carries the friction curve beside it, too: without that the curve would follow speed at once."""
    curve, late = ("friction_curve", CASES["friction_curve"].parameters), ("viscous_lag", {"time_constant_s": 0.05})
    machine = extended(curve, late, free=("viscous_lag.time_constant_s",))
    integrator, signals = ReferenceIntegrator(build_model(machine)), simulated(machine, as_read=False, noise_N=0.05)
    quiet = simulated(machine, as_read=False)
    prompt = ReferenceIntegrator(build_model(extended(curve, free=())))
    error, without = (deviation(model, quiet)[START:] for model in (integrator, prompt))
    assert rms(error) < CASES["friction_curve"].rms_N and rms(without) > 20.0 * rms(error)
    assert_c_agrees(machine, integrator, signals)


# --- structure --------------------------------------------------------------------------------------------------


def group_shapes(model: Model) -> list[tuple[int, int]]:
    return [(len(group.blocks), group.m) for group in analyse(model).groups]


LEVEL_STATES = ("frictional_lag", "dwell_dependence")


@pytest.mark.parametrize("name", sorted(set(EFFECT_NAMES) - {"backlash", *LEVEL_STATES}))
def test_elements_stay_apart_from_effects_that_do_not_move_them(name: str) -> None:
    shapes = group_shapes(build_model(machine_of(name)))
    assert shapes[0] == (4, 1)
    definition = effect_definition(name)
    count = len(definition.states)
    # Each state of a table follows the motion for itself; those of any other effect are coupled.
    assert shapes[1:] == ([(1, 1)] * count if definition.learned else [(1, count)] if count else [])


@pytest.mark.parametrize("name", LEVEL_STATES)
def test_state_of_the_level_stands_in_every_element_and_leaves_it_its_flow(name: str) -> None:
    structure = analyse(build_model(machine_of(name)))
    assert [(len(g.blocks), g.m, g.is_elements) for g in structure.groups] == [(4, 2, True)]
    assert [block.states for block in structure.groups[0].blocks] == [(i, 4) for i in range(4)]
    assert all(block.saturates for block in integrator_of(name).blocks)


@pytest.mark.parametrize("extents", [Extents(0.2, 0.5, 10.0, 12.0, RATE), Extents(0.01, 0.02, 60.0, 60.0, RATE)])
@pytest.mark.parametrize("name", LEVEL_STATES)
def test_no_value_that_a_record_allows_renews_a_level_many_times_a_row(name: str, extents: Extents) -> None:
    shortest = {
        p.name: max(p.lower, p.least(extents) if p.least else 0.0)
        for p in effect_definition(name).parameters
        if p.name.endswith(("_m", "_s"))
    }
    structure = analyse(build_model(extended((name, CASES[name].parameters | shortest), free=())))
    blocks = structure.groups[0].blocks
    assert max(b.rate_per_metre * extents.speed + b.rate_per_second for b in blocks) <= 110.0 * RATE


def test_backlash_couples_all_elements() -> None:
    assert group_shapes(build_model(machine_of("backlash"))) == [(1, 5)]


@pytest.mark.parametrize("name", LEVEL_STATES)
def test_flow_of_a_level_with_states_agrees_with_runge_kutta(name: str) -> None:
    signals = simulated(machine_of(name), as_read=False)
    sampling = {"integrator": {"scheme": "rk4", "displacement": 0.05}}
    fine = ReferenceIntegrator(build_model(extended((name, CASES[name].parameters), free=(), sampling=sampling)))
    # The level moves through a step; the flow sees it at the step's end.
    assert np.abs(deviation(integrator_of(name), signals) - deviation(fine, signals)).max() < 3e-3


@pytest.mark.parametrize("name", LEVEL_STATES)
def test_sensitivities_of_a_level_with_states_are_derivatives(name: str) -> None:
    integrator = integrator_of(name)
    n_x, n_p = integrator.model.n_x, integrator.model.n_p
    plan = integrator.plan(simulated(machine_of(name), as_read=False))
    fast = int(np.argmax(plan.fastest))
    assert np.count_nonzero(plan.substeps[fast * plan.steps : (fast + 1) * plan.steps] == 0) > 100
    x, theta = np.array([0.9, 0.3, -0.2, -0.5, 0.05]), np.ones(n_p)
    linear = integrator.intervals(plan, fast, x[None], theta)
    found = np.hstack([linear.A[0], linear.B[0]])
    for j in range(n_x + n_p):
        step = 1e-6 * np.eye(n_x + n_p)[j]
        up, down = (
            integrator.intervals(plan, fast, (x + s * step[:n_x])[None], theta + s * step[n_x:]).x1[0]
            for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(found[:, j], (up - down) / 2e-6, rtol=1e-5, atol=1e-8)


# --- wrong input ------------------------------------------------------------------------------------------------


def refused(folder: Path, text: str, machine: str = "etel_xy") -> str:
    path = folder / "bad.toml"
    path.write_text(f'extends = "{machine}"\nname = "bad"\n{text}', encoding="utf-8")
    with pytest.raises(InputError) as error:
        build_model(load_machine(path))
    return str(error.value)


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_wrong_parameters_are_refused(name: str, tmp_path: Path) -> None:
    entry, units = f'[[effects]]\nname = "{name}"\n', base_for(name).plant.units
    machine = {"linear": "etel_xy", "rotary": "etel_xy_rotary"}[units.kind]
    message = refused(tmp_path, entry + "size = 1.0\n", machine)
    assert "size = 1.0" in message and all(units.named(p.name) in message for p in effect_definition(name).parameters)
    first = units.named(effect_definition(name).parameters[0].name)
    assert first in refused(tmp_path, f'{entry}{first} = "much"\n', machine)
    assert first in refused(tmp_path, f"{entry}{first} = nan\n", machine)
    assert f"{name}.size" in refused(tmp_path, f'[estimator]\nparameters = ["{name}.size"]\n{entry}', machine)
    for parameter in effect_definition(name).parameters:
        if math.isfinite(parameter.lower):
            message = refused(tmp_path, f"{entry}{units.named(parameter.name)} = {parameter.lower - 1.0}\n", machine)
            assert units.named(parameter.name) in message


@pytest.mark.parametrize("name", sorted(set(EFFECT_NAMES) - set(own_effects("linear"))))
def test_effects_of_axes_that_turn_are_refused_of_others(name: str, tmp_path: Path) -> None:
    message = refused(tmp_path, f'[[effects]]\nname = "{name}"\n')
    assert f"effects[1].name = '{name}'" in message and f"{name} is for [plant] kind = rotary" in message
    with pytest.raises(InputError, match=rf"{name}.*this is for rotary"):
        simulate_axis(base(), trajectory(), AxisConfig(), hidden_effects=[(name, CASES[name].parameters)])
    assert name not in effect_names("linear") and name in effect_names("rotary")
    assert name in refused(tmp_path, '[[effects]]\nname = "gremlins"\n', "etel_xy_rotary")


def test_unknown_effect_is_refused_with_the_catalogue(tmp_path: Path) -> None:
    message = refused(tmp_path, '[[effects]]\nname = "gremlins"\n')
    assert all((name in message) == (name in own_effects("linear")) for name in EFFECT_NAMES)


def test_bounds_need_a_nominal_value_to_multiply(tmp_path: Path) -> None:
    text = (
        '[estimator]\nparameters = ["constant_offset.force_N"]\n[estimator.bounds]\n'
        '"constant_offset.force_N" = [0.5, 2.0]\n[[effects]]\nname = "constant_offset"\n'
    )
    assert "nominal of 0" in refused(tmp_path, text)


def test_sizes_follow_the_machine() -> None:
    machines = load_machine("emps"), load_machine("etel_xy")
    emps, etel = (scales_of(machine) for machine in machines)
    amplitude = effect_definition("force_ripple").parameter("amplitude_N")
    assert amplitude.size(emps) / amplitude.size(etel) == pytest.approx(emps.coulomb / etel.coulomb)
    assert etel.of("deflection") == pytest.approx(0.83 * 4.0 / 7.9e3)
    phase = effect_definition("force_ripple").parameter("phase_rad")
    assert phase.estimation_scale(etel, 3.0) == phase.estimation_scale(etel, 0.0) == 0.1


FACTORS = ("coulomb_factor", "viscous_factor", "micro_viscous", "level_force")


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_no_size_of_an_effect_takes_power_and_drives_the_axis(name: str) -> None:
    """Of every size at its limits: what changes sign with the velocity brakes, and so does each way by itself."""
    definition, scales = effect_definition(name), scales_of(load_machine("emps"))
    axis = SymbolicAxis(1.0, 1.0, step=1e-4, gate_per_velocity=3.5e4)
    axis.scope = name
    nominal = definition.entries({p.name: p.default for p in definition.parameters})
    symbols = {key: ca.SX.sym(key) for key in nominal}
    definition.contribute(axis, symbols, nominal)
    states = ca.vertcat(*(state.chi for state in axis.states)) if axis.states else ca.SX(0, 1)
    found = ca.Function(
        "found",
        [axis.measured, ca.vertcat(*symbols.values()), states],
        [axis.output + axis.load + axis.curve, ca.vertcat(*(getattr(axis, factor) for factor in FACTORS))],
    )
    speed, rest = 0.5 * scales.speed, np.zeros(len(axis.states))
    for size in (p for p in definition.parameters if p.is_size and not p.array):
        for end in (max(size.lower, -1e3 * scales.of(size.unit)), min(size.upper, 1e3 * scales.of(size.unit))):
            values = nominal | {size.name: end}
            if not definition.possible(values, scales):
                continue
            forth, back = (found([0.1, v, 0.0, 0.0, 1.0], list(values.values()), rest) for v in (speed, -speed))
            assert float(forth[0]) - float(back[0]) >= -1e-9, (size.name, end)
            assert np.min(np.array(forth[1])) >= 0.0 and np.min(np.array(back[1])) >= 0.0, (size.name, end)


@pytest.mark.parametrize(("share", "possible"), [(0.9, True), (-0.9, True), (2.5, False), (-2.5, False)])
def test_damping_of_each_direction_brakes(share: float, possible: bool) -> None:
    scales = scales_of(load_machine("emps"))
    largest = {"difference_N_s_m": share * max(scales.damping, scales.coulomb_over_speed)}
    assert effect_definition("asymmetric_viscous").possible(largest, scales) == possible


@pytest.mark.parametrize("name", ["quadratic_drag", "eddy_current_damping", "micro_viscous"])
def test_a_file_of_a_drag_that_drives_is_refused(name: str) -> None:
    size = effect_definition(name).main[0]
    with pytest.raises(InputError, match=size):
        override_machine(load_machine("etel_xy"), {"effects": [{"name": name, size: -1.0}]})
