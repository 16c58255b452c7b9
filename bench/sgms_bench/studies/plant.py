"""Coverage on the axis in closed loop, whose noise is not what the estimator assumes."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.experiment.running import PAPER_WEIGHTS, papers
from sgms_bench.studies.cases import Case, done_of, factor_of_two, positive, simulate_case, spread, weight_changes
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]

SEEDS_PER_TASK: Final = 5


def _ten_percent(rng: np.random.Generator) -> Array:
    return positive(rng, 0.1, 4)


CASES: Final[tuple[Case, ...]] = (
    Case("default", {}, spread),
    Case("stiffness within the prior, 10 %", {}, _ten_percent),
    Case("factor 2", {}, factor_of_two),
    Case("force noise 0.35 N (0.1 N of friction)", {}, spread, 0.35),
    Case("force noise 1.6 N (0.46 N of friction)", {}, spread, 1.6),
    Case("the same, measurement = 0.5", weight_changes(measurement=0.5), spread, 1.6),
    Case("prior 0.3", weight_changes(parameter=0.3), spread),
    Case("no drift", weight_changes(parameter_drift=0.0), spread),
    Case("the paper's weights", papers(PAPER_WEIGHTS), spread),
)


def _kind(machine: Machine) -> str:
    """The filter's covariance is the MHE's to the third digit, at a twentieth of the time."""
    return "mhe" if machine.estimator.arrival_cost.update == "fixed" else "ekf"


def _part(index: int, seeds: range, duration_s: float) -> list[tuple[Array, Array]]:
    """Of some axes of a configuration: share of the second half within two sigma, and error over sigma at the end."""
    case = CASES[index]
    machine = override_machine(load_machine("etel_xy"), case.changes)
    machine = override_machine(machine, {"estimator": {"kind": _kind(machine)}})
    estimator = CompiledEstimator(machine)
    nominal = np.array(machine.friction.stiffness)
    found = []
    for seed in seeds:
        record = simulate_case(machine, case, seed, duration_s)
        estimates = estimator.estimate(record.signals)
        error = (estimates.parameters / nominal - record.theta) / (estimates.std / nominal)
        second_half = error[len(error) // 2 :]
        found.append((np.mean(np.abs(second_half) <= 2.0, axis=0), error[-1]))
    return found


def plant_study(seeds: int, duration_s: float = 20.0, place: WorkerSlot = HERE) -> CsvTable:
    """Coverage on the closed-loop plant, and what moves it."""
    starts = range(0, seeds, SEEDS_PER_TASK)
    tasks = [
        Task(f"{index}-{first}", _part, (index, range(first, min(first + SEEDS_PER_TASK, seeds)), duration_s))
        for index in range(len(CASES))
        for first in starts
    ]
    parts = results(tasks, place, done_of("axes"))
    rows = []
    for index, case in enumerate(CASES):
        own = [pair for part in parts[index * len(starts) : (index + 1) * len(starts)] for pair in part]
        cover, z = np.mean([inside for inside, _ in own], axis=0), [error for _, error in own]
        kind = _kind(override_machine(load_machine("etel_xy"), case.changes))
        row: dict[str, Any] = {"configuration": case.name, "estimator": kind.upper()}
        row |= {f"cover {k + 1}": float(value) for k, value in enumerate(cover)}
        row |= {f"rms z {k + 1}": float(value) for k, value in enumerate(np.sqrt(np.mean(np.square(z), axis=0)))}
        rows.append(row)
    formats = {"configuration": "", "estimator": ""} | {f"cover {k + 1}": ".0%" for k in range(4)}
    return CsvTable(
        f"coverage of +-2 sigma on the closed-loop axis, {seeds} seeds of {duration_s:g} s, second half of each run",
        formats | {f"rms z {k + 1}": ".2f" for k in range(4)},
        rows,
        ("rms z: error over its sigma at the end",),
    )
