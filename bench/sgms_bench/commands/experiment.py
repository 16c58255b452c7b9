"""`sgms-mhe experiment`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from sgms_mhe.commands.common import check_output_folder, progress_bar, show
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option


@make_command("experiment etel_xy --out build/experiment")
def command(machine: str, *, out: Annotated[Path, Option("DIR")]) -> None:
    """Run the paper's experiment on MACHINE.

    Prints its table, writes figures and data.

    Args:
        out: folder of figures and data.
    """
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    check_output_folder(out)

    from sgms_bench.experiment.running import run_experiment

    with progress_bar(f"experiment {resolved.name}") as progress:
        table = run_experiment(resolved, out, progress)
    show(str(table))
