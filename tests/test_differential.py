"""Emitted C against the reference solver over simulated closed-loop logs: two implementations of docs/."""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_packages import PRECISIONS, Array, elements, machine, scheme
from reference_cases import estimate_once, linear_model
from sgms_mhe.configuration import load_machine, make_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import CompiledEstimator, CompiledModel
from sgms_mhe.machine import Machine, merge_tables
from sgms_mhe.model import Model
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.reference import UpdateStatus, estimate_model
from sgms_mhe.signals.chain import Signals, settle_samples, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, QUICK_FLAGS

SEED = 1
OFF = (1.2, 0.8, 1.1, 0.97)
"""True stiffness over nominal, element by element in turn."""

PRIORS: dict[str, Any] = {
    "effects": [{"name": "constant_offset"}],
    "estimator": {
        "parameters": ["stiffness", "coulomb", "constant_offset.force_N"],
        "prior": {"coulomb": 0.05, "constant_offset.force_N": 0.02},
        "bounds": {},
    },
}

UNCERTAIN: dict[str, Any] = {"estimator": {"disturbance": {"mass": 0.02, "gain": 0.01}}}


def rounded(**estimator: Any) -> dict[str, Any]:
    """An axis that keeps past velocities rounded, and every second factor of the sweep."""
    return {"code": {"accuracy": 1e-3}, "estimator": {"relinearise": "auto", **estimator}}


TABLE: dict[str, Any] = {
    "name": "learned_residual",
    "place_cells": 4,
    "place_low_m": -2e-4,
    "place_high_m": 4e-3,
    "travel_cells": 2,
    "travel_length_m": 5e-4,
    "force_N": [0.05 * ((7 * k) % 11 - 5) for k in range(35)],
}

