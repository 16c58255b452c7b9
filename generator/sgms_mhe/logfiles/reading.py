"""A file read: each step's result, and the log that comes of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_mhe.logfiles.bags import read_bag
from sgms_mhe.logfiles.clocks import Note, join_seconds
from sgms_mhe.logfiles.hdf5 import read_hdf5
from sgms_mhe.logfiles.json_files import SUFFIXES
from sgms_mhe.logfiles.mat import read_mat
from sgms_mhe.logfiles.mdf import read_mdf
from sgms_mhe.logfiles.names import split_name
from sgms_mhe.logfiles.numpy_files import read_numpy
from sgms_mhe.logfiles.parquet import read_feather, read_parquet
from sgms_mhe.logfiles.plausibility import note_speed_scale
from sgms_mhe.logfiles.quantities import integrate, si_values
from sgms_mhe.logfiles.resampling import Resampling, resample
from sgms_mhe.logfiles.sources import Source, choose_sources
from sgms_mhe.logfiles.table import Column, Table
from sgms_mhe.logfiles.text import read_text
from sgms_mhe.logfiles.timing import Timing, check_steps, measure_time
from sgms_mhe.machine import OF_KIND, QUANTITIES, REQUIRED, Kind, LogMapping, Machine
from sgms_mhe.signals.logs import JITTER, Log, advise_time_unit, check_rate
from sgms_mhe.support.arrays import AnyArray, Array
from sgms_mhe.support.errors import InputError

READERS: Final[Mapping[str, Callable[[Path], Table]]] = {
    ".mat": read_mat,
    ".npz": read_numpy,
    ".npy": read_numpy,
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), read_hdf5),
    **dict.fromkeys((".parquet", ".pq"), read_parquet),
    **dict.fromkeys((".feather", ".arrow"), read_feather),
    **dict.fromkeys((".mf4", ".mdf"), read_mdf),
    **dict.fromkeys((".mcap", ".bag", ".db3"), read_bag),
}
"""Reader of each format that is no text, by the suffix of the file's name, in lower case."""

FOLDERS: Final[Mapping[str, Callable[[Path], Table]]] = {"metadata.yaml": read_bag, "meta/info.json": read_parquet}
"""Reader of a folder, by the file that makes it one of ROS 2 or LeRobot."""

MOST_REPEATED: Final = 0.01
"""Share of the samples that may have the time of the one before: beyond it the stamps are coarser than the samples."""

TEXTS: Final = (".csv", ".txt", ".tsv", ".tab", ".dat", ".asc", ".prn", ".log", ".lvm")
"""Usual suffixes of delimited text."""


@dataclass(frozen=True)
class LogContent:
    """Content of a file, not yet judged.

    Attributes:
        table: the file, its format and dialect understood.
        kind: of the axis whose quantities it holds.
        sources: where each quantity comes from.
        timing: the clock as it was recorded.
        resampling: of uneven time, where [log] asks for it; else None.
        columns: the quantities (n,) by their columns' names, in SI units, on the grid where there is one.
        notes: sentences on omitted or changed data.
        payload: whether each record moves a mass of its own, as [log] says.
    """

    path: Path
    table: Table
    kind: Kind
    sources: tuple[Source, ...]
    timing: Timing
    resampling: Resampling | None
    columns: Mapping[str, Array]
    notes: tuple[str, ...] = ()
    payload: bool = False

    @property
    def log(self) -> Log:
        """The quantities as a log, which nothing has checked."""
        return Log(
            **fields_of_log(self.kind, self.columns),
            rate=self.timing.rate if self.resampling is None else self.resampling.rate,
            source=str(self.path),
            kind=self.kind,
            payload=self.payload,
            run=self.table.run,
            force_keys=next((source.keys for source in self.sources if source.quantity.role == "force"), {}),
        )


def read_log(path: str | Path, machine: Machine | None = None) -> Log:
    """Read and check a log; `[log]` of the machine maps the file's variables, scales and units.

    A column whose mapped variable is not in the file is taken from the variable of the column's own name, so that a
    simulated log is read with the machine file that maps a measured one. Raises InputError, which names the first
    offending row, for time that is not uniform within 1 %, for a column that is missing or has no number at all, and
    for files that cannot be read.
    """
    return log_of(understand(path, machine), machine)


