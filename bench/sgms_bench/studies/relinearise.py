"""Error of the estimate from stored linearisations."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.experiment.running import PAPER_WEIGHTS, papers
from sgms_bench.studies.cases import (
    Case,
    counted_updates,
    done_of,
    friction_error,
    simulate_case,
    spread,
    thirty_percent,
    weight_changes,
)
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]


RELINEARISE: Final = ("all", "auto", "newest")


def _paper(**noise: float) -> dict[str, Any]:
    return papers(PAPER_WEIGHTS | {"noise": PAPER_WEIGHTS["noise"] | noise})


RELINEARISE_CASES: Final[tuple[Case, ...]] = (
    Case("default (state 0.01)", {}, spread),
    Case("state 0.003", weight_changes(state=0.003), spread),
    Case("state 0.1", weight_changes(state=0.1), spread),
    Case("measurement 0.5, noise 1.6 N", weight_changes(measurement=0.5), spread, 1.6),
    Case("30 % off", {}, thirty_percent),
    Case("30 % off, prior 0.3", weight_changes(parameter=0.3), thirty_percent),
    Case("coulomb too", {"estimator": {"parameters": ["stiffness", "coulomb"]}}, spread),
    Case("mixed motion", {}, spread, trajectory="mixed"),
    Case("mixed motion, noise 1.6 N", weight_changes(measurement=0.5), spread, 1.6, "mixed"),
    Case("the paper's", _paper(), spread),
    Case("the paper's, noise 1.6 N", _paper(), spread, 1.6),
    Case("the paper's, state 0.01", _paper(state=0.01), spread),
)


@dataclass(frozen=True)
class RelinearisationCost:
    """Error from stored linearisations.

    Attributes:
        errors: RMS errors of friction [N] and of every parameter over nominal, against truth (1 + n_p).
        away: RMS difference of every parameter from that of `all`, in its stated standard deviations (n_p).
    """

    errors: Array
    away: Array


def relinearise_errors(case: Case, seeds: Sequence[int], duration_s: float) -> dict[str, RelinearisationCost]:
    """Of the ways to relinearise, `all` first."""
    machine = override_machine(load_machine("etel_xy"), case.changes)
    records = [simulate_case(machine, case, seed, duration_s) for seed in seeds]
    kept: dict[str, RelinearisationCost] = {}
    of_all: list[Estimates] = []
    for relinearise in RELINEARISE:
        estimator = CompiledEstimator(override_machine(machine, {"estimator": {"relinearise": relinearise}}))
        nominal = np.array([parameter.nominal for parameter in estimator.model.parameters])
        estimates = [estimator.estimate(record.signals) for record in records]
        of_all = of_all or estimates
        errors, away = [], []
        for record, estimate, by_all in zip(records, estimates, of_all, strict=True):
            late = counted_updates(record)
            wrong = estimate.parameters[late] / nominal - record.theta
            apart = (estimate.parameters - by_all.parameters)[late] / by_all.std[late]
            errors.append([friction_error(estimate, record), *np.sqrt(np.mean(wrong**2, axis=0))])
            away.append(np.sqrt(np.mean(apart**2, axis=0)))
        kept[relinearise] = RelinearisationCost(*(np.sqrt(np.mean(np.square(rows), axis=0)) for rows in (errors, away)))
    return kept


def _part(index: int, seeds: int, duration_s: float) -> dict[str, RelinearisationCost]:
    return relinearise_errors(RELINEARISE_CASES[index], range(seeds), duration_s)


def relinearise_study(seeds: int, duration_s: float = 8.0, place: WorkerSlot = HERE) -> CsvTable:
    """Estimate errors with linearisations that are kept over those with all intervals linearised anew."""
    rows: list[dict[str, Any]] = []
    tasks = [Task(str(index), _part, (index, seeds, duration_s)) for index in range(len(RELINEARISE_CASES))]
    for case, kept in zip(RELINEARISE_CASES, results(tasks, place, done_of("configurations")), strict=True):
        for relinearise in RELINEARISE[1:]:
            ratio = kept[relinearise].errors / kept["all"].errors
            row: dict[str, Any] = {"weights": case.name, "relinearise": relinearise, "friction": float(ratio[0])}
            row |= {f"p {k + 1}": float(ratio[k + 1]) if k + 1 < len(ratio) else None for k in range(5)}
            rows.append(row | {"worst": float(ratio.max()), "away": float(kept[relinearise].away.max())})
    formats = {"weights": "", "relinearise": "", "friction": ".3f"} | {f"p {k + 1}": ".3f" for k in range(5)}
    return CsvTable(
        f"RMS errors against truth over those of relinearise = all, {seeds} seeds of {duration_s:g} s",
        formats | {"worst": ".3f", "away": ".3f"},
        rows,
        (
            "p 1 to 4: stiffness, 5: coulomb; noise: of the logged force; the paper's: its weights, docs/weights.md",
            "away: largest RMS difference of a parameter from that of all, in its stated standard deviations",
        ),
    )
