"""Identification from several records of one axis: what belongs to a record is free in each."""

import re

import numpy as np
import pytest

from record_cases import record_axis, small_axis
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.identification.elements import NO_RISE, run_elements
from sgms_mhe.identification.identify import Wanted, identify
from sgms_mhe.identification.records import Records, filter_motion, scale_levels
from sgms_mhe.identification.terms import OF_RECORD, record_sizes, record_terms
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.recording import prepare


@pytest.fixture(scope="module")
def machine() -> Machine:
    return small_axis()


@pytest.mark.slow
def test_offset_level_and_damping_are_free_in_each_record(machine: Machine) -> None:
    logs = [
        record_axis(machine, 1, scale={"coulomb": 0.8, "viscous": 0.7}, offset=0.5),
        record_axis(machine, 2, scale={"coulomb": 1.2, "viscous": 1.3}, offset=-0.3),
        record_axis(machine, 3, offset=0.2),
    ]
    found = identify(logs, Wanted("found", machine.plant.moved))
    truth = machine.friction
    assert found.held_out_rms_N < 1.3 * found.noise_floor_N  # one offset and level for all leave 60 noise floors
    assert found.machine.friction.stiffness == pytest.approx(truth.stiffness, rel=0.01)
    assert found.machine.friction.fraction == pytest.approx(truth.fraction, abs=0.003)
    numbers = {number.name: number for number in found.numbers}
    # Level and damping are the means, as uncertain as the records differ.
    assert numbers["coulomb"].value == pytest.approx(truth.coulomb, rel=0.005)
    assert numbers["coulomb"].std == pytest.approx(0.2 * truth.coulomb, rel=0.05)
    assert numbers["viscous"].value == pytest.approx(truth.viscous, rel=0.005)
    assert numbers["viscous"].std == pytest.approx(0.3 * truth.viscous, rel=0.05)
    assert numbers["coulomb"].determined and numbers["viscous"].determined
    level, damping = (next(w for w in found.warnings if w.startswith(word)) for word in ("Coulomb level", "damping"))
    levels = {name: float(size) for size, name in re.findall(r"([\d.]+) N in (record \d)", level)}
    assert levels == pytest.approx({"record 1": 3.2, "record 2": 4.8, "record 3": 4.0}, rel=0.005)
    dampings = {name: float(size) for size, name in re.findall(r"([\d.]+) N s/m in (record \d)", damping)}
    assert dampings == pytest.approx({"record 1": 14.0, "record 2": 26.0, "record 3": 20.0}, rel=0.005)
    # The file has one of each, so its estimator finds them again, and takes for noise what then is left.
    assert found.machine.estimator.parameters == ("coulomb", "viscous", "constant_offset.force_N")
    mean = numbers["constant_offset.force_N"].value
    assert found.machine.estimator.prior == {"constant_offset.force_N": pytest.approx(0.3 + mean, rel=0.02)}
    assert "# Of each record its own: constant_offset.force_N, coulomb, viscous." in found.toml
    for log, offset, level in zip(logs, (0.5, -0.3, 0.2), (3.2, 4.8, 4.0), strict=True):
        estimates = CompiledEstimator(found.machine).estimate_log(log)
        by_name = dict(zip(estimates.parameter_names, estimates.parameters[-1], strict=True))
        assert by_name["constant_offset.force_N"] == pytest.approx(offset, abs=0.05)
        assert by_name["coulomb"] == pytest.approx(level, rel=0.03)


def test_terms_of_records_are_differences_to_their_mean(machine: Machine) -> None:
    rows = prepare(machine, record_axis(machine, 4, offset=0.1))
    count = len(rows.time)
    sliding = np.sign(rows.velocity)
    assert record_terms(rows, [count], sliding) == ()
    lengths = [count // 3, count // 3, count - 2 * (count // 3)]
    terms = record_terms(rows, lengths, sliding)
    assert tuple(term.name for term in terms) == OF_RECORD[:-1]  # no payload was stated
    sizes = record_sizes(np.array([0.5, -0.2]))
    assert sizes == pytest.approx([0.5, -0.2, -0.3])
    each = np.repeat(sizes, lengths)
    assert terms[0].columns @ sizes[:2] == pytest.approx(each)
    assert terms[1].columns @ sizes[:2] == pytest.approx(each * sliding)


def test_a_level_of_a_record_leaves_stiffness_as_it_is(machine: Machine) -> None:
    rows = prepare(machine, record_axis(machine, 5, offset=0.1))
    motion = filter_motion(rows)
    records = Records(machine, ("a", "b"), rows, (motion, motion), (motion, motion), 0.0, ())
    scaled = scale_levels(scale_levels(records, [1.0, 3.0]), [1.0, 1.0])
    assert [m.scale for m in scaled.coarse] == [m.scale for m in scaled.fine] == pytest.approx([0.5, 1.5])
    distance, count = 2e-4, motion.rows
    both = run_elements(scaled.coarse, "switching", np.array([distance]), NO_RISE)
    for k, factor in enumerate((0.5, 1.5)):
        alone = run_elements([motion], "switching", np.array([factor * distance]), NO_RISE)
        part = slice(k * count, (k + 1) * count)
        assert both.chi[part] == pytest.approx(factor * alone.chi)
        assert both.jacobian[part] == pytest.approx(factor * alone.jacobian)
