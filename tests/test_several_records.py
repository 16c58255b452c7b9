"""Causes fitted to several records and judged on each: other origins, temperatures, a cause that only one has."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import SMALL, refused, run
from diagnosis_cases import explained
from record_cases import ASYMMETRY, RIPPLE, Hidden, record_axis, small_axis
from sgms_mhe.api.inputs import list_sources
from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis import Cause, Diagnosis
from sgms_mhe.diagnosis.extension import extend_machine
from sgms_mhe.diagnosis.joint_numbers import refit_to_motion
from sgms_mhe.diagnosis.parametrisation import JacobianColumn, bounds
from sgms_mhe.diagnosis.parts import Rms
from sgms_mhe.diagnosis.transfer import judge_on_records
from sgms_mhe.diagnosis.written_file import WrittenError
from sgms_mhe.evaluation.prediction import force_error, predict_log
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.free_run import run_freely
from sgms_mhe.recordings.output_error import Objective
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.statements import Rule

FINE_RIPPLE = ("force_ripple", {"amplitude_N": 0.7, "pitch_m": 0.0053, "phase_rad": -1.1})
FORCE_AGE_s = 3.4e-4
"""Of the logged force, which a diagnosis finds in every record of this axis: its controller holds it over a sample."""
COLD = {"coulomb": 1.3, "viscous": 1.6}


@pytest.fixture(scope="module")
def machine() -> Machine:
    return small_axis()


def make_diagnosis(
    machine: Machine, log: Log, hidden: Sequence[Hidden], friction: Mapping[str, float] | None = None
) -> Diagnosis:
    """A diagnosis that found what is hidden, number by number."""
    rms, nan, numbers = Rms(1.0, 0.1, 1.0, 0.1), math.nan, dict(friction or {})
    labels = [f"{name}_2" if any(n == name for n, _ in hidden[:i]) else name for i, (name, _) in enumerate(hidden)]
    found = [
        Cause(name, label, values, dict.fromkeys(values, nan), {}, rms, 0.5, (0.4, 0.6), 1e-9)
        for (name, values), label in zip(hidden, labels, strict=True)
    ]
    for name, value in numbers.items():
        nominal = {f"{name}_N": getattr(machine.friction, name)}
        found.append(Cause(name, name, {f"{name}_N": value}, {f"{name}_N": nan}, nominal, rms, 0.5, (0.4, 0.6), 1e-9))
    entries: list[dict[str, Any]] = [{"name": name, **values} for name, values in hidden]
    extended, changes = extend_machine(machine, labels, numbers, entries or None)
    shown = explained(machine)
    m = len(log)
    used = np.ones(m, dtype=np.bool_)
    traces = replace(shown.traces, position_m=log.position_m, used=used)
    return replace(
        shown,
        machine=machine,
        causes=tuple(found),
        extended=extended,
        changes=changes,
        traces=traces,
        offset_s=FORCE_AGE_s,
    )


def judge_hidden(machine: Machine, hidden: Sequence[Hidden], others: Sequence[Log], **changes: Any) -> Diagnosis:
    scale = {name: value / getattr(machine.friction, name) for name, value in changes.get("friction", {}).items()}
    first = record_axis(machine, 1, hidden, scale=scale)
    return judge_on_records(make_diagnosis(machine, first, hidden, **changes), first, others, lambda _: None)


def test_a_ripple_transfers_to_another_power_up_and_temperature(machine: Machine) -> None:
    other = record_axis(machine, 2, [RIPPLE], scale=COLD, origin=0.0061, offset=0.3)
    found = judge_hidden(machine, [RIPPLE, ASYMMETRY], [other])
    ripple, asymmetry = found.causes
    assert ripple.transfers is True
    assert asymmetry.transfers is False  # the other record has none
    assert not found.identifies(asymmetry)
    _, record = found.records
    assert record.name == "record 2"
    assert record.origin_m == pytest.approx(0.0061, abs=3e-4)
    first, second = record.causes
    assert first.gain_interval_N[0] > 0.3
    assert second.gain_interval_N[1] < 0.0
    assert any("asymmetric_coulomb: of the first record alone" in limit for limit in found.limits)


def test_what_both_records_have_leaves_no_more_than_noise(machine: Machine) -> None:
    hidden = [RIPPLE, ASYMMETRY]
    found = judge_hidden(machine, hidden, [record_axis(machine, 2, hidden, scale=COLD, origin=-0.0021, offset=-0.2)])
    _, record = found.records
    assert [cause.transfers for cause in found.causes] == [True, True]
    assert record.origin_m % 0.0171 == pytest.approx(-0.0021 % 0.0171, abs=5e-5)  # one ripple: but for its periods
    assert record.held_out_after < 1.1 * record.noise_floor_N
    assert record.held_out_before > 5.0 * record.held_out_after
    assert record.plain > record.held_out_before
    assert not [s for s in found.statements if s.sure == "no" and s.kind in ("cause", "file", "learned")]


def test_a_homed_axis_has_one_origin(machine: Machine) -> None:
    homed = override_machine(machine, {"log": {"homed": True}})
    other = record_axis(machine, 2, [RIPPLE], origin=0.0171 / 2.0)  # the opposite phase
    found = judge_hidden(homed, [RIPPLE], [other, record_axis(machine, 3, [RIPPLE])])
    assert found.causes[0].transfers is False
    assert [record.origin_m for record in found.records] == [0.0, 0.0, 0.0]
    assert found.records[1].causes[0].gain_interval_N[1] < 0.0 < found.records[2].causes[0].gain_interval_N[0]
    assert judge_hidden(machine, [RIPPLE], [other]).causes[0].transfers is True


def test_two_ripples_say_the_origin_beyond_a_period(machine: Machine) -> None:
    hidden = [RIPPLE, FINE_RIPPLE]
    found = judge_hidden(machine, hidden, [record_axis(machine, 2, hidden, origin=0.0243)])
    assert [cause.transfers for cause in found.causes] == [True, True]
    assert found.records[1].origin_m == pytest.approx(0.0243, abs=5e-5)


def test_a_level_is_judged_as_it_was_found(machine: Machine) -> None:
    level = 1.25 * machine.friction.coulomb
    same, other = (record_axis(machine, seed, (), scale={"coulomb": factor}) for seed, factor in ((2, 1.25), (3, 1.0)))
    found = judge_hidden(machine, (), [same], friction={"coulomb": level})
    assert found.causes[0].transfers is True
    found = judge_hidden(machine, (), [same, other], friction={"coulomb": level})
    assert found.causes[0].transfers is False
    # As a property of the record it is fitted, and no error of either machine.
    assert found.records[2].held_out_after < 1.1 * found.records[2].noise_floor_N


def test_an_offset_of_each_record_is_no_one_number_and_the_estimator_follows_it(machine: Machine) -> None:
    file = override_machine(machine, {"effects": [{"name": "constant_offset", "force_N": 5.0}]})
    first, other = (record_axis(machine, seed, [RIPPLE], offset=offset) for seed, offset in ((1, 5.0), (2, 60.0)))
    found = make_diagnosis(file, first, [("constant_offset", {"force_N": 5.0}), RIPPLE])
    found = judge_on_records(found, first, [other], lambda _: None)
    (offset,) = found.differences
    assert offset.values == pytest.approx((5.0, 60.0), abs=0.1)
    assert any("constant_offset.force_N: differs between the records" in limit for limit in found.limits)
    assert {cause.name: cause.transfers for cause in found.causes} == {"constant_offset": False, "force_ripple": True}
    # Started at an offset 55 N off, a joint fit ends at another ripple.
    assert all(record.held_out_after < 1.1 * record.noise_floor_N for record in found.records)
    assert found.extended is not None
    assert dict(found.extended.effects[0].parameters) == pytest.approx({"force_N": 5.0}, abs=0.1)
    assert "constant_offset.force_N" in found.extended.estimator.parameters
    assert found.extended.estimator.prior["constant_offset.force_N"] == pytest.approx(55.0, abs=0.1)


@pytest.mark.parametrize("objective", ["motion", "both"])
def test_numbers_of_the_written_file_are_those_of_the_motion(machine: Machine, objective: Objective) -> None:
    """Level and ripple of the file and of its causes alike; the mass is that of the force."""
    log = record_axis(machine, 2, [RIPPLE])
    level, amplitude = machine.friction.coulomb, RIPPLE[1]["amplitude_N"]
    less = (RIPPLE[0], {**RIPPLE[1], "amplitude_N": 0.5 * amplitude})
    found = refit_to_motion(make_diagnosis(machine, log, [less], {"coulomb": 1.2 * level}), [log], objective)
    assert found.extended is not None and found.refit is not None
    assert found.extended.friction.coulomb == pytest.approx(level, rel=0.02)
    assert found.extended.friction.stiffness == machine.friction.stiffness
    assert found.extended.effects[0].parameters["amplitude_N"] == pytest.approx(
        amplitude, rel=0.15
    )  # the force is late
    assert found.extended.plant == machine.plant
    ripple, coulomb = found.causes
    assert ripple.parameters["amplitude_N"] == found.extended.effects[0].parameters["amplitude_N"]
    assert coulomb.parameters["coulomb_N"] == found.extended.friction.coulomb
    assert 0.0 < coulomb.std["coulomb_N"] < 0.2 * level
    moved, before = found.refit.motion
    assert moved < 0.1 * before
    assert WrittenError.measure(machine, found.extended, log).motion[1] == pytest.approx(moved, rel=0.01)
    assert Rule.REFITTED_MOTION in [statement.rule for statement in found.statements]


def test_errors_of_the_written_file_are_those_of_predict(machine: Machine) -> None:
    log = record_axis(machine, 2, [RIPPLE])
    found = make_diagnosis(machine, log, [RIPPLE])
    written = WrittenError.measure(machine, found.extended, log)
    for file, error in ((machine, written.before), (found.extended, written.after)):
        assert file is not None
        stated = force_error(predict_log(file, log))
        assert error == pytest.approx(stated.residual_rms_N, rel=1e-12)
        assert written.force == pytest.approx(stated.force_rms_N, rel=1e-12)
    assert written.after < 0.9 * written.before
    assert found.extended is not None
    for file, error in zip((machine, found.extended), written.motion, strict=True):
        run = run_freely(file, log)
        apart = (run.simulated_position_m - run.position_m)[run.compared]
        assert error == pytest.approx(np.sqrt(np.mean(apart**2)))
    assert [said.rule for said in written.state("force")] == [Rule.WRITTEN, Rule.FREE_RUN]
    alone = WrittenError.measure(machine, found.extended, replace(log, force_N=log.force_N, friction_N=log.force_N))
    assert [said.rule for said in alone.state("force")] == [Rule.WRITTEN]  # friction alone moves nothing


def test_records_that_do_not_show_a_cause_say_nothing_of_it(machine: Machine) -> None:
    tiny = ("asymmetric_coulomb", {"ratio": 0.001})
    found = judge_hidden(machine, [tiny], [record_axis(machine, 2, ())])
    assert found.causes[0].transfers is None
    assert not [s for s in found.statements if s.sure == "no" and s.kind in ("cause", "file", "learned")]


def test_a_machine_worse_than_plain_friction_is_not_recommended(machine: Machine) -> None:
    wrong = ("force_ripple", {"amplitude_N": 8.0, "pitch_m": 0.0171, "phase_rad": 0.0})
    found = judge_hidden(machine, [wrong], [record_axis(machine, 2, ())])
    _, record = found.records
    assert record.held_out_after > record.plain
    (sentence,) = (limit for limit in found.limits if "not recommended" in limit)
    assert "on record 2" in sentence
    content = found.to_json()
    assert content["causes"][0]["transfers"] is False
    assert content["causes"][0]["identified"] is False
    _, entry = content["records"]
    assert entry["residual_rms_N"]["held_out_after"] == record.held_out_after
    assert entry["simulation_error"]["after"] == pytest.approx(record.held_out_after / record.force)
    assert record.force > record.plain  # most of the force is inertial
    assert entry["gains"][0]["name"] == "force_ripple"
    assert entry["gains"][0]["shown"] is True


ROUGH_RIPPLE = ("force_ripple", {"amplitude_N": 1.1, "pitch_m": 0.01711, "phase_rad": 0.35})
ROUGH_ASYMMETRY = ("asymmetric_coulomb", {"ratio": 0.23})
"""As one record might say."""


def together(
    machine: Machine, hidden: Sequence[Hidden], found: Sequence[Hidden], others: Sequence[Log], **changes: Any
) -> Diagnosis:
    """Several records that hide one thing, of which the first was found to have another."""
    first = record_axis(machine, 1, hidden, scale={"coulomb": 0.8}, offset=0.4)
    return judge_on_records(make_diagnosis(machine, first, found, **changes), first, others, lambda _: None)


def test_numbers_are_those_of_all_records_together(machine: Machine) -> None:
    hidden = [RIPPLE, ASYMMETRY]
    others = [
        record_axis(machine, 2, hidden, scale=COLD, origin=0.0061, offset=0.3),
        record_axis(machine, 3, hidden, origin=-0.0017, offset=-0.2),
    ]
    found = together(machine, hidden, [ROUGH_RIPPLE, ROUGH_ASYMMETRY], others)
    assert [cause.transfers for cause in found.causes] == [True, True]
    for cause, (_, truth), (_, rough) in zip(found.causes, hidden, [ROUGH_RIPPLE, ROUGH_ASYMMETRY], strict=True):
        for name, value in truth.items():
            error = abs(cause.parameters[name] - value)
            assert error < 0.1 * abs(rough[name] - value)
            assert error < 3.0 * cause.std[name]
            assert cause.std[name] < 0.1 * abs(value)
    assert found.extended is not None and found.changes is not None
    stated = {effect.label: dict(effect.parameters) for effect in found.extended.effects}
    assert stated == {cause.label: pytest.approx(dict(cause.parameters)) for cause in found.causes}
    assert found.changes["effects"][1]["ratio"] == found.causes[1].parameters["ratio"]
    # What belongs to a record is its own.
    level, own = machine.friction.coulomb, [record.own for record in found.records]
    assert [o["coulomb_N"] / level for o in own] == pytest.approx([0.8, 1.3, 1.0], abs=0.02)
    assert [o["constant_offset.force_N"] for o in own] == pytest.approx([0.4, 0.3, -0.2], abs=0.03)
    assert found.to_json()["records"][1]["own"] == own[1]
    # Each is predicted by the numbers of the others.
    assert [record.name for record in found.records] == ["record 1", "record 2", "record 3"]
    assert all(record.held_out_after < 1.2 * record.noise_floor_N for record in found.records)
    assert [len(record.causes) for record in found.records] == [2, 2, 2]


def test_a_cause_of_the_first_record_alone_keeps_its_numbers(machine: Machine) -> None:
    other = record_axis(machine, 2, [RIPPLE], scale=COLD, origin=0.0061)
    found = together(machine, [RIPPLE, ASYMMETRY], [ROUGH_RIPPLE, ASYMMETRY], [other])
    ripple, asymmetry = found.causes
    assert (ripple.transfers, asymmetry.transfers) == (True, False)
    assert asymmetry.parameters == ASYMMETRY[1]
    assert ripple.parameters["amplitude_N"] == pytest.approx(
        RIPPLE[1]["amplitude_N"], abs=3.0 * ripple.std["amplitude_N"]
    )
    assert [t.label for t in found.records[0].causes] == ["force_ripple"]  # by the other one there is no asymmetry


def test_a_phase_is_surer_by_another_record_only_if_that_has_the_same_origin(machine: Machine) -> None:
    other = record_axis(machine, 2, [RIPPLE])
    homed = override_machine(machine, {"log": {"homed": True}})
    free, known = (together(axis, [RIPPLE], [ROUGH_RIPPLE], [other]).causes[0] for axis in (machine, homed))
    assert known.std["phase_rad"] < 0.8 * free.std["phase_rad"]
    assert known.std["amplitude_N"] == pytest.approx(free.std["amplitude_N"], rel=0.2)


def test_a_level_is_the_mean_of_the_records_and_as_uncertain_as_they_differ(machine: Machine) -> None:
    level = machine.friction.coulomb
    others = [record_axis(machine, 2, (), scale={"coulomb": 1.4}), record_axis(machine, 3, (), scale={"coulomb": 1.2})]
    first = record_axis(machine, 1, (), scale={"coulomb": 1.3})
    found = make_diagnosis(machine, first, (), friction={"coulomb": 1.3 * level})
    (cause,) = judge_on_records(found, first, others, lambda _: None).causes
    assert cause.transfers is True
    assert cause.parameters["coulomb_N"] == pytest.approx(1.3 * level, rel=0.01)
    assert cause.std["coulomb_N"] == pytest.approx(0.1 * level, rel=0.1)


def test_a_number_of_all_records_that_a_bound_stops_has_no_interval(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def limited(columns: Sequence[JacobianColumn], recording: Recording) -> tuple[NDArray[np.float64], ...]:
        """No amplitude above 1 N, of a ripple of 1.2 N."""
        lower, upper = bounds(columns, recording)
        return lower, np.array(
            [c.theta(1.0) if c.name == "amplitude_N" else u for c, u in zip(columns, upper, strict=True)]
        )

    for module in ("joint_fit", "fits"):
        monkeypatch.setattr(f"sgms_mhe.diagnosis.{module}.bounds", limited)
    low = ("force_ripple", {**RIPPLE[1], "amplitude_N": 0.9})
    found = together(machine, [RIPPLE], [low], [record_axis(machine, 2, [RIPPLE])])
    (ripple,) = found.causes
    assert ripple.parameters["amplitude_N"] == pytest.approx(1.0)
    assert math.isnan(ripple.std["amplitude_N"])
    assert ripple.vague == ("amplitude_N",)
    assert ripple.std["pitch_m"] > 0.0


def test_one_log_or_several_are_sources() -> None:
    log = Log(np.zeros(3), np.zeros(3), np.zeros(3), 1.0)
    assert list_sources("a.csv") == ["a.csv"]
    assert list_sources(log) == [log]
    assert list_sources({"time_s": [0.0]}) == [{"time_s": [0.0]}]
    assert list_sources((log, Path("b.csv"))) == [log, Path("b.csv")]
    assert list_sources([]) == []


@pytest.mark.slow
def test_diagnose_takes_several_logs(machine: Machine, tmp_path: Path) -> None:
    axis, first, second = (tmp_path / name for name in ("small.toml", "first.csv", "second.csv"))
    axis.write_text(SMALL)
    write_log(first, record_axis(machine, 1, [RIPPLE]))
    write_log(second, record_axis(machine, 2, [RIPPLE], scale=COLD, origin=0.0061, offset=0.3))
    out = tmp_path / "out"
    result = run("diagnose", axis, first, second, "--out", out)
    assert result.exit_code == 0, result.output
    assert "rms on held-out data; transfers" in result.stdout
    assert re.search(rf"{re.escape(str(second))}, unseen data: [\d.]+ % of the force's RMS before", result.stdout)
    content = json.loads((out / "diagnosis.json").read_text())
    assert [cause["transfers"] for cause in content["causes"]] == [True]
    assert [record["name"] for record in content["records"]] == [str(first), str(second)]
    report = (out / "report.html").read_text()
    assert "On each record" in report
    assert "second.csv" in report
    assert "absent.csv" in refused("diagnose", axis, first, tmp_path / "absent.csv", "--out", out)
