"""How a text holds a table: separator, where the data begin and end, names, units, decimal mark."""

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from sgms_mhe.logfiles.decimals import Mark, is_missing, is_number, told_by
from sgms_mhe.logfiles.key_rows import Header, find_key_rows
from sgms_mhe.logfiles.stamps import is_clock
from sgms_mhe.machine import BY_COLUMN, SEPARATORS, LogMapping, split_unit
from sgms_mhe.support.errors import InputError

UNITS: Final = frozenset(unit for quantity in BY_COLUMN.values() for unit in quantity.allowed if unit)
"""Every unit that any quantity of a log may have."""

_COMMENT: Final = ("#", "%", "//", "!")
_NO_UNIT: Final = ("", "-", "1")
_LABELS: Final = ("unit", "units", "einheit", "einheiten")
"""What the first field of a unit row may say instead of a unit."""
_TYPES: Final = frozenset("REAL LREAL FLOAT DOUBLE BOOL BYTE WORD SINT USINT INT UINT DINT UDINT LINT".split())
"""Data types that a controller's export may have a row of."""
_TRIAL: Final = 50
"""Rows behind the first that a separator is tried on."""
_SURE_ROWS: Final = 5
"""Rows in sequence that are samples; above them a preamble may have two or three alike."""
_SEARCHED: Final = 2000
"""Lines in which the first sample is looked for before the whole file is."""
_SAYS: Final = "[log] (machine file, --log) has"
UNTOLD: Final = f'a number that is told: a decimal mark, or groups of thousands? {_SAYS} decimal = "," or decimal = "."'
"""What is wanted instead of 1,234, where nothing tells which of the two it is."""
LONGEST_SUMMARY: Final = 200
"""Lines after the data that may hold something else."""
_END: Final = re.compile(r"\r\n|\n|\r")
_NAMED: Final = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "spaces"}


@dataclass(frozen=True)
class Dialect:
    """Dialect of a text.

    Attributes:
        separator: between fields; a space for any number of spaces and tabs.
        decimal: the decimal mark.
        header: the columns' properties.
        rows: (line number, line) of every sample; 0 where samples are no lines.
        before: lines before the header; `after`: lines after the last sample; `comments`: lines between samples that
            are none.
        first: samples before these rows, where they are a piece of a text.
        run: stated by the file.
    """

    separator: str
    decimal: Mark
    header: Header
    rows: tuple[tuple[int, str], ...]
    before: int
    after: tuple[str, ...]
    comments: int
    first: int = 0
    run: Mapping[str, float] = field(default_factory=dict)

    def row(self, index: int) -> str:
        """Where a sample stands."""
        line = self.rows[index][0]
        return f"row {self.first + index + 1}" + (f" (line {line})" if line else "")

    @property
    def lead(self) -> int:
        """Index of the first field of a row that is a value."""
        return _lead(self.rows[0][1], self.separator)

    @property
    def description(self) -> tuple[tuple[str, str], ...]:
        """The same for people."""
        header = f"line {self.header.line}" if self.header.line else "none"
        rows = f"{len(self.rows)}, lines {self.rows[0][0]} to {self.rows[-1][0]}"
        return (
            ("separator", _NAMED[self.separator]),
            ("decimal mark", "comma" if self.decimal == "," else "point"),
            *((("preamble", f"{self.before} lines"),) if self.before else ()),
            ("header", header),
            ("unit row", "yes" if self.header.units else "no"),
            ("rows", f"{rows}; {len(self.after)} lines after them" if self.after else rows),
            *((("comments", f"{self.comments} lines"),) if self.comments else ()),
        )


def fields_of(line: str, separator: str) -> list[str]:
    """Fields of a line, without the spaces and quotation marks around them, and the brackets of a list of one."""
    if separator == " ":
        parts = re.findall(r'"[^"]*"|\S+', line) if '"' in line else line.split()
    elif '"' in line:
        parts = next(csv.reader([line.strip()], delimiter=separator, skipinitialspace=True), [])
    else:
        parts = line.split(separator)
    fields = [part.strip().strip('"').strip() for part in parts]
    return [field[1:-1].strip() if field[:1] == "[" and _is_list_of_one(field) else field for field in fields]


def _is_list_of_one(field: str) -> bool:
    inner = field[1:-1].strip()
    return field[-1] == "]" and (is_value(inner) or is_missing(inner))


def note_left_out(lines: Sequence[str]) -> list[str]:
    """The sentence on lines after the last sample; none where there are none."""
    return [f"{len(lines)} lines after the last sample are left out, the first: {lines[0][:80]}"] if lines else []


def lines_of(text: str) -> list[str]:
    """Lines of Unix, Windows and old Mac."""
    return _END.split(text)


