"""Arguments of every function: a machine by path, name or as it was loaded; a log by path, as a Log or as a table."""

import inspect
import logging
import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol, cast

from sgms_mhe.configuration import load_machine, override_log
from sgms_mhe.logfiles.frames import FRAME, Frame, read_frame
from sgms_mhe.logfiles.plausibility import check_has_force, check_plausible
from sgms_mhe.logfiles.reading import check_kind, log_of, understand, understand_table
from sgms_mhe.machine import Machine, log_mapping
from sgms_mhe.signals.drive import find_force
from sgms_mhe.signals.logs import JITTER, Log, check_rate
from sgms_mhe.support.errors import InputError, LogWarning
from sgms_mhe.support.notebooks import read_only

LogSource = str | Path | Log | Frame | Mapping[str, Any]
"""A log file of any format, a Log, or its columns: a pandas.DataFrame, or arrays by name."""

Note = Callable[[str], None]
"""Called with sentences on what was understood of a log; where nobody listens they are warnings."""

Step = Callable[[str], None]
"""Called with each step of a long computation."""
LOGGER: Final = logging.getLogger("sgms_mhe.progress")
"""Steps of long computations, at level INFO."""


class Progress(Protocol):
    """Called with steps done and steps in all."""

    def __call__(self, done: int, total: int, /) -> Any:
        """Show it."""


def load(machine: str | Path | Machine) -> Machine:
    """Read a machine file.

    Args:
        machine: path of the file, or the name of one in `machines/`; a machine that was loaded is returned as it is.

    Raises:
        InputError: whatever is wrong with the file: names it, the key, the value and the allowed ones.
    """
    return machine if isinstance(machine, Machine) else load_machine(machine)


def list_sources(logs: LogSource | Iterable[LogSource]) -> list[LogSource]:
    """Return the sources of one log or of several."""
    single = isinstance(logs, str | Path | Log | Mapping) or hasattr(logs, "columns")
    return list(cast("Iterable[LogSource]", [logs] if single else logs))


def read_log(
    log: LogSource,
    machine: str | Path | Machine | None = None,
    *,
    start_s: float = 0.0,
    end_s: float = math.inf,
    rate: float | None = None,
    table: Mapping[str, Any] | None = None,
    note: Note | None = None,
) -> Log:
    """Read a log in SI units; every array (n,), NaN where a sample is missing.

    Args:
        log: a file of any format and dialect; a Log; or its columns, a pandas.DataFrame or arrays by name, which are
            understood as those of a file are: by their names and units, or by `[log]` of the machine. An index of
            times, or one that has a name, is a column.
        machine: whose `[log]`, kind of axis and rate count; None: the log speaks for itself.
        start_s, end_s: part of it [s since the first sample].
        rate: samples per second [Hz], where no column says the time.
        table: content of a table `[log]`, laid over that of the machine: `{"rate": 1000.0}`.
        note: called with each sentence on omitted or changed data; None: they are `LogWarning`s.

    Raises:
        InputError: it cannot be read, is of another kind of axis or rate than the machine, or time is not uniform.
    """
    table = {**(table or {}), **({} if rate is None else {"rate": rate})}
    note = warn_of_log if note is None else note
    axis = None if machine is None else override_log(load(machine), table)
    mapping = log_mapping(table, "[log]") if table and axis is None else None
    if isinstance(log, Log):
        if axis is not None:
            check_kind(log.source or "log", log.kind, log.units.keyed(log.columns), axis)
            check_rate(log, axis)
        return read_only(log.part(start_s, end_s))
    if isinstance(log, str | Path):
        reading = understand(log, axis, mapping, note)
    else:
        reading = understand_table(FRAME, read_frame(log), axis, mapping, note)
    return read_only(log_of(reading, axis).part(start_s, end_s))


def read_logs(
    logs: LogSource | Iterable[LogSource],
    machine: Machine | None = None,
    *,
    table: Mapping[str, Any] | None = None,
    note: Note | None = None,
) -> list[Log]:
    """Read the logs of one axis, at one rate where they are resampled: the lowest of theirs, or the machine's.

    Arguments and errors are those of `read_log`; none at all is one too.
    """
    sources, table = list_sources(logs), dict(table or {})
    if not sources:
        raise InputError("logs", "logs", [], "at least one")
    if machine is not None or "rate" in table:
        return [read_log(log, machine, table=table, note=note) for log in sources]
    notes: list[list[str]] = [[] for _ in sources]
    read = [read_log(log, table=table, note=said.append) for log, said in zip(sources, notes, strict=True)]
    if table.get("resample") or any(log.run for log in read):
        table |= {"resample": True, "rate": min(log.rate for log in read)}
    for k, log in enumerate(read):
        if abs(log.rate - table.get("rate", log.rate)) > JITTER * log.rate:
            notes[k].clear()
            read[k] = read_log(sources[k], table=table, note=notes[k].append)
        for sentence in notes[k]:
            (note or warn_of_log)(sentence)
    return read


def warn_of_log(sentence: str) -> None:
    """Warn of how a log was read, at the first line outside of this package."""
    depth, frame = 1, inspect.currentframe()
    while frame is not None and frame.f_globals.get("__name__", "").startswith("sgms_mhe."):
        depth, frame = depth + 1, frame.f_back
    warnings.warn(sentence, LogWarning, stacklevel=depth)


def recorded_log(
    log: LogSource, machine: Machine, *, commanded: bool = False, driven: bool = False, note: Note | None = None
) -> Log:
    """Read a log an axis of this machine can have left.

    `commanded`: it may have no force, but a command; `driven`: its force is then that which the machine's drive made.

    Raises:
        InputError: as read_log does; an ImplausibleError where its columns contradict their names.
    """
    found = read_log(log, machine, note=note)
    if found.is_commanded and commanded:
        return found
    found = find_force(found, machine) if driven and machine.drive.kind != "force" else found
    check_has_force(found)
    check_plausible(found, machine)
    return found
