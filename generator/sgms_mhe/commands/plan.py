"""`sgms-mhe plan`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine


@make_command(
    "plan etel_xy --out plan.csv",
    "plan etel_xy --separate constant_offset asymmetric_coulomb",
    "plan my_axis.toml --open my_axis_start.json",
    of="experiments.plan",
)
def command(machine: Machine, *, out: Path | None = None, **options: Any) -> None:
    """Find the motion that distinguishes two causes on MACHINE, or answers the questions left open by a result.

    Writes it as a reference trajectory, which `simulate --trajectory` takes.

    Args:
        out: columns time_s and position_m; None: MACHINE's name and _plan.csv.
    """
    common.note_broken_effects()
    path = out or Path(f"{machine.name}_plan.csv")
    common.check_output_file(path, (".csv",))

    from sgms_mhe.api import experiments
    from sgms_mhe.diagnosis.plan import write_plan

    plan = experiments.plan(machine, **options)
    write_plan(path, plan, machine.plant.units)
    common.show(f"{path}: {plan.trajectory.duration_s:.1f} s; {plan.reason}", path)