EQUAL: dict[str, Any] = {
    "friction": {"stiffness": [4e4] * 4, "fraction": [0.25] * 4},
    "sampling": scheme("flow", slow_displacement=0.0005),
}
"""Below the gate all take the same number of steps, side by side where they are as fast."""
MHE_CASES: dict[str, dict[str, Any]] = {
    "default": {},
    # elements
    "one element": {"friction": elements(1)},
    "two elements": {"friction": elements(2)},
    "ten elements": {"friction": elements(10)},
    # parameters
    "stiffness, coulomb": {"estimator": {"parameters": ["stiffness", "coulomb"], "bounds": {}}},
    "coulomb, viscous": {"estimator": {"parameters": ["coulomb", "viscous"], "bounds": {}}},
    "fraction": {"estimator": {"parameters": ["fraction", "coulomb"], "bounds": {}}},
    "fraction as deflection": {
        "estimator": {"parameters": ["stiffness", "fraction"], "bounds": {}, "noise": {"state_as": "deflection"}}
    },
    "stribeck": {"estimator": {"parameters": ["coulomb", "stribeck_ratio", "stribeck_velocity"], "bounds": {}}},
    "ripple": {
        "effects": [{"name": "force_ripple", "pitch_m": 0.001, "amplitude_N": 0.8, "phase_rad": 0.7}],
        "estimator": {"parameters": ["stiffness", "force_ripple.amplitude_N"]},
    },
    "micro-viscous": {"friction": {"micro_viscous": [50.0, 20.0, 10.0, 5.0]}},
    # bounds
    "bound": {"estimator": {"bounds": {"stiffness": [0.99, 1.1]}}},
    "bound, two kinds": {
        "estimator": {
            "parameters": ["stiffness", "coulomb"],
            "bounds": {"stiffness": [0.9, 1.05], "coulomb": [0.99, 1.001]},
        }
    },
    # horizon
    "horizon 1": {"estimator": {"horizon": 1}},
    "horizon 1, bound": {"estimator": {"horizon": 1, "bounds": {"stiffness": [0.99, 1.1]}}},
    "horizon 5": {"estimator": {"horizon": 5}},
    # arrival cost and noise
    "fixed": {"estimator": {"arrival_cost": {"update": "fixed"}, "noise": {"state_as": "deflection"}}},
    "fixed, horizon 1": {"estimator": {"arrival_cost": {"update": "fixed"}, "horizon": 1}},
    "no drift": {"estimator": {"noise": {"parameter_drift": 0.0}}},
    "priors": PRIORS,
    "mass": UNCERTAIN,
    "mass beside one, five merged": UNCERTAIN
    | {"effects": [{"name": "mass_mismatch", "mass_kg": 1.5}], "sampling": scheme("flow", substeps=20)},
    # integrators
    "rk4": {"sampling": scheme("rk4")},
    "two substeps": {"sampling": scheme("rk4", substeps=200)},
    "merged flow": {"sampling": scheme("flow", substeps=50)},
    "merged rk4": {"sampling": scheme("rk4", substeps=25)},
    "five merged": {"sampling": scheme("flow", substeps=20)},
    "many steps below the gate": {"sampling": scheme("flow", slow_displacement=0.003)},
    "equal elements": EQUAL,
    "equal elements, all": EQUAL | {"estimator": {"relinearise": "all"}},
    "equal elements, five merged": EQUAL | {"sampling": scheme("flow", substeps=20, slow_displacement=0.0005)},
    "ten merged": {"sampling": scheme("flow", substeps=10, slow_displacement=0.03)},
    "all merged": {"sampling": scheme("flow", substeps=1)},
    "five merged, stiffness, coulomb": {
        "sampling": scheme("flow", substeps=20),
        "estimator": {"parameters": ["stiffness", "coulomb"], "bounds": {}},
    },
    "five merged, level of its own": {
        "sampling": scheme("flow", substeps=20),
        "effects": [{"name": "dwell_dependence"}],
        "estimator": {"horizon": 8},
    },
    "five merged, level in a parameter": {
        "sampling": scheme("flow", substeps=20),
        "effects": [{"name": "asymmetric_coulomb", "ratio": 0.1}],
        "estimator": {"parameters": ["stiffness", "asymmetric_coulomb.ratio"], "bounds": {}},
    },
    "five merged, another law": {
        "sampling": scheme("flow", substeps=20),
        "effects": [{"name": "position_dependent_friction"}, {"name": "actuator_lag"}],
    },
    # linearisations that are kept
    "auto": {"estimator": {"relinearise": "auto"}},
    "auto, fixed": {"estimator": {"relinearise": "auto", "arrival_cost": {"update": "fixed"}}},
    "auto, horizon 2": {"estimator": {"relinearise": "auto", "horizon": 2}},
    "auto, stiffness, coulomb": {
        "estimator": {"relinearise": "auto", "parameters": ["stiffness", "coulomb"], "bounds": {}}
    },
    "auto, bound": {"estimator": {"relinearise": "auto", "bounds": {"stiffness": [0.99, 1.1]}}},
    "auto, ten elements": {"friction": elements(10), "estimator": {"relinearise": "auto"}},
    "auto, level of its own": {
        "effects": [{"name": "dwell_dependence"}],
        "estimator": {"relinearise": "auto", "horizon": 8},
    },
    "auto, rk4": {"sampling": scheme("rk4"), "estimator": {"relinearise": "auto"}},
    "auto, merged flow": {"sampling": scheme("flow", substeps=50), "estimator": {"relinearise": "auto"}},
    "auto, five merged": {"sampling": scheme("flow", substeps=20), "estimator": {"relinearise": "auto"}},
    "auto, five merged, ten elements": {
        "friction": elements(10),
        "sampling": scheme("flow", substeps=20),
        "estimator": {"relinearise": "auto"},
    },
    "auto, five merged, level of its own": {
        "sampling": scheme("flow", substeps=20),
        "effects": [{"name": "dwell_dependence"}],
        "estimator": {"relinearise": "auto"},
    },
    "auto, groups": {"effects": [{"name": "hose_hysteresis"}], "estimator": {"relinearise": "auto"}},
    "auto, five merged, groups": {
        "sampling": scheme("flow", substeps=20),
        "effects": [{"name": "hose_hysteresis"}],
        "estimator": {"relinearise": "auto"},
    },
    "auto, output not affine": {
        "friction": {"micro_viscous": [50.0, 20.0, 10.0, 5.0]},
        "estimator": {"relinearise": "auto"},
    },
    "auto, priors": PRIORS | {"estimator": PRIORS["estimator"] | {"relinearise": "auto", "horizon": 7}},
    "auto, much drift": {"estimator": {"relinearise": "auto", "horizon": 7, "noise": {"parameter_drift": 0.02}}},
    # what is kept rounded, or found again
    "accuracy": rounded(),
    "accuracy, horizon 7, much drift": rounded(horizon=7, noise={"parameter_drift": 0.02}),
    "accuracy, horizon 23": rounded(horizon=23, noise={"parameter_drift": 0.02}),
    "accuracy, horizon 2": rounded(horizon=2),
    "accuracy, coulomb, viscous": rounded(parameters=["coulomb", "viscous"], bounds={}),
    "accuracy, five merged": rounded() | {"sampling": scheme("flow", substeps=20)},
    "accuracy, measurements at ends alone": rounded() | {"sampling": {"update_rate": 1000.0}},
    "accuracy, ripple": rounded(parameters=["stiffness", "force_ripple.amplitude_N"])
    | {"effects": [{"name": "force_ripple", "pitch_m": 0.001, "amplitude_N": 0.8, "phase_rad": 0.7}]},
    "accuracy, level over the place": rounded()
    | {"effects": [{"name": "position_dependent_friction", "ratio": 0.2, "pitch_m": 0.004}]},
    "accuracy, newest": rounded(relinearise="newest"),
    "newest": {"estimator": {"relinearise": "newest"}},
    "newest, fixed": {"estimator": {"relinearise": "newest", "arrival_cost": {"update": "fixed"}}},
    "newest, rk4": {"sampling": scheme("rk4"), "estimator": {"relinearise": "newest"}},
    "newest, merged rk4": {"sampling": scheme("rk4", substeps=25), "estimator": {"relinearise": "newest"}},
    # filter
    "ekf": {"estimator": {"kind": "ekf"}},
    "ekf, bound": {"estimator": {"kind": "ekf", "bounds": {"stiffness": [0.995, 1.05]}, "noise": {"parameter": 0.3}}},
    "auto, mass": {"estimator": UNCERTAIN["estimator"] | {"relinearise": "auto", "horizon": 7}},
    "newest, mass, rk4": {"estimator": UNCERTAIN["estimator"] | {"relinearise": "newest"}, "sampling": scheme("rk4")},
    "ekf, mass": {"estimator": UNCERTAIN["estimator"] | {"kind": "ekf"}},
    "ekf, priors": PRIORS | {"estimator": PRIORS["estimator"] | {"kind": "ekf"}},
    # a table that the model looks up, over two coordinates, one of them a state
    "table": {"effects": [TABLE]},
    "table, five merged": {"sampling": scheme("flow", substeps=20), "effects": [TABLE]},
    "table, auto": {"effects": [TABLE], "estimator": {"relinearise": "auto"}},
    "table, ekf": {"effects": [TABLE], "estimator": {"kind": "ekf"}},
    "ekf, coulomb": {"estimator": {"kind": "ekf", "parameters": ["stiffness", "coulomb"], "bounds": {}}},
}
BOUNDED = [name for name in MHE_CASES if "bound" in name]


