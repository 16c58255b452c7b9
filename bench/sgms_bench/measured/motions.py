"""Commanded axes: fitted to some runs, compared by free runs with the same runs again."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from sgms_bench.measured.table import MeasuredMotion, MeasuredTable
from sgms_mhe.api.identification import identify
from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import carry_load
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.free_run import run_freely
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.parallel import run_parallel
from sgms_mhe.support.tables import CsvTable


@dataclass(frozen=True)
class MotionOutcome:
    """Mean absolute errors of one entry [m, rad], over all samples of all runs that no fit has seen.

    Attributes:
        name: of the entry; `runs`: that were fitted.
        published: of others, by name.
        ours: of free runs from the command alone.
        repeatability: of one run to the same again.
        unit: of all; `seconds`: of the identification.
    """

    name: str
    runs: int
    published: Mapping[str, float]
    ours: float
    repeatability: float
    unit: str
    seconds: float


def run_motion(table: MeasuredTable, motion: MeasuredMotion) -> MotionOutcome:
    """Identify from the runs of an entry, and run freely along the others."""
    seen, unseen = (
        [read_log(path, note=lambda _: None) for path in sorted(table.folder.glob(pattern))]
        for pattern in (motion.logs, motion.other)
    )
    started = time.monotonic()
    machine = identify(seen).machine
    seconds = time.monotonic() - started
    errors = run_parallel([partial(_free_error, machine, log) for log in unseen])
    again = [_mean_distance(one, other) for one, other in zip(seen, unseen, strict=True)]
    unit, repeated = machine.plant.units.position, float(np.mean(again))
    return MotionOutcome(motion.name, len(seen), motion.published, float(np.mean(errors)), repeated, unit, seconds)


def _free_error(machine: Machine, log: Log) -> float:
    run = run_freely(carry_load(machine, log.run), log)
    return float(np.nanmean(np.abs(run.simulated_position_m - run.position_m)))


def _mean_distance(one: Log, other: Log) -> float:
    least = min(len(one), len(other))
    return float(np.nanmean(np.abs(one.position_m[:least] - other.position_m[:least])))


def table_of_motions(outcomes: Sequence[MotionOutcome]) -> CsvTable:
    """Return ours beside the published numbers and the repeatability."""
    rows: list[dict[str, Any]] = [
        {
            "axis": o.name,
            "runs": o.runs,
            "unit": o.unit,
            "ours": o.ours,
            "repeatability": o.repeatability,
            "published": ", ".join(f"{error:.3g} {name}" for name, error in o.published.items()),
            "ahead": "yes" if o.ours < min(o.published.values(), default=0.0) else "no",
        }
        for o in outcomes
    ]
    formats = dict.fromkeys(rows[0], "") | {"runs": "d", "ours": ".3g", "repeatability": ".3g"}
    return CsvTable("Mean absolute error of free runs from the command alone, runs that no fit has seen", formats, rows)
