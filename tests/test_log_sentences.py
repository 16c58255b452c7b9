"""Sentences about logs that drawn ones found false, each with the axis that shows it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sgms_bench.logs.cases import draw_truth
from sgms_bench.logs.faults import one_way_truth, relay_truth
from sgms_bench.logs.mutations import trace
from sgms_mhe.configuration import load_machine
from sgms_mhe.identification import Wanted, identify
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import ImplausibleError, InputError


def drawn_machine(seed: int, folder: Path) -> tuple[Machine, Log]:
    truth = draw_truth(np.random.default_rng(seed))
    path = folder / "drawn.toml"
    path.write_text(truth.axis.machine_file(truth.log.rate, truth.fastest))
    return load_machine(path), replace(truth.log, velocity_m_s=None, friction_N=None)


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 5])
def test_a_wrong_unit_is_not_called_swapped_columns(seed: int, tmp_path: Path) -> None:
    machine, log = drawn_machine(seed, tmp_path)
    small = "mm" if log.kind == "linear" else "mrad"
    with pytest.raises(ImplausibleError) as caught:
        check_plausible(replace(log, position_m=1e3 * log.position_m), machine)
    assert f'unit = "{small}"' in str(caught.value) and "swapped" not in str(caught.value)


@pytest.mark.parametrize("seed", [0, 1, 2, 4, 10, 14, 16, 18, 19])
def test_swapped_columns_are_refused_also_where_each_could_be_the_other(seed: int, tmp_path: Path) -> None:
    """A smooth force that is a position, and a rough position that is a force: neither mass nor friction in them."""
    machine, log = drawn_machine(seed, tmp_path)
    check_plausible(log, machine)
    with pytest.raises(ImplausibleError):
        check_plausible(replace(log, position_m=log.force_N, force_N=log.position_m), machine)


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 5])
def test_a_mass_from_the_log_itself_judges_no_force(seed: int, tmp_path: Path) -> None:
    machine, log = drawn_machine(seed, tmp_path)
    weak = replace(log, force_N=log.force_N / 500.0)
    with pytest.raises(InputError, match=r"(scale|unit) = "):
        check_plausible(weak, machine)
    check_plausible(weak, machine, has_mass=False)


def test_a_motion_one_way_is_refused_where_no_element_has_a_level() -> None:
    """All levels are 0 on the way of the search; their distances were merged by weights of 0."""
    log = one_way_truth(np.random.default_rng(10)).log
    with pytest.raises(InputError, match="a log that shows dry friction"):
        identify([replace(log, velocity_m_s=None, friction_N=None)], Wanted("one_way"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3, 5])
def test_a_run_up_of_one_torque_shows_no_inertia(seed: int) -> None:
    """Level, viscous friction and inertia are one curve there, and noise alone tells them apart: 40 to 76 % too low."""
    log = replace(one_way_truth(np.random.default_rng(seed)).log, velocity_m_s=None, friction_N=None)
    with pytest.raises(InputError, match="--inertia: the motion does not show it"):
        identify([log], Wanted("one_way"))


@pytest.mark.slow
def test_a_motion_that_was_there_is_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a rotor that slides both ways a level that is not determined lacks no sliding in both directions."""
    log = relay_truth(np.random.default_rng(2)).log
    monkeypatch.setattr("sgms_mhe.identification.description.KNOWN", 1e-6)  # nothing is determined
    found = identify([replace(log, velocity_m_s=None, friction_N=None)], Wanted("relay"))
    said = next(limit for limit in found.limits if limit.startswith("coulomb"))
    assert "though the motion has sliding in both directions" in said


def test_a_log_of_one_sample_a_second_is_refused() -> None:
    """No block of it holds enough rows; as where the unit of time is wrong, which is the reason that is given."""
    log, _ = trace()
    slow = replace(log, time_s=1e3 * log.time_s, rate=1e-3 * log.rate)
    with pytest.raises(InputError, match=r"time_s = '1 Hz': at least 2.5 Hz; time in another unit"):
        identify([slow], Wanted("slow"))


@pytest.mark.slow
@pytest.mark.parametrize("given", [None, 3.0])
def test_friction_alone_needs_no_mass(given: float | None) -> None:
    """The mass that force over acceleration shows is none there: its sign was called wrong."""
    truth = draw_truth(np.random.default_rng(4))
    axis, log = truth.axis, truth.log
    friction = log.columns["friction_N"] + 0.01 * axis.coulomb * np.random.default_rng(1).standard_normal(len(log))
    alone = replace(log, force_N=friction, friction_N=friction, velocity_m_s=None)
    found = identify([alone], Wanted("alone", mass=given))
    mass, coulomb = found.number("mass"), found.number("coulomb")
    assert (mass.value, mass.determined) == (given or 1.0, False)
    assert any("friction alone was recorded" in limit for limit in found.limits)
    assert coulomb.value == pytest.approx(axis.coulomb, rel=0.05)
    assert coulomb.std < 0.01 * coulomb.value  # what a mass would take from a force, no step of an encoder took here
    assert found.number("viscous").value == pytest.approx(axis.viscous, rel=0.1)
    with_force = replace(log, velocity_m_s=None, friction_N=None)
    with pytest.raises(InputError, match=r"logs of one call share it"):
        identify([alone, with_force], Wanted("both"))
