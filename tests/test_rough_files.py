"""A diagnosis does not hang on the file's numbers: from rough ones it finds what it finds from the true ones."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis_cases import Within, assert_found, explained
from record_cases import simulate_log, slow_axis
from sgms_mhe.configuration import law_changes, load_machine, override_machine
from sgms_mhe.diagnosis import diagnose, verdict, write_diagnosis
from sgms_mhe.diagnosis.beginning import ROUGH, begin_from_record, distance, plain_friction
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.diagnosis.laws import _thinned
from sgms_mhe.diagnosis.models import make_model
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, smooth_law
from sgms_mhe.diagnosis.parts import RefutedNumber, Rms
from sgms_mhe.diagnosis.uncertainty import covariance, standard_deviations
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.identification.elements import SLOW_STEP, Stribeck, least_distance
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.signals.logs import Log

NUMBERS = ("coulomb", "viscous", "stribeck_ratio", "stribeck_velocity")
HIDDEN: Mapping[str, Mapping[str, float]] = {
    "": {},
    "force_ripple": {"amplitude_N": 0.5, "pitch_m": 0.0173, "phase_rad": 0.7},
    "actuator_lag": {"time_constant_s": 0.0005},
}


def recorded(machine: Machine, name: str, seed: int) -> Log:
    """A log of the simulated axis with an effect hidden in it."""
    return simulate_log(machine, *([(name, HIDDEN[name])] if name else []), seconds=6.0, seed=seed)


def roughened(machine: Machine, seed: int) -> Machine:
    """The machine with every number off by a factor of up to ten, either way."""
    random, friction = np.random.default_rng(seed), machine.friction

    def off() -> float:
        return float(10.0 ** random.uniform(-1.0, 1.0))

    shares = np.array([share * off() for share in friction.fraction])
    changes = {
        "stiffness": [kappa * off() for kappa in friction.stiffness],
        "fraction": (shares / shares.sum()).tolist(),
        **{name: getattr(friction, name) * off() for name in NUMBERS},
    }
    return override_machine(machine, {"plant": {"mass": machine.plant.mass * off()}, "friction": changes})


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("", 3), ("force_ripple", 3), ("actuator_lag", 8)])
def test_a_rough_file_ends_where_the_true_one_does(name: str, seed: int, tmp_path: Path) -> None:
    machine = load_machine("etel_xy")
    log, file = recorded(machine, name, seed), roughened(machine, seed)
    rough = diagnose(file, log)
    causes = {name: {key: Within(value, 4.0) for key, value in HIDDEN[name].items()}} if name else {}
    assert_found(rough, causes, "explained" if name else "adequate")
    assert rough.is_rough and rough.rms.held_out_after < 1.1 * rough.noise_floor_N
    # The file's numbers that are refuted, and the record's beside them.
    refuted = {number.name: number for number in rough.refuted}
    assert {"coulomb_N", "mass_kg", "break_away_m"} <= set(refuted)
    for key, value in (("coulomb_N", machine.friction.coulomb), ("mass_kg", machine.plant.moved)):
        assert refuted[key].record == pytest.approx(value, abs=max(4.0 * refuted[key].std, 0.003 * value))
    assert refuted["coulomb_N"].file == file.friction.coulomb
    # The extended file stands for itself, and has them.
    folder = write_diagnosis(rough, tmp_path)
    content = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    assert {entry["name"] for entry in content["refuted"]} == set(refuted)
    assert rough.extended is not None
    assert rough.extended.friction.coulomb == pytest.approx(machine.friction.coulomb, rel=0.01)
    assert rough.extended.plant.moved == pytest.approx(machine.plant.moved, rel=0.001)
    if name == "force_ripple":
        left = diagnose(rough.extended, log)
        assert left.verdict == "adequate" and not left.is_rough, left.summary


def test_plain_friction_stands_beside_every_verdict() -> None:
    machine = load_machine("etel_xy")
    log = recorded(machine, "", 1)
    found = diagnose(machine, log)
    assert found.plain is not None and not found.is_rough and not found.refuted
    signals = found.traces
    held, seen = signals.held_out, signals.used & ~signals.held_out
    # Presliding and the Stribeck effect are beyond it.
    assert 0.05 * machine.friction.coulomb < found.plain.held_out < machine.friction.coulomb
    X = np.column_stack(
        (signals.acceleration_m_s2, signals.velocity_m_s, np.sign(signals.velocity_m_s), np.ones(len(signals.time_s)))
    )
    b = np.linalg.lstsq(X[seen], signals.friction_N[seen], rcond=None)[0]
    rest = signals.friction_N - X @ b
    assert found.plain.held_out == pytest.approx(float(np.sqrt(np.mean(rest[held] ** 2))), rel=1e-6)
    assert found.errors["plain"] > found.errors["after"] > 0.0
    assert found.to_json()["simulation_error"] == found.errors


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 10.0])
def test_a_file_that_is_rough_in_presliding_alone_begins_from_the_record(factor: float) -> None:
    """It predicts better than plain friction, which has no presliding at all, and is no beginning all the same."""
    machine = load_machine("etel_xy")
    file = override_machine(machine, {"friction": {"stiffness": [factor * k for k in machine.friction.stiffness]}})
    recording = prepare(file, recorded(machine, "", 3))
    nominal = fit_model(Subject.of(file, recording), (), refitted=())
    assert nominal.rms < plain_friction(recording).held_out
    begun = begin_from_record(recording, nominal, lambda step: None, has_force=True)
    if factor == 1.0:
        assert begun is None
    else:
        assert begun is not None
        assert begun.machine.friction.mean_break_away == pytest.approx(machine.friction.mean_break_away, rel=0.1)


def test_distance_is_of_what_the_record_determines() -> None:
    level = RefutedNumber("coulomb_N", 4.0, 4.0, 0.1)
    assert distance([level], 0.1) == 0.0
    assert distance([RefutedNumber("coulomb_N", 40.0, 4.0, 0.0)], 0.1) == pytest.approx(math.log(10.0))
    # Inside two deviations nothing is told apart, and a number alone that is wrong by half is no rough file.
    assert distance([RefutedNumber("coulomb_N", 4.19, 4.0, 0.1)], 0.1) == 0.0
    assert distance([RefutedNumber("coulomb_N", 6.0, 4.0, 0.01)], 0.1) < ROUGH
    damping = RefutedNumber("viscous_N_s_m", 0.0, 20.0, 0.0)
    assert distance([level, damping], 0.1) == pytest.approx(0.5)
    assert distance([level, RefutedNumber("break_away_m", 1e-3, 1e-5, 1e-7)], 0.1) > 2.0 * ROUGH


@pytest.mark.slow
def test_elements_that_break_away_within_a_sample_cost_no_more_than_it_resolves() -> None:
    """A slow log of plain sliding friction whose level falls with speed: smooth elements would take for ever."""
    rate, period = 60.0, 8.0
    time = np.arange(int(60.0 * rate)) / rate
    velocity = 0.004 * np.sin(2.0 * np.pi * time / period)
    position = -0.004 * period / (2.0 * np.pi) * np.cos(2.0 * np.pi * time / period)
    friction = 4.0 * np.sign(velocity) * (1.0 + 0.4 * np.exp(-((velocity / 0.002) ** 2)))
    friction += np.random.default_rng(1).normal(0.0, 0.05, len(time))
    log = Log(time, position, friction, rate, velocity_m_s=velocity, friction_N=friction)
    rough = {"stiffness": [1e5], "fraction": [1.0], "micro_viscous": [0.0], "coulomb": 40.0, "stribeck_ratio": 0.0}
    for law in ("sgms", "switching"):
        file = override_machine(
            load_machine("etel_xy"),
            {
                "friction": {**rough, "law": law},
                "sampling": {"rate": rate, "update_rate": rate, "velocity_cutoff": 24.0},
            },
        )
        recording = prepare(file, log)
        nominal = fit_model(Subject.of(file, recording), (), refitted=())
        begun = begin_from_record(recording, nominal, lambda step: None, has_force=False)
        assert begun is not None
        found = begun.machine.friction
        distances = np.array(found.fraction) * found.coulomb / np.array(found.stiffness)
        least = least_distance(law, Stribeck(found.stribeck_ratio, found.stribeck_velocity), rate)
        assert np.all(distances >= 0.999 * least)
        # Steps below the gate leave no room for stiffness that is wrong by far, and are short enough for this one.
        assert begun.machine.sampling.integrator.slow_displacement == (0.02 if law == "switching" else SLOW_STEP)
        code = make_model(begun.machine, ()).code
        fine = CompiledModel(override_machine(code.machine, {"sampling": {"integrator": {"slow_displacement": 2e-3}}}))
        ours, theirs = (model.predict(recording.signals) for model in (code, fine))
        assert np.max(np.abs(ours - theirs)) < 1e-4 * found.coulomb


def test_smooth_elements_for_ones_that_switch_cost_no_more_than_a_sample_tells() -> None:
    """A servo whose level falls up to a high speed, as identified: an element of 3 urad and a gate at 0.6 rad/s."""
    friction = {"law": "switching", "stiffness": [5764.0, 5.0], "fraction": [0.9, 0.1], "coulomb": 0.019}
    friction |= {"micro_viscous": [0.0, 0.0], "stribeck_ratio": 5.0, "stribeck_velocity": 1.7}
    file = override_machine(slow_axis(), {"friction": friction})
    own, other = _thinned(file, prepare(file, simulate_log(file, seconds=1.0, seed=1)), 1.0)
    assert own.machine.friction.stiffness == (5764.0, 5.0)
    found = other.machine.friction
    distances = found.coulomb * np.array(found.fraction) / np.array(found.stiffness)
    assert found.law == "sgms" and found.stiffness[1] == 5.0
    assert distances[0] == pytest.approx(least_distance("sgms", Stribeck(5.0, 1.7), 1000.0))
    lag = [CandidateEffect("micro_viscous", {})]
    sharp = smooth_law(own.machine, lag)
    assert sharp.friction.stiffness == found.stiffness and sharp.friction.smoothing.lambda_ > 100.0
    model, stiff = own.model(lag), own.start_from({"stiffness_1": 5764.0})  # more than their steps are chosen for
    assert model.columns[0].si(float(stiff.start(model, lag)[0])) == pytest.approx(10.0 * found.stiffness[0])
    written = override_machine(file, {"friction": law_changes(file, other.machine)})
    assert written.friction == found, "the extended machine has not the elements that were fitted"


def test_the_file_is_no_scale_of_a_number_that_the_record_does_not_show() -> None:
    machine = override_machine(load_machine("etel_xy"), {"friction": {"law": "switching"}})
    log = simulate_log(machine, seconds=4.0)
    stiff = 1e4 * machine.friction.stiffness[0]  # slides at once, whatever it is
    subject = Subject.of(machine, prepare(machine, log)).start_from({"stiffness_1": stiff})
    fit = fit_model(subject, ())
    (number,) = (i for i, column in enumerate(fit.model.columns) if column.name == "stiffness_1")
    assert fit.model.columns[number].si(fit.theta[number]) == pytest.approx(stiff, rel=0.1)
    assert standard_deviations(covariance(subject, fit), fit)[number] > 0.5 * stiff


@pytest.mark.parametrize(("left", "stands"), [(0.5, "file"), (0.3, "record")])
def test_a_beginning_that_leaves_more_than_the_file_refutes_nothing(
    left: float, stands: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A joint's friction, from what identify had found of all of it: 0.059 N m were left instead of 0.048."""
    machine = load_machine("etel_xy")
    bare = replace(explained(machine), verdict="unexplained", causes=(), is_rough=True)
    found = replace(bare, source="record", rms=Rms(1.0, 1.0, 0.4, left))
    unused: Any = None
    monkeypatch.setattr(verdict, "_diagnose_aligned", lambda *_: (replace(bare, source="file"), unused))
    again = verdict._diagnose_again(unused, unused, found, unused)
    assert again.source == stands
