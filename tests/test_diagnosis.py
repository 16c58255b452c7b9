"""Hidden effects, wrong numbers and clean logs: the diagnosis must find what is there and nothing else."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytest import approx

from diagnosis_cases import Causes, Within, assert_found
from record_cases import simulate_log
from sgms_bench.diagnosis.motions import draw_motion
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import diagnose, write_diagnosis
from sgms_mhe.diagnosis.alignment import align, decimate
from sgms_mhe.diagnosis.candidates import search
from sgms_mhe.diagnosis.criteria import material_force
from sgms_mhe.diagnosis.extension import extend_machine, extension_toml
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.diagnosis.models import compile_once
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, ParameterGroup
from sgms_mhe.diagnosis.plan import make_plan, write_plan
from sgms_mhe.evaluation.prediction import force_error, predict_log
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.recordings.evidence import find_nuisance, inconstancy, noise_floor, score_test
from sgms_mhe.recordings.recording import Recording, prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError


def simulated(
    machine: Machine, *hidden: tuple[str, Mapping[str, float]], law: str | None = "sgms", **options: Any
) -> Log:
    """A log of the plant in closed loop with encoder quantisation and force noise."""
    return simulate_log(machine, *hidden, law=law, **{"seed": 1, **options})


# --- hidden effects, wrong numbers, nothing wrong ---------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A log, its options, and what is found in it; `law`: that the axis is said to obey; `left`: share of the residual.

    `changes` of the machine file, `hidden` effects.
    """

    causes: Causes
    hidden: tuple[tuple[str, Mapping[str, float]], ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    law: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict)
    left: float = 1.0


def named(name: str, *, rel: float = 0.1, **numbers: float) -> Case:
    """One effect alone, its size known and most of the residual explained; its time to less than a row of 1 ms."""
    known = {k: approx(v, abs=0.7e-3) if k == "time_s" else approx(v, rel=rel) for k, v in numbers.items()}
    return Case({name: known}, ((name, numbers),), left=0.3)


