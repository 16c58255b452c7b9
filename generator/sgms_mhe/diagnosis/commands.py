"""Commands `diagnose` and `plan`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from sgms_mhe.diagnosis.plan import make_plan, write_plan
from sgms_mhe.diagnosis.result import Diagnosis, write_diagnosis
from sgms_mhe.diagnosis.verdict import diagnose
from sgms_mhe.logs import read_log
from sgms_mhe.machine import load_machine


@click.command("diagnose", epilog="Example: sgms-mhe diagnose etel_xy log.csv --out diagnosis/")
@click.argument("machine")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), default=None, help="Folder; default: <machine>_diagnosis.")
@click.option("--json", "as_json", is_flag=True, help="Print diagnosis.json instead of a summary.")
@click.option(
    "--held-out",
    "held_out",
    type=(float, float),
    multiple=True,
    metavar="FROM TO",
    help="Seconds since the log's start that no fit may see; default: a third of the record.",
)
@click.pass_context
def diagnose_command(
    context: click.Context,
    machine: str,
    log: Path,
    out: Path | None,
    as_json: bool,
    held_out: tuple[tuple[float, float], ...],
) -> None:
    """Say what the simulation of MACHINE gets wrong along LOG, and why.

    Writes diagnosis.json and, where a cause is named, the extended machine file. Exit code 1: structure is left that
    no known effect accounts for.
    """
    loaded = load_machine(machine)
    diagnosis = diagnose(
        loaded,
        read_log(log, loaded),
        progress=lambda text: click.echo(text, err=True),
        held_out_s=held_out or None,
    )
    folder = write_diagnosis(diagnosis, out or Path(f"{loaded.name}_diagnosis"))
    click.echo(json.dumps(diagnosis.to_json(), indent=2) if as_json else summary(diagnosis, folder))
    context.exit(1 if diagnosis.verdict == "unexplained" else 0)


@click.command("plan", epilog="Example: sgms-mhe plan etel_xy --separate constant_offset asymmetric_coulomb")
@click.argument("machine")
@click.option("--separate", type=(str, str), default=None, metavar="A B", help="Two causes to tell apart.")
@click.option("--out", type=click.Path(path_type=Path), default=None, help="CSV; default: <machine>_plan.csv.")
def plan_command(machine: str, separate: tuple[str, str] | None, out: Path | None) -> None:
    """Write a trajectory (time_s, position_m) that excites every effect, or separates two causes."""
    loaded = load_machine(machine)
    plan = make_plan(loaded, separate)
    path = out or Path(f"{loaded.name}_plan.csv")
    write_plan(path, plan)
    click.echo(f"{path}: {plan.trajectory.duration_s:.1f} s; {plan.reason}")


def summary(diagnosis: Diagnosis, folder: Path) -> str:
    """What a terminal shows of a diagnosis."""
    lines = [f"{diagnosis.verdict}: {diagnosis.summary}"]
    for cause in diagnosis.causes:
        values = ", ".join(
            f"{name} = {value:.4g} +- {2.0 * cause.std.get(name, float('nan')):.1g}"
            for name, value in cause.parameters.items()
        )
        lines.append(f"  {cause.name}: {values}; explains {cause.gain_N:.3g} N RMS on held-out data")
    lines += [f"  {a.name}: {a.why_not}" for a in diagnosis.alternatives if a.rival]
    if diagnosis.separating_experiment:
        lines.append(f"next: {diagnosis.separating_experiment}")
    lines += [f"note: {warning}" for warning in diagnosis.warnings]
    if diagnosis.extended_name:
        lines.append(f"extended machine: {folder / diagnosis.extended_name}")
    return "\n".join(lines)
