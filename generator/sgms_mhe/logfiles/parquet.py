"""Columns of a Parquet file, by pyarrow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sgms_mhe.logfiles.table import Array, Column, Table, array_row, damage_error, real, seconds
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.libraries import optional_library

_WHOLE = "a whole Parquet file, its columns numbers or time stamps"


def read_parquet(path: Path) -> Table:
    """The table of a Parquet file; a unit is a field's metadata `unit`. Null is a missing sample.

    Raises InputError for a damaged file and where pyarrow is absent, OSError as open does.
    """
    parquet = optional_library("pyarrow.parquet", "parquet", "Parquet", path)
    arrow = optional_library("pyarrow", "parquet", "Parquet", path)
    with path.open("rb"):
        pass  # a file that cannot be opened is told from one that is no Parquet
    try:
        schema = parquet.read_schema(path)
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise damage_error(path, _WHOLE, error) from None
    columns = tuple(Column(entry.name, entry.name, _unit(entry.metadata)) for entry in schema)
    stamped = frozenset(entry.name for entry in schema if arrow.types.is_timestamp(entry.type))

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        try:
            content = parquet.read_table(path, columns=list(names))
            values = {name: content.column(name).to_numpy() for name in names}
            return {name: _values(path, name, value, name in stamped) for name, value in values.items()}
        except InputError:
            raise
        except (arrow.ArrowException, OSError, ValueError) as error:
            raise damage_error(path, _WHOLE, error) from None

    return Table("Parquet", columns, read, array_row, stamped=stamped)


def _unit(metadata: Any) -> str:
    value = (metadata or {}).get(b"unit", b"")
    return str(value.decode("utf-8", "replace"))


def _values(path: Path, name: str, value: Any, is_stamp: bool) -> Array:
    if is_stamp:
        return seconds(np.asarray(value))
    return real(path, name, value)
