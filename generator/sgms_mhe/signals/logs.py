"""Measured logs: files of any format into arrays in SI units, checked, and back into files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.machine import LOG_UNITS, LogColumn, Machine
from sgms_mhe.signals.formats import READERS, write_columns
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write

Array = NDArray[np.float64]

REQUIRED: Final = ("time_s", "position_m", "force_N")
COLUMNS: Final = tuple(LOG_UNITS)
"""Every column of a log, the required ones first."""

JITTER: Final = 0.01
"""Largest deviation of a time step, and of the log's rate from the machine's, as a fraction."""


@dataclass(frozen=True)
class Log:
    """A log in SI units; all arrays (n,), NaN where a sample is missing (never in time_s).

    `rate` [Hz] is measured from time_s. The optional columns are used in place of what would be computed.
    """

    time_s: Array
    position_m: Array
    force_N: Array
    rate: float
    velocity_m_s: Array | None = None
    acceleration_m_s2: Array | None = None
    friction_N: Array | None = None
    temperature_degC: Array | None = None
    source: str = ""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def columns(self) -> dict[str, Array]:
        """The columns that are present, by name, in the order of a log file."""
        present = {name: getattr(self, name) for name in COLUMNS}
        return {name: values for name, values in present.items() if values is not None}

    def part(self, start_s: float = 0.0, end_s: float = math.inf) -> Log:
        """The rows from `start_s` to `end_s` [s since the first sample] as a log of its own.

        Raises:
            InputError: fewer than two rows are left.
        """
        since = self.time_s - self.time_s[0]
        rows = slice(int(np.searchsorted(since, start_s)), int(np.searchsorted(since, end_s, side="right")))
        left = len(since[rows])
        if left < 2:
            asked = f"rows from {start_s:g} to {min(end_s, float(since[-1])):g} s"
            raise InputError(self.source or "log", asked, left, f"at least 2 rows within 0 to {since[-1]:g} s")
        if left == len(self):
            return self
        source = f"{self.source or 'log'}, {since[rows][0]:g} to {since[rows][-1]:g} s"
        columns: dict[str, Any] = {name: values[rows] for name, values in self.columns.items()}
        return replace(self, source=source, **columns)


def read_log(path: str | Path, machine: Machine | None = None) -> Log:
    """Read and check a log; `[log]` of the machine maps the file's variables, scales and units.

    A column whose mapped variable is not in the file is taken from the variable of the column's own name, so that a
    simulated log is read with the machine file that maps a measured one. Raises InputError, which names the first
    offending row, for time that is not uniform within 1 %, for a column that is missing or has no number at all, and
    for files that cannot be read.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise InputError(path, "file name", path.name, f"a log with one of the suffixes {', '.join(READERS)}")
    sources: dict[str, LogColumn] = {}

    def choose(found: Sequence[str]) -> list[str]:
        sources.update(_sources(path, found, machine))
        return sorted({source.variable for source in sources.values()})

    try:
        variables = READERS[suffix](path, choose)
    except OSError as error:
        raise InputError(path, "file", None, f"a readable log ({error.strerror or error})") from None
    columns = {name: _si(name, source, variables.by_name[source.variable]) for name, source in sources.items()}
    _check_columns(path, columns, variables.row)
    time = columns["time_s"]
    log = Log(**columns, rate=(len(time) - 1) / float(time[-1] - time[0]), source=str(path))
    if machine is not None:
        check_rate(log, machine)
    return log


def check_rate(log: Log, machine: Machine) -> None:
    """Refuse a log that was not recorded at the machine's sample rate."""
    rate = machine.sampling.rate
    if not abs(log.rate - rate) <= JITTER * rate:
        raise InputError(
            log.source or "log", "time_s", f"{log.rate:.6g} Hz", f"sampling.rate of {machine.name}, {rate:g} Hz"
        )


def write_log(path: str | Path, log: Log) -> None:
    """Write a log atomically as CSV (numbers by shortest round-trip) or, by its suffix, as NPZ."""
    if Path(path).suffix.lower() == ".npz":
        with atomic_write(path) as stream:
            np.savez(stream, allow_pickle=False, **log.columns)
    else:
        write_columns(path, log.columns)


def _sources(path: Path, found: Sequence[str], machine: Machine | None) -> dict[str, LogColumn]:
    """Which variable of the file each column of the log comes from."""
    mapping = machine.log if machine is not None else None
    sources: dict[str, LogColumn] = {}
    for name in COLUMNS:
        mapped: LogColumn | None = getattr(mapping, name, None)
        if mapped is not None and mapped.variable in found:
            sources[name] = mapped
        elif name in found:
            sources[name] = LogColumn(variable=name)
        elif name in REQUIRED or mapped is not None:
            wanted = name if mapped is None else f"{mapped.variable} (log.{name}) or {name}"
            shown = ", ".join(found[:20]) + (", ..." if len(found) > 20 else "")
            raise InputError(
                path, f"column {name}", None, f"missing: a column {wanted}; the file has {shown or 'none'}"
            )
    return sources


def _si(name: str, source: LogColumn, values: Array) -> Array:
    factor, shift = LOG_UNITS[name][source.unit] if source.unit else (1.0, 0.0)
    if (source.scale, source.offset, factor, shift) == (1.0, 0.0, 1.0, 0.0):
        return values
    return (values * source.scale + source.offset) * factor + shift


def _check_columns(path: Path, columns: Mapping[str, Array], row: Callable[[int], str]) -> None:
    time = columns["time_s"]
    for name, values in columns.items():
        if len(values) != len(time):
            raise InputError(path, f"column {name}", len(values), f"as many rows as time_s has, {len(time)}")
    if len(time) < 2:
        raise InputError(path, "rows", len(time), "at least 2 rows, better some seconds of motion")
    for name, values in columns.items():
        if name != "time_s" and not np.isfinite(values).any():
            raise InputError(path, f"column {name}", "NaN throughout", "numbers, NaN only where a sample is missing")
    steps = np.diff(time)
    finite = steps[np.isfinite(steps)]
    nominal = float(np.median(finite)) if len(finite) else 0.0
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(time[1:]) & (steps > 0) & (np.abs(steps - nominal) <= JITTER * nominal)
    if not np.isfinite(time[0]):
        raise InputError(path, f"{row(0)}, column time_s", float(time[0]), "a finite time in every row")
    if sound.all():
        return
    first = int(np.argmin(sound)) + 1
    value, step = float(time[first]), float(steps[first - 1])
    if not np.isfinite(value):
        allowed = "a finite time in every row"
    elif step == 0.0:
        allowed = "a time after the previous row's (duplicate time)"
    elif step < 0.0:
        allowed = f"a time after the previous row's {time[first - 1]:.9g} s (time decreases)"
    else:
        allowed = (
            f"uniform time within 1 %: a step of {nominal:.9g} s, not {step:.9g} s "
            "(a missing sample keeps its row, with NaN)"
        )
    raise InputError(path, f"{row(first)}, column time_s", value, allowed)
