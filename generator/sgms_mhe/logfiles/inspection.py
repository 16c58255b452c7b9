"""Interpretation of a log, for people and for programs, and the reasons why commands would refuse it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_mhe.logfiles.names import split_name
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.logfiles.reading import LogContent, log_of, read_table, understand_table
from sgms_mhe.logfiles.sources import find_missing
from sgms_mhe.logfiles.table import Column, Table
from sgms_mhe.machine import LogMapping, Machine
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError


@dataclass(frozen=True)
class Inspection:
    """A parsed log with remarks on it.

    Attributes:
        problems: why the commands refuse it, in their words; empty where they take it.
        notes: on irregular, accepted data.
    """

    reading: LogContent
    problems: tuple[str, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain data."""
        reading, timing, grid = self.reading, self.reading.timing, self.reading.resampling
        used = {source.column for source in reading.sources}
        return {
            "file": str(reading.path),
            "format": reading.table.form,
            "dialect": dict(reading.table.dialect),
            "kind": reading.kind,
            "columns": [self._column(k) for k in range(len(reading.sources))],
            "missing": [],
            "not_read": [column.name for column in reading.table.columns if column.name not in used],
            "time": {
                "samples": timing.samples,
                "start_s": timing.start,
                "duration_s": timing.duration,
                "rate_Hz": timing.rate,
                "step_s": timing.step,
                "shortest_step_s": timing.shortest,
                "longest_step_s": timing.longest,
                "jitter": timing.jitter,
                "gaps": timing.gaps,
                "uniform": timing.uniform,
            },
            "resampled": None
            if grid is None
            else {
                "rate_Hz": grid.rate,
                "missing": grid.missing,
                "error_at_most": {name: vars(entry) for name, entry in grid.interpolations.items()},
            },
            "problems": list(self.problems),
            "notes": list(self.notes),
        }

    def _column(self, index: int) -> dict[str, Any]:
        source = self.reading.sources[index]
        return {
            "name": source.quantity.column,
            "from": source.description,
            **{key: getattr(source, key) for key in _SHOWN},
            **_range(self.reading.columns[source.quantity.column]),
        }


_SHOWN: Final = ("unit", "because", "scale", "offset", "counts_per", "wrap", "signed")
"""Return the source of a column as it is shown."""


@dataclass(frozen=True)
class Unread:
    """A file whose columns are known, and not which of them are which.

    Attributes:
        missing: the quantities for which no one column was found, by their columns' names.
        problems: why; in the words of the commands that refuse it.
    """

    path: Path
    table: Table
    missing: tuple[str, ...]
    problems: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain data, with the keys of an Inspection; `columns` are all that the file has."""
        return {
            "file": str(self.path),
            "format": self.table.form,
            "dialect": dict(self.table.dialect),
            "kind": None,
            "columns": [self._column(column) for column in self.table.columns[:MOST_COLUMNS]],
            "missing": list(self.missing),
            "not_read": [column.name for column in self.table.columns],
            "time": None,
            "resampled": None,
            "problems": list(self.problems),
            "notes": list(self.table.notes),
        }

    def _column(self, column: Column) -> dict[str, Any]:
        """Name, unit and range of a column; no range where it holds no numbers."""
        try:
            values = np.asarray(self.table.read([column.name])[column.name])
        except InputError:
            values = np.empty(0)
        unit = column.unit or split_name(column.header)[1]
        return {"name": None, "from": column.name, "unit": unit, **_range(values)}


def _range(values: Array) -> dict[str, Any]:
    """Range of a column's numbers, and how many are missing."""
    finite = values[np.isfinite(values)]
    least, most = (float(finite.min()), float(finite.max())) if len(finite) else (None, None)
    return {"min": least, "max": most, "missing": values.size - finite.size}


MOST_COLUMNS: Final = 500
"""Columns whose ranges are looked at."""


def inspect_log(path: Path, machine: Machine | None, mapping: LogMapping | None) -> Inspection | Unread:
    """Understand a file and judge it, or list its columns. Raises InputError for a file no reader can open."""
    hints = machine.log if machine is not None else mapping
    table = read_table(path, hints)
    try:
        return inspect_reading(understand_table(path, table, machine, mapping), machine)
    except InputError as error:
        missing = find_missing(path, table, hints, machine.plant.kind if machine is not None else None)
        return Unread(path, table, missing, (str(error),))


def inspect_reading(reading: LogContent, machine: Machine | None) -> Inspection:
    """Judge a reading as the commands would, going on where they stop."""
    problems: tuple[str, ...] = ()
    try:
        check_plausible(log_of(reading, machine), machine)
    except InputError as error:
        problems = (str(error),)
    return Inspection(reading, problems, reading.notes)
