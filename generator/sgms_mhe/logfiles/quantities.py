"""From the values of a file to SI units."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from sgms_mhe.logfiles.clocks import Note, align_clocks
from sgms_mhe.logfiles.sources import Source
from sgms_mhe.logfiles.table import Table
from sgms_mhe.machine import COUNTS, log_line
from sgms_mhe.support.arrays import AnyArray, Array
from sgms_mhe.support.errors import InputError

PERIODS: Final = (256.0, 4096.0, 8192.0, 65536.0, 16777216.0, 4294967296.0, 1.0, 360.0, 2.0 * np.pi, 400.0)
"""Ranges after which positions start over: registers of 8 to 32 bits, a turn in its units."""
_MANY: Final = 5.0
"""A jump is one where it is so many times the largest of all other steps."""
_ONE: Final = 50.0
"""The same of a single jump, which has to be one of PERIODS."""
_LARGEST: Final = 1e15
"""A recorded number at or beyond it is none of an encoder or a register, and its digits tell no period."""
_LEAST: Final = 100
"""Samples that tell whether a column jumps."""
REGISTERS: Final = (8, 12, 16, 24, 32)
"""Bits of registers."""
_WHOLE: Final = 0.02
"""Of a step between two values: how far all of them are from whole numbers of it."""
_EXACT: Final = 2.0**53
"""Largest count that a number holds to the last one."""
_LEFT: Final = 0.1
"""Share of the jumps of an unsigned record that the signed numbers may have."""
_CUT: Final = 0.01
"""Share of the samples by which a column may be longer or shorter than time."""


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
    """Return the turn counters of the positions that start over, by their names in the table."""
    positions = (source for source in sources if source.quantity.role == "position")
    return {source.column: Turns(source.wrap) for source in positions if source.wrap is not None}


def si_values(
    path: Path, table: Table, sources: tuple[Source, ...], rate: float | None, note: Note
) -> dict[str, Array]:
    """Columns of the log (n,) by their names, in SI units, all of one length; time by `rate` [Hz] where it has none.

    `note` is called with sentences on the part cut off. Raises InputError for a matrix without a row, columns of
    unequal length, a position that starts over, and a number with a sign recorded without.
    """
    names = {source.column for source in sources}
    raw = table.read(sorted(names | {table.clocks[name] for name in names if name in table.clocks}))
    for source in sources:
        if source.quantity.role == "position" and source.wrap is None and source.signed is None:
            _check_jumps(path, source, _vector(path, source, raw[source.column]), table.row)
    sources = check_signs(path, sources, raw, table.row)
    columns = si_piece(path, table, sources, raw, turns_of(sources))
    if table.clocks and "time_s" in columns:
        columns = align_clocks(path, columns, _clocks(path, table, sources, raw), note)
    if "time_s" not in columns and rate is not None:
        columns = {"time_s": np.arange(max(map(len, columns.values()))) / rate} | columns
    length, shortest = len(columns["time_s"]), min(map(len, columns.values()))
    for name, values in columns.items():
        if abs(len(values) - length) > _CUT * length:
            raise InputError(path, f"column {name}", len(values), f"as many rows as time_s has, {length}")
        if name != "time_s" and length >= 2 and not np.isfinite(values).any():
            raise InputError(path, f"column {name}", "NaN throughout", "numbers, NaN only where a sample is missing")
    if any(len(values) > shortest for values in columns.values()):
        lengths = ", ".join(f"{name} {len(values)}" for name, values in columns.items())
        note(f"columns of unequal length ({lengths} samples) are cut to the first {shortest}")
    return {name: values[:shortest] for name, values in columns.items()}


def _clocks(path: Path, table: Table, sources: tuple[Source, ...], raw: Mapping[str, AnyArray]) -> dict[str, Array]:
    """Times [s] of the columns that are on another clock than the log's; both in one unit."""
    time = next(source for source in sources if source.quantity.role == "time")
    others = {s.quantity.column: table.clocks[s.column] for s in sources if s.column in table.clocks}
    return {
        name: _si(path, time, _vector(path, time, raw[clock]), clock in table.stamped)
        for name, clock in others.items()
        if clock != time.column
    }


def integrate(columns: Mapping[str, Array], velocity: str) -> Array:
    """Integral of a velocity over time by trapezia (n,), NaN where that is; over a gap by a line.

    Raises ValueError where no velocity is finite.
    """
    time, values = columns["time_s"], columns[velocity]
    good = np.isfinite(values)
    whole = np.interp(time, time[good], values[good])
    position = np.concatenate(([0.0], np.cumsum(0.5 * (whole[1:] + whole[:-1]) * np.diff(time))))
    return np.where(good, position, np.nan)