@functools.cache
def closed_loop(n_z: int, trajectory: str, duration_s: float) -> Log:
    """Log of etel_xy with n_z elements whose stiffness is off; the plant knows nothing of the case."""
    axis = machine(friction=elements(n_z)) if n_z != 4 else machine()
    return simulate_axis(
        axis,
        make_trajectory(trajectory, axis.sampling.rate, duration_s=duration_s),
        AxisConfig(seed=SEED),
        scale={"stiffness": (OFF * 3)[:n_z]},
        truth=False,
    ).log


def signals_of(settings: Machine, trajectory: str = "paper", duration_s: float = 1.2) -> Signals:
    log = closed_loop(settings.friction.n_z, trajectory, duration_s)
    return signals_from_log(log, settings)


def compare(c: Estimates, reference: Estimates, tolerance: float = 1e-8) -> None:
    """Friction relative to its range, every parameter and its deviation relative to itself, statuses exactly.

    A parameter that begins at nothing is compared relative to its deviation.
    """
    np.testing.assert_array_equal(c.status, reference.status)
    np.testing.assert_array_equal(c.time_s, reference.time_s)
    usable = reference.status & UpdateStatus.MISSING == 0
    np.testing.assert_array_equal(c.friction_measured_N[usable], reference.friction_measured_N[usable])
    for name in ("friction_N", "z_m"):
        expected = getattr(reference, name)
        scale = np.ptp(expected, axis=0)
        np.testing.assert_array_less(np.abs(getattr(c, name) - expected).max(axis=0), tolerance * scale, err_msg=name)
    sizes = np.where(np.abs(reference.parameters[0]) < 1e-12, reference.std, np.abs(reference.parameters))
    assert np.all(np.abs(c.parameters - reference.parameters) <= tolerance * sizes)
    np.testing.assert_allclose(c.std, reference.std, rtol=tolerance)


