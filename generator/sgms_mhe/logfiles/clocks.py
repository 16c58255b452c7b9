"""Clocks of a log: whole and parts of seconds in two columns; columns with times of their own, onto position's."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from sgms_mhe.logfiles.table import Column, Table
from sgms_mhe.logfiles.timing import GAP
from sgms_mhe.support.arrays import AnyArray, Array
from sgms_mhe.support.errors import InputError

Note = Callable[[str], None]

LEAST: Final = 2
"""Samples that a line goes through."""
_PART: Final = re.compile(r"(?P<of>.*?)[\s_.:/]*(?P<unit>(?:nano|micro|n|u)?sec(?:ond)?s?)", re.IGNORECASE)
_PARTS_IN_A_SECOND: Final = {"n": 1e9, "m": 1e6, "u": 1e6}


def join_seconds(table: Table) -> Table:
    """The table with a column of time stamps for each two of whole seconds and of the parts beyond them.

    Such as `stamp.sec` and `stamp.nanosec`, as ROS writes them; other columns of these names are ordinary ones.
    """
    found: dict[str, dict[str, Column]] = {}
    for column in table.columns:
        if name := _PART.fullmatch(column.header):
            unit = name["unit"][0].lower()
            found.setdefault(name["of"], {})["whole" if unit == "s" else unit] = column
    stamps: dict[str, AnyArray] = {}
    for columns in found.values():
        unit = next((unit for unit in columns if unit != "whole"), None)
        if "whole" in columns and unit is not None:
            whole, part = (np.asarray(table.read([c.name])[c.name]) for c in (columns["whole"], columns[unit]))
            if ((whole % 1 == 0) & (part >= 0) & (part < _PARTS_IN_A_SECOND[unit])).all() and whole.ndim == 1:
                since = (whole - whole[0]) + (part - part[0]) / _PARTS_IN_A_SECOND[unit]
                stamps[f"{columns['whole'].name} + {columns[unit].name}"] = since
    if not stamps:
        return table

    def read(wanted: Sequence[str]) -> Mapping[str, AnyArray]:
        own = table.read([name for name in wanted if name not in stamps])
        return {**own, **{name: stamps[name] for name in wanted if name in stamps}}

    return replace(
        table,
        columns=(*table.columns, *(Column(name, "time", "s") for name in stamps)),
        read=read,
        stamped=table.stamped | set(stamps),
    )


def align_clocks(path: Path, columns: Mapping[str, Array], clocks: Mapping[str, Array], note: Note) -> dict[str, Array]:
    """Columns (n,) of a log at the times of its time column that are numbers; `note` is told which were interpolated.

    Args:
        path: for messages.
        columns: time_s (m,), the columns on its clock (m,), and those on others.
        clocks: times [s] of the columns that have others.
        note: called with a sentence.

    Raises:
        InputError: a column with fewer than two samples, or whose clock falls.
    """
    time = columns["time_s"]
    known = np.isfinite(time)
    taken, moved = {}, []
    for name, values in columns.items():
        at = clocks.get(name)
        if at is None or (len(at) == len(time) and np.array_equal(at, time, equal_nan=True)):
            taken[name] = values[: len(known)][known[: len(values)]]
        else:
            moved.append(name)
            taken[name] = _interpolate(path, name, at, values, time[known])
    if moved:
        note(f"{', '.join(moved)}: sampled at other times than position, interpolated to them by lines")
    return taken


def _interpolate(path: Path, name: str, at: Array, values: Array, time: Array) -> Array:
    """Values of a column sampled `at`, by lines at the times (n,); NaN in its gaps and beyond its ends."""
    count = min(len(at), len(values))
    good = np.isfinite(at[:count]) & np.isfinite(values[:count])
    at, values = at[:count][good], values[:count][good]
    if len(at) < LEAST or (np.diff(at) < 0.0).any():
        raise InputError(path, f"column {name}", f"{len(at)} samples", "two samples or more, whose time never falls")
    right = np.clip(np.searchsorted(at, time), 1, len(at) - 1)
    step = float(np.median(np.diff(at)))
    gap = (time < at[0] - 0.5 * step) | (time > at[-1] + 0.5 * step) | (at[right] - at[right - 1] > GAP * step)
    return np.where(gap, np.nan, np.interp(time, at, values))