def si_piece(
    path: Path, table: Table, sources: tuple[Source, ...], raw: Mapping[str, AnyArray], turns: Mapping[str, Turns]
) -> dict[str, Array]:
    """Columns of a log, or of a piece of one, (n,) by their names, in SI units.

    Args:
        path: for messages.
        table: that `raw` was read from.
        sources: of the columns.
        raw: values by their names in the table.
        turns: of the same log, which remember the piece before.

    Raises:
        InputError: a matrix without a row; time stamps that are no time; a number beyond its stated range.
    """
    columns = {}
    for source in sources:
        values = _vector(path, source, raw[source.column])
        if source.period is not None:
            if not np.all(np.isnan(values) | (np.abs(values) < source.period)):
                allowed = f"recorded numbers below {source.period:.10g}, after which they start over as [log] says"
                raise InputError(path, f"column {source.column}", float(np.nanmax(np.abs(values))), allowed)
            values = _centre(values, source.period)
        if source.quantity.role == "position" and source.column in turns:
            values = turns[source.column].unwrap(values)
        columns[source.quantity.column] = _si(path, source, values, source.column in table.stamped)
    return columns


def _vector(path: Path, source: Source, values: AnyArray) -> Array:
    """A vector (n,): the array itself, or a row of a matrix whose signals lie along its longer side."""
    where = f"variable {source.column}"
    if source.row is None:
        if values.size != max(values.shape, default=0):
            line = f'{source.quantity.column} = {{ variable = "{source.column}", row = 1 }}'
            allowed = f"a vector; [log] (machine file, --log) says which row: {line}"
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
    known = values[good]
    steps = np.diff(known)
    if len(known) <= _LEAST or not np.abs(known).max() < _LARGEST:
        return
    sizes, extent = np.abs(steps), float(np.ptp(known))
    jumps = np.flatnonzero(sizes > 0.5 * extent)
    rest = float(np.delete(sizes, jumps).max(initial=0.0))
    count = len(jumps)
    # From one end to the other, with a motion beside it that is slow: as of one that starts over, and no other.
    if not count or sizes[jumps].min() < extent - 2.0 * rest or not sizes[jumps].min() > _MANY * rest > 0.0:
        return
    # What it moved on meanwhile is what it did before and after.
    before, after = steps[np.maximum(jumps - 1, 0)], steps[np.minimum(jumps + 1, len(steps) - 1)]
    beside = (before + after) / 2.0
    beside[np.abs(beside) > rest] = 0.0
    periods = np.abs(steps[jumps] - beside)
    usual = (*PERIODS, *((source.counts_per,) if source.counts_per else ()))
    listed = next((p for p in usual if abs(float(np.median(periods)) - p) <= rest), None)
    if count < 2 and (listed is None or sizes[jumps[0]] <= _ONE * rest):
        return  # an encoder that jumped
    if listed is None and count % 2 == 0 and bool(np.all(np.diff(jumps)[::2] == 1)):
        return  # lone readings that failed: there and straight back
    off = float(np.median(np.abs(before - after)) + np.ptp(periods))
    period = listed if listed is not None else _round_number(float(np.median(periods)), min(off, rest / 4.0))
    first, column = int(jumps[0]), source.quantity.column
    seen = f"jumps by {steps[first]:.6g}" + (f", {count} such jumps" if count > 1 else "")
    line = log_line(column, **source.keys, wrap=period)
    allowed = f"a position that goes on; where it starts over [log] (machine file, --log) says so: {line}"
    raise InputError(path, f"{row(int(good[first + 1]))}, column {source.column}", seen, f"{allowed}, as --wrap")


def _centre(values: Array, period: float) -> Array:
    """A number that starts over after `period`, about zero."""
    return np.mod(values + 0.5 * period, period) - 0.5 * period


def check_signs(
    path: Path, sources: tuple[Source, ...], raw: Mapping[str, AnyArray], row: Callable[[int], str]
) -> tuple[Source, ...]:
    """The sources, with the period of each register whose numbers are scaled.

    Args:
        path: for messages.
        sources: of a log, or of its last samples.
        raw: values by their names in the table.
        row: name of a sample.

    Raises:
        InputError: a number with a sign recorded without, of which [log] says nothing: it jumps by the range
            of its register where it turns. Or a scaled number that is said to be one and does not show its period.
    """
    return tuple(_check_sign(path, source, _vector(path, source, raw[source.column]), row) for source in sources)