def compiled(settings: Machine, model: Model | None = None) -> CompiledEstimator:
    return CompiledEstimator(settings, emit_package(settings, model, selftest=False), model=model)


@pytest.mark.parametrize("case", list(MHE_CASES))
def test_c_is_the_reference(case: str) -> None:
    settings = machine(**MHE_CASES[case])
    signals = signals_of(settings)
    reference = estimate_once(settings, signals)
    compare(compiled(settings).estimate(signals), reference)
    # The comparison means something: parameters moved, windows filled, bounds were hit where there are some.
    assert np.ptp(reference.parameters, axis=0).max() > 1e-3 * np.abs(reference.parameters).max()
    assert (reference.status == 0).any() or case in BOUNDED
    if case in BOUNDED:
        assert np.count_nonzero(reference.status & UpdateStatus.BOUND) > 3


@pytest.mark.parametrize("precision", PRECISIONS)
def test_what_the_compiler_takes_longer_for_is_the_same_to_the_bit(precision: str) -> None:
    settings = machine(code={"precision": precision}, estimator={"horizon": 6})
    signals, package = signals_of(settings), emit_package(settings, selftest=False)
    quick, thorough = (
        CompiledEstimator(settings, package, flags).estimate(signals) for flags in (QUICK_FLAGS, DEFAULT_FLAGS)
    )
    for name in ("friction_N", "z_m", "parameters", "std", "status"):
        np.testing.assert_array_equal(getattr(quick, name), getattr(thorough, name), err_msg=name)


@pytest.mark.parametrize("name", ["axis", "replay", "predict"])
def test_a_machine_may_have_the_name_of_a_source_of_the_runtime(name: str) -> None:
    settings = machine(name=name, estimator={"kind": "ekf"})
    signals = signals_of(settings)
    assert np.all(compiled(settings).estimate(signals).status >= 0)
    assert np.isfinite(CompiledModel(settings).predict(signals)).all()


@pytest.mark.parametrize(("kind", "relinearise"), [("mhe", "all"), ("mhe", "auto"), ("mhe", "newest"), ("ekf", "all")])
def test_all_speeds_and_bad_samples(kind: str, relinearise: str) -> None:
    """Presliding loops, 0.3 m/s and 1 m/s moves, standstill; samples missing alone, in short and in long gaps."""
    settings = machine(
        estimator={"kind": kind, "relinearise": relinearise, "parameters": ["stiffness", "coulomb"], "bounds": {}}
    )
    log = closed_loop(4, "mixed", 2.6)
    q, u = log.position_m.copy(), log.force_N.copy()
    u[7777], q[9000:9006], u[12000:12300], q[15000:15400] = np.nan, np.nan, np.inf, np.nan
    signals = signals_from_log(dataclasses.replace(log, position_m=q, force_N=u), settings)
    assert np.abs(signals.velocity).max() > 0.9
    reference = estimate_once(settings, signals)
    compare(compiled(settings).estimate(signals), reference)
    for flag in (UpdateStatus.MISSING, UpdateStatus.HOLD, *((UpdateStatus.FILLING,) if kind == "mhe" else ())):
        assert np.any(reference.status & flag), flag.name


def test_all_speeds_by_runge_kutta() -> None:
    settings = machine(sampling=scheme("rk4", displacement=0.1), estimator={"horizon": 4})
    signals = signals_of(settings, "mixed", 1.5)
    assert np.abs(signals.velocity).max() > 0.25
    compare(compiled(settings).estimate(signals), estimate_once(settings, signals))


def test_beyond_the_stated_speed_the_status_says_so() -> None:
    settings = machine(sampling={"max_velocity": 0.1})
    signals = signals_of(settings, "mixed", 1.0)
    reference = estimate_once(settings, signals)
    compare(compiled(settings).estimate(signals), reference)
    assert np.any(reference.status & UpdateStatus.SPEED) and not np.all(reference.status & UpdateStatus.SPEED)


