"""Measured logs: arrays in SI units, and back into files. `sgms_mhe.logfiles` reads them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from sgms_mhe.machine import OF_KIND, QUANTITIES, Kind, Machine, Units, log_line
from sgms_mhe.support.arrays import AnyArray, Array
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write
from sgms_mhe.support.libraries import data_frame
from sgms_mhe.support.notebooks import Presentation, Shown, labelled_axes

COLUMNS: Final = tuple(quantity.column for quantity in QUANTITIES["linear"])
"""Every column of a log, the required ones first."""

JITTER: Final = 0.01
"""Largest deviation of a time step, and of the log's rate from the machine's, as a fraction."""


@dataclass(frozen=True, repr=False)
class Log(Shown):
    """A log in SI units; all arrays (n,), NaN where a sample is missing (never in time_s).

    Of a rotary axis `position_m` is its angle [rad], `force_N` the torque [N m], and so on: `kind` says which it is.
    `rate` [Hz] is measured from time_s. The optional columns are used in place of computed signals. `payload`:
    whether it moves a mass of its own beside the axis, as `[log] payload` says. `force_keys`: keys a line
    of `[log]` needs for the force that was read. `run`: by the
    run itself: mass [kg] of the weight on its arm, whose length [m] hangs down at 0, gain and supply [V] of
    its drive. Without a force (NaN throughout) a command drives the axis.
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
    kind: Kind = "linear"
    goal_m: Array | None = None
    voltage_V: Array | None = None
    duty: Array | None = None
    enabled: Array | None = None
    payload: bool = False
    run: Mapping[str, float] = field(default_factory=dict)
    force_keys: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def units(self) -> Units:
        """Return the names of the units of this kind of axis."""
        return OF_KIND[self.kind]

    @property
    def columns(self) -> dict[str, Array]:
        """The columns that are present, by the names of a linear axis, in the order of a log file."""
        present = {name: getattr(self, name) for name in COLUMNS}
        return {name: values for name, values in present.items() if values is not None}

    @property
    def is_friction_alone(self) -> bool:
        """Return True if a recorded friction stands for the force: the driving force is unknown."""
        return self.friction_N is not None and np.array_equal(self.force_N, self.friction_N, equal_nan=True)

    @property
    def is_commanded(self) -> bool:
        """Return True if no force was recorded but a command: it drives the axis."""
        has_command = any(values is not None for values in (self.goal_m, self.voltage_V, self.duty))
        return has_command and bool(np.isnan(self.force_N).all())

    def to_frame(self) -> Any:
        """A pandas.DataFrame of the columns that are present, named as in a log file of this kind of axis."""
        return data_frame(self._recorded())

    def _recorded(self) -> dict[str, Array]:
        """Columns of a file, as this kind of axis names them: no force where none was recorded."""
        kept = {name: values for name, values in self.columns.items() if name != "force_N" or not self.is_commanded}
        recorded: dict[str, Array] = self.units.keyed(kept)
        return recorded

    def plot(self, axes: Any | None = None) -> Any:
        """Draw the force over time; return the matplotlib axes, those given or new ones."""
        push = self.units.named("force_N")
        axes = labelled_axes(axes, "time [s]", f"{self.units.push} [{self.units.force}]")
        axes.plot(self.time_s, self.force_N, linewidth=0.8, label=push)
        return axes

    def _shown(self) -> Presentation:
        columns = self._recorded()
        rows = [(name, f"{np.nanmin(v):.6g}", f"{np.nanmax(v):.6g}", np.isnan(v).sum()) for name, v in columns.items()]
        title = f"{self.source or 'log'}: {len(self)} samples at {self.rate:.6g} Hz"
        return title, ("column", "least", "largest", "missing"), rows

    def part(self, start_s: float = 0.0, end_s: float = math.inf) -> Self:
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


def align_velocity(log: Log) -> Log:
    """Return a whole record with its velocity over the sample before each instant, as a difference of the position is.

    Some loggers write that, others the velocity at the instant itself, which is half a sample ahead of it: acceleration
    is then as much ahead of the force. The better agreement with the position's differences decides.
    """
    velocity = log.velocity_m_s
    if velocity is None:
        return log
    moved, mean = np.diff(log.position_m) * log.rate, 0.5 * (velocity[1:] + velocity[:-1])
    if not np.nansum((mean - moved) ** 2) < np.nansum((velocity[1:] - moved) ** 2):
        return log
    return replace(log, velocity_m_s=np.concatenate((velocity[:1], mean)))


def check_rate(log: Log, machine: Machine) -> None:
    """Refuse a log that was not recorded at the machine's sample rate."""
    rate = machine.sampling.rate
    if abs(log.rate - rate) <= JITTER * rate:
        return
    allowed = f"sampling.rate of {machine.name}, {rate:g} Hz"
    unit = next((unit for unit, factor in _CLOCKS.items() if abs(log.rate / factor - rate) <= JITTER * rate), None)
    if unit is not None:
        line = log_line("time_s", variable="...", unit=unit)
        allowed += f"; time in {unit}? [log] (machine file, --log) has {line}"
    raise InputError(log.source or "log", "time_s", f"{log.rate:.6g} Hz", allowed)


def advise_time_unit(rate: float) -> str:
    """Return the line of [log] for a time in another unit, where no drive is recorded at this rate [Hz]; or ''."""
    if SLOW_HZ <= rate <= FAST_HZ:
        return ""
    slow = (unit for unit, factor in _CLOCKS.items() if factor < 1.0 and rate < SLOW_HZ <= rate / factor)
    line = log_line("time_s", variable="...", unit=next(slow, "..."))
    return f"time in another unit? [log] (machine file, --log) has {line}"


SLOW_HZ: Final = 20.0
FAST_HZ: Final = 1e6
"""Rates outside which a drive is not recorded."""
_CLOCKS: Final = {unit: factor for unit, (factor, _) in QUANTITIES["linear"][0].units.items() if factor != 1.0}
"""Units in which a time may be that was read as seconds, and their lengths [s]."""


def write_log(path: str | Path, log: Log) -> None:
    """Write a log atomically as CSV (numbers by shortest round-trip) or, by its suffix, as NPZ; columns of its kind."""
    columns = log._recorded()
    if Path(path).suffix.lower() == ".npz":
        with atomic_write(path) as stream:
            np.savez(stream, allow_pickle=False, **columns)
    else:
        write_columns(path, columns)


def write_columns(path: str | Path, columns: Mapping[str, AnyArray]) -> None:
    """Write named columns (n,) as CSV, atomically; floats by shortest round-trip, integers as integers."""
    block = 65536
    with atomic_write(path) as stream:
        stream.write((",".join(columns) + "\n").encode())
        length = len(next(iter(columns.values())))
        for start in range(0, length, block):
            parts = (map(repr, values[start : start + block].tolist()) for values in columns.values())
            stream.write("".join(",".join(row) + "\n" for row in zip(*parts, strict=True)).encode())