def _check_sign(path: Path, source: Source, values: Array, row: Callable[[int], str]) -> Source:
    """The source as `check_signs` has it."""
    if source.wrap is not None or source.quantity.role in ("time", "temperature", "position"):
        return source
    good = np.flatnonzero(np.isfinite(values))
    known = values[good]
    is_whole = bool(np.all(known == np.rint(known)))
    if source.signed is not None and is_whole:
        return source
    bits, period = _find_register(known)
    if source.signed is not None:
        if not 0 < bits <= source.signed:
            allowed = (
                f"whole numbers, or jumps by the range of {source.signed} bits; of scaled numbers [log] (machine file, "
                f"--log) says it in their unit: wrap = 2^{source.signed} times the step between two of them"
            )
            raise InputError(path, f"column {source.column}, signed", source.signed, allowed)
        return replace(source, signed=None, wrap=period)
    if bits:
        jumps = np.flatnonzero(np.abs(np.diff(known)) > 0.5 * period)
        more = {"signed": bits} if period == 2.0**bits else {"wrap": period}
        seen = f"jumps by {known[jumps[0] + 1] - known[jumps[0]]:.6g}, {len(jumps)} such jumps"
        allowed = (
            f"a number with its sign; an unsigned record of a signed number of {bits} bits, as this one seems, "
            f"[log] (machine file, --log) turns back: {log_line(source.quantity.column, **source.keys, **more)}"
        )
        raise InputError(path, f"{row(int(good[jumps[0] + 1]))}, column {source.column}", seen, allowed)
    return source


def _find_register(known: Array) -> tuple[int, float]:
    """(bits, period) of the register with a sign a record (n) without one shows; (0, 0) where it shows none."""
    if len(known) < _LEAST or known.min() < 0.0 or not 1.0 / _LARGEST < known.max() < _LARGEST:
        return 0, 0.0
    steps = np.abs(np.diff(known))
    if steps.max() <= 0.5 * known.max():
        return 0, 0.0
    levels = np.unique(known)
    for bits, period in _registers(levels) if len(levels) >= 4 else ():
        turned = _centre(known, period)
        jumps = np.count_nonzero(steps > 0.5 * period)
        left = np.count_nonzero(np.abs(np.diff(turned)) > 0.25 * period)
        # Both signs have several values: on and off would have one each, the ends of the range.
        fewest = min(len(np.unique(turned[sign * turned > 0.0])) for sign in (1, -1))
        if jumps and left <= _LEFT * jumps and fewest >= 2:
            return bits, period
    return 0, 0.0


def _registers(levels: Array) -> Iterator[tuple[int, float]]:
    """(bits, period) of registers that may hold sorted numbers from 0 on: by the step between them, or a round range.

    Scaled numbers with too few digits to show the step show the range where they come as close to it as to 0.
    """
    top, least = float(levels[-1]), float(np.diff(levels).min())

    def is_on(step: float) -> bool:
        return least > 0.5 * step and bool(np.abs(levels / step - np.rint(levels / step)).max() < _WHOLE)

    for step in _steps(levels):
        bits = next((bits for bits in REGISTERS if top < 2.0**bits * step), 0)
        if bits and is_on(step):
            yield bits, 2.0**bits * step
    decade = 10.0 ** np.floor(np.log10(top))
    for period in (2.0 ** (np.floor(np.log2(top)) + 1.0), 2.0 * decade, 10.0 * decade):
        if top < period <= 2.0 * top and period - top <= levels[min(len(levels), 10) - 1]:
            yield next((bits for bits in REGISTERS if is_on(period / 2.0**bits)), REGISTERS[-1]), float(period)


def _steps(levels: Array) -> Iterator[float]:
    """Steps of which sorted numbers (n) may be multiples: 1, by decimal or binary places, the least difference."""
    yield 1.0
    for base, most in ((10.0, 9), (2.0, 52)):
        for places in range(1, most + 1):
            counts = levels * base**places
            if counts[-1] < _EXACT and np.abs(counts - np.rint(counts)).max() < 1e-3:
                yield float(np.gcd.reduce(np.rint(counts).astype(np.int64)) / base**places)
                break
    yield float(np.diff(levels).min())


def _round_number(value: float, tolerance: float) -> float:
    """The number of fewest digits within a tolerance."""
    shorter = (float(f"{value:.{digits}g}") for digits in range(1, 17))
    return next((number for number in shorter if abs(number - value) <= tolerance), value)