@pytest.mark.slow
def test_full_run_of_the_experiment() -> None:
    """20 s in closed loop of the machine as it is shipped."""
    settings = load_machine("etel_xy")
    signals = signals_of(settings, "paper", 20.0)
    reference = estimate_once(settings, signals)
    assert len(reference.status) == 1999
    compare(compiled(settings).estimate(signals), reference)


# --- as logs and files of an owner are ---------------------------------------------------------------------------

PENDULUM: dict[str, Any] = {
    "name": "pendulum",
    "plant": {"kind": "rotary", "inertia": 0.11},
    "friction": {
        "law": "sgms",
        "stiffness": [8000.0],
        "fraction": [1.0],
        "coulomb": 0.25,
        "viscous": 0.0,
        "stribeck_ratio": 0.0,
        "stribeck_velocity": 1e-3,
    },
    "sampling": {"rate": 500.0, "update_rate": 100.0, "velocity_cutoff": 15.0, "max_velocity": 7.0},
    "estimator": {"parameters": ["coulomb"], "noise": {"measurement": 0.3}},
    "effects": [
        {"name": "unbalance", "amplitude_Nm": 3.3, "phase_rad": -0.02},
        {"name": "position_spring", "stiffness_Nm_rad": -0.15, "centre_rad": 0.5},
    ],
}
"""As identification writes it: one element stiffer than the encoder shows, what hides in gravity as a small spring."""
SOFTENING: dict[str, Any] = {
    "friction": {"law": "switching", "stiffness": [8000.0, 2000.0], "fraction": [0.5, 0.5]},
    "estimator": {"parameters": ["stiffness"]},
}
OWNERS: dict[str, tuple[dict[str, Any], float, float, int]] = {
    "encoder of a low-cost drive": ({"estimator": {"bounds": {"coulomb": [0.3, 3.0]}}}, 3.8e-4, 0.1, 1),
    "another record of it": ({}, 3.8e-4, 0.1, 3),
    "jitter of half a step": ({}, 1e-4, 0.5, 1),
    "coarse": ({}, 6e-3, 0.0, 1),
    "fine": ({}, 5e-5, 0.0, 2),
    "bound": ({"estimator": {"bounds": {"coulomb": [0.9, 1.1]}}}, 3.8e-4, 0.1, 1),
    "level over speed": ({"friction": {"stribeck_ratio": 0.5, "stribeck_velocity": 0.3}}, 3.8e-4, 0.1, 1),
    "stiffness through zero": (SOFTENING, 1e-4, 0.5, 11),
}
"""Changes, step of the encoder [rad], its jitter in steps, seed."""


@functools.cache
def swinging(step: float, jitter: float, seed: int) -> Log:
    """A pendulum drive that swings from stop to stop, rests there, and logs a torque with a chatter."""
    rng, time = np.random.default_rng(seed), np.arange(3000) / 500.0
    q = 0.5 + 1.1 * np.clip(3.0 * np.sin(0.6 * np.pi * time) - 1.0, -2.0, 2.0)
    v = np.gradient(q, time)
    torque = 0.11 * np.gradient(v, time) + 3.3 * np.sin(q) + 0.25 * np.tanh(v / 0.02)
    force = np.convolve(torque, np.full(15, 1.0 / 15.0), "same") + rng.normal(0.0, 0.3, len(time))
    read = np.round(q / step + rng.normal(0.0, jitter, len(time))) * step
    return Log(time_s=time, position_m=read, force_N=force, rate=500.0, kind="rotary")


@pytest.mark.parametrize("case", list(OWNERS))
def test_c_is_the_reference_over_what_an_owner_has(case: str) -> None:
    """Intervals that slide have moved alike where they were linearised at one time: rounding chooses none of them."""
    changes, *record = OWNERS[case]
    settings = make_machine(merge_tables(PENDULUM, changes), Path("pendulum.toml"))
    signals = signals_from_log(swinging(*record), settings)
    reference = estimate_once(settings, signals)
    compare(compiled(settings).estimate(signals), reference)
    assert len(reference) == 599 and np.ptp(reference.parameters, axis=0).max() > 0.02
    if changes is SOFTENING:
        assert np.any(reference.parameters[:, 0] < 0.0)


# --- single precision --------------------------------------------------------------------------------------------

