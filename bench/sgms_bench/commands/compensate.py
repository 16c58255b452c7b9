"""`sgms-mhe compensate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from sgms_mhe.commands.common import check_output_folder, json_text, note, progress_bar, show
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine


@make_command(
    "compensate etel_xy_compensation --out build/compensation",
    "compensate etel_xy_compensation --trajectory circle --duration 5 --json",
)
def command(
    machine: Machine,
    *,
    out: Annotated[Path | None, Option("DIR")] = None,
    trajectory: tuple[Literal["paper", "step_and_settle", "circle"], ...] = (),
    duration_s: Annotated[float, Option(least=1e-3, most=3600.0)] = 12.0,
    window: Annotated[float, Option("NM", 1e-3, 1e9)] = 50.0,
    seed: Annotated[int, Option("N", 0)] = 0,
    no_set_point: bool = False,
    json: bool = False,
) -> None:
    """Show friction compensation in closed loop.

    A simulated axis of MACHINE follows trajectories with the emitted C in its loop.

    The plant obeys the switching Maxwell-slip law; its parameters start 30 % off the machine file's and drift by 25 %.
    No compensation, static Coulomb and viscous feed-forward with nominal parameters, EKF and MHE are compared with the
    true friction fed forward: tracking error, peaks after reversals, settling.

    Args:
        out: folder of figures and data.
        trajectory: motion to run; may be repeated; None: all.
        duration_s: least length of a run; whole periods.
        window: within which the axis counts as settled.
        seed: seed of the noise.
        no_set_point: the drive does not tell the estimator where it is going.
    """
    if out is not None:
        check_output_folder(out)

    from sgms_bench.compensation.running import SCENARIOS, compare_compensations

    with progress_bar(f"compensate {machine.name}") as progress:
        comparison = compare_compensations(
            machine,
            trajectory or SCENARIOS,
            duration_s=duration_s,
            window_m=1e-9 * window,
            seed=seed,
            set_point=not no_set_point,
            out_dir=out,
            progress=progress,
        )
    show(json_text(comparison.table.as_dict()) if json else str(comparison.table))
    for path in comparison.figures:
        note(f"wrote {path}")
