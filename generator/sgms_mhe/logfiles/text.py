"""Delimited text: a table from any dialect, the numbers of the wanted columns by numpy wherever they are plain."""

import gzip
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from sgms_mhe.logfiles.decimals import is_number, told_by, value_of
from sgms_mhe.logfiles.dialect import UNTOLD, Dialect, fields_of, find_dialect, note_left_out
from sgms_mhe.logfiles.encoding import decode
from sgms_mhe.logfiles.json_files import SUFFIXES, find_samples
from sgms_mhe.logfiles.list_cells import spread_lists
from sgms_mhe.logfiles.long_format import pivot
from sgms_mhe.logfiles.stamps import Stamps, stamp_form
from sgms_mhe.logfiles.table import Table, columns_of
from sgms_mhe.machine import LogMapping
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError

COMPRESSED: Final = ".gz"
"""Suffix after that of a text that gzip compressed."""
LARGEST: Final = 2**30
"""Bytes of a compressed text: a few kilobytes may claim to be more than any memory holds."""


def read_text(path: Path, hints: LogMapping | None, least: int = 2) -> Table:
    """The table of a text whose rows have `least` values or more.

    Raises InputError, with the key to write; OSError as open does.
    """
    text, encoding = decode(path, _content(path), None if hints is None else hints.encoding)
    is_json = Path(path.stem if path.suffix.lower() == COMPRESSED else path.name).suffix.lower() in SUFFIXES
    dialect = find_samples(path, text) if is_json else find_dialect(path, spread_lists(text), hints, least)
    cells = Cells(path, dialect, hints)
    notes = note_left_out(dialect.after)
    names, header = [column.name for column in cells.columns], dialect.header
    scales = {names[k]: scale for k, scale in header.scales.items()}
    counted: dict[str, Array] = {
        names[k]: step * np.arange(float(len(dialect.rows))) for k, step in header.steps.items()
    }
    notes += [f"{name}: taken times {a:g} plus {b:g}, as its key rows state" for name, (a, b) in scales.items()]
    if header.steps:
        first, step = next(iter(header.steps.items()))
        notes.append(f"time is counted in the step of {step:g} {header.units[first]} that the file states")

    def read(wanted: Sequence[str]) -> Mapping[str, Array]:
        values = dict(Cells(path, dialect, hints).read(dialect, [name for name in wanted if name not in counted]))
        for name in scales.keys() & values:
            values[name] = values[name] * scales[name][0] + scales[name][1]
        return {name: counted[name] if name in counted else values[name] for name in wanted}

    table = Table(
        "JSON" if is_json else "text",
        cells.columns,
        read,
        dialect.row,
        () if is_json else (("encoding", encoding), *dialect.description),
        cells.stamped,
        tuple(notes),
        {names[k]: names[clock] for k, clock in header.clocks.items()},
        dialect.run,
    )
    return pivot(path, table, dialect, hints)


_PROBE = 1000


def _content(path: Path) -> bytes:
    """Bytes of the text. Raises InputError for a compressed one that is damaged or too large; OSError as open does."""
    if path.suffix.lower() != COMPRESSED:
        return path.read_bytes()
    try:
        with gzip.open(path) as stream:
            content = stream.read(LARGEST + 1)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise InputError(path, "file", str(error), "a text that gzip compressed, whole") from None
    if len(content) > LARGEST:
        raise InputError(path, "file", f"more than {LARGEST} bytes", "a smaller text, or parquet, HDF5 or MDF")
    return content


