"""`sgms-mhe plan`."""

from __future__ import annotations

from pathlib import Path

import click

from sgms_mhe.commands import common


@click.command(
    short_help="Find the trajectory that distinguishes two causes.",
    epilog=common.example("plan etel_xy --out plan.csv", "plan etel_xy --separate constant_offset asymmetric_coulomb"),
)
@common.machine_argument
@click.option(
    "--separate",
    type=(str, str),
    metavar="A B",
    shell_complete=common.causes_begun,
    help="Two causes; default: a motion that excites them all.",
)
@common.out_option("Columns time_s and position_m; default: MACHINE's name and _plan.csv.", required=False)
def command(machine: str, separate: tuple[str, str] | None, out: Path | None) -> None:
    """Write the reference trajectory that separates two causes on MACHINE, or that excites every effect."""
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    common.note_broken_effects()
    path = out or Path(f"{resolved.name}_plan.csv")
    common.check_output_file(path, (".csv",))

    from sgms_mhe.diagnosis.plan import make_plan, write_plan

    plan = make_plan(resolved, separate)
    write_plan(path, plan, resolved.plant.units)
    common.show(f"{path}: {plan.trajectory.duration_s:.1f} s; {plan.reason}", path)
