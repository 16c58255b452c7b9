"""Cost of a task beside its work, and a fleet's time over the number of processes."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from sgms_bench.studies.cases import say
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.logs import write_log
from sgms_mhe.support.parallel import workers
from sgms_mhe.support.processes import Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

JOBS: Final = (1, 2, 4, 8)
EMPTY: Final = 200
"""Tasks without work, whose processes import nothing."""
WAIT_S: Final = 0.2
LOG_S: Final = 10.0


def _estimate(log: str) -> int:
    machine = load_machine("etel_xy")
    return len(CompiledEstimator(machine).estimate_log(read_log(log, machine), mode="tick"))


def _diagnose(log: str) -> str:
    machine = load_machine("etel_xy")
    return diagnose(machine, read_log(log, machine)).verdict


def scaling_study(logs: int) -> CsvTable:
    """Time of `estimate` and `diagnose` per log in 1 to 8 processes, of tasks that do nothing and of ones that wait.

    Work is faster only as far as there are cores; waiting needs none, and so says how many processes the engine itself
    keeps busy.
    """
    machine = load_machine("etel_xy")
    with TemporaryDirectory() as folder:
        paths = []
        for seed in range(logs):
            path = Path(folder) / f"log_{seed}.csv"
            motion = make_trajectory("mixed", machine.sampling.rate, duration_s=LOG_S)
            write_log(path, simulate_axis(machine, motion, AxisConfig(seed=seed), truth=False).log)
            paths.append(str(path))
        work = {
            "nothing": [Task(str(k), abs, (k,)) for k in range(EMPTY)],
            "waiting": [Task(str(k), time.sleep, (WAIT_S,)) for k in range(EMPTY)],
            "estimate": [Task(path, _estimate, (path,)) for path in paths],
            "diagnose": [Task(path, _diagnose, (path,)) for path in paths],
        }
        results(work["estimate"][:1] + work["diagnose"][:1], WorkerSlot(1))  # what is compiled once for all is compiled
        rows: list[dict[str, Any]] = []
        for name, tasks in work.items():
            rows += _rows(name, tasks)
    return CsvTable(
        f"time of {logs} logs of {LOG_S:g} s at {machine.sampling.rate:g} Hz, and of {EMPTY} tasks that do nothing or "
        f"wait {WAIT_S:g} s",
        {"work": "", "processes": "d", "s": ".2f", "ms per task": ".1f", "faster than 1": ".2f"},
        rows,
        (f"the start of the processes is in it; the caches of compiled code are warm; {workers()} cores",),
    )


def _rows(name: str, tasks: list[Task]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for jobs in JOBS:
        started = time.monotonic()
        results(tasks, WorkerSlot(jobs))
        seconds = time.monotonic() - started
        first = rows[0]["s"] if rows else seconds
        cost = {"s": seconds, "ms per task": 1e3 * seconds / len(tasks), "faster than 1": first / seconds}
        rows.append({"work": name, "processes": jobs, **cost})
        say(f"{name}, {jobs} processes: {seconds:.1f} s")
    return rows
