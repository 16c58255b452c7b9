"""The benchmark of measured records, on a simulated record that stands for a measured one."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from sgms_bench.measured import __main__ as benchmark
from sgms_bench.measured.motions import MotionOutcome
from sgms_bench.measured.table import MeasuredMotion, MeasuredTable, read_table
from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import load_machine


def test_every_public_record_is_read_by_its_table(measured_data: Callable[[str], Path]) -> None:
    table = read_table(measured_data("emps").parent)
    assert table.absent == ()
    for record in table.records:
        machine = None if record.machine is None else load_machine(record.machine)
        log = read_log(table.locate(record.log), machine, table=record.table if machine is None else None)
        assert log.time_s[-1] - log.time_s[0] > 9.0


def test_runs_of_a_commanded_axis_have_a_table_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("servo_1.json", "servo_2.json"):
        (tmp_path / name).write_text(json.dumps({}))
    content = 'name = "servo"\nlogs = "servo_1*"\nother = "servo_2*"\npublished = { others = 0.03, better = 0.02 }\n'
    (tmp_path / "measured.toml").write_text(f"[[motions]]\n{content}")

    def run(table: MeasuredTable, motion: MeasuredMotion) -> MotionOutcome:
        return MotionOutcome(motion.name, 1, motion.published, 0.0128, 0.0098, "rad", 1.0)

    monkeypatch.setattr(benchmark, "run_motion", run)
    assert benchmark.main([str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "0.0128" in shown and "0.0098" in shown and "0.02 better" in shown and "yes" in shown
    (tmp_path / "servo_2.json").unlink()
    assert benchmark.main([str(tmp_path)]) == 2
