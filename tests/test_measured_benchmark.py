"""The benchmark of measured records, on a simulated record that stands for a measured one."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cli_cases import SMALL
from sgms_bench.measured.running import MeasuredTally, run_table
from sgms_bench.measured.table import read_table
from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import load_machine
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


def test_every_public_record_is_read_by_its_table(measured_data: Callable[[str], Path]) -> None:
    table = read_table(measured_data("emps").parent)
    assert table.absent == ()
    for record in table.records:
        machine = None if record.machine is None else load_machine(record.machine)
        log = read_log(table.locate(record.log), machine, table=record.table if machine is None else None)
        assert log.time_s[-1] - log.time_s[0] > 9.0
