"""Results of a fleet: a table, the same as JSON, and a page."""

import csv
import io
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sgms_mhe import __version__
from sgms_mhe.api.fleet.running import Done, Fleet
from sgms_mhe.api.fleet.work import FleetNumber, json_text
from sgms_mhe.machine import OF_KIND, Kind
from sgms_mhe.model.effects import reported_name
from sgms_mhe.report import FleetLog, FleetPoint, write_fleet_report
from sgms_mhe.report.fleet import state_fleet
from sgms_mhe.support.files import write_text
from sgms_mhe.support.statements import Statement

_LINKED = ("report.html", "estimates.csv", "identification.json")


def write_fleet(fleet: Fleet, out: str | Path) -> Path:
    """Write results.csv, results.json and fleet.html; return the page's path."""
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    results = results_json(fleet, folder)
    write_text(folder / "results.csv", results_csv(results))
    write_text(folder / "results.json", json_text(results))
    logs = [_log(done, folder) for done in fleet.rows]
    return write_fleet_report(fleet.verb, str(fleet.table), logs, fleet.courses, folder)


def state_rows(fleet: Fleet, folder: Path) -> tuple[Statement, ...]:
    """Return every judgement on a fleet."""
    return state_fleet([_log(done, folder) for done in fleet.rows], fleet.courses)


def results_json(fleet: Fleet, folder: Path) -> dict[str, Any]:
    """Content of results.json: every row of the table once, in its order."""
    bands = {(point.row, course.name): point for course in fleet.courses for point in course.points}
    return {
        "verb": fleet.verb,
        "version": __version__,
        "statements": [statement.to_json() for statement in state_rows(fleet, folder)],
        "trends": [
            {"axis": c.axis, "name": _name_with_unit(c.kind, c.name), **asdict(c.trend)}
            for c in fleet.courses
            if c.trend is not None
        ],
        "changes": [
            {"axis": c.axis, "name": _name_with_unit(c.kind, c.name), **asdict(change)}
            for c in fleet.courses
            for change in c.changes
        ],
        "rows": [
            {
                "row": done.row.number,
                **_identity(done, fleet.table),
                "outcome": "failed" if done.failure else "done",
                "failure": done.failure or None,
                **{key: getattr(done.result, key, None) for key in ("verdict", "standing", "summary")},
                "notes": list(done.result.notes) if done.result else [],
                "folder": _relative(done, folder),
                "numbers": [_number(done.result.kind, n, bands[done.row.number, n.name]) for n in done.result.numbers]
                if done.result
                else [],
            }
            for done in fleet.rows
        ],
    }


def _number(kind: Kind, number: FleetNumber, point: FleetPoint) -> dict[str, Any]:
    band = point.band
    return {
        "name": _name_with_unit(kind, number.name),
        "value": number.value,
        "std": number.std,
        "nominal": number.nominal,
        "band": band and {"low": band.low, "high": band.high, "from": band.origin, "count": band.count},
        "left_band": point.left if band else None,
    }


def results_csv(results: Mapping[str, Any]) -> str:
    """Content of results.csv, of results.json: a row each; a number a row does not determine stays empty."""
    names = dict.fromkeys(number["name"] for row in results["rows"] for number in row["numbers"])
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    columns = [column for name in names for column in (name, f"std_{name}")]
    identity = ("row", "name", "axis", "date", "machine", "log", "outcome", "verdict")
    lines.writerow([*identity, "said", "left_band", "folder", *columns])
    for row in results["rows"]:
        numbers = {number["name"]: number for number in row["numbers"]}
        cells = [repr(numbers[name][key]) if name in numbers else "" for name in names for key in ("value", "std")]
        left = " ".join(name for name, number in numbers.items() if number["left_band"])
        said = row["failure"] or row["summary"]
        lines.writerow([*(row[key] for key in identity), said, left, row["folder"], *cells])
    return text.getvalue()


def _name_with_unit(kind: Kind, name: str) -> str:
    """A number's name with its unit, as this kind of axis has it: `coulomb_N`, `force_ripple.amplitude_N`."""
    return OF_KIND[kind].named(reported_name(name))


def _identity(done: Done, table: Path) -> dict[str, str]:
    row, beside = done.row, table.resolve().parent
    log = row.log.relative_to(beside) if row.log.is_relative_to(beside) else row.log
    machine = row.machine.removeprefix(f"{beside}/")
    return {"name": row.name, "axis": row.axis, "date": row.when, "machine": machine, "log": str(log)}


def _relative(done: Done, folder: Path) -> str:
    return "" if done.folder is None else done.folder.relative_to(folder).as_posix()


def _log(done: Done, folder: Path) -> FleetLog:
    row, result = done.row, done.result
    link = ""
    if done.folder is not None:
        link = next((f"{_relative(done, folder)}/{name}" for name in _LINKED if (done.folder / name).is_file()), "")
    return FleetLog(
        name=row.name,
        axis=row.axis,
        date=row.when,
        machine=result.machine if result else row.machine,
        verdict=result.verdict if result else "",
        standing=result.standing if result else "nothing",
        summary=result.summary if result else "",
        failure=done.failure,
        link=link,
        notes=result.notes if result else (),
    )
