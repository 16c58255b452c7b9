"""Commanded axes: fitted to some runs, compared by free runs with the same again and with unseen loads and gains."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial
from typing import Any

import numpy as np

from sgms_bench.measured.table import MeasuredMotion, MeasuredTable, MotorConstants
from sgms_mhe.api.identification import identify
from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import carry_load
from sgms_mhe.identification.result import Identification
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.free_run import FreeRunRecord
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.numbers import SIGMAS
from sgms_mhe.support.parallel import run_parallel
from sgms_mhe.support.statements import Rule, Statement
from sgms_mhe.support.tables import CsvTable


@dataclass(frozen=True)
class FreeRuns:
    """Free runs from the command alone, along runs that no fit has seen.

    Attributes:
        fitted: runs that the machine is identified from.
        errors: mean absolute error of each run [m, rad].
        again: mean absolute distance of each from the same run before it [m, rad].
        unseen: what of the runs no fitted one had; empty: they are repetitions of fitted ones.
        seen: errors of the same runs by the fit that has seen such ones.
    """

    fitted: int
    errors: Sequence[float]
    again: Sequence[float]
    unseen: str = ""
    seen: Sequence[float] | None = None


@dataclass(frozen=True)
class MotionOutcome:
    """One entry: its free runs, and the numbers that all fitted runs told.

    Attributes:
        name: of the entry.
        published: mean absolute errors of others [m, rad], by name. wanted: the error that is wanted.
        unit: of all errors.
        runs: repetitions of all that was fitted first; then what a second fit has not seen.
        statements: of the first fit, and the largest force with the clamp that it means.
        seconds: of all fits.
    """

    name: str
    published: Mapping[str, float]
    wanted: float | None
    unit: str
    runs: tuple[FreeRuns, ...]
    statements: tuple[Statement, ...]
    seconds: float

    @property
    def ours(self) -> float:
        """Mean absolute error over all repeated runs [m, rad]."""
        return float(np.mean(self.runs[0].errors))


def run_motion(table: MeasuredTable, motion: MeasuredMotion, tell: Callable[[str], None]) -> MotionOutcome:
    """Identify from the runs of an entry, and run freely along the others; then once more without some of them."""
    paths, others = (sorted(table.folder.glob(pattern)) for pattern in (motion.logs, motion.other))
    logs = run_parallel([partial(read_log, path, note=_ignore) for path in (*paths, *others)])
    seen, repeated = logs[: len(paths)], logs[len(paths) :]
    again = [_mean_distance(one, other) for one, other in zip(seen, repeated, strict=True)]
    started = time.monotonic()
    found = identify(seen, progress=tell)
    first = _free_errors(found.machine, repeated)
    runs = [FreeRuns(len(seen), first, again)]
    if motion.unseen:
        which = {name: [fnmatch(path.name, pattern) for path in paths] for name, pattern in motion.unseen.items()}
        left_out = np.any(list(which.values()), axis=0)
        kept = [log for log, is_out in zip(seen, left_out, strict=True) if not is_out]
        tell(f"without {', '.join(which)}: {len(kept)} runs")
        other = identify(kept, progress=tell).machine
        columns = np.array([_free_errors(other, repeated), again, first])
        for name, chosen in {"none, fitted without the following": ~left_out, **which}.items():
            errors, distances, before = columns[:, chosen].tolist()
            runs.append(FreeRuns(len(kept), errors, distances, name, before))
    unit, statements = found.machine.plant.units.position, (*found.statements, *_state_largest(found, motion.constants))
    spent = time.monotonic() - started
    return MotionOutcome(motion.name, motion.published, motion.wanted, unit, tuple(runs), statements, spent)


def _ignore(_: str) -> None:
    """Notes on how a log was understood are not for here."""


def _free_errors(machine: Machine, logs: Sequence[Log]) -> list[float]:
    return run_parallel([partial(_free_error, machine, log) for log in logs])


def _free_error(machine: Machine, log: Log) -> float:
    loaded = carry_load(machine, log.run)
    record = FreeRunRecord(loaded, log)
    runs, _ = record.run(record.axis(loaded), record.stretches)
    errors = [run - record.position[a:b] for run, (a, b) in zip(runs, record.stretches, strict=True)]
    return float(np.mean(np.abs(np.concatenate(errors))))


def _mean_distance(one: Log, other: Log) -> float:
    least = min(len(one), len(other))
    return float(np.nanmean(np.abs(one.position_m[:least] - other.position_m[:least])))


def _state_largest(found: Identification, constants: MotorConstants | None) -> list[Statement]:
    """Return statements on the largest force at rest, by which alone a clamp shows, and on that of given constants.

    Their variances are added as if they had nothing in common.
    """
    drive, units = found.machine.drive, found.machine.plant.units
    k, resistance, clamp = drive.torque_constant, drive.resistance, drive.clamp
    if k is None or resistance is None or drive.supply is None or clamp is None:
        return []
    force, known = drive.supply * clamp * k / resistance, {number.name: number for number in found.numbers}
    parts = [known[f"drive.{key}"] for key in ("torque_constant", "resistance", "clamp") if f"drive.{key}" in known]
    relative = math.hypot(*(number.std / number.value for number in parts))
    stated = [("largest force at rest", force, units.force)]
    if constants is not None:
        share = force * constants.resistance / (constants.torque_constant * drive.supply)
        stated.append((f"clamp, were torque_constant {constants.torque_constant:g}", share, ""))
    return [Statement.of_number(Rule.DETERMINED, name, value, value * relative, unit) for name, value, unit in stated]


def table_of_motions(outcomes: Sequence[MotionOutcome]) -> list[CsvTable]:
    """Return errors beside the published numbers and the repeatability, and the numbers of each axis."""
    rows: list[dict[str, Any]] = []
    for o in outcomes:
        published = [f"{1e3 * error:.3g} {name}" for name, error in o.published.items()]
        for runs in o.runs:
            row = {"axis": o.name, "unseen": runs.unseen, "fitted": runs.fitted, "compared": len(runs.errors)}
            row |= {"unit": f"m{o.unit}", "ours": 1e3 * np.mean(runs.errors), "median": 1e3 * np.median(runs.errors)}
            row |= {"seen": runs.seen and 1e3 * np.mean(runs.seen), "repeatability": 1e3 * np.mean(runs.again)}
            rows.append(row)
        limits = [*o.published.values(), *([o.wanted] if o.wanted else [])]
        wanted = [f"{1e3 * o.wanted:.3g} wanted"] if o.wanted else []
        ahead = "yes" if o.ours < min(limits, default=0.0) else "no"
        rows[-len(o.runs)] |= {"published": ", ".join([*published, *wanted]), "ahead": ahead}
    formats = {"axis": "", "unseen": "", "fitted": "d", "compared": "d", "unit": "", "ours": ".3g", "median": ".3g"}
    formats |= {"seen": ".3g", "repeatability": ".3g", "published": "", "ahead": ""}
    title = "Mean absolute error of free runs from the command alone, runs that no fit has seen"
    notes = tuple(f"{o.name}: {o.seconds:.0f} s for all fits and free runs" for o in outcomes)
    errors = CsvTable(title, formats, rows, notes)
    told = [(o, statement) for o in outcomes for statement in o.statements]
    numbers: list[dict[str, Any]] = [
        {"axis": o.name, "number": s.about, "value": s.value, "+-": SIGMAS * s.std, "unit": s.unit, "sure": s.sure}
        for o, s in told
        if s.kind == "number"
    ]
    columns = {"axis": "", "number": "", "value": ".4g", "+-": ".2g", "unit": "", "sure": ""}
    others = tuple(f"{o.name}: {s.sentence}" for o, s in told if s.kind != "number")
    return [errors, CsvTable("Numbers of the axis, of all runs that are fitted", columns, numbers, others)]
