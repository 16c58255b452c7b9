"""Delimited text: a header line with the columns' names, a row per sample; commas, semicolons or tabs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.signals.formats.variables import Array, Choose, Variables
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write


def write_columns(path: str | Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write named columns (n,) as CSV, atomically; floats by shortest round-trip, integers as integers."""
    block = 65536
    with atomic_write(path) as stream:
        stream.write((",".join(columns) + "\n").encode())
        length = len(next(iter(columns.values())))
        for start in range(0, length, block):
            parts = (map(repr, values[start : start + block].tolist()) for values in columns.values())
            stream.write("".join(",".join(row) + "\n" for row in zip(*parts, strict=True)).encode())


def read_columns(path: str | Path, choose: Choose = list) -> dict[str, Array]:
    """Named columns (n,) of a CSV file; `choose` says which of the columns found are wanted. An empty field is NaN.

    Raises InputError with file, row and column for rows of unequal length and for fields that are no numbers.
    """
    try:
        return dict(read_delimited(Path(path), choose).by_name)
    except OSError as error:
        raise InputError(path, "file", None, f"a readable file ({error.strerror or error})") from None


def read_delimited(path: Path, choose: Choose) -> Variables:
    """Read the wanted columns. Raises InputError with row and column for what is no number, OSError as open does."""
    header_line, names, delimiter = _header(path)
    wanted = list(choose(names))
    indices = [names.index(name) for name in wanted]

    def row(index: int) -> str:
        return f"row {index + 1} (line {_line(path, header_line, index)})"

    try:
        values = np.loadtxt(
            path, delimiter=delimiter, skiprows=header_line, comments=None, ndmin=2, encoding="utf-8-sig"
        )
        if values.shape[1] != len(names):
            raise ValueError("header and rows differ in length")
        values = values[:, indices]
    except ValueError:  # text, an empty field, a ragged row: slower, field by field, to say which and where
        values = _slowly(path, header_line, delimiter, names, indices)
    return Variables({name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(wanted)}, row)


def _header(path: Path) -> tuple[int, list[str], str]:
    """(lines up to and including the header, column names, delimiter) of a file that holds at least one row."""
    with path.open(encoding="utf-8-sig", errors="replace", newline=None) as stream:
        number, delimiter = 0, ","
        names: list[str] = []
        for line in stream:
            if not names:
                number += 1
                if not line.strip():
                    continue
                delimiter = max(",;\t", key=line.count)
                names = [name.strip().strip('"').strip() for name in line.lstrip("#").split(delimiter)]
            elif line.strip():
                break
        else:
            what = "header but no row" if names else "nothing"
            raise InputError(path, "file", what, "a header line with the columns' names and at least 2 rows")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InputError(path, f"line {number}", twice[0], "each column's name once in the header")
    return number, names, delimiter


def _lines(path: Path, header_line: int) -> Iterable[tuple[int, str]]:
    """(line number, line) of every row after the header; blank lines are no rows."""
    with path.open("rb") as stream:
        for number, raw in enumerate(stream, start=1):
            if number > header_line and raw.strip():
                try:
                    yield number, raw.decode().rstrip("\r\n")
                except UnicodeDecodeError:
                    raise InputError(path, f"line {number}", None, "UTF-8 text") from None


def _line(path: Path, header_line: int, index: int) -> int:
    return next((number for k, (number, _) in enumerate(_lines(path, header_line)) if k == index), 0)


def _slowly(path: Path, header_line: int, delimiter: str, names: Sequence[str], indices: Sequence[int]) -> Array:
    rows: list[list[float]] = []
    for number, line in _lines(path, header_line):
        fields = line.split(delimiter)
        where = f"row {len(rows) + 1} (line {number})"
        if len(fields) != len(names):
            allowed = f"{len(names)} fields, as many as the header has names"
            raise InputError(path, where, f"{len(fields)} fields", allowed)
        entries = []
        for index in indices:
            field = fields[index].strip().strip('"').strip()
            try:
                if "_" in field or not field.isascii():
                    raise ValueError("digits of a programming language, or of another script")
                entries.append(float(field) if field else np.nan)
            except ValueError:
                raise InputError(path, f"{where}, column {names[index]}", field, "a number, or NaN") from None
        rows.append(entries)
    return np.array(rows).reshape(len(rows), len(indices))
