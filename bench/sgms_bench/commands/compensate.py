"""`sgms-mhe compensate`."""

from __future__ import annotations

from pathlib import Path

import click

from sgms_mhe.commands.common import (
    NumberType,
    check_output_folder,
    example,
    json_option,
    json_text,
    machine_argument,
    note,
    out_option,
    progress_bar,
    show,
)


@click.command(
    short_help="Friction compensation in closed loop.",
    epilog=example(
        "compensate etel_xy_compensation --out build/compensation",
        "compensate etel_xy_compensation --trajectory circle --duration 5 --json",
    ),
)
@machine_argument
@out_option("Folder of figures and data.", metavar="DIR", required=False)
@click.option(
    "--trajectory",
    "names",
    type=click.Choice(["paper", "step_and_settle", "circle"]),
    multiple=True,
    help="What to run; may be repeated; default all.",
)
@click.option(
    "--duration",
    type=NumberType(1e-3, 3600.0),
    metavar="S",
    default=12.0,
    show_default=True,
    help="Least length of a run; whole periods.",
)
@click.option(
    "--window",
    type=NumberType(1e-3, 1e9),
    metavar="NM",
    default=50.0,
    show_default=True,
    help="Within which the axis counts as settled.",
)
@click.option("--seed", type=click.IntRange(0), metavar="N", default=0, show_default=True, help="Seed of the noise.")
@click.option("--no-set-point", is_flag=True, help="The drive does not tell the estimator where it is going.")
@json_option
def command(
    machine: str,
    out: Path | None,
    names: tuple[str, ...],
    duration: float,
    window: float,
    seed: int,
    no_set_point: bool,
    as_json: bool,
) -> None:
    """Follow trajectories with a simulated axis of MACHINE and the emitted C in its loop.

    The plant obeys the switching Maxwell-slip law; its parameters start 30 % off the machine file's and drift by 25 %.
    No compensation, static Coulomb and viscous feed-forward with nominal parameters, EKF and MHE are compared with the
    true friction fed forward: tracking error, peaks after reversals, settling.
    """
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    if out is not None:
        check_output_folder(out)

    from sgms_bench.compensation.running import SCENARIOS, compare_compensations

    with progress_bar(f"compensate {resolved.name}") as progress:
        comparison = compare_compensations(
            resolved,
            names or SCENARIOS,
            duration_s=duration,
            window_m=1e-9 * window,
            seed=seed,
            set_point=not no_set_point,
            out_dir=out,
            progress=progress,
        )
    show(json_text(comparison.table.as_dict()) if as_json else str(comparison.table))
    for path in comparison.figures:
        note(f"wrote {path}")
