"""Delimited text: a table from any dialect, the numbers of the wanted columns by numpy wherever they are plain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from sgms_mhe.logfiles.decimals import is_number, told_by, value_of
from sgms_mhe.logfiles.dialect import UNTOLD, Dialect, fields_of, find_dialect
from sgms_mhe.logfiles.encoding import decode
from sgms_mhe.logfiles.stamps import seconds_of_stamps, stamp_form
from sgms_mhe.logfiles.table import Array, Table, columns_of
from sgms_mhe.machine import LogMapping
from sgms_mhe.support.errors import InputError


def read_text(path: Path, hints: LogMapping | None) -> Table:
    """The table of a text. Raises InputError, with what to write where; OSError as open does."""
    text, encoding = decode(path, path.read_bytes(), None if hints is None else hints.encoding)
    dialect = find_dialect(path, text, hints)
    columns = columns_of(dialect.names, dialect.units)
    indices = {column.name: k for k, column in enumerate(columns)}
    order = None if hints is None else hints.dates
    stated = hints is not None and hints.decimal is not None
    # The first row that has something in a column tells whether it holds time stamps.
    probe = [fields_of(line, dialect.separator) for _, line in dialect.rows[:_PROBE]]
    stamped = {
        name
        for name, k in indices.items()
        if stamp_form(next((fields[k] for fields in probe if k < len(fields) and fields[k]), ""))
    }

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        wanted = {name: indices[name] for name in names}
        plain = None if stamped & set(names) else _plainly(path, dialect, list(wanted.values()))
        if plain is not None:
            return dict(zip(names, plain, strict=True))
        cells = [fields_of(line, dialect.separator) for _, line in dialect.rows]
        for index, fields in enumerate(cells):
            _check_length(path, dialect, index, len(fields))
        columns = {name: [fields[k] for fields in cells] for name, k in wanted.items()}
        return {
            name: _stamps(path, dialect, name, tokens, order)
            if name in stamped
            else _numbers(path, dialect, name, tokens, stated)
            for name, tokens in columns.items()
        }

    def row(index: int) -> str:
        return f"row {index + 1} (line {dialect.rows[index][0]})"

    left = (
        f"{len(dialect.after)} lines after the last sample are left out, the first: {dialect.after[0][:80]}"
        if dialect.after
        else ""
    )
    return Table(
        "text",
        columns,
        read,
        row,
        (("encoding", encoding), *dialect.described),
        frozenset(stamped),
        (left,) if left else (),
    )


_PROBE = 1000


def _check_length(path: Path, dialect: Dialect, index: int, found: int) -> None:
    """Refuse a row with more or fewer fields than the header has names."""
    count = len(dialect.names)
    if found != count:
        where = f"row {index + 1} (line {dialect.rows[index][0]})"
        raise InputError(path, where, f"{found} fields", f"{count} fields, as many as the header has names")


def _plainly(path: Path, dialect: Dialect, indices: Sequence[int]) -> list[Array] | None:
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


def _refused(path: Path, dialect: Dialect, name: str, index: int, token: str, allowed: str) -> InputError:
    where = f"row {index + 1} (line {dialect.rows[index][0]}), column {name}"
    return InputError(path, where, token, allowed)


def _stamps(path: Path, dialect: Dialect, name: str, tokens: Sequence[str], order: str | None) -> Array:
    """A column of time stamps [s]. Raises InputError that names the first field that is none."""
    try:
        return seconds_of_stamps(tokens, order)
    except ValueError as error:
        index, allowed = error.args
        raise _refused(path, dialect, name, index, tokens[index], allowed) from None


def _numbers(path: Path, dialect: Dialect, name: str, tokens: Sequence[str], stated: bool) -> Array:
    """A column of numbers; `stated`: [log] says the decimal mark.

    Raises InputError that names the first field that is no number, or whose groups of thousands may be decimals: in a
    column where no number has both marks, or two groups.
    """
    values = np.empty(len(tokens))
    other = "," if dialect.decimal == "." else "."
    for k, token in enumerate(tokens):
        try:
            values[k] = value_of(token, dialect.decimal)
        except ValueError:
            mark, remedy = _MARKS[dialect.decimal]
            allowed = f"a number with a decimal {mark}, or NaN{remedy if is_number(token) else ''}"
            raise _refused(path, dialect, name, k, token, allowed) from None
    grouped = [k for k, token in enumerate(tokens) if other in token]
    if grouped and not stated and not any(told_by(tokens[k]) == dialect.decimal for k in grouped):
        raise _refused(path, dialect, name, grouped[0], tokens[grouped[0]], UNTOLD)
    return values


_MARKS = {
    ".": ("point", '; [log] of the machine file has decimal = "," for a comma'),
    ",": ("comma", '; [log] of the machine file has decimal = "." for a point'),
}