STIFFER, STIFFNESS = 0.56, load_machine("etel_xy").friction.stiffness
CASES = {
    "asymmetric damping": named("asymmetric_viscous", difference_N_s_m=-1.5),
    "step": named("step_disturbance", force_N=-0.5, time_s=3.7),
    "lag": named("actuator_lag", time_constant_s=0.0005),  # 27 deviations of a lag were once a chance of 0.4
    "stiffness far off, on a switching axis": Case(
        {"stiffness": {f"stiffness_{i}_N_m": approx(STIFFER * k, rel=0.1) for i, k in enumerate(STIFFNESS, 1)}},
        options={"law": "maxwell_slip", "scale": {"stiffness": STIFFER}},
    ),
    "thinning does not decide the law": Case(
        {"micro_viscous": {}}, (("micro_viscous", {"damping_N_s_m": 68.0}),), {"law": "maxwell_slip"}, "switching"
    ),
    # Noise hides no law behind a Stribeck effect.
    "noise, elements slip at once": Case(
        {}, options={"law": "maxwell_slip", "seed": 5, "force_noise_N": 0.9}, law="switching"
    ),
    "noise, elements slip smoothly": Case(
        {}, options={"seed": 5, "force_noise_N": 0.9}, law="sgms", changes={"friction": {"law": "switching"}}
    ),
    "clean": Case({}, options={"seed": 7}),
    "clean, switching": Case({}, options={"law": "maxwell_slip", "path": "trapezoids", "seed": 7}),
    "clean, steps": Case({}, options={"path": "step_and_settle", "seed": 7}),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_what_is_there_is_found_and_nothing_else(machine: Machine, case: Case) -> None:
    axis = override_machine(machine, case.changes)
    diagnosis = diagnose(axis, simulated(axis, *case.hidden, **case.options))
    assert_found(diagnosis, case.causes, *(("explained", "ambiguous") if case.causes else ("adequate",)))
    assert (diagnosis.extended is None) is not bool(case.causes)
    assert case.law in ("", diagnosis.law)
    if case.left < 1.0:
        assert diagnosis.causes[0].p_value < 1e-3
        assert diagnosis.rms.held_out_after < case.left * diagnosis.rms.held_out_before
        assert diagnosis.rms.held_out_after < 1.6 * diagnosis.noise_floor_N


@pytest.mark.slow
def test_phase_is_that_of_the_log_s_clock(machine: Machine) -> None:
    """Neither the signal chain's lag nor the rate that models are fitted at is in it."""
    hum = {"amplitude_N": 0.4, "frequency_Hz": 40.0, "phase_rad": 0.7}
    log = simulated(machine, ("periodic_disturbance", hum))
    diagnosis = diagnose(machine, log)
    assert_found(diagnosis, {"periodic_disturbance": {key: Within(value) for key, value in hum.items()}})
    assert diagnosis.causes[0].std["phase_rad"] < 0.01  # the chain's lag is 0.25 rad
    assert diagnosis.extended is not None
    left, clean = (
        force_error(predict_log(m, record), start_s=0.3).residual_rms_N
        for m, record in ((diagnosis.extended, log), (machine, simulated(machine)))
    )
    assert left < 1.05 * clean


def test_a_lag_is_seen_though_the_fit_left_nothing_that_could_lag() -> None:
    """A Stribeck effect that comes late fits none better than a prompt one: the refit drives it to its bound."""
    machine = override_machine(load_machine("etel_xy"), {"friction": {"stribeck_ratio": 0.4}})
    moves = draw_motion("strokes", machine, 10.0, np.random.default_rng(0))
    log = simulated(machine, ("frictional_lag", {"time_constant_s": 0.15}), path=moves, law=None)
    subject = decimate(Subject.of(machine, prepare(machine, log)))
    fit = fit_model(subject, ())
    driven = {c.name for c, held in zip(fit.model.columns, fit.free & ~fit.interior, strict=True) if held}
    assert driven == {"stribeck_ratio"}
    used = subject.recording.used
    (found,) = search(subject, fit, ["frictional_lag"], find_nuisance(fit.jacobian[used][:, fit.interior]))
    assert 0.03 < found.parameters["time_constant_s"] < 0.3
    assert found.p_value < 1e-6
    assert found.energy > 0.7 * float(np.sum(fit.residual[used] ** 2))


@pytest.mark.slow
def test_what_no_effect_explains_stays_unexplained(machine: Machine) -> None:
    log = simulated(machine)
    random = np.random.default_rng(3)
    n = len(log.force_N)
    # A smooth random force with a correlation time of 50 ms: in no catalogue.
    kernel = np.hanning(1000)
    unmodelled = np.convolve(random.normal(size=n + 999), kernel, mode="valid")
    log = replace(log, force_N=log.force_N + 0.5 * unmodelled / unmodelled.std())
    diagnosis = diagnose(machine, log)
    assert_found(diagnosis, {}, "unexplained")
    assert diagnosis.separating_experiment
    assert max(s.rms_N for s in diagnosis.structure_after) > 0.1


# --- what logs really have --------------------------------------------------------------------------------------


def test_a_log_that_is_too_short_says_so(machine: Machine) -> None:
    log = Log(time_s=np.arange(200) / 1e4, position_m=np.zeros(200), force_N=np.zeros(200), rate=1e4)
    with pytest.raises(InputError, match="at least"):
        diagnose(machine, log)


# --- results ----------------------------------------------------------------------------------------------------


def test_writes_the_contract_and_a_machine_that_loads(machine: Machine, tmp_path: Path) -> None:
    log = simulated(machine, ("constant_offset", {"force_N": -0.6}), path="step_and_settle")
    diagnosis = diagnose(machine, log)
    write_diagnosis(diagnosis, tmp_path)
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    assert content["verdict"] in ("explained", "ambiguous")
    assert set(content["residual_rms_N"]) >= {"held_out_before", "held_out_after", "noise_floor"}
    cause = content["causes"][0]
    assert set(cause) >= {"name", "parameters", "std", "residual_rms_N"}
    assert set(cause["residual_rms_N"]) == {"before", "after", "held_out_before", "held_out_after"}
    assert all({"name", "why_not"} <= set(a) for a in content["alternatives"])
    if content["verdict"] == "ambiguous":
        assert content["separating_experiment"]
    extended = load_machine(tmp_path / content["extended_machine"])
    assert diagnosis.extended is not None
    assert extended.digest == diagnosis.extended.digest


@pytest.mark.parametrize(
    ("estimated", "bounds", "effect", "left"),
    [
        (["stiffness", "viscous"], {}, {}, ("stiffness",)),
        (["viscous", "stribeck_ratio"], {"viscous": [0.5, 2.0]}, {}, ("stiffness",)),
        (["viscous", "position_spring.stiffness_N_m"], {}, {"stiffness_N_m": 0.0}, ("position_spring.stiffness_N_m",)),
        (
            ["coulomb", "position_spring.stiffness_N_m"],
            {"position_spring.stiffness_N_m": [0.5, 2.0]},
            {"stiffness_N_m": 0.0},
            ("coulomb",),
        ),
    ],
)
def test_a_number_that_is_0_is_not_the_scale_of_its_estimate(
    estimated: list[str],
    bounds: dict[str, list[float]],
    effect: dict[str, float],
    left: tuple[str, ...],
    tmp_path: Path,
) -> None:
    spring = {"name": "position_spring", "stiffness_N_m": 50.0}
    # What the file of the base is called does not matter: the extended file names it.
    base = tmp_path / 'base "one".toml'
    base.write_text(
        'extends = "etel_xy"\ndescription = \'the "base"\'\n'
        f'effects = [{{ name = "position_spring", stiffness_N_m = 50.0 }}]\nestimator.parameters = {estimated}\n'
        + "".join(f'estimator.bounds."{key}" = {value}\n' for key, value in bounds.items())
    )
    machine = load_machine(base)
    friction = {"viscous": 0.0, "stribeck_ratio": 0.0}
    extended, changes = extend_machine(machine, ["viscous"], friction, [spring | effect])
    assert extended.estimator.parameters == left
    path = tmp_path / "results" / "extended.toml"
    path.parent.mkdir()
    for alone in (False, True):
        text = extension_toml(machine, extended, changes, path.parent, (), alone=alone)
        assert ("extends = " in text) is not alone
        path.write_text(text)
        assert load_machine(path).digest == extended.digest
    build_model(extended)


def test_a_number_that_a_bound_holds_is_not_rounded_beyond_it() -> None:
    lag = {"name": "actuator_lag", "time_constant_s": -1e-20}
    extended, _ = extend_machine(load_machine("etel_xy"), ["actuator_lag"], {}, [lag])
    assert extended.effects[0].parameters == {"time_constant_s": 0.0}


def test_a_machine_file_says_how_a_record_is_split_and_what_matters(machine: Machine) -> None:
    log = simulated(machine)
    usual, changed = (
        prepare(override_machine(machine, {"diagnosis": table}), log)
        for table in ({}, {"folds": 4, "held_out_one_in": 2, "material": 0.1})
    )
    assert set(usual.fold) == set(range(5)) and set(changed.fold) == set(range(4))
    assert usual.held_out.mean() == pytest.approx(1 / 3, abs=0.05)
    assert changed.held_out.mean() == pytest.approx(1 / 2, abs=0.05)
    floor, level = 0.05, machine.friction.coulomb
    assert material_force(machine, floor) == pytest.approx(max(0.004 * level, 0.25 * floor))
    assert material_force(changed.machine, floor) == pytest.approx(0.1 * level)


def test_held_out_intervals_are_not_seen(machine: Machine) -> None:
    recording = prepare(machine, simulated(machine), [(4.0, 9.0)])
    rows = recording.rows_held_out()
    assert recording.time[rows].min() > 3.8
    assert recording.time[recording.used & ~rows].max() < 4.2


# --- parts ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording(machine: Machine) -> Recording:
    return prepare(machine, simulated(machine, path="trapezoids"))


def test_score_test_holds_its_level_under_coloured_residuals(recording: Recording) -> None:
    random = np.random.default_rng(5)
    used = int(recording.used.sum())
    smooth = np.hanning(25)
    low = 0
    for _ in range(400):
        e, z = (np.convolve(random.normal(size=used + 24), smooth, mode="valid") for _ in range(2))
        p, _ = score_test(recording, z[:, None], e)
        low += p < 0.02
    assert low / 400 < 0.06


def test_projection_removes_what_is_free() -> None:
    random = np.random.default_rng(0)
    X = random.normal(size=(500, 3)) @ np.diag([1.0, 1e-6, 1e6])
    left = find_nuisance(X).project(X @ np.array([1.0, 2.0, 3.0]))
    assert np.abs(left).max() < 1e-3


def test_noise_floor_is_that_of_the_noise(recording: Recording) -> None:
    random = np.random.default_rng(2)
    wave = np.sin(2.0 * np.pi * 3.0 * recording.time)
    assert noise_floor(recording, wave + 0.05 * random.normal(size=len(wave))) == pytest.approx(0.05, rel=0.1)


def test_derivatives_along_a_recording_match_differences(machine: Machine, recording: Recording) -> None:
    subject = Subject.of(machine, recording)
    extras = [CandidateEffect("force_ripple", {"amplitude_N": 0.3, "pitch_m": 0.02, "phase_rad": 0.1})]
    model = subject.model(extras)
    theta = subject.start(model, extras)
    _, slopes = model.run(recording, theta)
    assert slopes is not None
    for i, column in enumerate(model.columns):
        step = 1e-5
        up, down = theta.copy(), theta.copy()
        up[i] += step
        down[i] -= step
        difference = (
            model.run(recording, up, derivatives=False)[0] - model.run(recording, down, derivatives=False)[0]
        ) / (2.0 * step)
        error = np.sqrt(np.mean((difference - slopes[:, i]) ** 2))
        assert error < 1e-2 * np.sqrt(np.mean(slopes[:, i] ** 2)) + 1e-6, column.name


def test_a_thinned_record_agrees_with_the_whole_at_the_fit(machine: Machine, recording: Recording) -> None:
    thin = decimate(Subject.of(machine, recording))
    used = recording.used

    def difference(subject: Subject) -> float:
        whole, model = subject.whole, subject.whole.model(())
        exact, _ = model.run(whole.recording, whole.start(model, ()), derivatives=False)
        coarse = fit_model(subject, (), refitted=()).residual
        return float(np.std((whole.recording.friction - exact - coarse)[used]))

    assert thin.recording.factor < recording.factor
    before = difference(thin)
    assert before > 0.003
    assert difference(align(thin, fit_model(thin, (), refitted=()))) < 1e-9
    assert difference(thin) == before  # a value of its own


def test_the_timing_of_force_and_position_is_no_cause(machine: Machine, recording: Recording) -> None:
    """A force that is late is late with all that it overcomes: the mass, and the friction where it reverses."""
    step = machine.sampling.step
    jerk = recording.reduce(np.gradient(recording.signals.acceleration) / step)
    subject = Subject.of(machine, recording)
    friction = subject.friction(fit_model(subject, (), refitted=()))
    rate = machine.plant.moved * jerk + np.gradient(friction) / (recording.factor * step)

    def left(share: float) -> float:
        late = replace(recording, friction=recording.friction + 0.05 * share * step * rate)
        subject = Subject.of(machine, late)
        return fit_model(align(subject, fit_model(subject, (), refitted=())), (), refitted=()).rms

    assert left(1.0) == pytest.approx(left(0.0), rel=1e-3)
    assert left(20.0) > 1.5 * left(0.0)  # a sample late is a delay


def test_a_parameter_at_its_bound_is_no_free_direction(machine: Machine, recording: Recording) -> None:
    plain = fit_model(Subject.of(machine, recording), (), refitted=())
    at = {c.name: i for i, c in enumerate(plain.model.columns)}
    # As if friction fell towards low speed: the record pushes the Stribeck ratio below zero.
    falling = recording.friction - 2.0 * plain.jacobian[:, at["stribeck_ratio"]]
    fit = fit_model(
        Subject.of(machine, replace(recording, friction=falling)), (), refitted=(ParameterGroup("base", "stribeck"),)
    )
    assert fit.theta[at["stribeck_ratio"]] == 0.0
    assert fit.free[at["stribeck_ratio"]]
    assert not fit.interior[at["stribeck_ratio"]]
    assert not (fit.interior & ~fit.free).any()


def test_an_imitation_is_not_the_same_everywhere(recording: Recording) -> None:
    random = np.random.default_rng(4)
    ripple = np.sin(2.0 * np.pi * recording.position / 0.01)
    noise = 0.3 * random.normal(size=len(ripple))
    assert inconstancy(recording, ripple, noise) < 0.1
    # Twice as much in the first half, nothing in the second; all of it in one place.
    early = np.where(recording.time < np.median(recording.time[recording.used]), 1.0, -1.0)
    assert inconstancy(recording, ripple, ripple * early + noise) > 0.8
    left = np.where(recording.position < np.median(recording.position[recording.used]), 1.0, -1.0)
    assert inconstancy(recording, ripple, ripple * left + noise) > 0.8
    assert inconstancy(recording, np.zeros(len(ripple)), noise) == np.inf
    # An offset has nothing that changes fast: rounding says nothing of it.
    offset = np.full(len(ripple), -0.2)
    assert inconstancy(recording, offset, 0.1 * noise) < 0.1
    assert inconstancy(recording, offset, offset * early) > 0.8


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (
            CandidateEffect("constant_offset", {"force_N": 0.4}),
            CandidateEffect("quadratic_drag", {"coefficient_N_s2_m2": 1.5}),
        ),
        (
            CandidateEffect("asymmetric_coulomb", {"ratio": 0.1}),
            CandidateEffect("position_dependent_friction", {"ratio": 0.2}),
        ),
    ],
)
def test_models_are_compiled_once_whatever_the_order(
    machine: Machine,
    recording: Recording,
    one: CandidateEffect,
    other: CandidateEffect,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    subject = Subject.of(machine, recording)
    first, second = (subject.model(extras) for extras in ((one, other), (other, one)))
    runs = [
        model.run(recording, subject.start(model, extras), derivatives=False)[0]
        for model, extras in ((first, (one, other)), (second, (other, one)))
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    found = {c.name for c in second.columns if c.group == ParameterGroup("candidate", other.name, index=0)}
    assert found and found >= set(other.parameters)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("emitted again")

    monkeypatch.setattr("sgms_mhe.host.packages.emit_package", refuse)
    compile_once.cache_clear()
    subject.model((one, other))


@pytest.mark.parametrize("separate", [None, ("constant_offset", "asymmetric_coulomb"), ("viscous", "quadratic_drag")])
def test_plan_is_a_trajectory_within_limits(machine: Machine, separate: tuple[str, str] | None, tmp_path: Path) -> None:
    plan = make_plan(machine, separate)
    speed = np.abs(plan.trajectory.velocity_m_s).max()
    assert 0.0 < speed <= machine.sampling.max_velocity
    assert plan.trajectory.position_m[-1] == pytest.approx(0.0, abs=1e-9)
    write_plan(tmp_path / "plan.csv", plan, machine.plant.units)
    lines = (tmp_path / "plan.csv").read_text().splitlines()
    assert lines[0] == "time_s,position_m"
    assert len(lines) == 1 + len(plan.trajectory.position_m)
    with pytest.raises(InputError, match="separate"):
        make_plan(machine, ("constant_offset", "gremlins"))