class Cells:
    """The columns of a text, read at once or piece after piece: findings on earlier rows hold for later ones.

    Args:
        path: of the text, for messages.
        dialect: of the whole text, or of its beginning.
        hints: keys of [log].

    Attributes:
        columns: everything that the header names.
        stamped: names of the columns that hold time stamps.
    """

    def __init__(self, path: Path, dialect: Dialect, hints: LogMapping | None) -> None:
        self._path = path
        self.columns = columns_of(dialect.header.names, dialect.header.units)
        self._indices = {column.name: k for k, column in enumerate(self.columns)}
        # The first row that has something in a column tells whether it holds time stamps.
        probe = [fields_of(line, dialect.separator) for _, line in dialect.rows[:_PROBE]]
        self.stamped = frozenset(
            name
            for name, k in self._indices.items()
            if stamp_form(next((fields[k] for fields in probe if k < len(fields) and fields[k]), ""))
        )
        order = None if hints is None else hints.dates
        self._clocks = {name: Stamps(order) for name in self.stamped}
        stated = hints is not None and hints.decimal is not None
        # Columns whose groups of thousands are known to be groups.
        self._told = set(self._indices) if stated else set[str]()

    def read(self, dialect: Dialect, names: Sequence[str], *, ahead: bool = True) -> Mapping[str, Array]:
        """Columns (n,) of the dialect's rows, which follow those that were read before.

        Args:
            dialect: with these rows.
            names: of the columns.
            ahead: whether a row may tell of those before it the mark of their groups of thousands.

        Raises:
            InputError: names the first row with another number of fields, or field that is no number.
        """
        path = self._path
        wanted = {name: self._indices[name] for name in names}
        plain = None if self.stamped & set(names) else read_plainly(path, dialect, list(wanted.values()))
        if plain is not None:
            return dict(zip(names, plain, strict=True))
        cells = [fields_of(line, dialect.separator) for _, line in dialect.rows]
        for index, fields in enumerate(cells):
            _check_length(path, dialect, index, len(fields))
        columns = {name: [fields[k] for fields in cells] for name, k in wanted.items()}
        return {
            name: _stamps(path, dialect, name, tokens, self._clocks[name])
            if name in self.stamped
            else _numbers(path, dialect, name, tokens, self._told, ahead)
            for name, tokens in columns.items()
        }


def _check_length(path: Path, dialect: Dialect, index: int, found: int) -> None:
    """Refuse a row with more or fewer fields than the header has names."""
    count = len(dialect.header.names)
    if found != count:
        allowed = f"{count} fields, as many as the header has names"
        raise InputError(path, dialect.row(index), f"{found} fields", allowed)


def read_plainly(path: Path, dialect: Dialect, indices: Sequence[int]) -> list[Array] | None:
    """The columns, by numpy's reader, where every field of theirs is a plain number; else None."""
    lines = [line for _, line in dialect.rows]
    separator = dialect.separator
    if any('"' in line for line in lines):
        return None
    for index, line in enumerate(lines):
        _check_length(path, dialect, index, len(line.split()) if separator == " " else line.count(separator) + 1)
    if dialect.decimal == ",":
        if any("." in line for line in lines):
            return None
        lines = [line.replace(",", ".") for line in lines]
    try:
        delimiter = None if separator == " " else separator
        values = np.loadtxt(lines, delimiter=delimiter, comments=None, usecols=indices, ndmin=2)
    except ValueError:  # text, an empty field, a group of thousands: field by field, to say which and where
        return None
    return [np.ascontiguousarray(values[:, k]) for k in range(len(indices))]


def _refusal(path: Path, dialect: Dialect, name: str, index: int, token: str, allowed: str) -> InputError:
    return InputError(path, f"{dialect.row(index)}, column {name}", token, allowed)


def _stamps(path: Path, dialect: Dialect, name: str, tokens: Sequence[str], clock: Stamps) -> Array:
    """A column of time stamps [s]. Raises InputError that names the first field that is none."""
    try:
        return clock.seconds(tokens)
    except ValueError as error:
        index, allowed = error.args
        raise _refusal(path, dialect, name, index, tokens[index], allowed) from None


def _numbers(path: Path, dialect: Dialect, name: str, tokens: Sequence[str], told: set[str], ahead: bool) -> Array:
    """A column of numbers; `told`: names of the columns whose groups of thousands are known to be groups.

    Raises InputError that names the first field that is no number, or whose groups of thousands may be decimals: in a
    column where no number, or with not `ahead` none before it, has both marks, or two groups.
    """
    values = np.empty(len(tokens))
    other = "," if dialect.decimal == "." else "."
    for k, token in enumerate(tokens):
        try:
            values[k] = value_of(token, dialect.decimal)
        except ValueError:
            mark, remedy = _MARKS[dialect.decimal]
            allowed = f"a number with a decimal {mark}, or NaN{remedy if is_number(token) else ''}"
            raise _refusal(path, dialect, name, k, token, allowed) from None
    if name not in told:
        grouped = [k for k, token in enumerate(tokens) if other in token]
        telling = next((k for k in grouped if told_by(tokens[k]) == dialect.decimal), None)
        if grouped and (telling is None or (telling > grouped[0] and not ahead)):
            raise _refusal(path, dialect, name, grouped[0], tokens[grouped[0]], UNTOLD)
        if grouped:
            told.add(name)
    return values


_MARKS = {
    ".": ("point", '; [log] (machine file, --log) has decimal = "," for a comma'),
    ",": ("comma", '; [log] (machine file, --log) has decimal = "." for a point'),
}
