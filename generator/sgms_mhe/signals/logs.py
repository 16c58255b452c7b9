"""Measured logs: CSV, NPZ and MAT v5 files into arrays in SI units, checked, and back into files."""

from __future__ import annotations

import math
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.machine import LOG_UNITS, LogColumn, Machine
from sgms_mhe.signals.matfile import mat_variables
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


@dataclass(frozen=True)
class _Table:
    """The wanted variables of a file, and how to tell a user where row i (from 0) stands in it."""

    variables: Mapping[str, Array]
    row: Callable[[int], str]


def read_log(path: str | Path, machine: Machine | None = None) -> Log:
    """Read and check a log; `[log]` of the machine maps the file's variables, scales and units.

    A column whose mapped variable is not in the file is taken from the variable of the column's own name, so that a
    simulated log is read with the machine file that maps a measured one. Raises InputError, which names the first
    offending row, for time that is not uniform within 1 %, for a column that is missing or has no number at all, and
    for files that cannot be read.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    readers = {".csv": _csv_variables, ".txt": _csv_variables, ".npz": _npz_variables, ".mat": _mat_variables}
    if suffix not in readers:
        raise InputError(path, "file name", path.name, f"a log with one of the suffixes {', '.join(readers)}")
    sources: dict[str, LogColumn] = {}

    def choose(found: Sequence[str]) -> list[str]:
        sources.update(_sources(path, found, machine))
        return sorted({source.variable for source in sources.values()})

    try:
        table = readers[suffix](path, choose)
    except OSError as error:
        raise InputError(path, "file", None, f"a readable log ({error.strerror or error})") from None
    columns = {name: _si(name, source, table.variables[source.variable]) for name, source in sources.items()}
    _check_columns(path, columns, table.row)
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


def write_columns(path: str | Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write named columns (n,) as CSV, atomically; floats by shortest round-trip, integers as integers."""
    block = 65536
    with atomic_write(path) as stream:
        stream.write((",".join(columns) + "\n").encode())
        length = len(next(iter(columns.values())))
        for start in range(0, length, block):
            parts = (map(repr, values[start : start + block].tolist()) for values in columns.values())
            stream.write("".join(",".join(row) + "\n" for row in zip(*parts, strict=True)).encode())


def read_columns(path: str | Path, choose: Callable[[Sequence[str]], Iterable[str]] = list) -> dict[str, Array]:
    """Named columns (n,) of a CSV file; `choose` says which of the columns found are wanted. An empty field is NaN.

    Raises InputError with file, row and column for rows of unequal length and for fields that are no numbers.
    """
    try:
        return dict(_csv_variables(Path(path), choose).variables)
    except OSError as error:
        raise InputError(path, "file", None, f"a readable file ({error.strerror or error})") from None


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


# --- CSV --------------------------------------------------------------------------------------------------------------


def _csv_variables(path: Path, choose: Callable[[Sequence[str]], Iterable[str]]) -> _Table:
    header_line, names, delimiter = _csv_header(path)
    wanted = list(choose(names))
    indices = [names.index(name) for name in wanted]

    def row(index: int) -> str:
        return f"row {index + 1} (line {_csv_line(path, header_line, index)})"

    try:
        values = np.loadtxt(
            path, delimiter=delimiter, skiprows=header_line, comments=None, ndmin=2, encoding="utf-8-sig"
        )
        if values.shape[1] != len(names):
            raise ValueError("header and rows differ in length")
        values = values[:, indices]
    except ValueError:  # text, an empty field, a ragged row: slower, field by field, to say which and where
        values = _csv_slowly(path, header_line, delimiter, names, indices)
    return _Table({name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(wanted)}, row)


