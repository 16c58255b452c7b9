"""`sgms-mhe identify`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.log_options import load_for_log, log_options
from sgms_mhe.support.decisions import trace_decisions

if TYPE_CHECKING:
    from sgms_mhe.diagnosis.record_residual import MachineResidual
    from sgms_mhe.identification import Identification

HEAVIEST: Final = 1e6
"""kg, as in a machine file."""


def _elements(ctx: click.Context, param: click.Parameter, text: str) -> int | None:
    """The option --elements: a number, or None for auto."""
    if text == "auto":
        return None
    if text.isdecimal() and 1 <= int(text) <= 10:
        return int(text)
    raise click.BadParameter(f"{text!r} is neither auto nor a number from 1 to 10.", ctx, param)


@click.command(
    short_help="A machine file from measurements alone.",
    epilog=common.example(
        "identify log.csv --out my_axis.toml --mass 20",
        "identify first.csv second.csv --out my_axis.toml --like etel_xy",
    ),
)
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@log_options
@common.out_option("The machine file to write; its stem is the machine's name.", metavar="MACHINE.toml")
@click.option(
    "--mass",
    type=common.NumberType(1e-9, HEAVIEST),
    metavar="KG",
    help="Moved mass; default: the one that the motion shows.",
)
@click.option(
    "--inertia",
    type=common.NumberType(1e-12, HEAVIEST),
    metavar="KG_M2",
    help="The same of an axis that turns; its logs say it does.",
)
@click.option(
    "--elements", callback=_elements, metavar="N|auto", default="auto", show_default=True, help="Friction elements."
)
@click.option("--like", metavar="MACHINE", help="Take sampling, estimator, code and [log] from this machine.")
@common.trace_option
@common.json_option
def command(
    logs: tuple[Path, ...],
    table: dict[str, Any],
    out: Path,
    mass: float | None,
    inertia: float | None,
    elements: int | None,
    like: str | None,
    trace: Path | None,
    as_json: bool,
) -> None:
    """Identify an axis from its logs alone and write its machine file.

    No starting values are asked for. Prints what the logs determine, with intervals of two standard deviations, and
    what they do not, with the move that would.
    """
    common.check_output_file(out, (".toml",))

    from sgms_mhe.api.identification import identify
    from sgms_mhe.api.inputs import read_log
    from sgms_mhe.diagnosis.record_residual import measure_residual
    from sgms_mhe.machine.writing import toml_log
    from sgms_mhe.support.files import write_text

    model = load_for_log(like, table) if like is not None else None
    read = [read_log(path, model, table=table, note=common.note) for path in logs]
    with trace_decisions(trace), common.step_notes() as progress:
        found = identify(
            read,
            out.stem,
            mass=mass,
            inertia=inertia,
            elements=elements,
            like=model,
            note=common.note,
            progress=progress,
        )
    write_text(out, found.toml if model is not None else found.toml + toml_log(table, read[0].kind))
    residuals = [measure_residual(found.machine, log) for log in read]
    if as_json:
        stated = found.machine.plant.units.keyed({"residual_of_file": [residual.to_json() for residual in residuals]})
        common.show(common.json_text(found.to_json() | stated | {"file": str(out)}), out)
    else:
        common.show(_text(found, residuals, [log.name for log in logs], out), out)


def _text(found: Identification, residuals: Sequence[MachineResidual], names: Sequence[str], out: Path) -> str:
    units = found.machine.plant.units
    rows = [
        [units.named(n.name), n.interval, n.note or ("" if n.determined else "not determined")] for n in found.numbers
    ]
    lines = [
        common.table_text(["number", "value +- 2 sigma", ""], rows),
        f"law: {found.law}{'' if found.law_decided else ' (default)'}",
        f"held-out residual: {found.held_out_rms_N:.3g} {units.force} of {found.friction_rms_N:.3g} {units.force} rms; "
        f"noise floor {found.noise_floor_N:.3g} {units.force}",
        f"without errors of timing: {found.stated_rms_N:.3g} {units.force}; least squares alone: "
        f"{found.plain_rms_N:.3g} {units.force}{', which is what is written' if found.is_plain else ''}",
    ]
    lines += [
        f"{residual.describe(units)}, of the file along {name}" for residual, name in zip(residuals, names, strict=True)
    ]
    lines += [f"open: {sentence}" for sentence in found.limits]
    lines += [f"note: {warning}" for warning in found.warnings]
    lines.append(f"machine file: {out}")
    return "\n".join(lines)
