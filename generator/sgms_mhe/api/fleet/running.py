"""A fleet from its table to its results: existing results are taken, missing ones computed, failures listed."""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sgms_mhe import __version__
from sgms_mhe.api.fleet.bands import courses
from sgms_mhe.api.fleet.table import Row, Verb, read_table
from sgms_mhe.api.fleet.work import RESULT, Result, work
from sgms_mhe.api.inputs import load
from sgms_mhe.configuration import override_log
from sgms_mhe.host.provenance import digest_of_sources
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_names
from sgms_mhe.report import FleetCourse
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.kept import run_kept
from sgms_mhe.support.notebooks import Presentation, Shown
from sgms_mhe.support.processes import Outcome, Task, WorkerSlot

ROWS: Final = "rows"
"""Folder of the rows' results, in that of the fleet."""
_DIGITS: Final = 16

Told = Callable[[str, float], None]
"""Called with what has come of a row, and the share of all rows that are through."""


@dataclass(frozen=True)
class Done:
    """A row that is through.

    Attributes:
        result: None where it failed.
        failure: why, in a sentence; empty where it did not.
        folder: of the result's files.
        seconds: computing time of this run; 0 where the result was there.
    """

    row: Row
    result: Result | None
    failure: str
    folder: Path | None
    seconds: float


@dataclass(frozen=True, repr=False)
class Fleet(Shown):
    """Every row of a table once, in the table's order, and the numbers of every axis in their bands."""

    table: Path
    verb: Verb
    rows: tuple[Done, ...]
    courses: tuple[FleetCourse, ...]

    def _shown(self) -> Presentation:
        return f"{self.verb} of {self.table}: {len(self.rows)} logs, {len(self.failures)} failed", (), ()

    @property
    def failures(self) -> tuple[Done, ...]:
        """Rows without a result."""
        return tuple(done for done in self.rows if done.failure)


def run_fleet(
    verb: Verb,
    table: str | Path,
    out: str | Path,
    place: WorkerSlot,
    told: Told | None = None,
    log_table: Mapping[str, Any] = MappingProxyType({}),
) -> Fleet:
    """Diagnose, estimate or identify every row of a table.

    A row whose machine, log and version have a result in `out` is not done again.

    Args:
        verb: which.
        table: CSV with columns machine and log.
        out: folder; results appear in its `rows` one by one.
        place: where the work is done.
        told: as `Told`.
        log_table: content of a table `[log]` that is laid over that of every machine.

    Raises:
        InputError: the table; the folder; a scheduler that does not answer.
    """
    path, folder = Path(table), Path(out)
    rows = read_table(path, verb)
    through: dict[int, Done] = {}

    def tell(done: Done) -> None:
        through[done.row.number] = done
        if told is not None:
            said = done.failure and f"failed: {done.failure}"
            if done.result is not None:
                said = f"{done.result.verdict}{f', {done.seconds:.1f} s' if done.seconds else ', was there'}"
            told(f"{done.row.name}: {said}", len(through) / len(rows))

    sharing: dict[str, list[Row]] = {}
    queue: list[Task] = []

    @cache
    def load_once(machine: str) -> Machine:
        return override_log(load(machine), log_table)

    for row in rows:
        try:
            machine = load_once(row.machine) if row.machine else None
            key = _key(verb, row, machine, log_table)
        except InputError as error:
            tell(Done(row, None, str(error), None, 0.0))
            continue
        # Copies of one log have one result.
        if key not in sharing:
            queue.append(Task(key, work, (verb, row, machine, dict(log_table))))
        sharing.setdefault(key, []).append(row)
    for outcome in run_kept(queue, folder / ROWS, place):
        for row in sharing[outcome.task.key]:
            tell(_done(row, outcome))
    done = tuple(through[row.number] for row in rows)
    return Fleet(path, verb, done, courses([(d.row, d.result) for d in done if d.result is not None]))


def _done(row: Row, outcome: Outcome) -> Done:
    if outcome.failure:
        return Done(row, None, outcome.failure, None, outcome.seconds)
    content = json.loads((outcome.value / RESULT).read_text(encoding="utf-8"))
    return Done(row, Result.from_json(content), "", outcome.value, outcome.seconds)


def _key(verb: Verb, row: Row, machine: Machine | None, log_table: Mapping[str, Any]) -> str:
    """Name of a row's result: of all that it hangs on. Raises InputError where the log cannot be read."""
    try:
        with row.log.open("rb") as stream:
            log = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(row.log, "log", None, f"a file that can be read ({error.strerror})") from None
    described = None if machine is None else machine.as_dict()
    used: Mapping[str, object] = {"axis": row.axis, "mass": row.mass} if verb == "identify" else {}
    content = json.dumps([verb, described, log, _version(), used, log_table], sort_keys=True, default=dict)
    plain = re.sub(r"[^A-Za-z0-9]+", "-", row.name).strip("-")[:40] or "log"
    return f"{verb}-{plain}-{hashlib.sha256(content.encode()).hexdigest()[:_DIGITS]}"


@cache
def _version() -> str:
    """Of all that computes: this package to the last line, its libraries, the effects of other distributions."""
    package = Path(__file__).resolve().parents[2]
    whole = hashlib.sha256(f"{__version__} {digest_of_sources(effect_names())}".encode())
    for source in sorted(package.rglob("*.py")):
        whole.update(source.relative_to(package).as_posix().encode() + b"\0" + source.read_bytes())
    return whole.hexdigest()