def understand(
    path: str | Path, machine: Machine | None = None, mapping: LogMapping | None = None, note: Note | None = None
) -> LogContent:
    """Read a file as far as it can be understood.

    Args:
        path: of the file.
        machine: whose [log], kind of axis and rate count; None: the file speaks for itself.
        mapping: in place of the machine's [log].
        note: called with each sentence on omitted or changed data, before anything is refused.

    Raises:
        InputError: the part not understood, with the key to write.
    """
    path, mapping = Path(path), _mapping(machine, mapping)
    return understand_table(path, read_table(path, mapping), machine, mapping, note)


def understand_table(
    path: Path,
    table: Table,
    machine: Machine | None = None,
    mapping: LogMapping | None = None,
    note: Note | None = None,
) -> LogContent:
    """Understand a table read from `path`, or that messages call so; arguments and errors as `understand`."""
    mapping = _mapping(machine, mapping)
    notes: list[str] = []

    def say(sentence: str) -> None:
        notes.append(sentence)
        if note is not None:
            note(f"{path}: {sentence}")

    for sentence in table.notes:
        say(sentence)
    kind, sources = choose_sources(path, table, mapping, machine.plant.kind if machine is not None else None)
    stated = mapping.rate if mapping is not None else None
    columns = si_values(path, table, sources, stated, say)
    columns, table = _drop_repeats(columns, table, say)
    timing = measure_time(path, columns["time_s"], table.row)
    resampled = mapping is not None and mapping.resample
    if stated is not None and not resampled and abs(timing.rate - stated) > JITTER * stated:
        raise InputError(path, "[log] rate", stated, f"{timing.rate:.6g} Hz, as its time column says")
    advice = advise_time_unit(timing.rate) if machine is None else ""
    if advice:
        say(f"{timing.rate:.4g} samples per second: {advice}")
    rate = machine.sampling.rate if machine is not None else stated
    resampling = None
    is_at_rate = rate is None or abs(timing.rate - rate) <= JITTER * rate
    if (table.run or resampled) and not (timing.uniform and is_at_rate):
        resampling = resample(path, columns, timing, rate)
        columns = dict(resampling.columns)
        say(resampling.note)
    columns = _complete(kind, columns, say)
    payload = mapping is not None and mapping.payload
    content = LogContent(path, table, kind, sources, timing, resampling, columns, payload=payload)
    scaled = note_speed_scale(content.log)
    if scaled:
        say(scaled)
    return replace(content, notes=tuple(notes))


def _drop_repeats(columns: dict[str, Array], table: Table, say: Note) -> tuple[dict[str, Array], Table]:
    """The columns and the table without the samples with the time of the one before, where these are few."""
    time = columns["time_s"]
    repeated = np.flatnonzero(np.diff(time) == 0.0) + 1
    if not 0 < len(repeated) <= MOST_REPEATED * len(time):
        return columns, table
    kept = np.delete(np.arange(len(time)), repeated)
    more = f", and {len(repeated) - 1} more" if len(repeated) > 1 else ""
    say(f"{table.row(int(repeated[0]))}{more}: the time of the row before, left out: one sample fewer each")
    return {name: values[kept] for name, values in columns.items()}, replace(
        table, row=lambda index: table.row(int(kept[index]))
    )


def _complete(kind: Kind, columns: dict[str, Array], say: Note) -> dict[str, Array]:
    """The columns with a position of the velocity, and a force of the friction, where either is not recorded."""
    names = {quantity.role: quantity.column for quantity in QUANTITIES[kind]}
    units, time = OF_KIND[kind], columns["time_s"]
    if names["position"] not in columns:
        columns = columns | {names["position"]: integrate(columns, names["velocity"])}
        drift = 1e-3 * float(np.nanmax(np.abs(columns[names["velocity"]]))) * float(time[-1] - time[0])
        say(
            f"no position: {names['velocity']} is integrated from 0. Places are not those of the axis, and a velocity "
            f"off by 0.1 % of its largest moves them by {drift:.2g} {units.position} by the end: nothing that depends "
            "on place, nor displacement before break-away, can be trusted"
        )
    if names["force"] not in columns and names["friction"] not in columns:
        columns = columns | {names["force"]: np.full(len(time), np.nan)}  # the command stands for it
    elif names["force"] not in columns:
        columns = columns | {names["force"]: columns[names["friction"]]}
        say(
            f"no {units.push}: {names['friction']} stands for it; what moves the axis, and its {units.inert}, "
            "are unknown"
        )
    return columns