def _csv_header(path: Path) -> tuple[int, list[str], str]:
    """(lines up to and including the header, column names, delimiter) of a file that holds at least one row."""
    with path.open(encoding="utf-8-sig", errors="replace", newline=None) as stream:
        number, delimiter = 0, ","
        names: list[str] = []
        for line in stream:
            if not names:
                number += 1
                if not line.strip():
                    continue
                delimiter = max(",;\t", key=line.count)
                names = [name.strip().strip('"').strip() for name in line.lstrip("#").split(delimiter)]
            elif line.strip():
                break
        else:
            what = "header but no row" if names else "nothing"
            raise InputError(path, "file", what, "a header line with the columns' names and at least 2 rows")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InputError(path, f"line {number}", twice[0], "each column's name once in the header")
    return number, names, delimiter


def _csv_lines(path: Path, header_line: int) -> Iterable[tuple[int, str]]:
    """(line number, line) of every row after the header; blank lines are no rows."""
    with path.open("rb") as stream:
        for number, raw in enumerate(stream, start=1):
            if number > header_line and raw.strip():
                try:
                    yield number, raw.decode().rstrip("\r\n")
                except UnicodeDecodeError:
                    raise InputError(path, f"line {number}", None, "UTF-8 text") from None


def _csv_line(path: Path, header_line: int, index: int) -> int:
    return next((number for k, (number, _) in enumerate(_csv_lines(path, header_line)) if k == index), 0)


def _csv_slowly(path: Path, header_line: int, delimiter: str, names: Sequence[str], indices: Sequence[int]) -> Array:
    rows: list[list[float]] = []
    for number, line in _csv_lines(path, header_line):
        fields = line.split(delimiter)
        where = f"row {len(rows) + 1} (line {number})"
        if len(fields) != len(names):
            allowed = f"{len(names)} fields, as many as the header has names"
            raise InputError(path, where, f"{len(fields)} fields", allowed)
        entries = []
        for index in indices:
            field = fields[index].strip().strip('"').strip()
            try:
                if "_" in field or not field.isascii():
                    raise ValueError("digits of a programming language, or of another script")
                entries.append(float(field) if field else np.nan)
            except ValueError:
                raise InputError(path, f"{where}, column {names[index]}", field, "a number, or NaN") from None
        rows.append(entries)
    return np.array(rows).reshape(len(rows), len(indices))


# --- NPZ and MAT ------------------------------------------------------------------------------------------------------


def _npz_variables(path: Path, choose: Callable[[Sequence[str]], Iterable[str]]) -> _Table:
    with path.open("rb") as stream:
        try:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise ValueError("a single array")
            variables = {name: archive[name] for name in choose(archive.files)}
        except InputError:
            raise
        except Exception as error:  # the readers of a damaged file stumble in many ways
            raise _damaged(path, "a whole NPZ archive of numeric arrays", error) from None
    return _Table({name: _vector(path, name, value) for name, value in variables.items()}, _array_row)


def _mat_variables(path: Path, choose: Callable[[Sequence[str]], Iterable[str]]) -> _Table:
    try:
        found = mat_variables(path)
        variables = {name: found[name].read() for name in choose(list(found))}
    except NotImplementedError:
        raise InputError(path, "file", None, "MAT v5; this one is v7.3 (save it with -v7)") from None
    except (ValueError, zlib.error) as error:
        raise _damaged(path, "a whole MAT v5 file, its columns vectors of real numbers", error) from None
    return _Table({name: _vector(path, name, value) for name, value in variables.items()}, _array_row)


def _damaged(path: Path, allowed: str, error: Exception) -> InputError:
    return InputError(path, "file", None, f"{allowed} ({type(error).__name__}: {error})")


def _array_row(index: int) -> str:
    return f"row {index + 1}"


def _vector(path: Path, name: str, value: Any) -> Array:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub" or array.size != max(array.shape, default=0):
        found = f"{array.dtype} array of shape {array.shape}"
        raise InputError(path, f"variable {name}", found, "a vector of real numbers, one per row")
    return array.reshape(-1).astype(np.float64)