SINGLE_CASES: dict[str, dict[str, Any]] = {
    "flow": {},
    "auto": {"estimator": {"relinearise": "auto"}},
    "auto, rk4": {"sampling": scheme("rk4"), "estimator": {"relinearise": "auto"}},
    "newest": {"estimator": {"relinearise": "newest"}},
    "rk4": {"sampling": scheme("rk4")},
    "ekf": {"estimator": {"kind": "ekf"}},
    "bound": {"estimator": {"bounds": {"stiffness": [0.99, 1.1]}}},
    "stiffness, coulomb": {"estimator": {"parameters": ["stiffness", "coulomb"], "bounds": {}}},
    "coulomb, viscous": {"estimator": {"parameters": ["coulomb", "viscous"], "bounds": {}}},
    "horizon 1": {"estimator": {"horizon": 1}},
    "table": {"effects": [TABLE]},
}


def compare_single(c: Estimates, reference: Estimates, prior: float) -> None:
    """Friction to 1e-4 of its range; every parameter that the data have said something of to 1e-3."""
    assert np.abs(c.friction_N - reference.friction_N).max() < 1e-4 * np.ptp(reference.friction_N)
    nominal = reference.parameters[0]
    excited = reference.std < 0.9 * prior * np.abs(nominal)
    assert excited[-1].any()
    error = np.abs(c.parameters / reference.parameters - 1.0)
    assert error[excited].max() < 1e-3
    np.testing.assert_allclose(c.std, reference.std, rtol=2e-3)
    # Thresholds of the status may be crossed an update earlier or later, by rounding alone.
    assert np.count_nonzero(c.status != reference.status) <= 2


@pytest.mark.parametrize("case", list(SINGLE_CASES))
def test_single_precision_follows_the_reference(case: str) -> None:
    settings = machine(**SINGLE_CASES[case], code={"precision": "single"})
    signals = signals_of(settings)
    compare_single(
        compiled(settings).estimate(signals), estimate_once(settings, signals), settings.estimator.noise.parameter
    )


@pytest.mark.parametrize(("relinearise", "substeps"), [("all", 100), ("auto", 100), ("auto", 20)])
def test_single_precision_at_all_speeds_through_its_own_chain(relinearise: str, substeps: int) -> None:
    settings = machine(
        code={"precision": "single"}, estimator={"relinearise": relinearise}, sampling=scheme("flow", substeps=substeps)
    )
    log = closed_loop(4, "mixed", 2.6)
    reference = estimate_once(settings, signals_from_log(log, settings))
    for mode in ("tasks", "tick"):
        c = compiled(settings).estimate_log(log, mode=mode)
        compare_single(c, reference, settings.estimator.noise.parameter)


# --- signal chain and tasks --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"estimator": {"relinearise": "auto"}},
        {"estimator": {"relinearise": "newest"}},
        {"estimator": {"kind": "ekf"}},
        {"sampling": scheme("flow", substeps=50)},
        {"sampling": scheme("flow", substeps=20), "estimator": {"relinearise": "auto"}},
        {"estimator": {"horizon": 1}},
    ],
    ids=["mhe", "auto", "newest", "ekf", "merged", "auto, merged", "horizon 1"],
)
def test_raw_samples_and_one_task_give_the_same(changes: Mapping[str, Any]) -> None:
    settings = machine(**changes)
    log = closed_loop(4, "paper", 1.2)
    estimator = compiled(settings)
    reference = estimate_once(settings, signals_from_log(log, settings))
    tasks, tick = (estimator.estimate_log(log, mode=m) for m in ("tasks", "tick"))
    for name in ("friction_N", "friction_measured_N", "z_m", "parameters", "std", "status"):
        np.testing.assert_array_equal(getattr(tick, name), getattr(tasks, name), err_msg=name)
    # The two chains round differently, nothing more.
    usable = reference.status & UpdateStatus.MISSING == 0
    np.testing.assert_array_equal(tick.status, reference.status)
    np.testing.assert_allclose(
        tick.friction_measured_N[usable], reference.friction_measured_N[usable], rtol=0.0, atol=1e-8
    )
    assert np.abs(tick.friction_N - reference.friction_N).max() < 1e-8
    np.testing.assert_allclose(tick.parameters, reference.parameters, rtol=1e-8)
    # At the updates, one task feeds the new estimate forward and two the prediction of it; else they do the same.
    at = settings.sampling.samples_per_update * np.arange(1, len(tick.time_s) + 1)
    between = np.setdiff1d(np.arange(len(log.time_s)), at)
    np.testing.assert_array_equal(tick.extra["compensation_N"][between], tasks.extra["compensation_N"][between])
    settled = slice(settle_samples(settings) + at[0] * 20, None)
    assert np.abs(np.diff(tick.extra["compensation_N"][settled])).max() < 2.0


