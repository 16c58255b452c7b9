"""The benchmark of measured records, on a simulated record that stands for a measured one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sgms_bench.measured.table import read_table
from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import load_machine


def test_every_public_record_is_read_by_its_table(measured_data: Callable[[str], Path]) -> None:
    table = read_table(measured_data("emps").parent)
    assert table.absent == ()
    for record in table.records:
        machine = None if record.machine is None else load_machine(record.machine)
        log = read_log(table.locate(record.log), machine, table=record.table if machine is None else None)
        assert log.time_s[-1] - log.time_s[0] > 9.0