def find_dialect(path: Path, text: str, hints: LogMapping | None, least: int = 2) -> Dialect:
    """Understand a text whose rows have `least` values or more; `hints` are keys of [log].

    Raises InputError, with the key to write.
    """
    lines = lines_of(text)
    if not any(line.strip() for line in lines):
        raise InputError(path, "file", "nothing", "a header line with the columns' names and at least 2 rows")
    stated = None if hints is None else hints.header_line
    filled = [(k + 1, line) for k, line in enumerate(lines) if k >= (stated or 0) and not is_empty(line)]
    separator, first, count = _data(path, filled, hints, least)
    last = _last(filled, first, separator)
    rows = tuple(filled[first : last + 1])
    # Rows that all end in a separator have a field more than names; any other field without a name is refused.
    closed = separator != " " and all(line.rstrip(" ").endswith(separator) for _, line in rows)
    above = lines[: rows[0][0] - 1]
    decimal = _decimal(path, rows, separator, hints)
    header = None
    if stated is None:
        upwards = ((k, fields_of(above[k - 1], separator)) for k in range(len(above), 0, -1) if above[k - 1].strip())
        header = find_key_rows([*upwards], ((k, fields_of(line, separator)) for k, line in rows), decimal)
    if header is None:
        header = _header(path, above, separator, count, closed, stated)
    else:
        rows = tuple((k, line + separator * (count - 1 - line.count(separator))) for k, line in rows)
    between = sum(1 for line in lines[rows[0][0] - 1 : rows[-1][0]] if line.strip()) - len(rows)
    before = lines[: header.line - 1] if header.line else above
    return Dialect(
        separator,
        decimal,
        header,
        rows,
        sum(1 for line in before if line.strip()),
        tuple(line.strip() for line in lines[rows[-1][0] :] if not is_empty(line)),
        between,
    )


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(_COMMENT)


def is_empty(line: str) -> bool:
    """Return True if a line is no row: blank, a comment, or separators alone, as spreadsheets write at the end."""
    return not line.strip(" \t,;|") or _is_comment(line)


def is_value(field: str) -> bool:
    """Return True for a number or a time stamp."""
    return is_number(field) or is_clock(field)


def _data(path: Path, filled: Sequence[tuple[int, str]], hints: LogMapping | None, least: int) -> tuple[str, int, int]:
    """(separator, index of the first sample, fields in it): the separator that leaves most fields values."""
    separators = (hints.separator,) if hints is not None and hints.separator else SEPARATORS
    for limit in (_SEARCHED, len(filled)):
        firsts = {separator: _first_sample(filled[:limit], separator, least) for separator in separators}
        found = {separator: first for separator, first in firsts.items() if first is not None}
        if found:
            rated = {s: _rate([fields_of(line, s) for _, line in filled[k : k + _TRIAL]]) for s, k in found.items()}
            best = max(rated, key=lambda separator: rated[separator])
            return best, found[best], rated[best][1]
    allowed = (
        "a header line with the columns' names and at least 2 rows of numbers, with , ; | tab or spaces between "
        f'them; {_SAYS} separator = "..."'
    )
    raise InputError(path, "file", "no row of numbers", allowed)


def _rate(rows: Sequence[Sequence[str]]) -> tuple[float, int]:
    """(share of values, fields): of the rows that have as many fields as the first, over all."""
    count = len(rows[0])
    full = [fields for fields in rows if len(fields) == count]
    entries = [field for fields in full for field in fields if field]
    return sum(map(is_value, entries)) / len(entries) * len(full) / len(rows), count


def _first_sample(filled: Sequence[tuple[int, str]], separator: str, least: int) -> int | None:
    """Index of the first sample: where rows of `least` values or more begin, two of them with as many fields.

    A preamble may have a few such rows too, but lines without a value below them; or each begins with a key, another
    word in each row, where samples begin with values.
    """
    best, start, rows, count, keys = (False, 0, 0), 0, 0, 0, set[str]()
    for k, (_, line) in enumerate(filled):
        fields = fields_of(line, separator) if separator == " " or separator in line or least == 1 else []
        values = sum(map(is_value, fields))
        key = {field for field in fields[:1] if not is_value(field) and not is_missing(field)}
        is_keyed = len(keys) == rows > 0
        if values >= least and ((rows < 2 and count != len(fields)) or (is_keyed and not key)):
            start, rows, count, keys = k, 1, len(fields), key
        elif values >= least and count == len(fields):
            rows, keys = rows + 1, keys | key
        elif not values:
            rows, count, keys = 0, 0, set()
        best = max(best, (1 < rows > len(keys), rows, -start))
        if rows >= _SURE_ROWS and len(keys) < rows:
            break
    return -best[2] if best[1] else None


