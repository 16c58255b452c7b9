"""Causes of given size: every cause in every size on both laws, tables of what was found and of intervals."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from cli_cases import done, refused
from sgms_bench.diagnosis import small
from sgms_bench.diagnosis.draws import OFF_SIZE, VISIBLE, Draw, machine_of, sized_draw
from sgms_bench.diagnosis.running import kept_result, read_result
from sgms_bench.diagnosis.scoring import ScoredDiagnosis
from sgms_bench.diagnosis.small import LAWS, Cell, cells, covered_shares, run_small
from sgms_mhe.configuration import load_machine
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import CAUSE_NAMES

SIZES = (0.02, 0.05)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("etel_xy")


def test_every_cause_comes_in_every_size_on_both_laws_before_any_comes_again() -> None:
    turn = len(CAUSE_NAMES) * len(SIZES) * len(LAWS)
    first, again = cells(SIZES, turn), cells(SIZES, 2 * turn)[turn:]
    assert len({(c.name, c.size, c.obeys) for c in first}) == turn
    assert [(c.name, c.size, c.obeys) for c in again] == [(c.name, c.size, c.obeys) for c in first]
    assert not {c.index for c in first} & {c.index for c in again}


@pytest.mark.parametrize(("name", "obeys"), [("force_ripple", "maxwell_slip"), ("coulomb", "sgms")])
def test_a_draw_has_the_cause_size_and_law_that_were_asked_for(machine: Machine, name: str, obeys: str) -> None:
    draw = sized_draw(machine, 3, 7, name, 0.03, obeys)  # type: ignore[arg-type]
    assert draw is not None
    assert draw.truth == (name,) and draw.axis.obeys == obeys
    assert draw.size == pytest.approx(0.03, rel=OFF_SIZE)
    assert name == "coulomb" or draw.hidden[0].visible >= VISIBLE
    assert sized_draw(machine, 3, 7, name, 0.03, obeys) == draw  # type: ignore[arg-type]


def test_what_an_axis_cannot_show_has_no_draw(machine: Machine) -> None:
    """A gap stands on smooth elements alone: a file that switches has none to give."""
    draw = sized_draw(machine, 3, 7, "backlash", 0.05, "maxwell_slip")
    assert draw is None or not machine_of(machine, draw).friction.switches


def test_results_are_kept_and_said(machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = [
        Cell(0, "constant_offset", 0.02, "sgms"),
        Cell(1, "viscous", 0.02, "sgms"),
        Cell(2, "viscous", 0.02, "sgms"),
    ]
    asked: list[int] = []

    def run_cell(_: Machine, seed: int, cell: Cell) -> tuple[Draw, ScoredDiagnosis] | None:
        asked.append(cell.index)
        if cell.index == 2:
            return None
        draw = sized_draw(machine, seed, 0, "constant_offset", 0.02, "sgms")
        assert draw is not None
        force = draw.hidden[0].parameters["force_N"]
        said = (("constant_offset", {"force_N": 1.02 * force}, {"force_N": 0.005 * abs(force)}),)
        return draw, ScoredDiagnosis("explained", said if cell.index == 0 else (("viscous", {}, {}),))

    monkeypatch.setattr(small, "cells", lambda *_: chosen)
    monkeypatch.setattr(small, "run_cell", run_cell)
    found, intervals = run_small(machine, tmp_path, (0.02,), draws=3, jobs=1)
    assert asked == [0, 1, 2]
    rows = {row["cause"]: row for row in found.rows}
    assert rows["constant_offset"]["0.02 sgms"] == "1/1"
    assert rows["viscous"]["0.02 sgms"] == "0/1 !1" and rows["viscous"]["0.02 maxwell_slip"] == "-"
    assert rows["all"]["0.02 sgms"] == "1/2 !1"
    (row,) = intervals.rows
    assert (row["number"], row["inside"], row["of"]) == ("constant_offset.force_N", 0, 1)
    assert row["largest"] == pytest.approx(4.0)
    text = done("bench-diagnosis", "etel_xy", "--sizes", "0.02", "--draws", "3", "--jobs", "1", "--out", tmp_path)
    assert asked == [0, 1, 2] and text.stdout.strip() == (tmp_path / "small.txt").read_text().strip()


@pytest.mark.parametrize("sizes", ["0", "0.9", "a", ""])
def test_sizes_that_are_none_are_refused(sizes: str, tmp_path: Path) -> None:
    said = refused("bench-diagnosis", "etel_xy", "--sizes", sizes, "--out", tmp_path)
    assert "numbers above 0 and up to 0.8" in said


def test_a_result_is_read_as_it_was_kept(machine: Machine, tmp_path: Path) -> None:
    draw = sized_draw(machine, 3, 7, "constant_offset", 0.03, "sgms")
    assert draw is not None
    force = draw.hidden[0].parameters["force_N"]
    said = ScoredDiagnosis("explained", (("constant_offset", {"force_N": force}, {"force_N": math.nan}),))
    for name, content in kept_result(draw, said).items():
        (tmp_path / name).write_bytes(content)
        json.loads(content)
    assert read_result(tmp_path)[0] == draw
    assert covered_shares(machine, [read_result(tmp_path)]) == []  # no interval is stated
