"""`sgms-mhe fleet`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option
from sgms_mhe.support.parallel import workers

if TYPE_CHECKING:
    from sgms_mhe.api.fleet import Fleet


@make_command(
    "fleet diagnose table.csv --out fleet", "fleet estimate table.csv --scheduler tcp://head:8786", of="fleets.fleet"
)
def command(
    verb: Literal["diagnose", "estimate", "identify"],
    table: Path,
    *,
    log_table: Mapping[str, Any],
    out: Annotated[Path | None, Option("DIR")] = None,
    time_limit_s: float,
    jobs: int | None = None,
    scheduler: str | None = None,
    json: bool = False,
) -> bool:
    """Diagnose, estimate or identify many logs.

    TABLE is a CSV of machines and logs. Columns: machine, log (relative to TABLE); optional name, axis, date, mass.
    Writes results.csv, results.json and fleet.html: parameters of every axis over time, which axis left its band and
    why, failures on top. Results are stored as they come; a second run does missing and changed rows.

    Exit code 1: some rows failed, the rest is done.

    Args:
        out: folder of the results; None: TABLE's name and the verb.
    """
    folder = out or Path(f"{table.stem}_{verb}")
    common.check_output_folder(folder)
    common.note_broken_effects()

    from sgms_mhe.api.fleet import run_fleet
    from sgms_mhe.api.fleet.writing import results_json, write_fleet
    from sgms_mhe.support.processes import WorkerSlot

    place = WorkerSlot(jobs or workers(), scheduler, time_limit_s)
    with common.steps_bar(common.note) as progress:  # the result of each row is no progress
        fleet = run_fleet(verb, table, folder, place, progress, log_table)
    page = write_fleet(fleet, folder)
    if json:
        common.show(common.json_text(results_json(fleet, folder)))
    else:
        common.show(_text(fleet, page))
    return bool(fleet.failures)


def _text(fleet: Fleet, page: Path) -> str:
    from sgms_mhe.api.fleet.writing import state_rows
    from sgms_mhe.report.fleet import describe_doubts

    done = [row for row in fleet.rows if not row.failure]
    fresh = [row.seconds for row in done if row.seconds]
    cost = f", {sum(fresh) / len(fresh):.1f} s each" if fresh else ""
    statements = state_rows(fleet, page.parent)
    lines = [s.sentence for s in statements if s.kind != "row" or s.sure == "no"]
    lines += filter(None, [describe_doubts(statements)])
    lines.append(
        f"{len(done)} of {len(fleet.rows)} logs done, {len(fresh)} of them now{cost}, {len(fleet.failures)} failed"
    )
    lines.append(f"page: {page}")
    return "\n".join(lines)
