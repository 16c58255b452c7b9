"""`sgms-mhe inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sgms_mhe.commands.common import (
    example,
    json_option,
    json_text,
    log_argument,
    show,
    table_text,
)
from sgms_mhe.commands.log_options import load_for_log, log_options

SHOWN = 12
"""Names of columns that are not read, that the text repeats."""


@click.command(
    short_help="Show what is understood of LOG.",
    epilog=example("inspect axis.csv", "inspect DATA_EMPS.mat --machine emps"),
)
@log_argument
@log_options
@click.option("--machine", metavar="MACHINE", help="Machine file whose [log] and whose axis LOG is read for.")
@json_option
@click.pass_context
def command(ctx: click.Context, log: Path, table: dict[str, Any], machine: str | None, as_json: bool) -> None:
    """Show what is understood of LOG: dialect, columns, units, rate, jitter, missing samples, range.

    Exit code 1 where the commands that read logs would refuse this one; the reason is printed.
    """
    resolved = None if machine is None else load_for_log(machine, table)

    from sgms_mhe.logfiles.inspection import inspect_reading
    from sgms_mhe.logfiles.reading import understand
    from sgms_mhe.machine import log_mapping

    mapping = log_mapping(table, "[log]") if resolved is None and table else None
    found = inspect_reading(understand(log, resolved, mapping), resolved)
    content = found.as_dict()
    show(json_text(content) if as_json else _text(content))
    if found.problems:
        ctx.exit(1)


def _text(content: dict[str, Any]) -> str:
    time, grid = content["time"], content["resampled"]
    columns = [
        (c["name"], c["from"], c["unit"], c["because"], f"{c['min']:.6g}", f"{c['max']:.6g}", str(c["missing"]))
        for c in content["columns"]
    ]
    steps = f"{time['shortest_step_s']:.6g} to {time['longest_step_s']:.6g} s"
    jitter = f"jitter {100 * time['jitter']:.2g} % rms, steps {steps}"
    lines = [
        f"{content['file']}: {content['format']}, {content['kind']} axis",
        *(f"  {what:<14}{how}" for what, how in content["dialect"].items()),
        f"  {'time':<14}{time['samples']} samples, {time['duration_s']:.6g} s from {time['start_s']:.6g} s, "
        f"{time['rate_Hz']:.6g} Hz; {jitter}; gaps {time['gaps']}",
        "\n".join(f"    {line}" for line in table_text(_HEADER, columns).splitlines()),
    ]
    if grid is not None:
        lines.append(f"  {'grid':<14}{grid['rate_Hz']:.6g} Hz, {grid['missing']} samples missing")
    others = content["not_read"]
    if others:
        lines.append(f"  {'not read':<14}{', '.join(others[:SHOWN])}{', ...' if len(others) > SHOWN else ''}")
    lines += [f"  {'note':<14}{note}" for note in content["notes"]]
    lines += [f"  {'refused':<14}{problem}" for problem in content["problems"]]
    return "\n".join(lines)


_HEADER = ("column", "from", "unit", "by", "least", "most", "missing")