def log_of(reading: LogContent, machine: Machine | None = None) -> Log:
    """The log. Raises InputError for one of another kind of axis than the machine's, uneven time, and another rate."""
    if machine is not None:
        check_kind(reading.path, reading.kind, [source.quantity.column for source in reading.sources], machine)
    if reading.resampling is None:
        check_steps(reading.path, reading.columns["time_s"], reading.timing.step, reading.table.row)
    log = reading.log
    if machine is not None:
        check_rate(log, machine)
    return log


def fields_of_log(kind: Kind, columns: Mapping[str, Array]) -> dict[str, Any]:
    """Columns of an axis of this kind by their fields' names in `Log`."""
    own = {quantity.column: quantity.role for quantity in QUANTITIES[kind]}
    field = {quantity.role: quantity.column for quantity in QUANTITIES["linear"]}
    return {field[own[name]]: values for name, values in columns.items()}


def check_kind(source: str | Path, kind: Kind, columns: Iterable[str], machine: Machine) -> None:
    """Refuse a log with columns of another kind of axis than the machine's."""
    wanted = machine.plant.kind
    if kind == wanted:
        return
    needed = ", ".join(quantity.column for quantity in QUANTITIES[wanted] if quantity.role in REQUIRED)
    allowed = (
        f"columns of a {wanted} axis, as {machine.name} is ([plant] kind); [log] (machine file, --log) maps {needed}"
    )
    raise InputError(source, "columns", f"{', '.join(columns)} of a {kind} axis", allowed)


def _mapping(machine: Machine | None, mapping: LogMapping | None) -> LogMapping | None:
    return machine.log if mapping is None and machine is not None else mapping


def read_table(path: Path, mapping: LogMapping | None) -> Table:
    """Read the columns of a file, and of those beside it that [log] names as FILE:VARIABLE.

    Raises InputError for one that no reader knows, or that is damaged.
    """
    table = _read_file(path, mapping, 2)
    named = [column.name.partition(":")[0] for column in mapping.columns.values()] if mapping is not None else []
    for file in dict.fromkeys(name for name in named if Path(name).suffix.lower() in (*READERS, *TEXTS, *SUFFIXES)):
        table = _join(table, file, _read_file(path.parent / file.replace("{stem}", path.stem), None, 1))
    return join_seconds(table)


def _join(table: Table, file: str, other: Table) -> Table:
    """The table with the columns of another file as FILE:VARIABLE, which none but that name finds."""
    names = {f"{file}:{column.name}": column for column in other.columns}
    columns = [Column(name, "", c.unit or split_name(c.header)[1], c.shape) for name, c in names.items()]

    def read(wanted: Sequence[str]) -> Mapping[str, AnyArray]:
        there = [name for name in wanted if name in names]
        own = table.read([name for name in wanted if name not in names])
        found = other.read([names[name].name for name in there])
        return {**own, **{name: found[names[name].name] for name in there}}

    return replace(
        table,
        columns=(*table.columns, *columns),
        read=read,
        stamped=table.stamped | {name for name, column in names.items() if column.name in other.stamped},
        notes=(*table.notes, *(f"{file}: {note}" for note in other.notes)),
    )


def _read_file(path: Path, mapping: LogMapping | None, least: int) -> Table:
    """Read a file of a format its suffix tells, or else a text. Raises InputError for one that is neither."""
    reader = READERS.get(path.suffix.lower())
    if path.is_dir():
        reader = next((reader for name, reader in FOLDERS.items() if (path / name).is_file()), None)
        if reader is None:
            raise InputError(path, "folder", None, f"a file, or a folder with {' or '.join(FOLDERS)} in it")
    try:
        if reader is None:
            return read_text(path, mapping, least)
        if not path.is_dir():
            path.open("rb").close()  # a file that cannot be opened is told from one that is damaged
        return reader(path)
    except OSError as error:
        raise InputError(path, "file", None, f"a readable log ({error.strerror or error})") from None
    except InputError as error:
        if reader is not None or any(suffix.lower() in (*TEXTS, *SUFFIXES) for suffix in path.suffixes):
            raise
        allowed = f"{error.allowed}; or a log with one of the suffixes {', '.join((*TEXTS, *SUFFIXES, *READERS))}"
        raise InputError(path, error.where, error.value, allowed) from None