def _last(filled: Sequence[tuple[int, str]], first: int, separator: str) -> int:
    """Index of the last sample: lines after it begin with words where the data have values."""
    lead = _lead(filled[first][1], separator)
    for k in range(len(filled) - 1, max(first, len(filled) - LONGEST_SUMMARY), -1):
        if is_row(filled[k][1], separator, lead):
            return k
    return first if len(filled) - first <= LONGEST_SUMMARY else len(filled) - 1


def _lead(line: str, separator: str) -> int:
    return next(k for k, field in enumerate(fields_of(line, separator)) if is_value(field))


def is_row(line: str, separator: str, lead: int) -> bool:
    """Return True if a line begins as samples do: a value, or nothing, in the field `lead` or the first behind it."""
    begins = next((field for field in fields_of(line, separator)[lead:] if field), "")
    return is_value(begins) or is_missing(begins)


def _header(path: Path, above: Sequence[str], separator: str, count: int, closed: bool, stated: int | None) -> Header:
    """Find the line of names, and the rows of units and types below it, above the first sample."""
    unnamed = Header(0, tuple(f"column {k + 1}" for k in range(count)))
    if stated == 0:
        return unnamed
    units: tuple[str, ...] = ()
    for number, fields in _candidates(above, separator, count, closed):
        if stated is not None and number != stated and not _is_unit_row(fields):
            continue
        if len(fields) != count:
            found = f"{len(fields)} names"
            allowed = f"{count} names, as many as the rows have fields; {_SAYS} separator, decimal or header_line"
            raise InputError(path, f"line {number}", found, allowed)
        if any(map(is_number, fields)):
            break
        if number != stated and not units and _is_unit_row(fields):
            units = tuple("" if field.casefold().rstrip(":") in _LABELS else field for field in fields)
        elif number == stated or len(fields) < 2 or not all(field.upper() in _TYPES for field in fields[1:]):
            return Header(number, tuple(fields), units)
    if stated is not None:
        raise InputError(path, "[log] header_line", stated, f"a line above the rows with {count} names")
    return Header(0, units) if units else unnamed


def _candidates(above: Sequence[str], separator: str, count: int, closed: bool) -> Iterator[tuple[int, list[str]]]:
    """(line number, fields) that may be header or unit row, the nearest first; comments only with as many fields."""
    for number in range(len(above), 0, -1):
        line = above[number - 1]
        if not line.strip():
            continue
        is_comment = _is_comment(line)
        fields = _header_names(line.lstrip().lstrip("#%!/").strip() if is_comment else line, separator, count, closed)
        if is_comment and len(fields) != count:
            continue
        if len(fields) < 2 <= count:
            return
        yield number, fields


def _header_names(line: str, separator: str, count: int, closed: bool) -> list[str]:
    """Names of a header; between spaces, names of several words hold together where the number of columns says so."""
    fields = fields_of(line, separator)
    if len(fields) == count + 1 and not fields[-1]:
        return fields[:-1]
    if len(fields) == count - 1 and closed:
        return [*fields, ""]
    if separator == " " and len(fields) != count:
        for pattern in (r"\s+(?![\[(])", r"\t+|\s{2,}", r"\t+|\s{2,}(?![\[(])"):
            joined = [part.strip().strip('"') for part in re.split(pattern, line.strip())]
            if len(joined) == count:
                return joined
    return fields


def _is_unit_row(fields: Sequence[str]) -> bool:
    """Return True if all fields are units, except for a first one that says so."""
    own = fields[1:] if fields and fields[0].casefold().rstrip(":") in _LABELS else fields
    plain = [split_unit(field)[1] for field in own]
    return all(unit in UNITS or unit in _NO_UNIT for unit in plain) and any(unit in UNITS for unit in plain)


def told_in(line: str, separator: str) -> tuple[Mark | Literal["either"] | None, str]:
    """The decimal mark a row tells, with the field that does; `either` where fields may be read in two ways."""
    either = ""
    if "," in line or "." in line:
        for field in fields_of(line, separator):
            told = told_by(field)
            if told is not None and told != "either":
                return told, field
            either = either or (field if told is not None else "")
    return ("either" if either else None), either


def _decimal(path: Path, rows: Sequence[tuple[int, str]], separator: str, hints: LogMapping | None) -> Mark:
    if hints is not None and hints.decimal is not None:
        return hints.decimal
    if separator == "," and not any('"' in line for _, line in rows):
        return "."
    either: tuple[int, str] | None = None
    for number, line in rows:
        told, field = told_in(line, separator)
        if told == "either":
            either = either or (number, field)
        elif told is not None:
            return told
    if either is None:
        return "."
    raise InputError(path, f"line {either[0]}", either[1], UNTOLD)
