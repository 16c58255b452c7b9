"""`sgms-mhe identify`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.log_options import load_for_log
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.decisions import trace_decisions
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.diagnosis.record_residual import MachineResidual
    from sgms_mhe.identification import Identification
    from sgms_mhe.machine import Machine
    from sgms_mhe.recordings.free_run import FreeRun
    from sgms_mhe.signals.logs import Log


@make_command(
    "identify log.csv --out my_axis.toml --mass 20",
    "identify first.csv second.csv --out my_axis.toml --like etel_xy",
    of="identification.identify",
)
def command(
    log: tuple[Path, ...],
    *,
    log_table: Mapping[str, Any],
    out: Annotated[Path, Option("MACHINE.toml")],
    elements: Annotated[str, Option("N|auto")] = "auto",
    like: str | None = None,
    trace: Annotated[Path | None, Option("DIR")] = None,
    json: bool = False,
    **options: Any,
) -> None:
    """Write a machine file from measurements alone.

    No starting values are asked for. Prints the numbers determined by the logs, with intervals of two standard
    deviations, and the others, with the move needed for each. Logs without a force, but with a command, show the
    effect of the command: runs of servos that state load, gain and supply alone, others with the [drive] of --like.

    Args:
        out: the machine file to write; its stem is the machine's name.
        elements: number of friction elements; auto: as many as held-out data gain by.
    """
    if elements != "auto" and not (elements.isdecimal() and 1 <= int(elements) <= 10):
        allowed = f"{elements!r} is neither auto nor a number from 1 to 10."
        raise click.BadParameter(allowed, param_hint="'--elements'")
    common.check_output_file(out, (".toml",))

    from sgms_mhe.api.identification import identify
    from sgms_mhe.api.inputs import read_logs
    from sgms_mhe.diagnosis.record_residual import measure_residual
    from sgms_mhe.support.files import write_text
    from sgms_mhe.support.parallel import run_parallel

    model = load_for_log(like, log_table) if like is not None else None
    read = read_logs(log, model, table=log_table, note=common.note)
    with trace_decisions(trace), common.step_notes() as progress:
        found = identify(
            read,
            out.stem,
            elements=None if elements == "auto" else int(elements),
            like=model,
            table=log_table,
            note=common.note,
            progress=progress,
            **options,
        )
    write_text(out, found.toml)
    residuals = [measure_residual(found.machine, record) for record in read if not record.is_commanded]
    motions = run_parallel([partial(_run_freely, found.machine, record) for record in read])
    if json:
        stated = found.machine.plant.units.keyed({"residual_of_file": [residual.to_json() for residual in residuals]})
        stated |= {"free_run": [None if motion is None else motion.to_json() for motion in motions], "file": str(out)}
        common.show(common.json_text(found.to_json() | stated), out)
    else:
        common.show(_text(found, residuals, motions, [path.name for path in log], out), out)


def _run_freely(machine: Machine, log: Log) -> FreeRun | None:
    """Return the free run along a log; None where it allows none."""
    from sgms_mhe.configuration import carry_load
    from sgms_mhe.recordings.free_run import run_freely

    try:
        return run_freely(carry_load(machine, log.run), log)
    except InputError:
        return None


def _text(
    found: Identification,
    residuals: Sequence[MachineResidual],
    motions: Sequence[FreeRun | None],
    names: Sequence[str],
    out: Path,
) -> str:
    units = found.machine.plant.units
    rows = [[units.named(n.name), n.interval, n.note] for n in found.numbers]
    lines = [
        common.table_text(["number", "value +- 2 sigma", ""], rows),
        *(s.sentence for s in found.others if s.sure == "yes" and s.kind != "file"),
    ]
    if residuals:
        lines.append(
            f"without errors of timing: {found.stated_rms_N:.3g} {units.force}; least squares alone: "
            f"{found.plain_rms_N:.3g} {units.force}{', which is what is written' if found.is_plain else ''}"
        )
        lines += [f"{r.describe(units)}, of the file along {name}" for r, name in zip(residuals, names, strict=True)]
    lines += [f"{motion.describe()}, along {name}" for motion, name in zip(motions, names, strict=True) if motion]
    lines += [f"open: {sentence}" for sentence in found.limits]
    lines += [f"note: {warning}" for warning in found.warnings]
    lines.append(f"machine file: {out}")
    return "\n".join(lines)
