"""MHE, EKF and batch smoother over random axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.studies.cases import (
    Case,
    done_of,
    factor_of_two,
    friction_error,
    rms,
    simulate_case,
    spread,
    weight_changes,
)
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.reference import estimate_reference
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]

SEEDS_PER_TASK: Final = 10
"""A task compiles its two estimators once for so many axes."""


def _updates_at(rate: float) -> dict[str, Any]:
    return {"sampling": {"update_rate": rate}}


def _auto(changes: dict[str, Any]) -> dict[str, Any]:
    return {**changes, "estimator": {**changes["estimator"], "relinearise": "auto"}}


CASES: Final[tuple[Case, ...]] = (
    Case("default", {}, spread),
    Case("noise of the force 1.6 N", weight_changes(measurement=0.5), spread, 1.6),
    Case("factor 2", {}, factor_of_two),
    Case("factor 2, prior 1.0", weight_changes(parameter=1.0), factor_of_two),
    Case("bounds at truth's limits", weight_changes((0.7, 1.4), parameter=0.3, measurement=0.5), spread, 1.6),
    Case("bounds 0.95, 1.05", weight_changes((0.95, 1.05)), spread),
    Case("coulomb too", {"estimator": {"parameters": ["stiffness", "coulomb"]}}, spread),
    Case("fast moves", {}, spread, trajectory="mixed"),
    Case("50 ms", _updates_at(20.0), spread),
    Case("50 ms, factor 2, prior 0.5", _updates_at(20.0) | weight_changes(parameter=0.5), factor_of_two),
    Case("100 ms, factor 2, prior 0.5", _updates_at(10.0) | weight_changes(parameter=0.5), factor_of_two),
    Case("50 ms, factor 2, prior 0.5, auto", _updates_at(20.0) | _auto(weight_changes(parameter=0.5)), factor_of_two),
    Case("100 ms, factor 2, prior 0.5, auto", _updates_at(10.0) | _auto(weight_changes(parameter=0.5)), factor_of_two),
)
"""With everything about the last solution, which is all that a window can give, unless a case says otherwise."""


@dataclass(frozen=True)
class EstimatorRatio:
    """Friction RMS of one configuration [N], per seed; the smoother's only of the first ones."""

    case: Case
    mhe: Array
    ekf: Array
    smoother: Array

    @property
    def ratio(self) -> float:
        """RMS over all seeds, MHE over EKF."""
        return rms(self.mhe) / rms(self.ekf)


def compare_case(case: Case, seeds: Sequence[int], duration_s: float = 6.0, smoothed: int = 0) -> EstimatorRatio:
    """MHE and EKF with equal weights on the same simulated axes; the batch smoother on the first `smoothed` of them."""
    whole = override_machine(load_machine("etel_xy"), {"estimator": {"relinearise": "all"}})
    machine = override_machine(whole, case.changes)
    estimators = {
        kind: CompiledEstimator(override_machine(machine, {"estimator": {"kind": kind}})) for kind in ("mhe", "ekf")
    }
    errors: dict[str, list[float]] = {"mhe": [], "ekf": [], "smoother": []}
    for index, seed in enumerate(seeds):
        record = simulate_case(machine, case, seed, duration_s)
        for kind, estimator in estimators.items():
            errors[kind].append(friction_error(estimator.estimate(record.signals), record))
        if index < smoothed:
            errors["smoother"].append(friction_error(estimate_reference(machine, record.signals, "smoother"), record))
    return EstimatorRatio(case, *(np.array(errors[kind]) for kind in ("mhe", "ekf", "smoother")))


def _part(index: int, first: int, last: int, duration_s: float, smoothed: int) -> tuple[Array, Array, Array]:
    """Errors of one configuration over some of its seeds; the smoother's of those below `smoothed`."""
    found = compare_case(CASES[index], range(first, last), duration_s, max(0, min(last, smoothed) - first))
    return found.mhe, found.ekf, found.smoother


def monte_carlo_study(seeds: int, duration_s: float = 6.0, smoothed: int = 3, place: WorkerSlot = HERE) -> CsvTable:
    """Friction RMS of MHE, EKF and batch smoother over random axes, every configuration."""
    starts = range(0, seeds, SEEDS_PER_TASK)
    tasks = [
        Task(f"{index}-{first}", _part, (index, first, min(first + SEEDS_PER_TASK, seeds), duration_s, smoothed))
        for index in range(len(CASES))
        for first in starts
    ]
    parts = results(tasks, place, done_of("axes"))
    rows = []
    for index, case in enumerate(CASES):
        own = parts[index * len(starts) : (index + 1) * len(starts)]
        result = EstimatorRatio(case, *(np.concatenate([part[k] for part in own]) for k in range(3)))
        ratio = result.mhe / result.ekf
        rows.append(
            {
                "configuration": case.name,
                "MHE [N]": rms(result.mhe),
                "EKF [N]": rms(result.ekf),
                "MHE/EKF": result.ratio,
                "median": float(np.median(ratio)),
                "worst": float(ratio.max()),
                "MHE/smoother": rms(result.mhe[:smoothed]) / rms(result.smoother) if smoothed else None,
            }
        )
    formats = {"configuration": "", "MHE [N]": ".4f", "EKF [N]": ".4f", "MHE/EKF": ".3f", "median": ".3f"}
    return CsvTable(
        f"friction RMS against truth, {seeds} seeds of {duration_s:g} s, equal weights",
        formats | {"worst": ".3f", "MHE/smoother": ".2f"},
        rows,
        (f"MHE/smoother: over the first {smoothed} seeds; median and worst: of the seeds' own MHE/EKF",),
    )
