"""`sgms-mhe export`."""

from __future__ import annotations

from pathlib import Path

import click

from sgms_mhe.commands import common


@click.command(
    short_help="Write MACHINE's axis for another simulator.",
    epilog=common.example(
        "export etel_xy --to mujoco --out axis.xml --log measured.csv", "export etel_xy --to fmu3 --out axis.fmu"
    ),
)
@common.machine_argument
@click.option(
    "--to",
    "form",
    required=True,
    metavar="FORM",
    help="One of mujoco, urdf, modelica, simscape, csv, matlab, fmu2, fmu3.",
)
@common.out_option("The file; its name without suffix is that of the model in it.")
@click.option(
    "--log",
    type=click.Path(path_type=Path),
    metavar="LOG",
    help="Log along which the error of a simpler form, and each force that it loses, is measured.",
)
@common.json_option
def command(machine: str, form: str, out: Path, log: Path | None, as_json: bool) -> None:
    """Write MACHINE's axis, the plant that moves, for another simulator.

    Says what the form holds and what is lost. With --log also the error that a simpler form makes: its friction minus
    that of MACHINE's own model along the motion in LOG, and the part of it that each lost force has.
    """
    from sgms_mhe.api import exporting
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    common.check_output_file(out, exporting.find_form(form).suffixes)
    with common.progress_bar(f"export {resolved.name}"):
        exported = exporting.export(resolved, form, out, log=log, note=common.note)
    if exported.missing is not None:
        common.note(f"{out}: sources without a binary: {exported.missing}")
    units, error = resolved.plant.units, exported.error
    if as_json:
        measured = None if error is None else error.content
        sentences = {"holds": exported.holds, "lost": exported.lost}
        result = {"machine": resolved.name, "form": form, "file": str(out), **sentences, "error": measured}
        common.show(common.json_text(units.keyed(result)), out)
        return
    lines = [f"{out}: {form} of {resolved.name}", *(f"holds: {sentence}" for sentence in exported.holds)]
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
