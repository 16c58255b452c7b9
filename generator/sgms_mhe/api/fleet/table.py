"""The table of a fleet: a CSV with a machine and a log in each row."""

import csv
import io
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Literal

from sgms_mhe.support.errors import InputError
from sgms_mhe.support.names import did_you_mean

Verb = Literal["diagnose", "estimate", "identify"]
COLUMNS: Final = ("machine", "log", "name", "axis", "date", "mass")


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        number: of its line in the file, 2 is the first below the header.
        machine: a machine file, or the name of one in `machines/`; empty: none, which `identify` takes.
        log: file.
        name: of the row; by default the log's stem.
        axis: the axis that left the log; the name where the table does not say: then it is an axis of its own.
        date: when the log was taken; None: the order is not known.
        mass: moving mass [kg], or inertia [kg m^2]; None: as the motion shows. For `identify`.
    """

    number: int
    machine: str
    log: Path
    name: str
    axis: str
    date: datetime | None
    mass: float | None

    @property
    def when(self) -> str:
        """The date in words; empty where it is not known."""
        if self.date is None:
            return ""
        return (
            f"{self.date:%Y-%m-%d}" if (self.date.hour, self.date.minute) == (0, 0) else f"{self.date:%Y-%m-%dT%H:%M}"
        )


def read_table(path: Path, verb: Verb) -> tuple[Row, ...]:
    """Read a fleet's table. Commas, semicolons or tabs; paths are relative to the table.

    Raises:
        InputError: names the row (of the file) and the column, the value and the allowed ones.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "table", None, f"a CSV in UTF-8 that can be read ({error})") from None
    first = text.partition("\n")[0]
    delimiter = max(",;\t", key=first.count)
    lines = csv.reader(io.StringIO(text), delimiter=delimiter)
    header = [cell.strip().lower() for cell in next(lines, [])]
    _check_header(path, header, verb)
    rows, seen = [], dict[tuple[str, Path], int]()
    for cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        number = lines.line_num
        if len(cells) != len(header):
            raise InputError(path, f"row {number}", len(cells), f"{len(header)} fields, as the header has")
        row = _row(path, number, dict(zip(header, (cell.strip() for cell in cells), strict=True)), verb)
        before = seen.setdefault((row.machine, row.log), number)
        if before != number:
            allowed = f"each machine and log once; row {before} has both"
            raise InputError(path, f"row {number}, column log", str(row.log), allowed)
        rows.append(row)
    if not rows:
        raise InputError(path, "table", None, "at least one row below its header")
    return tuple(rows)


def _check_header(path: Path, header: list[str], verb: Verb) -> None:
    for name in header:
        if name not in COLUMNS:
            allowed = f"one of {', '.join(COLUMNS)}{did_you_mean(name, COLUMNS)}"
            raise InputError(path, "row 1, column", name, allowed)
        if header.count(name) > 1:
            raise InputError(path, "row 1, column", name, "each column once")
    for name in ("log",) if verb == "identify" else ("machine", "log"):
        if name not in header:
            raise InputError(path, f"row 1, column {name}", None, f"missing: fleet {verb} needs it")


def _row(path: Path, number: int, cells: dict[str, str], verb: Verb) -> Row:
    def refuse(column: str, allowed: str) -> InputError:
        return InputError(path, f"row {number}, column {column}", cells.get(column), allowed)

    if not cells["log"]:
        raise refuse("log", "a log file, relative to the table")
    machine = cells.get("machine", "")
    if not machine and verb != "identify":
        raise refuse("machine", "a machine file relative to the table, or a name in machines/")
    if machine.endswith(".toml"):
        machine = str(path.resolve().parent / machine)
    log = path.resolve().parent / cells["log"]
    name = cells.get("name") or log.stem
    return Row(
        number=number,
        machine=machine,
        log=log,
        name=name,
        axis=cells.get("axis") or name,
        date=_date(cells.get("date", ""), refuse("date", "a date as 2026-03-31, or with a time 2026-03-31T14:05")),
        mass=_mass(cells.get("mass", ""), refuse("mass", "a positive number, kg; of an axis that turns kg m^2")),
    )


def _date(text: str, refusal: InputError) -> datetime | None:
    if not text:
        return None
    try:
        day = datetime.fromisoformat(text)
    except ValueError:
        raise refusal from None
    # Without a zone: taken as they stand, in one order with the others.
    return day if day.tzinfo is not None else day.replace(tzinfo=UTC)


def _mass(text: str, refusal: InputError) -> float | None:
    if not text:
        return None
    try:
        mass = float(text)
    except ValueError:
        mass = math.nan
    if not 0.0 < mass < math.inf:
        raise refusal
    return mass
