"""Interpretation of a log, for people and for programs, and the reasons why commands would refuse it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.logfiles.reading import Reading, log_of
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

SLOW_HZ: Final = 20.0
FAST_HZ: Final = 1e6
"""Rates outside which a drive is not recorded: time is in another unit."""


@dataclass(frozen=True)
class Inspection:
    """A reading with what is to be said of it.

    Attributes:
        problems: why the commands refuse it, in their words; empty where they take it.
        notes: what they would not refuse.
    """

    reading: Reading
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
        values = self.reading.columns[source.quantity.column]
        finite = values[np.isfinite(values)]
        return {
            "name": source.quantity.column,
            "from": source.description,
            "unit": source.unit,
            "because": source.because,
            "scale": source.scale,
            "offset": source.offset,
            "counts_per": source.counts_per,
            "wrap": source.wrap,
            "min": float(finite.min()),
            "max": float(finite.max()),
            "missing": len(values) - len(finite),
        }


def inspect_reading(reading: Reading, machine: Machine | None) -> Inspection:
    """Judge a reading as the commands would, going on where they stop."""
    problems: list[str] = []
    log: Log | None = None
    try:
        log = log_of(reading, machine)
    except InputError as error:
        problems.append(str(error))
    if log is not None:
        try:
            check_plausible(log, machine)
        except InputError as error:
            problems.append(str(error))
    notes = list(reading.notes)
    if not SLOW_HZ <= reading.timing.rate <= FAST_HZ and machine is None:
        line = 'time_s = { variable = "...", unit = "ms" }'
        notes.append(
            f"{reading.timing.rate:.4g} samples per second: time in another unit? [log] of the machine file: {line}"
        )
    return Inspection(reading, tuple(problems), tuple(notes))
