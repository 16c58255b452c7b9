"""Causes sought in several records as one: what the first does not show, what is weak in each, a strange first one."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis_cases import Within, assert_found
from record_cases import ASYMMETRY, RIPPLE, record_axis, small_axis
from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose
from sgms_mhe.diagnosis.alignment import find_step_error
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.diagnosis.preparation import prepare_logs
from sgms_mhe.machine import Machine

DRAG = ("quadratic_drag", {"coefficient_N_s2_m2": 1.5})
LONG_RIPPLE = ("force_ripple", {"amplitude_N": 0.6, "pitch_m": 0.3, "phase_rad": 0.4})
WEAK_RIPPLE = ("force_ripple", {"amplitude_N": 0.045, "pitch_m": 0.0171, "phase_rad": 0.4})
WARM = {"coulomb": 1.2, "viscous": 1.3}


@pytest.fixture(scope="module")
def machine() -> Machine:
    return override_machine(small_axis(), {"log": {"homed": True}})


def holds(found: Diagnosis) -> dict[str, bool | None]:
    return {cause.label: cause.transfers for cause in found.causes}


def test_what_belongs_to_a_record_is_no_residual_of_all(machine: Machine) -> None:
    logs = [record_axis(machine, 1, ()), record_axis(machine, 2, (), scale=WARM, offset=0.3)]
    alone, joined = (prepare_logs(machine, some, None).recording for some in (logs[:1], logs))
    own, fit = (fit_model(Subject.of(machine, one), ()) for one in (alone, joined))
    assert prepare_logs(machine, logs[1:], None).nominal.rms > 4.0 * own.rms
    # What is left is the age of the force, as in the first alone.
    assert fit.rms < 1.05 * own.rms
    assert fit.own is not None and own.own is None
    offsets = np.linalg.lstsq(fit.own.columns, fit.own.force, rcond=None)[0][:2]
    assert offsets == pytest.approx([0.0, 0.3], abs=0.03)
    # No candidate is offered what an offset of one record explains.
    second = (joined.of_log == 1).astype(np.float64)[joined.used]
    left = fit.find_nuisance(joined.used).project(second[:, None])
    assert float(np.linalg.norm(left)) < 1e-6 * float(np.linalg.norm(second))


def test_records_that_do_not_meet_have_the_step_errors_of_each(machine: Machine) -> None:
    logs = [record_axis(machine, 1, ()), record_axis(machine, 2, ())]
    moved = [logs[0], replace(logs[1], position_m=logs[1].position_m + 0.7)]
    errors = []
    for one in ([logs[0]], moved):
        subject = Subject.of(machine, prepare_logs(machine, one, None).recording)
        errors.append((subject, find_step_error(subject, fit_model(subject, (), refitted=()))))
    (_, first), (together, both) = errors
    used = together.recording.used[: len(first)]
    assert np.abs(both[: len(first)] - first)[used].max() < 1e-9 * np.abs(first).max()


@pytest.mark.slow
def test_a_cause_that_the_second_record_alone_excites_is_found(machine: Machine) -> None:
    slow = record_axis(machine, 1, [DRAG], reach=0.15)
    fast = record_axis(machine, 2, [DRAG], scale=WARM, offset=0.3)
    assert diagnose(machine, slow).verdict == "adequate"
    found = diagnose(machine, slow, others=[fast])
    assert holds(found) == {"quadratic_drag": None}  # of one record, others say nothing
    (cause,) = found.causes
    (value,), (std,) = cause.parameters.values(), cause.std.values()
    assert abs(value - 1.5) < 3.0 * std < 0.3
    assert [record.name for record in found.records] == ["record 1", "record 2"]
    assert found.records[1].own["coulomb_N"] == pytest.approx(4.8, rel=0.02)


@pytest.mark.slow
def test_a_cause_that_is_weak_in_each_record_is_found_in_all(machine: Machine) -> None:
    logs = [record_axis(machine, seed, [WEAK_RIPPLE]) for seed in (11, 12, 13)]
    assert diagnose(machine, logs[0]).causes == ()
    found = diagnose(machine, logs[0], others=logs[1:])
    assert holds(found) == {"force_ripple": True}
    weak = {name: Within(value, 3.0) for name, value in WEAK_RIPPLE[1].items()}
    assert_found(found, {"force_ripple": weak}, "explained")


@pytest.mark.slow
def test_a_short_first_record_does_not_decide(machine: Machine) -> None:
    """A twelfth of a ripple is a spring."""
    short = record_axis(machine, 1, [LONG_RIPPLE], reach=0.05)
    assert [cause.name for cause in diagnose(machine, short).causes] == ["position_spring"]
    found = diagnose(machine, short, others=[record_axis(machine, 2, [LONG_RIPPLE], scale={"coulomb": 1.1})])
    assert holds(found) == {"force_ripple": True, "position_spring": False}
    assert found.causes[0].parameters["pitch_m"] == pytest.approx(0.3, rel=0.02)
    assert found.extended is not None
    assert [effect.name for effect in found.extended.effects] == ["force_ripple"]
    assert any("position_spring: of the first record alone" in limit for limit in found.limits)


@pytest.mark.slow
def test_a_cause_of_the_first_record_alone_stays_that(machine: Machine) -> None:
    logs = [record_axis(machine, 1, [RIPPLE, ASYMMETRY]), *(record_axis(machine, seed, [RIPPLE]) for seed in (2, 3))]
    found = diagnose(machine, logs[0], others=logs[1:])
    assert holds(found) == {"force_ripple": True, "asymmetric_coulomb": False}
