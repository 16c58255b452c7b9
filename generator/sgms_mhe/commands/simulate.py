"""`sgms-mhe simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine
    from sgms_mhe.signals.logs import Log


@make_command(
    "simulate etel_xy --out axis.csv",
    "simulate etel_xy --out axis.npz --trajectory mixed --duration 60 --scale stiffness_1=1.2",
    "simulate etel_xy --out next.csv --trajectory plan.csv",
    of="simulation.simulate",
)
def command(machine: Machine, *, out: Path, **options: Any) -> None:
    """Log a simulated axis in closed loop.

    Args:
        out: the log to write: .csv or .npz.
    """
    common.check_output_file(out, (".csv", ".npz"))

    from sgms_mhe.api import simulation
    from sgms_mhe.signals.logs import write_log

    with common.progress_bar(f"simulate {machine.name}"):
        run = simulation.simulate(machine, **options)
    write_log(out, run.log)
    common.show(f"{out}: {describe(run.log)}", out)


def describe(log: Log) -> str:
    """One line about a log."""
    import numpy as np

    units = log.units
    position, force = log.position_m[np.isfinite(log.position_m)], log.force_N[np.isfinite(log.force_N)]
    return (
        f"{len(log)} samples at {log.rate:g} Hz ({len(log) / log.rate:g} s), "
        f"position {position.min():.6g} to {position.max():.6g} {units.position}, "
        f"{units.push} {force.min():.6g} to {force.max():.6g} {units.force}"
    )
