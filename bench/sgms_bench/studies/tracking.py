"""Friction fed forward while the axis has what its machine file has not, with and without a force of the place."""

from itertools import product
from typing import Any, Final

from sgms_bench.compensation.running import compare_compensations
from sgms_bench.compensation.tracking import EKF, MHE, STATIC
from sgms_bench.studies.cases import done_of
from sgms_bench.studies.lasting import FOLLOWED, STATED
from sgms_bench.studies.lasting_errors import CLEAN, ERRORS
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

HIDDEN: Final = ("none", "cogging 0.3 N / 2 mm", "cogging 1 N / 32 mm", "offset 0.5 N")
"""Errors that stay, by name."""
TRACKED: Final = {"circle": "circle, contour", "step_and_settle": "step_and_settle", "paper": "paper"}
"""Row of the comparison that is shown of each scenario."""


def tracking_rows(hidden: str, scenario: str, duration_s: float) -> list[dict[str, Any]]:
    """Tracking errors under one hidden error, without the force of a place and with it."""
    machine = load_machine("etel_xy_compensation")
    effects = next(error.effects for error in (*CLEAN, *ERRORS) if error.name == hidden)
    rows = []
    for stated in ({}, STATED[FOLLOWED]):
        estimating = override_machine(machine, {"estimator": stated})
        found = compare_compensations(estimating, [scenario], duration_s=duration_s, hidden=effects).measures
        row: dict[str, Any] = {
            "hidden": hidden,
            "scenario": scenario,
            "estimator": FOLLOWED if stated else "as the file",
        }
        for method in (STATIC, EKF, MHE):
            measures = found[TRACKED[scenario], method]
            row |= {f"{method} RMS": 1e9 * measures.rms_m, f"{method} peak": 1e9 * measures.peak_m}
        rows.append(row)
    return rows


def tracking_study(duration_s: float, place: WorkerSlot = HERE) -> CsvTable:
    """Tracking errors [nm] of `etel_xy_compensation` under each of `HIDDEN`."""
    tasks = [
        Task(f"{hidden}-{scenario}", tracking_rows, (hidden, scenario, duration_s))
        for hidden, scenario in product(HIDDEN, TRACKED)
    ]
    rows = [row for part in results(tasks, place, done_of("scenarios")) for row in part]
    columns = [f"{method} {kind}" for method in (STATIC, EKF, MHE) for kind in ("RMS", "peak")]
    return CsvTable(
        "Tracking error [nm] with friction fed forward, of an axis that has what its machine file has not",
        {"hidden": "", "scenario": "", "estimator": ""} | dict.fromkeys(columns, ".1f"),
        rows,
        ("peak: mean of the peaks after reversals; plant as in `compensate`: switching law, parameters 30 % off",),
    )
