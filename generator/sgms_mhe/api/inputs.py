"""Arguments of every function: a machine by path, name or as it was loaded; a log by path, as a Log or as a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from sgms_mhe.configuration import load_machine, override_log
from sgms_mhe.logfiles.frames import FRAME, Frame, read_frame
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.logfiles.reading import check_kind, log_of, understand, understand_table
from sgms_mhe.machine import Machine, log_mapping
from sgms_mhe.signals.logs import Log, check_rate

LogSource = str | Path | Log | Frame
"""A log file of any format, a log that was read or simulated, or a pandas.DataFrame with the columns of a log."""

Note = Callable[[str], None]
"""Called with sentences on what was understood of a log."""


class Progress(Protocol):
    """Called with steps done and steps in all."""

    def __call__(self, done: int, total: int, /) -> Any:
        """Show it."""


def load(machine: str | Path | Machine) -> Machine:
    """Read a machine file.

    Args:
        machine: path of the file, or the name of one in `machines/`; a machine that was loaded is returned as it is.

    Raises:
        InputError: whatever is wrong with the file: names it, the key, the value and what is allowed.
    """
    return machine if isinstance(machine, Machine) else load_machine(machine)


def read_log(
    log: LogSource,
    machine: str | Path | Machine | None = None,
    *,
    start_s: float = 0.0,
    end_s: float = math.inf,
    table: Mapping[str, Any] | None = None,
    note: Note | None = None,
) -> Log:
    """Read a log in SI units; every array (n,), NaN where a sample is missing.

    Args:
        log: a file of any format and dialect; a Log; or a pandas.DataFrame, whose columns are understood as those of a
            file are: by their names and units, or by `[log]` of the machine.
        machine: whose `[log]`, kind of axis and rate count; None: the log speaks for itself.
        start_s, end_s: part of it [s since the first sample].
        table: content of a table `[log]`, laid over that of the machine: `{"rate": 1000.0}`.
        note: called with each sentence on what was left out or changed.

    Raises:
        InputError: it cannot be read, is of another kind of axis or rate than the machine, or time is not uniform.
    """
    axis = None if machine is None else override_log(load(machine), table or {})
    mapping = log_mapping(table, "[log]") if table and axis is None else None
    if isinstance(log, Log):
        if axis is not None:
            check_kind(log.source or "log", log.kind, log.units.keyed(log.columns), axis)
            check_rate(log, axis)
        return log.part(start_s, end_s)
    if isinstance(log, str | Path):
        reading = understand(log, axis, mapping, note)
    else:
        reading = understand_table(FRAME, read_frame(log), axis, mapping, note)
    return log_of(reading, axis).part(start_s, end_s)


def recorded_log(
    log: LogSource, machine: Machine, *, start_s: float = 0.0, end_s: float = math.inf, note: Note | None = None
) -> Log:
    """Read a log that an axis of this machine can have left.

    Raises:
        InputError: as read_log does; an ImplausibleError where its columns cannot be what they are called.
    """
    found = read_log(log, machine, start_s=start_s, end_s=end_s, note=note)
    check_plausible(found, machine)
    return found
