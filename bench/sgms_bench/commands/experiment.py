"""`sgms-mhe experiment`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sgms_mhe.commands.common import check_output_folder, progress_bar, show
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine


@make_command("experiment etel_xy --out build/experiment")
def command(machine: Machine, *, out: Annotated[Path, Option("DIR")]) -> None:
    """Run the paper's experiment on MACHINE.

    Prints its table, writes figures and data.

    Args:
        out: folder of figures and data.
    """
    check_output_folder(out)

    from sgms_bench.experiment.running import run_experiment

    with progress_bar(f"experiment {machine.name}") as progress:
        table = run_experiment(machine, out, progress)
    show(str(table))