# --- time --------------------------------------------------------------------------------------------------------

DISTURBED: list[dict[str, Any]] = [
    {"name": "periodic_disturbance", "frequency_Hz": 40.0, "amplitude_N": 0.8, "phase_rad": 0.7},
    {"name": "step_disturbance", "force_N": 1.0, "time_s": 0.6},
    {"name": "friction_drift", "ratio": 0.3, "time_constant_s": 0.5},
]


@pytest.mark.parametrize(
    "changes",
    [{}, {"estimator": {"kind": "ekf"}}, {"sampling": scheme("flow", substeps=20)}],
    ids=["mhe", "ekf", "merged"],
)
def test_time_is_that_of_the_signals_through_either_chain(changes: Mapping[str, Any]) -> None:
    free = ["stiffness", "periodic_disturbance.amplitude_N", "periodic_disturbance.phase_rad"]
    estimator = {**changes.get("estimator", {}), "parameters": free, "bounds": {}, "noise": {"parameter": 0.3}}
    settings = machine(**{**changes, "estimator": estimator}, effects=DISTURBED)
    path = make_trajectory("paper", settings.sampling.rate, duration_s=1.2)
    log = simulate_axis(settings, path, AxisConfig(seed=SEED), truth=False).log
    signals = signals_from_log(log, settings)
    reference, estimators = estimate_once(settings, signals), compiled(settings)
    inserted = estimators.estimate(signals)
    compare(inserted, reference)
    np.testing.assert_allclose(inserted.friction_N, reference.friction_N, rtol=1e-11, atol=1e-11)
    sampled = estimators.estimate_log(log, mode="tasks")
    np.testing.assert_array_equal(sampled.status, inserted.status)
    # The two chains round differently, nothing more.
    for name in ("friction_N", "parameters"):
        np.testing.assert_allclose(getattr(sampled, name), getattr(inserted, name), rtol=0.0, atol=1e-8, err_msg=name)
    # The phase is the plant's; by the samples' clock it would be 0.26 rad less, of which the prior admits a part.
    phase = reference.parameter_names.index("periodic_disturbance.phase_rad")
    assert np.abs(reference.parameters[:, phase] - 0.7).max() < 0.04
    prompt = estimators.estimate(dataclasses.replace(signals, delay=0.0))
    compare(prompt, estimate_once(settings, dataclasses.replace(signals, delay=0.0)))
    assert prompt.parameters[-1, phase] < 0.55


# --- linear models -----------------------------------------------------------------------------------------------


def linear_signals(updates: int = 40) -> Signals:
    """A motion at 100 Hz whose friction is noise: what the estimators make of it has to agree anyway."""
    rng = np.random.default_rng(11)
    n = 5 * updates + 1
    velocity = np.sin(0.37 * np.arange(n)) + 0.4
    zeros = np.zeros(n)
    return Signals(
        time=np.arange(n) / 100.0,
        position=np.cumsum(velocity) / 100.0,
        velocity=velocity,
        acceleration=zeros,
        force=zeros,
        friction=2.0 * velocity + rng.standard_normal(n),
        valid=rng.uniform(size=n) < 0.9,
        missing=np.zeros(n, dtype=bool),
    )


