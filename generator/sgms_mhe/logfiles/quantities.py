"""From the values of a file to SI units."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.logfiles.sources import Source
from sgms_mhe.logfiles.table import Array, Table
from sgms_mhe.machine import COUNTS
from sgms_mhe.support.errors import InputError

PERIODS: Final = (256.0, 4096.0, 8192.0, 65536.0, 16777216.0, 4294967296.0, 1.0, 360.0, 2.0 * np.pi, 400.0)
"""Ranges after which positions start over: registers of 8 to 32 bits, a turn in its units."""
_MANY: Final = 50
"""A jump is one where it is so many times the largest of nearly all other steps."""


class Turns:
    """A recorded number that starts over after `period`, read at once or piece after piece, as one that goes on."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._last = np.empty(0)
        self._correction = 0.0

    def unwrap(self, values: Array) -> Array:
        """The values (n,), those that are missing left out, with the jumps of all before them taken back."""
        good = np.isfinite(values)
        whole, known = values.copy(), values[good]
        steps = np.diff(np.concatenate((self._last, known)))
        half = self._period / 2.0
        short = np.mod(steps + half, self._period) - half
        short[(short == -half) & (steps > 0.0)] = half
        corrections = np.where(np.abs(steps) < half, 0.0, short - steps)
        # One sum in the order of samples, however many of them come at a time.
        taken = np.cumsum(np.concatenate(([self._correction], corrections)))[1 if len(self._last) else 0 :]
        whole[good] = known + taken[: len(known)]
        if len(known):
            self._last, self._correction = known[-1:], float(taken[-1])
        return whole


def turns_of(sources: tuple[Source, ...]) -> dict[str, Turns]:
    """Return the turn counters of the columns that start over, by their names in the table."""
    return {source.column: Turns(source.wrap) for source in sources if source.wrap is not None}


def si_values(path: Path, table: Table, sources: tuple[Source, ...], rate: float | None = None) -> dict[str, Array]:
    """Columns of the log (n,) by their names, in SI units, all of one length; time by `rate` [Hz] where it has none.

    Raises InputError for a matrix without a row, columns of unequal length, and a position that starts over.
    """
    raw = table.read(sorted({source.column for source in sources}))
    for source in sources:
        if source.quantity.role == "position" and source.wrap is None:
            _check_jumps(path, source, _vector(path, source, raw[source.column]), table.row)
    columns = si_piece(path, table, sources, raw, turns_of(sources))
    if "time_s" not in columns and rate is not None:
        columns = {"time_s": np.arange(len(next(iter(columns.values())))) / rate} | columns
    length = len(columns["time_s"])
    for name, values in columns.items():
        if len(values) != length:
            raise InputError(path, f"column {name}", len(values), f"as many rows as time_s has, {length}")
        if name != "time_s" and length >= 2 and not np.isfinite(values).any():
            raise InputError(path, f"column {name}", "NaN throughout", "numbers, NaN only where a sample is missing")
    return columns


def si_piece(
    path: Path, table: Table, sources: tuple[Source, ...], raw: Mapping[str, NDArray[Any]], turns: Mapping[str, Turns]
) -> dict[str, Array]:
    """Columns of a log, or of a piece of one, (n,) by their names, in SI units.

    Args:
        path: for messages.
        table: that `raw` was read from.
        sources: of the columns.
        raw: values by their names in the table.
        turns: of the same log, which remember the piece before.

    Raises:
        InputError: a matrix without a row; time stamps that are no time.
    """
    columns = {}
    for source in sources:
        values = _vector(path, source, raw[source.column])
        if source.quantity.role == "position" and source.column in turns:
            values = turns[source.column].unwrap(values)
        columns[source.quantity.column] = _si(path, source, values, source.column in table.stamped)
    return columns


def _vector(path: Path, source: Source, values: NDArray[Any]) -> Array:
    """A vector (n,): the array itself, or a row of a matrix whose signals lie along its longer side."""
    where = f"variable {source.column}"
    if source.row is None:
        if values.size != max(values.shape, default=0):
            line = f'{source.quantity.column} = {{ variable = "{source.column}", row = 1 }}'
            allowed = f"a vector; [log] of the machine file says which row: {line}"
            raise InputError(path, where, f"array of shape {values.shape}", allowed)
        return values.reshape(-1)
    if values.ndim != 2:
        raise InputError(path, where, f"array of shape {values.shape}", "a matrix, where [log] names a row")
    signals = values if values.shape[0] <= values.shape[1] else values.T
    if source.row > len(signals):
        raise InputError(
            path, f"[log] {source.quantity.column}, row", source.row, f"1 to {len(signals)}, rows of {where}"
        )
    return np.ascontiguousarray(signals[source.row - 1])


def _si(path: Path, source: Source, values: Array, stamped: bool) -> Array:
    quantity = source.quantity
    if stamped:
        if quantity.role != "time":
            raise InputError(path, f"column {source.column}", "time stamps", f"numbers, for {quantity.column}")
        return values
    factor, shift = quantity.units.get(source.unit, (1.0, 0.0))
    if source.unit in COUNTS:
        factor = quantity.counted / (source.counts_per or 1.0)
    if (source.scale, source.offset, factor, shift) == (1.0, 0.0, 1.0, 0.0):
        return values
    return np.asarray((values * source.scale + source.offset) * factor + shift)


def _check_jumps(path: Path, source: Source, values: Array, row: Callable[[int], str]) -> None:
    """Refuse a position that starts over where nothing says after how much."""
    good = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[good])
    if len(steps) < 100:
        return
    jumps = np.abs(steps)
    usual = float(np.quantile(jumps, 0.99))
    first = int(np.argmax(jumps))
    for period in (*PERIODS, *((source.counts_per,) if source.counts_per else ())):
        if abs(jumps[first] - period) <= 2.0 * usual and jumps[first] > _MANY * usual > 0.0:
            column = source.quantity.column
            seen = f"jumps by {steps[first]:.6g}"
            line = f'{column} = {{ variable = "{source.column}", unit = "{source.unit}", wrap = {period:.10g} }}'
            allowed = f"a position that goes on; where it starts over [log] of the machine file says so: {line}"
            raise InputError(path, f"{row(int(good[first + 1]))}, column {source.column}", seen, allowed)
