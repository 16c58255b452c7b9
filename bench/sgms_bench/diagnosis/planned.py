"""Test of the next experiment: one of two causes that look alike is hidden, the separating move is run.

Where a diagnosis is `ambiguous` it hands out a trajectory (`plan --separate A B`). On the log of that move it has to
say one name, the right one, whichever of the two is hidden and whichever law the axis obeys.
"""

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_bench.diagnosis.axes import LAWS, PlantLaw
from sgms_bench.diagnosis.causes import Hidden, prescribed_signals, sized_cause
from sgms_bench.diagnosis.draws import something_to_act_on
from sgms_bench.diagnosis.running import LIMIT_S, RESULT, RESULTS, Progress, plain_json
from sgms_bench.diagnosis.scoring import ScoredDiagnosis, Share
from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.diagnosis.plan import make_plan
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import cause_names, separating_moves
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.support.files import write_text
from sgms_mhe.support.kept import run_kept
from sgms_mhe.support.processes import Task, WorkerSlot
from sgms_mhe.support.tables import CsvTable

RMS: Final = 0.05
"""Of the force of what is hidden, over the Coulomb level; a diagnosis calls 0.02 a good fit."""
PEAKS: Final = (0.1, 0.8)
"""Size of the first try, and the largest one, over the Coulomb level."""


@dataclass(frozen=True)
class PlannedExperiment:
    """One cause of a pair hidden, on an axis of one law.

    Attributes:
        hidden: the cause.
        other: what it might be taken for.
        obeys: the law of the simulated axis.
    """

    hidden: str
    other: str
    obeys: PlantLaw

    @property
    def key(self) -> str:
        """Name of its result."""
        return f"{self.hidden}-or-{self.other}-{self.obeys}"


def experiments(machine: Machine) -> list[PlannedExperiment]:
    """Both causes of every pair that the catalogue says is confused, on both laws."""
    pairs = [pair for pair in combinations(cause_names(machine.plant.kind), 2) if separating_moves(*pair)]
    return [PlannedExperiment(a, b, law) for pair in pairs for a, b in (pair, pair[::-1]) for law in LAWS]


def run_experiment(machine: Machine, experiment: PlannedExperiment) -> ScoredDiagnosis | None:
    """Run the planned move on the axis and diagnose its log; None where the cause has not that size on it."""
    changes = something_to_act_on(machine, (experiment.hidden,))
    if changes:
        machine = override_machine(machine, changes)
    seed = int.from_bytes(hashlib.sha256(experiment.key.encode()).digest()[:4], "big")
    motion = make_plan(machine, (experiment.hidden, experiment.other)).trajectory
    hidden = _hidden(machine, motion, experiment.hidden, seed)
    if hidden is None:
        return None
    run = simulate_axis(
        machine,
        motion,
        AxisConfig(law=experiment.obeys, seed=seed),
        hidden_effects=[(hidden.name, hidden.parameters)] if hidden.parameters else [],
        scale=dict(hidden.factors),
        truth=False,
    )
    started = time.monotonic()
    found = diagnose(machine, run.log)
    return ScoredDiagnosis.of(found, float("nan"), time.monotonic() - started)


def _hidden(machine: Machine, motion: Trajectory, name: str, seed: int) -> Hidden | None:
    """A cause whose force has that RMS along the motion, or comes as near to it as its peak may."""
    plain, size = prescribed_signals(machine, motion, Hidden("")), PEAKS[0]
    found: Hidden | None = None
    for _ in range(3):
        sized = sized_cause(machine, motion, plain, name, size, np.random.default_rng(seed))
        if sized is None:
            break
        found, force = sized
        size = min(PEAKS[1], size * RMS * machine.friction.coulomb / float(np.sqrt(np.mean(force**2))))
    return found


def verdict_on(experiment: PlannedExperiment, found: ScoredDiagnosis | None) -> str:
    """`right`, `ambiguous` with the right name, `wrong`, `nothing` named, `unexplained`; `no log`: none was had."""
    if found is None:
        return "no log"
    if found.verdict == "explained":
        return "right" if found.names == (experiment.hidden,) else "wrong"
    if found.verdict == "ambiguous":
        return "ambiguous" if experiment.hidden in (*found.names, *(name for name, _ in found.rivals)) else "wrong"
    return "nothing" if found.verdict == "adequate" else found.verdict


def run_planned(machine: Machine, out: str | Path, *, jobs: int = 2, progress: Progress | None = None) -> CsvTable:
    """Run every experiment; results are kept in the folder as they come, and a table of them at the end.

    Args:
        machine: whose axis is simulated and whose file is diagnosed.
        out: folder; results that it holds are not computed again.
        jobs: processes; 1 runs here.
        progress: called with (logs done, logs in all).
    """
    folder, chosen = Path(out), experiments(machine)
    keys = {f"{experiment.key}-{machine.digest[:12]}": experiment for experiment in chosen}
    tasks = [Task(key, _kept, (machine, experiment)) for key, experiment in keys.items()]
    said: dict[PlannedExperiment, tuple[str, str]] = {}
    for outcome in run_kept(tasks, folder / RESULTS, WorkerSlot(jobs if jobs > 1 else 0, limit_s=LIMIT_S)):
        experiment = keys[outcome.task.key]
        said[experiment] = ("failed", outcome.failure) if outcome.failure else _read(experiment, outcome.value)
        if progress is not None:
            progress(len(said), len(keys))
    table = _table(machine, chosen, said)
    write_text(folder / "planned.txt", f"{table}\n")
    return table


def _kept(machine: Machine, experiment: PlannedExperiment) -> dict[str, bytes]:
    found = run_experiment(machine, experiment)
    return {RESULT: json.dumps(plain_json(None if found is None else found.to_json())).encode()}


def _read(experiment: PlannedExperiment, place: Path) -> tuple[str, str]:
    content: Any = json.loads((place / RESULT).read_bytes())
    found = None if content is None else ScoredDiagnosis.from_json(content)
    names = () if found is None else (*found.names, *(f"or {name}" for name, _ in found.rivals))
    return verdict_on(experiment, found), ", ".join(names)


def _table(
    machine: Machine, chosen: Sequence[PlannedExperiment], said: dict[PlannedExperiment, tuple[str, str]]
) -> CsvTable:
    had = [experiment for experiment in chosen if said[experiment][0] != "no log"]
    right = Share(sum(said[experiment][0] == "right" for experiment in had), len(had))
    low, high = right.interval
    rows = [
        {"hidden": e.hidden, "or": e.other, "law": e.obeys, "outcome": said[e][0], "named": said[e][1]}
        for e in chosen
        if said[e][0] != "right"
    ]
    return CsvTable(
        f"The move that tells two causes apart, on {machine.name}: one of them hidden, RMS {RMS:.0%} of f_C",
        dict.fromkeys(("hidden", "or", "law", "outcome", "named"), ""),
        rows,
        (
            f"the one right name: {right.hits} of {right.total} logs, {right.value:.1%} ({low:.0%} to {high:.0%}); "
            "the table lists the others;",
            "no log: the cause has not that size on the move",
        ),
    )
