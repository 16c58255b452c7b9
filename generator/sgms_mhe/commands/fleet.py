"""`sgms-mhe fleet`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.log_options import log_options
from sgms_mhe.support.numbers import interval
from sgms_mhe.support.parallel import workers

if TYPE_CHECKING:
    from sgms_mhe.api.fleet import Fleet

LONGEST_S = 1e6


@click.command(
    short_help="Diagnose, estimate or identify many logs.",
    epilog=common.example(
        "fleet diagnose table.csv --out fleet", "fleet estimate table.csv --scheduler tcp://head:8786"
    ),
)
@click.argument("verb", type=click.Choice(("diagnose", "estimate", "identify")))
@click.argument("rows", metavar="TABLE", type=click.Path(path_type=Path))
@log_options
@common.out_option("Folder of the results; default: TABLE's name and the verb.", metavar="DIR", required=False)
@click.option("--jobs", type=click.IntRange(1, 256), metavar="J", help="Processes at a time; default: one per core.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster that does the work in place of this host.")
@click.option(
    "--time-limit",
    type=common.NumberType(1.0, LONGEST_S),
    metavar="S",
    default=1800.0,
    show_default=True,
    help="Of one log; it has failed then.",
)
@common.json_option
def command(
    verb: Literal["diagnose", "estimate", "identify"],
    rows: Path,
    table: dict[str, Any],
    out: Path | None,
    jobs: int | None,
    scheduler: str | None,
    time_limit: float,
    as_json: bool,
) -> None:
    """Diagnose, estimate or identify every row of TABLE, a CSV of machines and logs.

    Columns: machine, log (relative to TABLE); optional name, axis, date, mass. Writes results.csv, results.json and
    fleet.html: parameters of every axis over time, which axis left its band and why, failures on top. Results are
    stored as they come; a second run does missing and changed rows.

    Exit code 1: some rows failed, the rest is done.
    """
    folder = out or Path(f"{rows.stem}_{verb}")
    common.check_output_folder(folder)
    common.note_broken_effects()

    from sgms_mhe.api.fleet import run_fleet
    from sgms_mhe.api.fleet.writing import results_json, write_fleet
    from sgms_mhe.support.processes import WorkerSlot

    place = WorkerSlot(jobs or workers(), scheduler, time_limit)
    with common.steps_bar(common.note) as progress:  # the result of each row is no progress
        fleet = run_fleet(verb, rows, folder, place, progress, table)
    page = write_fleet(fleet, folder)
    if as_json:
        common.show(common.json_text(results_json(fleet, folder)))
    else:
        common.show(_text(fleet, page))
    if fleet.failures:
        click.get_current_context().exit(1)


def _text(fleet: Fleet, page: Path) -> str:
    from sgms_mhe.api.fleet.writing import fleet_logs
    from sgms_mhe.report.fleet import describe_doubts, doubts

    done = [row for row in fleet.rows if not row.failure]
    fresh = [row.seconds for row in done if row.seconds]
    cost = f", {sum(fresh) / len(fresh):.1f} s each" if fresh else ""
    lines = [f"failed: row {d.row.number}, {d.row.name}: {d.failure}" for d in fleet.failures]
    lines += [
        f"left its band: {course.axis}, {course.name}, {point.row.name}: "
        f"{interval(point.number.value, point.number.std)}, band {point.band.low:.4g} to {point.band.high:.4g} of "
        f"{point.band.count} {'earlier logs' if point.band.origin == 'own' else 'other axes'}"
        for course in fleet.courses
        for point in course.points
        if point.band is not None and point.left
    ]
    lines += [
        f"moves steadily: {course.axis}, {course.name}: {interval(trend.change, trend.std)} over {trend.days:.0f} days"
        for course in fleet.courses
        if (trend := course.trend) is not None
    ]
    open_ = describe_doubts(doubts(fleet_logs(fleet, page.parent)), len(fleet.rows))
    lines += [open_] if open_ else []
    lines.append(
        f"{len(done)} of {len(fleet.rows)} logs done, {len(fresh)} of them now{cost}, {len(fleet.failures)} failed"
    )
    lines.append(f"page: {page}")
    return "\n".join(lines)
