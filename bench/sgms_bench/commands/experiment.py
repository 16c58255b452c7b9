"""`sgms-mhe experiment`."""

from __future__ import annotations

from pathlib import Path

import click

from sgms_mhe.commands.common import check_output_folder, example, machine_argument, out_option, progress_bar, show


@click.command(
    short_help="The paper's experiment: table and figures.", epilog=example("experiment etel_xy --out build/experiment")
)
@machine_argument
@out_option("Folder of figures and data.", metavar="DIR")
def command(machine: str, out: Path) -> None:
    """Run the paper's experiment on MACHINE: print its table, write figures and data."""
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    check_output_folder(out)

    from sgms_bench.experiment.running import run_experiment

    with progress_bar(f"experiment {resolved.name}") as progress:
        table = run_experiment(resolved, out, progress)
    show(str(table))
