"""Samples that are lost, late or early from the first one on: what the emitted estimators still learn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from sgms_bench.studies.cases import done_of
from sgms_bench.studies.faults import VARIANTS, base_record
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.status import FLAGS
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]
Spoil = Callable[[Log, np.random.Generator], Log]

COUNTED_S: Final = 3.0
"""From here on updates count."""


@dataclass(frozen=True)
class LostOutcome:
    """One estimator on one log.

    Attributes:
        deviation: stated at the end, over nominal (n_p).
        sigmas: largest error of a parameter over its stated deviation, from `COUNTED_S` on.
        error: largest relative error of a parameter at the end.
        left_out: share of updates without a measurement.
        doubted: share that say DOUBT.
    """

    deviation: Array
    sigmas: float
    error: float
    left_out: float
    doubted: float


def _lose(starts: Callable[[int, np.random.Generator], NDArray[np.int64]], length: int) -> Spoil:
    def spoil(log: Log, rng: np.random.Generator) -> Log:
        count = len(log.time_s)
        lost = np.zeros(count + length, dtype=np.bool_)
        lost[(starts(count, rng)[:, None] + np.arange(length)).ravel()] = True
        position, force = (np.where(lost[:count], np.nan, channel) for channel in (log.position_m, log.force_N))
        return replace(log, position_m=position, force_N=force)

    return spoil


def _lose_samples(share: float) -> Spoil:
    return _lose(lambda count, rng: np.flatnonzero(rng.random(count) < share), 1)


def _bursts(length: int) -> Spoil:
    return _lose(lambda count, rng: rng.integers(0, count, count // 100), length)


def _sample_at(times: Callable[[Array, np.random.Generator], Array]) -> Spoil:
    """Sample at other times than the log says, in sample periods."""

    def spoil(log: Log, rng: np.random.Generator) -> Log:
        index = np.arange(len(log.time_s), dtype=np.float64)
        at = np.clip(times(index, rng), 0.0, index[-1])
        position, force = CubicSpline(index, log.position_m)(at), np.interp(at, index, log.force_N)
        return replace(log, position_m=position, force_N=force)

    return spoil


CASES: Final[Mapping[str, Spoil]] = {
    "none": lambda log, _: log,
    **{f"{share:.0%} at random": _lose_samples(share) for share in (0.05, 0.1, 0.2, 0.3)},
    **{f"bursts of {length}": _bursts(length) for length in (2, 5, 10, 20)},
    "stamps off by 10 % of a period": _sample_at(lambda at, rng: at + 0.1 * rng.standard_normal(len(at))),
    "clock 0.1 % slow": _sample_at(lambda at, _: 0.999 * at),
}
"""Changes of whole logs by their names; bursts begin once in a hundred samples, anywhere."""


@cache
def _estimator(variant: str) -> CompiledEstimator:
    return CompiledEstimator(override_machine(load_machine("etel_xy"), VARIANTS[variant]))


def lost_outcome(case: str, seed: int, variant: str) -> LostOutcome:
    """Estimate a spoilt log, and compare what is stated with the truth."""
    record, estimator = base_record(seed), _estimator(variant)
    log = CASES[case](record.run.log, np.random.default_rng([seed, 11]))
    found, signals = estimator.estimate_log(log), signals_from_log(log, estimator.model.machine)
    measured = signals.valid[np.searchsorted(signals.time, found.time_s - 0.5 / log.rate)]
    nominal = np.array([parameter.nominal for parameter in estimator.model.parameters])
    counted, deviation = found.time_s > COUNTED_S, found.std / nominal
    error = np.abs(found.parameters / nominal - record.theta)
    return LostOutcome(
        deviation=deviation[-1],
        sigmas=float((error / deviation)[counted].max()),
        error=float((error[-1] / record.theta).max()),
        left_out=float(np.mean(~measured[counted])),
        doubted=float(np.mean(found.status[counted] & FLAGS["doubt"] > 0)),
    )


def _part(case: str, seed: int) -> list[LostOutcome]:
    return [lost_outcome(case, seed, variant) for variant in VARIANTS]


def lost_study(runs: int, place: WorkerSlot = HERE) -> CsvTable:
    """Deviations that are left after a log with lost samples, and whether the truth is within them."""
    drawn = list(product(CASES, range(runs)))
    tasks = [Task(f"{case}-{seed}", _part, (case, seed)) for case, seed in drawn]
    found: dict[str, list[LostOutcome]] = {case: [] for case in CASES}
    for (case, _), outcomes in zip(drawn, results(tasks, place, done_of("logs")), strict=True):
        found[case] += outcomes
    count = len(found["none"][0].deviation)
    return CsvTable(
        f"Lost samples in logs of {runs} axes, for each of {', '.join(VARIANTS)}",
        {
            "lost": "",
            **{f"sd {p + 1}": ".3f" for p in range(count)},
            "sigmas": ".1f",
            "error": ".3f",
            "left out": ".0%",
            "doubted": ".1%",
        },
        [_row(case, outcomes) for case, outcomes in found.items()],
        (
            "sd 1, ...: stated deviation of each stiffness at the end over nominal, mean;",
            f"sigmas: largest error of one over its stated deviation, from {COUNTED_S:g} s on, the worst of all;",
            "error: largest relative error of one at the end, mean;",
            "left out: share of updates without a measurement; doubted: of those that say so",
        ),
    )


def _row(case: str, outcomes: list[LostOutcome]) -> dict[str, Any]:
    deviations = np.mean([outcome.deviation for outcome in outcomes], axis=0)
    return {
        "lost": case,
        **{f"sd {p + 1}": deviation for p, deviation in enumerate(deviations)},
        "sigmas": max(outcome.sigmas for outcome in outcomes),
        "error": np.mean([outcome.error for outcome in outcomes]),
        "left out": np.mean([outcome.left_out for outcome in outcomes]),
        "doubted": np.mean([outcome.doubted for outcome in outcomes]),
    }
