"""The benchmark of measured records, on a simulated record that stands for a measured one."""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli_cases import SMALL
from diagnosis_cases import explained
from sgms_bench.measured.__main__ import main
from sgms_bench.measured.running import MeasuredOutcome, MeasuredTally, pair_numbers, run_table
from sgms_bench.measured.table import read_table
from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis import Diagnosis
from sgms_mhe.evaluation.prediction import ForceError
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory

SECONDS = 7.0
AMPLITUDE = 1.2
RIPPLE = ("force_ripple", {"amplitude_N": AMPLITUDE, "pitch_m": 0.0171, "phase_rad": 0.4})
TABLE = """
[[records]]
name = "simulated"
log = "record.csv.gz"
machine = "small.toml"
table = { time_s = "t", position_m = { variable = "x", unit = "mm" }, force_N = "u" }
other = "other.csv.gz"
lowpass = 60.0
decimate = 5
published = { "their model" = 0.9, "worse" = 1.5 }
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("measured")
    (folder / "small.toml").write_text(SMALL)
    (folder / "measured.toml").write_text(TABLE)
    machine = load_machine(folder / "small.toml")
    trajectory = make_trajectory("mixed", machine.sampling.rate, duration_s=SECONDS)
    for seed, name in ((3, "record"), (4, "other")):
        log = simulate_axis(machine, trajectory, AxisConfig(seed=seed), hidden_effects=[RIPPLE], truth=False).log
        rows = np.column_stack((log.time_s, 1e3 * log.position_m, log.force_N))
        with gzip.open(folder / f"{name}.csv.gz", "wt") as stream:
            np.savetxt(stream, rows, delimiter=",", header="t,x,u", comments="", fmt="%.17g")
    return folder


@pytest.mark.slow
def test_ours_stand_beside_the_published_numbers(data: Path) -> None:
    tally = MeasuredTally()
    said: list[str] = []
    for outcome in run_table(read_table(data), halves=True):
        tally.add(outcome, said.append)
    (found,) = tally.outcomes
    assert found.ours is not None
    # The ripple was learnt on one record and holds on the other, where plain friction leaves it.
    assert found.verdict == "explained: force_ripple"
    assert found.ours.rows == pytest.approx(7000 / 5, abs=10)  # filters settle
    assert found.plain.residual_rms_N**2 - found.ours.residual_rms_N**2 > 0.9 * AMPLITUDE**2 / 2.0
    # Two intervals of 95 % that are right miss each other rarely.
    assert found.numbers >= 8
    assert len(found.apart) <= 0.2 * found.numbers
    assert len(said) == 1


def outcome(published: dict[str, float], published_in: str, ours: ForceError | None) -> MeasuredOutcome:
    return MeasuredOutcome("axis", "file", published, published_in, "N", ours, ForceError(9, 0.5, 2.0, 10.0), "said")


def test_the_table_says_who_is_ahead() -> None:
    ours = ForceError(9, 0.3, 2.0, 10.0)  # 3 % of the force
    tally = MeasuredTally()
    for published, unit, error in (
        ({"a": 0.4, "b": 0.31}, "rms", ours),
        ({"a": 0.4, "b": 0.29}, "rms", ours),
        ({"a": 2.9}, "percent", ours),
        ({"a": 3.1}, "percent", replace(ours, residual_rms_N=0.305)),
        ({"a": 3.1}, "percent", None),
        ({}, "rms", replace(ours, residual_rms_N=0.6)),
    ):
        tally.add(outcome(published, unit, error), lambda _: None)
    (table,) = tally.tables()
    assert [row["ahead"] for row in table.rows] == ["yes", "no", "no", "yes", "no", ""]
    assert table.notes == ("ahead of the best published number: 2 of 5; of plain friction: 4 of 6",)
    # The machine that has what was learned is the one that is compared, for better or worse.
    for published, learned in ((0.29, 0.28), (0.4, 0.41)):
        taught = replace(outcome({"a": published}, "rms", ours), learned=replace(ours, residual_rms_N=learned))
        tally.add(taught, lambda _: None)
    rows = tally.tables()[0].rows[6:]
    assert [(row["ours"], row["learned"], row["ahead"]) for row in rows] == [(0.3, 0.28, "yes"), (0.3, 0.41, "no")]
    number = "base.viscous 203 +- 2 and 190 +- 3"
    tally.add(replace(outcome({}, "rms", ours), numbers=20, apart=(number,)), lambda _: None)
    notes = tally.tables()[0].notes
    assert "19 of 20 numbers, 95 %" in notes[1]
    assert notes[2] == f"  axis from file: {number}"


def test_numbers_of_halves_are_those_that_both_determine() -> None:
    one = explained(load_machine("etel_xy"))
    (ripple,) = one.causes
    other = replace(
        one,
        causes=(replace(ripple, parameters={**ripple.parameters, "pitch_m": 0.04}, vague=("phase_rad",)),),
        base=tuple(replace(number, std=math.nan) for number in one.base),
    )
    pairs = pair_numbers(one, other)
    # A vague phase, and numbers of the base that have no deviation, are known to one half alone.
    assert {name: pair[::2] for name, pair in pairs.items()} == {
        "force_ripple.amplitude_N": (0.797, 0.797),
        "force_ripple.pitch_m": (0.032003, 0.04),
    }
    assert pair_numbers(one, replace(one, causes=(), base=())) == {}


def test_a_number_that_a_half_leaves_open_does_not_count_as_one_that_agrees() -> None:
    one = replace(explained(load_machine("etel_xy")), causes=())
    wide = tuple(replace(number, std=0.6 * number.refitted) for number in one.base)
    assert len(pair_numbers(one, one)) > 0
    assert pair_numbers(one, replace(one, base=wide)) == {}


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('log = "record.csv.gz"', 'log = "absent.csv"', "absent.csv"),
        ("decimate = 5", "decimate = 0", "decimate"),
        ("lowpass = 60.0", "lowpas = 60.0", "lowpas"),
        ('machine = "small.toml"', 'begin = ["file"]', "there is no machine"),
        ("[[records]]", "[[record", "TOML"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(
    before: str, after: str, said: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "table.toml"
    table.write_text(TABLE.replace(before, after))
    assert main([str(data), "--table", str(table)]) == 2
    error = capsys.readouterr().err
    assert str(table) in error
    assert said in error


def test_a_folder_without_a_table_or_a_public_record_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "measured.toml" in error
    assert "emps/DATA_EMPS.mat" in error


def test_a_folder_without_a_table_has_the_public_records_that_it_holds(tmp_path: Path) -> None:
    (tmp_path / "joints").mkdir()
    (tmp_path / "joints" / "franka_case4_slow.csv.gz").touch()
    table = read_table(tmp_path)
    assert [record.name for record in table.records] == ["franka_case4_slow"]
    assert "EMPS, first half" in table.absent and "fairino_line_slow" in table.absent


def test_every_public_record_is_read_by_its_table(measured_data: Callable[[str], Path]) -> None:
    table = read_table(measured_data("emps").parent)
    assert table.absent == ()
    for record in table.records:
        machine = None if record.machine is None else load_machine(record.machine)
        log = read_log(table.locate(record.log), machine, table=record.table if machine is None else None)
        assert log.time_s[-1] - log.time_s[0] > 9.0


def test_harmonics_of_halves_are_compared_by_their_order() -> None:
    one = explained(load_machine("etel_xy"))
    (ripple,) = one.causes

    def with_map(orders: Mapping[int, float]) -> Diagnosis:
        values = {f"order_{k}": float(order) for k, order in enumerate(orders, start=1)}
        values |= {f"sine_{k}_N": size for k, size in enumerate(orders.values(), start=1)}
        std = {name: math.nan if name.startswith("order") else 0.01 for name in values}
        cause = replace(ripple, name="position_map", label="position_map", parameters=values, std=std)
        return replace(one, causes=(cause,), base=())

    pairs = pair_numbers(with_map({1: 0.3, 7: 0.5}), with_map({7: 0.49, 12: 0.1}))
    assert [pair[::2] for pair in pairs.values()] == [(0.5, 0.49)]
