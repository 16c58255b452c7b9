"""Columns that were sampled at times of their own, onto the clock of the position."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from sgms_mhe.logfiles.table import Array
from sgms_mhe.logfiles.timing import GAP
from sgms_mhe.support.errors import InputError

Note = Callable[[str], None]

LEAST: Final = 2
"""Samples that a line goes through."""


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