def kalman_filter(model: Model, signals: Signals, *, first: int) -> tuple[Array, Array, Array]:
    """Mean of (x, theta), standard deviations of theta and friction at every update, by the textbook's equations.

    The right side is linear in (chi, theta, 1) at a given velocity, so RK4 over one sample is the first five terms of
    the exponential series of its matrix. `first`: node of the first measurement that is used.
    """
    noise = model.machine.estimator.noise
    n_x, n_p = model.n_x, model.n_p
    n, h, samples = n_x + n_p, model.machine.sampling.step, model.machine.sampling.samples_per_update
    rhs, output = model.function("rhs"), model.function("output")
    to_node = np.diag(
        [float(np.array(model.function("to_node")(np.eye(n_x)[i], np.ones(n_p)))[i, 0]) for i in range(n_x)]
    )
    to_all = np.eye(n + 1)
    to_all[:n_x, :n_x] = to_node

    def affine(function: Any, w: Array, rows: int) -> Array:
        """[d/d(chi, theta), constant] of an affine function (rows, n + 1)."""
        at_zero = np.array(function(np.zeros(n_x), w, np.zeros(n_p))).reshape(rows)
        columns = [np.array(function(e[:n_x], w, e[n_x:])).reshape(rows) - at_zero for e in np.eye(n)]
        return np.column_stack([*columns, at_zero])

    def signal(k: int) -> Array:
        return np.array([signals.position[k], signals.velocity[k], 0.0, 0.0, k * h])

    s = np.concatenate([np.zeros(n_x), np.ones(n_p)])
    P = np.diag(np.concatenate([model.initial_state, np.full(n_p, noise.parameter)]) ** 2)
    Q = np.diag(np.concatenate([model.state_noise**2, np.zeros(n_p)]))
    means, deviations, frictions = [], [], []
    for node in range((len(signals) - 1) // samples + 1):
        if node > 0:
            F = np.eye(n + 1)
            for k in range((node - 1) * samples + 1, node * samples + 1):
                G = np.zeros((n + 1, n + 1))
                G[:n_x] = h * affine(rhs, signal(k), n_x)
                step = term = np.eye(n + 1)
                for order in range(1, 5):
                    term = term @ G / order
                    step = step + term
                F = step @ F
            F = to_all @ F @ np.linalg.inv(to_all)
            s, P = F[:n, :n] @ s + F[:n, n], F[:n, :n] @ P @ F[:n, :n].T + Q
        H = affine(output, signal(node * samples), 1)[0]
        H[:n_x] = H[:n_x] @ np.linalg.inv(to_node)
        if node >= first and signals.valid[node * samples]:
            S = H[:n] @ P @ H[:n] + noise.measurement**2
            gain = P @ H[:n] / S
            s = s + gain * (signals.friction[node * samples] - H[:n] @ s - H[n])
            P = P - np.outer(gain, gain) * S
        means.append(s)
        deviations.append(np.sqrt(np.diag(P)[n_x:]))
        frictions.append(H[:n] @ s + H[n])
    return np.array(means)[1:], np.array(deviations)[1:], np.array(frictions)[1:]


def without_drift(**estimator: Any) -> Model:
    """The linear model of the reference's tests, parameters at rest."""
    noise = machine().estimator.noise.model_dump() | {"parameter_drift": 0.0, "self_scaling": False}
    return linear_model(noise=noise, **estimator)


@pytest.mark.parametrize(
    "kind", ["horizon 1", "horizon 2", "horizon 5", "horizon 20", "horizon 5 auto", "horizon 5 newest", "ekf"]
)
def test_riccati_is_the_kalman_filter_on_a_linear_model(kind: str) -> None:
    words = kind.split()
    model = (
        without_drift(kind="ekf")
        if kind == "ekf"
        else without_drift(horizon=int(words[1]), relinearise=words[2] if len(words) > 2 else "all")
    )
    signals = linear_signals()
    c = compiled(model.machine, model).estimate(signals)
    means, deviations, frictions = kalman_filter(model, signals, first=int(kind == "ekf"))
    theta, scale = means[:, model.n_x :], np.array([p.scale for p in model.parameters])
    np.testing.assert_allclose(c.parameters, model.to_si(theta), rtol=0.0, atol=1e-10 * np.abs(scale).max())
    np.testing.assert_allclose(c.std, deviations * scale, rtol=1e-10)
    np.testing.assert_allclose(c.friction_N, frictions, rtol=0.0, atol=1e-10 * np.ptp(frictions))
    assert np.ptp(theta, axis=0).max() > 1e-2


@pytest.mark.parametrize(("horizon", "relinearise"), [(1, "all"), (6, "all"), (6, "auto"), (6, "newest")])
def test_coupled_states_agree_with_the_reference(horizon: int, relinearise: str) -> None:
    """Blocks of two states, bounds and drift: what no friction model without effects has."""
    model = linear_model(horizon=horizon, relinearise=relinearise, bounds={"stiffness": [0.95, 1.02]})
    signals = linear_signals()
    reference = estimate_model(model, signals, "mhe")
    assert np.count_nonzero(reference.status & UpdateStatus.BOUND) > 5
    compare(compiled(model.machine, model).estimate(signals), reference, 1e-9)
