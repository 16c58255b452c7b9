"""Columns of a pandas.DataFrame, or of any table that gives its columns' names and values as one does."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from sgms_mhe.logfiles.table import Array, Table, array_row, columns_of, real, seconds
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


def read_frame(frame: Frame) -> Table:
    """The table of a DataFrame: real numbers and time stamps by column; the index does not count.

    Raises:
        InputError: what is no DataFrame, or has two columns of a name.
    """
    try:
        keys = {str(name): name for name in frame.columns}
        count = len(list(frame.columns))
    except (AttributeError, TypeError):
        raise InputError("log", "type", type(frame).__name__, "a path, a Log or a pandas.DataFrame") from None
    if len(keys) < count:
        raise InputError(FRAME, "columns", list(map(str, frame.columns)), "each name once")

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        values = {name: np.asarray(frame[keys[name]]) for name in names}
        return {name: seconds(v) if v.dtype.kind == "M" else real(FRAME, name, v) for name, v in values.items()}

    stamped = frozenset(name for name, key in keys.items() if np.asarray(frame[key]).dtype.kind == "M")
    return Table("DataFrame", columns_of(list(keys)), read, array_row, stamped=stamped)
