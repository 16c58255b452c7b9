"""Columns of Parquet and Feather files, by pyarrow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sgms_mhe.logfiles.table import Column, Table, array_row, real, refuse_damage, seconds
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.libraries import optional_library


def read_parquet(path: Path) -> Table:
    """The table of a Parquet file; a unit is a field's metadata `unit`. Null is a missing sample.

    Raises InputError for a damaged file and where pyarrow is absent, OSError as open does.
    """
    parquet = optional_library("pyarrow.parquet", "parquet", "Parquet", path)
    return _read(path, "Parquet", parquet.read_schema, parquet.read_table)


def read_feather(path: Path) -> Table:
    """The table of a Feather file of either version, which is Arrow's too, as `read_parquet`."""
    feather = optional_library("pyarrow.feather", "parquet", "Feather", path)
    return _read(path, "Feather", lambda name: feather.read_table(name, memory_map=True).schema, feather.read_table)


def _read(path: Path, form: str, read_schema: Callable[[Path], Any], read_columns: Callable[..., Any]) -> Table:
    arrow = optional_library("pyarrow", "parquet", form, path)
    damaged = f"a whole {form} file, its columns numbers or time stamps"
    with refuse_damage(path, damaged):
        schema = read_schema(path)
    columns = tuple(Column(entry.name, entry.name, _unit(entry.metadata)) for entry in schema)
    stamped = frozenset(entry.name for entry in schema if arrow.types.is_timestamp(entry.type))

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        with refuse_damage(path, damaged):
            content = read_columns(path, columns=list(names))
            values = {name: content.column(name).to_numpy() for name in names}
            return {n: seconds(value) if n in stamped else real(path, n, value) for n, value in values.items()}

    return Table(form, columns, read, array_row, stamped=stamped)


def _unit(metadata: Any) -> str:
    value = (metadata or {}).get(b"unit", b"")
    return str(value.decode("utf-8", "replace"))
