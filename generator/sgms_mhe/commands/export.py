"""`sgms-mhe export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine


@make_command(
    "export etel_xy --to mujoco --out axis.xml --log measured.csv",
    "export etel_xy --to sinamics-table --range 0.0005 0.2 --out friction.txt",
    "export etel_xy --log measured.csv",
    of="exporting.export",
)
def command(
    machine: Machine,
    *,
    to: Annotated[str, Option("FORM")] = "all",
    out: Path | None = None,
    log: Annotated[Path | None, Option("LOG")] = None,
    json: bool = False,
    **options: Any,
) -> None:
    """Write MACHINE's axis for another simulator, or its friction for a drive.

    Lists the parts of the axis in the form, and the lost ones. With --log also the error a simpler form makes:
    its friction minus that of MACHINE's own model along the motion in LOG, and the part of it that each lost force
    has. Without --to that error of every form.

    Args:
        log: log along which the error of a simpler form, and each force it loses, is measured.
    """
    from sgms_mhe.api import exporting

    if to == "all":
        if out is not None or log is None:
            raise InputError("export", "--to", None, "a form and --out, or --log alone for the error of each")
        common.show(_compare_forms(machine, log, json=json))
        return
    if out is None:
        raise click.UsageError("Missing option '--out'.")
    common.check_output_file(out, exporting.find_form(to).suffixes)
    with common.progress_bar(f"export {machine.name}"):
        exported = exporting.export(machine, to, out, log=log, note=common.note, **options)
    if exported.missing is not None:
        common.note(f"{out}: sources without a binary: {exported.missing}")
    units, error = machine.plant.units, exported.error
    if json:
        measured = None if error is None else error.content
        sentences = {"holds": exported.holds, "lost": exported.lost}
        result = {"machine": machine.name, "form": to, "file": str(out), **sentences, "error": measured}
        common.show(common.json_text(units.keyed(result)), out)
        return
    lines = [f"{out}: {to} of {machine.name}", *(f"holds: {sentence}" for sentence in exported.holds)]
    lines += [f"lost: {sentence}" for sentence in exported.lost]
    if error is not None:
        lines.append(
            f"error: {error.rms:.6g} {units.force} rms, {100.0 * error.relative:.3g} % of the model's friction of "
            f"{error.model_rms:.6g} {units.force} rms, over {error.rows} samples"
        )
        for force in error.forces:
            lines.append(f"lost along {log}: {force.name}, {force.lost:.4g} {units.force} rms")
            if force.relative is not None:
                lines[-1] += f", {100.0 * force.relative:.3g} % of it"
            if error.model_rms > 0.0:
                lines[-1] += f", {100.0 * force.lost / error.model_rms:.3g} % of the friction"
    elif log is not None:
        lines.append("error: none, no force of the axis is left out")
    common.show("\n".join(lines), out)


def _compare_forms(machine: Machine, log: Path, *, json: bool) -> str:
    """Return the error of each form along a log: one a line, or as JSON."""
    from sgms_mhe.api import exporting
    from sgms_mhe.api.inputs import recorded_log
    from sgms_mhe.emission.friction_table import USUAL

    source, units = recorded_log(log, machine, note=common.note), machine.plant.units
    content: dict[str, Any] = {}
    lines = []
    for form in exporting.FORMS:
        try:
            error = exporting.export(machine, form, log=source, points=USUAL if form == "csv" else None).error
        except InputError as refusal:
            content[form] = text = f"refused, {refusal.allowed}"
        else:
            content[form] = error and error.content
            text = (
                f"{error.rms:.3g} {units.force} rms, {100.0 * error.relative:.3g} % of the friction"
                if error
                else "none"
            )
        lines.append(f"{form}: {text}")
    return common.json_text(units.keyed(content)) if json else "\n".join(lines)
