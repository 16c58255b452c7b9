"""Records of one axis that each move a payload of their own: `[log] payload = true`."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from record_cases import RIPPLE, Hidden, record_axis, small_axis
from sgms_mhe.api.inputs import read_log
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.diagnosis.preparation import prepare_logs
from sgms_mhe.identification.identify import Wanted, identify
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log, write_log

PAYLOADS_kg = (0.0, 6.0, 2.0)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return small_axis()


def record_payloads(machine: Machine, hidden: Sequence[Hidden] = (), *, stated: bool = True) -> list[Log]:
    """Records that each move a payload of their own."""
    logs = [record_axis(machine, k, hidden, payload=size) for k, size in enumerate(PAYLOADS_kg)]
    return [replace(log, payload=stated) for log in logs]


def test_a_payload_is_stated_in_the_table_of_a_log(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    write_log(path, record_axis(machine, 1))
    assert not read_log(path, machine).payload
    log = read_log(path, table={"payload": True})
    assert log.payload and log.part(0.0, 2.0).payload


def test_a_stated_payload_is_no_residual_of_all_records(machine: Machine) -> None:
    left = []
    for stated in (True, False):
        logs = record_payloads(machine, stated=stated)
        subject = Subject.of(machine, prepare_logs(machine, logs, None).recording)
        left.append(fit_model(subject, ()).rms)
    with_payload, without = left
    alone = fit_model(Subject.of(machine, prepare_logs(machine, logs[:1], None).recording), ()).rms
    assert with_payload < 1.3 * alone  # the age of the force, which grows with what is moved
    assert without > 10.0 * alone


@pytest.mark.slow
def test_a_cause_transfers_to_records_with_other_payloads(machine: Machine) -> None:
    first, *others = record_payloads(machine, [RIPPLE])
    found = diagnose(machine, first, others=others)
    assert found.verdict == "explained"
    assert {cause.label: cause.transfers for cause in found.causes} == {"force_ripple": True}
    moved = [record.own["mass_mismatch.mass_kg"] for record in found.records]
    assert moved == pytest.approx(PAYLOADS_kg, abs=0.02)
    assert found.extended is not None and found.extended.plant.moved == machine.plant.moved


@pytest.mark.slow
@pytest.mark.parametrize("given", [None, 20.0])
def test_identification_frees_the_mass_of_each_record(machine: Machine, given: float | None) -> None:
    logs = record_payloads(machine)
    found = identify(logs, Wanted("found", given))
    assert found.held_out_rms_N < 1.3 * found.noise_floor_N
    (said,) = (w for w in found.warnings if w.startswith("mass, payload included"))
    masses = {name: float(size) for size, name in re.findall(r"([\d.]+) kg in (record \d)", said)}
    truth = machine.plant.moved
    assert masses == pytest.approx({f"record {k}": truth + m for k, m in enumerate(PAYLOADS_kg)}, rel=0.005)
    (mass,) = (number for number in found.numbers if number.name == "mass")
    assert found.machine.plant.moved == pytest.approx(mass.value, rel=1e-3)  # the digits of a file
    if given is None:  # the mean of all, as unsure of another record as they differ
        assert mass.value == pytest.approx(truth + 8.0 / 3.0, rel=0.005)
        assert mass.std == pytest.approx(3.06, rel=0.05)
    else:
        assert mass.value == given
    assert found.machine.friction.stiffness == pytest.approx(machine.friction.stiffness, rel=0.02)
    # The weights do not take a payload, which an estimator is told, for noise: 0.53 N without any, several N with.
    assert found.machine.estimator.noise.measurement < 0.7
