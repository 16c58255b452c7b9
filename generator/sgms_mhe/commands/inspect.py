"""`sgms-mhe inspect`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine

SHOWN = 12
"""Names of columns that are not read, that the text repeats."""


@make_command("inspect axis.csv", "inspect DATA_EMPS.mat --machine emps")
def command(
    log: Path,
    *,
    log_table: Mapping[str, Any],
    machine: Annotated[Machine | None, Option("MACHINE")] = None,
    json: bool = False,
) -> bool:
    """Show how LOG is read.

    Shown are dialect, columns, units, rate, jitter, missing samples, range.

    Exit code 1 where the commands that read logs would refuse this one; the reason is printed.

    Args:
        machine: machine file whose [log] and whose axis LOG is read for.
    """
    from sgms_mhe.logfiles.inspection import inspect_log
    from sgms_mhe.machine import log_mapping

    mapping = log_mapping(log_table, "[log]") if machine is None and log_table else None
    found = inspect_log(log, machine, mapping)
    content = found.as_dict()
    common.show(common.json_text(content) if json else _text(content))
    return bool(found.problems)


def _text(content: dict[str, Any]) -> str:
    kind = "" if content["kind"] is None else f", {content['kind']} axis"
    lines = [f"{content['file']}: {content['format']}{kind}"]
    lines += [f"  {what:<14}{how}" for what, how in content["dialect"].items()]
    lines += _reading_lines(content) if content["time"] is not None else _column_lines(content)
    lines += [f"  {'note':<14}{note}" for note in content["notes"]]
    lines += [f"  {'refused':<14}{problem}" for problem in content["problems"]]
    return "\n".join(lines)


def _reading_lines(content: dict[str, Any]) -> list[str]:
    time, grid = content["time"], content["resampled"]
    columns = [(c["name"], c["from"], c["unit"], c["because"], *_range_cells(c)) for c in content["columns"]]
    steps = f"{time['shortest_step_s']:.6g} to {time['longest_step_s']:.6g} s"
    jitter = f"jitter {100 * time['jitter']:.2g} % rms, steps {steps}"
    lines = [
        f"  {'time':<14}{time['samples']} samples, {time['duration_s']:.6g} s from {time['start_s']:.6g} s, "
        f"{time['rate_Hz']:.6g} Hz; {jitter}; gaps {time['gaps']}",
        *_indent(("column", "from", "unit", "by", *_RANGE), columns),
    ]
    if grid is not None:
        lines.append(f"  {'grid':<14}{grid['rate_Hz']:.6g} Hz, {grid['missing']} samples missing")
    others = content["not_read"]
    if others:
        lines.append(f"  {'not read':<14}{', '.join(others[:SHOWN])}{', ...' if len(others) > SHOWN else ''}")
    return lines


def _column_lines(content: dict[str, Any]) -> list[str]:
    """Every column of a file in which not all quantities were found."""
    columns = [(c["from"], c["unit"] or "", *_range_cells(c)) for c in content["columns"]]
    missing = [f"  {'missing':<14}{', '.join(content['missing'])}"] if content["missing"] else []
    return [*_indent(("in the file", "unit", *_RANGE), columns), *missing]


def _range_cells(column: dict[str, Any]) -> tuple[str, str, str]:
    least, most = ("" if column[key] is None else f"{column[key]:.6g}" for key in ("min", "max"))
    return least, most, str(column["missing"])


def _indent(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"    {line}" for line in common.table_text(header, rows).splitlines()]


_RANGE = ("least", "most", "missing")
