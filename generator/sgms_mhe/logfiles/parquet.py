"""Columns of Parquet and Feather files and of LeRobot data sets, by pyarrow."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_mhe.logfiles.table import Column, Table, array_row, real, refuse_damage, seconds
from sgms_mhe.support.arrays import AnyArray, Array, Index
from sgms_mhe.support.libraries import optional_library

INFO: Final = Path("meta/info.json")
"""File that describes a LeRobot data set, below its folder."""
EPISODE: Final = "episode_index"
CLOCK: Final = "timestamp"
PAUSE_S: Final = 1.0
"""Between episodes, as long as samples are missing [s]."""


def read_parquet(path: Path) -> Table:
    """The table of a Parquet file, or of all episodes of a LeRobot data set, its folder; null is a missing sample.

    A unit is a field's metadata `unit`. Elements of lists are columns, `name[0]`; of a data set that names them,
    `observation.state.elbow.pos`. Raises InputError for a damaged file and where pyarrow is absent, OSError as open.
    """
    parquet = optional_library("pyarrow.parquet", "parquet", "Parquet", path)
    with refuse_damage(path, "a whole Parquet file, or a data set of some"):
        content = parquet.ParquetDataset(path / "data" if path.is_dir() else path)
    table = _read(path, "Parquet", content.schema, lambda names: content.read(columns=names))
    folders = (path, *path.absolute().parents)
    info = next((folder / INFO for folder in folders if (folder / INFO).is_file()), None)
    return table if info is None else _read_episodes(path, table, info)


def read_feather(path: Path) -> Table:
    """The table of a Feather file of either version, which is Arrow's too, as `read_parquet`."""
    feather = optional_library("pyarrow.feather", "parquet", "Feather", path)
    with refuse_damage(path, "a whole Feather file"):
        schema = feather.read_table(path, memory_map=True).schema
    return _read(path, "Feather", schema, lambda names: feather.read_table(path, columns=names))


def _read(path: Path, form: str, schema: Any, read_columns: Callable[[list[str]], Any]) -> Table:
    arrow = optional_library("pyarrow", "parquet", form, path)
    compute = optional_library("pyarrow.compute", "parquet", form, path)
    damaged = f"a whole {form} file, its columns numbers, lists of as many, or time stamps"
    where: dict[str, tuple[str, int | None]] = {}
    with refuse_damage(path, damaged):
        for entry in schema:
            name, size = entry.name, None
            if arrow.types.is_fixed_size_list(entry.type):
                size = entry.type.list_size
            elif arrow.types.is_list(entry.type):  # as long as the first one
                size = len(next(iter(read_columns([name]).column(name).drop_null()[:1].to_pylist()), ()))
            where |= {name: (name, None)} if size is None else {f"{name}[{k}]": (name, k) for k in range(size)}
    stamped = frozenset(entry.name for entry in schema if arrow.types.is_timestamp(entry.type))

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        with refuse_damage(path, damaged):
            content = read_columns(list(dict.fromkeys(where[name][0] for name in names)))
            values = {}
            for name in names:
                column, k = where[name]
                whole = content.column(column)
                value = (whole if k is None else compute.list_element(whole, k)).to_numpy()
                values[name] = seconds(value) if name in stamped else real(path, name, value)
            return values

    columns = tuple(Column(name, name, _unit(schema.field(column).metadata)) for name, (column, _) in where.items())
    return Table(form, columns, read, array_row, stamped=stamped)


def _unit(metadata: Any) -> str:
    return str((metadata or {}).get(b"unit", b"").decode("utf-8", "replace"))


def _read_episodes(path: Path, table: Table, info: Path) -> Table:
    """The table with the names of a data set's lists, and with its episodes one after the other, a pause between."""
    with refuse_damage(info, "what a LeRobot data set says of itself: features, with the names of their elements"):
        features = json.loads(info.read_text())["features"]
        parts = {name: feature.get("names") or () for name, feature in features.items()}
        parts = {name: next(iter(p.values())) if isinstance(p, dict) else p for name, p in parts.items()}  # version 2
        named = {f"{name}[{k}]": f"{name}.{part}" for name, own in parts.items() for k, part in enumerate(own)}
    names = {named.get(column.name, column.name): column.name for column in table.columns}
    columns = tuple(Column(name, name, "s" if name == CLOCK else "") for name in names)

    def read_by_name(wanted: Sequence[str]) -> Mapping[str, AnyArray]:
        found = table.read([names[name] for name in wanted])
        return {name: found[names[name]] for name in wanted}

    table_of_all = replace(table, form="LeRobot data set", columns=columns, read=read_by_name)
    if not {EPISODE, CLOCK} <= names.keys():
        return table_of_all
    number, time = table.read([EPISODE, CLOCK]).values()
    begins = np.flatnonzero(np.diff(number)) + 1
    if not len(begins):
        return table_of_all
    step = float(np.median(np.diff(time)))
    pause = max(2, round(PAUSE_S / step))
    episode = np.searchsorted(begins, np.arange(len(time)), side="right")
    place: Index = np.arange(len(time)) + pause * episode
    shifts = np.cumsum([0.0, *(time[begins - 1] - time[begins] + (pause + 1) * step)])
    clock = np.interp(np.arange(place[-1] + 1), place, time + shifts[episode])

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        spread = {name: np.full(len(clock), np.nan) for name in names}
        for name, values in read_by_name(names).items():
            spread[name][place] = values
        return spread | ({CLOCK: clock} if CLOCK in names else {})

    note = f"{len(begins) + 1} episodes, one after the other: between them {pause} samples are missing"
    return replace(table_of_all, read=read, row=lambda i: array_row(int(np.searchsorted(place, i))), notes=(note,))
