"""How a text holds a table: separator, where the data begin and end, names, units, decimal mark."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sgms_mhe.logfiles.decimals import Mark, evidence, is_missing, is_number
from sgms_mhe.logfiles.stamps import stamp_form
from sgms_mhe.machine import BY_COLUMN, SEPARATORS, LogMapping, normal_unit
from sgms_mhe.support.errors import InputError

UNITS: Final = frozenset(unit for quantity in BY_COLUMN.values() for unit in quantity.allowed)
"""Every unit that any quantity of a log may have."""

_COMMENT: Final = ("#", "%", "//", "!")
_NO_UNIT: Final = ("", "-", "1")
_TRIAL: Final = 50
"""Rows behind the first that a separator is tried on."""
_LONGEST_SUMMARY: Final = 200
"""Lines after the data that may hold something else."""
_NAMED: Final = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "spaces"}


@dataclass(frozen=True)
class Dialect:
    """What was understood of a text.

    Attributes:
        separator: between fields; a space for any number of spaces and tabs.
        decimal: the decimal mark.
        names: of the columns, as they stand in the header; `column 1`, ... where there is none.
        units: of the unit row, as many as names; empty where there is none.
        header_line: number of the line that names stand in; 0 where there is none.
        rows: (line number, line) of every sample.
        before: lines before the header; `after`: lines after the last sample; `comments`: lines between samples that
            are none.
    """

    separator: str
    decimal: Mark
    names: tuple[str, ...]
    units: tuple[str, ...]
    header_line: int
    rows: tuple[tuple[int, str], ...]
    before: int
    after: int
    comments: int

    @property
    def described(self) -> tuple[tuple[str, str], ...]:
        """The same for people."""
        header = f"line {self.header_line}" if self.header_line else "none"
        rows = f"{len(self.rows)}, lines {self.rows[0][0]} to {self.rows[-1][0]}"
        return (
            ("separator", _NAMED[self.separator]),
            ("decimal mark", "comma" if self.decimal == "," else "point"),
            ("header", f"{header}, {self.before} lines before it" if self.before else header),
            ("unit row", "yes" if self.units else "no"),
            ("rows", f"{rows}; {self.after} lines after them" if self.after else rows),
            *((("comments", f"{self.comments} lines"),) if self.comments else ()),
        )


def fields_of(line: str, separator: str) -> list[str]:
    """Fields of a line, without the spaces and quotation marks around them."""
    if separator == " ":
        parts = re.findall(r'"[^"]*"|\S+', line) if '"' in line else line.split()
    elif '"' in line:
        parts = next(csv.reader([line.strip()], delimiter=separator, skipinitialspace=True), [])
    else:
        parts = line.split(separator)
    return [part.strip().strip('"').strip() for part in parts]


def find_dialect(path: Path, text: str, hints: LogMapping | None) -> Dialect:
    """Understand a text; `hints` are what [log] states of it. Raises InputError, with what to write where."""
    lines = re.split(r"\r\n|\n|\r", text)
    if not any(line.strip() for line in lines):
        raise InputError(path, "file", "nothing", "a header line with the columns' names and at least 2 rows")
    stated = None if hints is None else hints.header_line
    separator, first, count = _data(path, lines, hints, stated or 0)
    last = _last(lines, first, separator)
    rows = tuple((k + 1, lines[k]) for k in range(first, last + 1) if lines[k].strip() and not _is_comment(lines[k]))
    comments = sum(1 for k in range(first, last + 1) if lines[k].strip()) - len(rows)
    header_at, names, units = _header(path, lines, first, separator, count, stated)
    before = sum(1 for line in lines[: header_at if header_at is not None else first] if line.strip())
    return Dialect(
        separator,
        _decimal(path, rows, separator, hints),
        names,
        units,
        0 if header_at is None else header_at + 1,
        rows,
        before,
        sum(1 for line in lines[last + 1 :] if line.strip()),
        comments,
    )


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(_COMMENT)


def _is_value(field: str) -> bool:
    return is_number(field) or stamp_form(field) is not None


def _data(path: Path, lines: Sequence[str], hints: LogMapping | None, start: int) -> tuple[str, int, int]:
    """(separator, index of the first sample's line, fields in it): the separator that leaves most fields numbers."""
    stated = None if hints is None else hints.separator
    best: tuple[float, int, str, int] | None = None
    for separator in (stated,) if stated else SEPARATORS:
        found = _first_sample(lines, separator, start)
        if found is None:
            continue
        following = [fields_of(line, separator) for line in lines[found : found + _TRIAL] if line.strip()]
        count = len(following[0])
        full = [fields for fields in following if len(fields) == count]
        filled = [field for fields in full for field in fields if field]
        share = sum(map(_is_value, filled)) / len(filled) * len(full) / len(following)
        if best is None or (share, count) > best[:2]:
            best = (share, count, separator, found)
    if best is None:
        allowed = (
            "a header line with the columns' names and at least 2 rows of numbers, with , ; | tab or spaces between "
            'them; [log] of the machine file has separator = "..."'
        )
        raise InputError(path, "file", "no row of numbers", allowed)
    return best[2], best[3], best[1]


def _first_sample(lines: Sequence[str], separator: str, start: int) -> int | None:
    """Index of the first line that is a sample: two or more values, and the line after it has as many fields."""
    waiting: tuple[int, int] | None = None
    for k in range(start, len(lines)):
        line = lines[k]
        if not line.strip() or _is_comment(line) or (separator != " " and separator not in line):
            waiting = waiting if not line.strip() or _is_comment(line) else None
            continue
        fields = fields_of(line, separator)
        if sum(map(_is_value, fields)) >= 2:
            if waiting is not None and waiting[1] == len(fields):
                return waiting[0]
            waiting = (k, len(fields))
        else:
            waiting = waiting if any(map(_is_value, fields)) else None
    return waiting[0] if waiting is not None else None


def _last(lines: Sequence[str], first: int, separator: str) -> int:
    """Index of the last line of the data: lines after it begin with words where the data have values."""
    lead = next(k for k, field in enumerate(fields_of(lines[first], separator)) if _is_value(field))
    filled = [k for k in range(first, len(lines)) if lines[k].strip() and not _is_comment(lines[k])]
    for k in filled[:-_LONGEST_SUMMARY:-1]:
        begins = next((field for field in fields_of(lines[k], separator)[lead:] if field), "")
        if _is_value(begins) or is_missing(begins):
            return k
    return filled[-1]


def _header(
    path: Path, lines: Sequence[str], first: int, separator: str, count: int, stated: int | None
) -> tuple[int | None, tuple[str, ...], tuple[str, ...]]:
    """(index of the header's line, names, units) above the first sample."""
    numbered = tuple(f"column {k + 1}" for k in range(count))
    if stated == 0:
        return None, numbered, ()
    units: tuple[str, ...] = ()
    for k, fields in _above(lines, first, separator, count):
        if stated is not None and k != stated - 1 and not _is_unit_row(fields):
            continue
        if len(fields) != count:
            allowed = f"{count} names, as many as the rows have fields; [log] has separator, decimal or header_line"
            raise InputError(path, f"line {k + 1}", f"{len(fields)} names", allowed)
        if any(is_number(field) for field in fields):
            break
        if not units and _is_unit_row(fields) and (stated is None or k != stated - 1):
            units = tuple(fields)
            continue
        return k, tuple(fields), units
    if stated is not None:
        raise InputError(path, "[log] header_line", stated, f"a line above the rows with {count} names")
    return (None, numbered, ()) if not units else (first - 1, units, ())


def _above(lines: Sequence[str], first: int, separator: str, count: int) -> Iterator[tuple[int, list[str]]]:
    """Lines above the data that may be header or unit row, the nearest first; comments only with as many fields."""
    for k in range(first - 1, -1, -1):
        line = lines[k]
        if not line.strip():
            continue
        if _is_comment(line):
            fields = _named(line.lstrip().lstrip("#%!/").strip(), separator, count)
            if len(fields) == count:
                yield k, fields
            continue
        fields = _named(line, separator, count)
        if len(fields) < 2 <= count:
            return
        yield k, fields


def _named(line: str, separator: str, count: int) -> list[str]:
    """Names of a header; between spaces, names of several words hold together where the number of columns says so."""
    fields = fields_of(line, separator)
    if len(fields) == count + 1 and not fields[-1]:
        return fields[:-1]
    if len(fields) == count - 1 and separator != " ":
        return [*fields, ""]  # the rows end in a separator, or the header lacks a name that is then wanted by nobody
    if separator == " " and len(fields) != count:
        for pattern in (r"\s+(?![\[(])", r"\t+|\s{2,}", r"\t+|\s{2,}(?![\[(])"):
            joined = [part.strip().strip('"') for part in re.split(pattern, line.strip())]
            if len(joined) == count:
                return joined
    return fields


def _is_unit_row(fields: Sequence[str]) -> bool:
    plain = [normal_unit(field) for field in fields]
    return all(unit in UNITS or unit in _NO_UNIT for unit in plain) and any(unit in UNITS for unit in plain)


def _decimal(path: Path, rows: Sequence[tuple[int, str]], separator: str, hints: LogMapping | None) -> Mark:
    if hints is not None and hints.decimal is not None:
        return hints.decimal
    told = [line for _, line in rows if "," in line]
    if not told or (separator == "," and not any('"' in line for line in told)):
        return "."
    found = evidence(field for _, line in rows for field in fields_of(line, separator))
    if found.mark is not None:
        return found.mark
    if found.comma is not None:
        seen, allowed = f"{found.comma} and {found.point}", "one decimal mark"
    else:
        seen, allowed = str(found.either), "a number that is told: a decimal comma, or groups of thousands?"
    number, _ = next((n, line) for n, line in rows if (found.either or found.comma or "") in line)
    raise InputError(path, f"line {number}", seen, f'{allowed} [log] has decimal = "," or decimal = "."')
