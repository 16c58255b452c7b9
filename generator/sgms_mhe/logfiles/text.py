"""Delimited text: a table from any dialect, the numbers of the wanted columns by numpy wherever they are plain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from sgms_mhe.logfiles.decimals import value_of
from sgms_mhe.logfiles.dialect import Dialect, fields_of, find_dialect
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
    # The first row that has something in a column tells whether it holds time stamps.
    probe = [fields_of(line, dialect.separator) for _, line in dialect.rows[:_PROBE]]
    stamped = {
        name
        for name, k in indices.items()
        if stamp_form(next((fields[k] for fields in probe if k < len(fields) and fields[k]), ""))
    }

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        _check_lengths(path, dialect)
        wanted = {name: indices[name] for name in names}
        plain = None if stamped & set(names) else _plainly(dialect, list(wanted.values()))
        if plain is not None:
            return dict(zip(names, plain, strict=True))
        return {name: _column(path, dialect, name, k, name in stamped, order) for name, k in wanted.items()}

    def row(index: int) -> str:
        return f"row {index + 1} (line {dialect.rows[index][0]})"

    left = (
        f"{dialect.after} lines after the last sample, line {dialect.rows[-1][0]}, are left out"
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


def _check_lengths(path: Path, dialect: Dialect) -> None:
    """Refuse a row with more or fewer fields than the header has names."""
    separator, count = dialect.separator, len(dialect.names)
    for index, (number, line) in enumerate(dialect.rows):
        plainly = separator != " " and '"' not in line
        found = line.count(separator) + 1 if plainly else len(fields_of(line, separator))
        if found != count:
            where = f"row {index + 1} (line {number})"
            raise InputError(path, where, f"{found} fields", f"{count} fields, as many as the header has names")


def _plainly(dialect: Dialect, indices: Sequence[int]) -> list[Array] | None:
    """The columns, by numpy's reader, where they hold numbers alone; else None."""
    lines = [line for _, line in dialect.rows]
    if dialect.decimal == ",":
        if dialect.separator == "," or any("." in line for line in lines):
            return None
        lines = [line.replace(",", ".") for line in lines]
    try:
        values = np.loadtxt(
            lines,
            delimiter=None if dialect.separator == " " else dialect.separator,
            comments=None,
            quotechar='"',
            usecols=indices,
            ndmin=2,
        )
    except ValueError:  # text, an empty field, a group of thousands: field by field, to say which and where
        return None
    return [np.ascontiguousarray(values[:, k]) for k in range(len(indices))]


def _column(path: Path, dialect: Dialect, name: str, index: int, stamped: bool, order: str | None) -> Array:
    """One column field by field. Raises InputError that names the first field that is no value."""
    tokens = [fields_of(line, dialect.separator)[index] for _, line in dialect.rows]

    def refused(k: int, allowed: str) -> InputError:
        where = f"row {k + 1} (line {dialect.rows[k][0]}), column {name}"
        return InputError(path, where, tokens[k], allowed)

    if stamped:
        try:
            return seconds_of_stamps(tokens, order)
        except ValueError as error:
            raise refused(error.args[0], error.args[1]) from None
    values = np.empty(len(tokens))
    for k, token in enumerate(tokens):
        try:
            values[k] = value_of(token, dialect.decimal)
        except ValueError:
            mark = "comma" if dialect.decimal == "," else "point"
            raise refused(k, f"a number with decimal {mark}, or NaN") from None
    return values
