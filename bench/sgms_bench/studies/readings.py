"""Gain of the estimate from more friction measurements per second, and its end where they become too alike."""

from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.records import Record, simulate_record
from sgms_bench.studies.cases import counted_updates, done_of, friction_error
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]

RATES: Final = (100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10000.0)
TRUE_STIFFNESS: Final = (1.25, 0.8, 1.15, 0.9)
"""Over nominal: the paper's."""
AFTER_S: Final = (3.0, 5.0, 10.0, 20.0)


def readings_row(rate: float, records: Sequence[Record]) -> dict[str, Any]:
    """Largest relative error of the stiffnesses after each time, coverage and friction error, means over records."""
    machine = override_machine(
        load_machine("etel_xy"), {"sampling": {"measurement_rate": rate}, "estimator": {"relinearise": "auto"}}
    )
    estimator = CompiledEstimator(machine)
    nominal = np.array([parameter.nominal for parameter in estimator.model.parameters])
    after, covered, friction = [], [], []
    for record in records:
        estimates = estimator.estimate(record.signals)
        wrong, std = np.abs(estimates.parameters / nominal - record.theta), estimates.std / nominal
        at = np.searchsorted(estimates.time_s, np.minimum(AFTER_S, estimates.time_s[-1]))
        after.append(np.max(wrong[at] / record.theta, axis=1))
        covered.append(float(np.mean((wrong < 2.0 * std)[counted_updates(record)])))
        friction.append(1e3 * friction_error(estimates, record))
    errors = np.mean(after, axis=0)
    return {
        "readings per second": rate,
        **{f"{seconds:g} s": float(error) for seconds, error in zip(AFTER_S, errors, strict=True)},
        "covered": float(np.mean(covered)),
        "friction, mN": float(np.mean(friction)),
    }


@cache
def _records(seeds: int, duration_s: float) -> tuple[Record, ...]:
    """The axes of the study, simulated once per process."""
    machine = load_machine("etel_xy")
    return tuple(
        simulate_record(machine, TRUE_STIFFNESS, duration_s=duration_s, config=AxisConfig(seed=seed))
        for seed in range(seeds)
    )


def _part(rate: float, seeds: int, duration_s: float) -> dict[str, Any]:
    return readings_row(rate, _records(seeds, duration_s))


def readings_study(seeds: int, duration_s: float = 20.0, place: WorkerSlot = HERE) -> CsvTable:
    """Estimate errors by `measurement_rate`."""
    tasks = [Task(f"{rate:g}", _part, (rate, seeds, duration_s)) for rate in RATES]
    errors = {f"{seconds:g} s": ".3f" for seconds in AFTER_S}
    return CsvTable(
        f"Largest relative error of a stiffness, by measurement_rate; {seeds} seeds of {duration_s:g} s",
        {"readings per second": ".0f"} | errors | {"covered": ".3f", "friction, mN": ".1f"},
        results(tasks, place, done_of("rates")),
        ("covered: share of |error| < 2 sigma; friction: RMS against truth",),
    )
