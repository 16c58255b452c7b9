"""`[diagnosis]`: every threshold is used, nothing decides beside them, and a machine file changes them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import sgms_mhe.diagnosis
import sgms_mhe.recordings
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis.criteria import criteria_of
from sgms_mhe.machine import Machine, Thresholds
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.recordings.evidence import noise_floor
from sgms_mhe.recordings.excitation import measures
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.signals.chain import signals_of_record
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

FOLDERS = [Path(package.__path__[0]) for package in (sgms_mhe.diagnosis, sgms_mhe.recordings)]
MODULES = sorted(path for folder in FOLDERS for path in folder.glob("*.py"))
SOURCES = {f"{path.parent.name}/{path.name}": path.read_text(encoding="utf-8") for path in MODULES}


@pytest.fixture(scope="module")
def machine() -> Machine:
    return override_machine(load_machine("etel_xy"), {"sampling": {"rate": 1000.0, "velocity_cutoff": 100.0}})


@pytest.fixture(scope="module")
def log(machine: Machine) -> Log:
    path = make_trajectory("mixed", machine.sampling.rate, duration_s=6.0, max_velocity=0.3)
    return simulate_axis(machine, path, AxisConfig(seed=1)).log


@pytest.mark.parametrize("name", Thresholds.model_fields)
def test_every_threshold_decides_something(name: str) -> None:
    assert any(re.search(rf"(thresholds|diagnosis)\.{name}\b", text) for text in SOURCES.values())


def compared_numbers(text: str) -> Iterator[tuple[int, float]]:
    """Lines and bare numbers of comparisons, but zero and one."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Compare):
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, float) and part.value not in (0.0, 1.0):
                    yield node.lineno, part.value


@pytest.mark.parametrize("name", SOURCES)
def test_no_decision_has_a_bare_number(name: str) -> None:
    assert list(compared_numbers(SOURCES[name])) == []


def test_a_bare_number_would_be_seen() -> None:
    assert list(compared_numbers("if x > 0.0 and y < 0.3 * z:\n    pass\n")) == [(1, 0.3)]


def test_thresholds_are_no_part_of_what_is_emitted(machine: Machine) -> None:
    changed = override_machine(machine, {"diagnosis": {"material": 0.01}})
    assert changed.diagnosis.changed == {"material": 0.01}
    assert changed.as_dict()["diagnosis"]["material"] == 0.01
    assert changed.digest == machine.digest


@pytest.mark.parametrize(
    ("table", "where"),
    [
        ({"material": -0.1}, r"diagnosis\.material = -0\.1"),
        ({"rounds": 2.5}, r"diagnosis\.rounds = 2\.5"),
        ({"materiel": 0.1}, "did you mean material"),
        ({"block_min": 3.0}, "at most block_max = 2"),
    ],
)
def test_thresholds_out_of_range_are_refused(machine: Machine, table: dict[str, float], where: str) -> None:
    with pytest.raises(InputError, match=where):
        override_machine(machine, {"diagnosis": table})


def test_a_machine_file_changes_how_a_record_is_cut(machine: Machine, log: Log) -> None:
    usual = prepare(machine, log)
    changed = prepare(override_machine(machine, {"diagnosis": {"blocks": 20, "folds": 4, "held_out_one_in": 2}}), log)
    assert usual.blocks == pytest.approx(48, abs=2) and set(usual.fold) == set(range(5))
    assert changed.blocks == pytest.approx(20, abs=1) and set(changed.fold) == set(range(4))
    assert usual.held_out.mean() == pytest.approx(1 / 3, abs=0.05)
    assert changed.held_out.mean() == pytest.approx(1 / 2, abs=0.05)
    with pytest.raises(InputError, match="samples"):
        prepare(override_machine(machine, {"diagnosis": {"rows_min": 5000}}), log)


def test_a_machine_file_changes_what_matters(machine: Machine, log: Log) -> None:
    found = measures(signals_of_record(log, machine), machine)
    residual = 0.05 * np.random.default_rng(0).normal(size=len(prepare(machine, log).time))
    floor = noise_floor(prepare(machine, log), residual)
    usual = criteria_of(machine, floor, found, print).material
    assert usual == pytest.approx(max(0.004 * machine.friction.coulomb, 0.25 * floor))
    changed = override_machine(machine, {"diagnosis": {"material": 0.1}})
    assert criteria_of(changed, floor, found, print).material == pytest.approx(0.1 * machine.friction.coulomb)
