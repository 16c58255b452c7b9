"""Columns of a pandas.DataFrame, of arrays by name, or of any table that gives names and values as a DataFrame does."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from sgms_mhe.logfiles.decimals import Mark, told_by, value_of
from sgms_mhe.logfiles.table import Table, array_row, columns_of, real, seconds
from sgms_mhe.support.arrays import AnyArray, Array
from sgms_mhe.support.errors import InputError

FRAME = Path("DataFrame")
"""What messages call it: a table in memory has no file."""


class Frame(Protocol):
    """Interface of a table in memory; a pandas.DataFrame has it."""

    @property
    def columns(self) -> Iterable[Any]:
        """Names."""

    def __getitem__(self, name: Any, /) -> Any:
        """The values of a column (n,)."""


def read_frame(frame: Frame | Mapping[str, Any]) -> Table:
    """The table of a DataFrame or of arrays by name: numbers, numbers as text, and time stamps.

    An index of times, or one that has a name, is a column of that name (`time_s` where it has none).

    Raises:
        InputError: the argument is no DataFrame, has two columns of a name, or arrays of unequal length.
    """
    try:
        names = list(frame if isinstance(frame, Mapping) else frame.columns)
    except (AttributeError, TypeError):
        allowed = "a path, a Log, a pandas.DataFrame or arrays by name"
        raise InputError("log", "type", type(frame).__name__, allowed) from None
    if len(set(map(str, names))) < len(names):
        raise InputError(FRAME, "columns", list(map(str, names)), "each name once")
    columns = _index(frame, names) | {str(name): np.asarray(frame[name]) for name in names}
    lengths = {name: len(np.atleast_1d(values)) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(FRAME, "lengths", lengths, "as many values in each array")

    def read(wanted: Sequence[str]) -> Mapping[str, Array]:
        return {name: _values(name, columns[name]) for name in wanted}

    stamped = frozenset(name for name, values in columns.items() if values.dtype.kind == "M")
    return Table("DataFrame", columns_of(list(columns)), read, array_row, stamped=stamped)


def _index(frame: Frame | Mapping[str, Any], names: Sequence[Any]) -> dict[str, AnyArray]:
    """The index of a DataFrame as a column, where it has a meaning."""
    index = getattr(frame, "index", None)
    if index is None or callable(index):
        return {}
    values, name = np.asarray(index), getattr(index, "name", None)
    if name is None and values.dtype.kind not in "mM":
        return {}
    name = "time_s" if name is None else str(name)
    return {} if name in map(str, names) else {name: values}


def _values(name: str, values: AnyArray) -> Array:
    """Numbers of a column: those of stamps in seconds since the first, of durations in seconds."""
    if values.dtype.kind == "M":
        return seconds(values)
    if values.dtype.kind == "m":
        return values.astype("timedelta64[ns]").astype(np.int64) / 1e9
    if values.dtype.kind in "OU":
        values = _numbers(name, np.atleast_1d(values))
    return real(FRAME, name, values)


def _numbers(name: str, cells: AnyArray) -> Array:
    """Cells as numbers, texts by the decimal mark they tell. Raises InputError for the first that is none."""
    tokens = [cell.strip() if isinstance(cell, str) else cell for cell in cells.tolist()]
    mark: Mark = "," if any(isinstance(token, str) and told_by(token) == "," for token in tokens) else "."
    numbers = np.full(len(tokens), np.nan)
    for k, token in enumerate(tokens):
        try:
            numbers[k] = value_of(token, mark) if isinstance(token, str) else token
        except (TypeError, ValueError):
            raise InputError(FRAME, f"{array_row(k)}, column {name}", token, "a number, or NaN") from None
    return numbers
