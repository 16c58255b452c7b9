"""The benchmark as a whole: draws, diagnoses in processes, results on disk as they come."""

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from sgms_bench.diagnosis.draws import Draw, machine_of, make_draw, simulate_draw
from sgms_bench.diagnosis.scoring import (
    ScoredDiagnosis,
    Summary,
    confusion_table,
    summarise,
    summary_json,
    summary_text,
)
from sgms_mhe import diagnosis
from sgms_mhe.diagnosis import Diagnosis
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import ImplausibleError, InputError
from sgms_mhe.support.files import write_text
from sgms_mhe.support.kept import run_kept
from sgms_mhe.support.processes import Outcome, Task, WorkerSlot

Diagnose = Callable[[Machine, Log], Diagnosis]
Progress = Callable[[int, int], None]
"""Called with (logs done, logs in all)."""

RESULTS: Final = "results"
"""Folder of the draws' results, a folder each."""
RESULT: Final = "result.json"
_DIGITS: Final = 12
LIMIT_S: Final = 3600.0
"""Of a diagnosis."""


def run_diagnosis_benchmark(
    machine: Machine,
    out: str | Path,
    *,
    draws: int = 600,
    seed: int = 1,
    jobs: int = 2,
    diagnose: Diagnose = diagnosis.diagnose,
    progress: Progress | None = None,
) -> Summary:
    """Hide causes in simulated logs, diagnose each, score.

    Every result is kept in `results` of the folder as it comes: an interrupted run goes on where it stopped, and more
    draws continue a smaller run. Those of another machine or seed are others. summary.json, summary.txt and
    confusion.csv are written at the end.

    Args:
        machine: whose axis is simulated and whose file is diagnosed.
        out: folder.
        draws: how many logs.
        seed: of everything.
        jobs: processes; 1 runs here.
        diagnose: instead of `sgms_mhe.diagnosis.diagnose` (a function of a module, or `jobs` = 1).
        progress: as `Progress`.
    """
    folder = Path(out)
    keys = {_key(machine, seed, index): index for index in range(draws)}
    tasks = [Task(key, _kept_draw, (machine, seed, index, diagnose)) for key, index in keys.items()]
    place = WorkerSlot(jobs if jobs > 1 else 0, limit_s=LIMIT_S)
    done: dict[int, tuple[Draw, ScoredDiagnosis]] = {}
    if progress is not None:
        progress(0, draws)
    for outcome in run_kept(tasks, folder / RESULTS, place):
        index = keys[outcome.task.key]
        done[index] = _score(outcome, machine, seed, index)
        if progress is not None:
            progress(len(done), draws)
    summary = summarise(machine, [done[k] for k in sorted(done)])
    write_text(folder / "summary.json", json.dumps(plain_json(summary_json(summary)), indent=1) + "\n")
    write_text(folder / "summary.txt", summary_text(summary) + "\n")
    rows, columns, counts = confusion_table(summary.confusion)
    lines = [["hidden", *columns], *([row, *map(str, line)] for row, line in zip(rows, counts, strict=True))]
    write_text(folder / "confusion.csv", "".join(",".join(line) + "\n" for line in lines))
    return summary


def run_draw(
    machine: Machine, seed: int, index: int, diagnose: Diagnose = diagnosis.diagnose
) -> tuple[Draw, ScoredDiagnosis]:
    """One log: drawn, simulated, read, diagnosed."""
    draw = make_draw(machine, seed, index)
    return draw, diagnose_draw(machine, draw, diagnose)


def diagnose_draw(machine: Machine, draw: Draw, diagnose: Diagnose = diagnosis.diagnose) -> ScoredDiagnosis:
    """Return the diagnosis of the draw's log. An error in it is a result too."""
    log, noise = simulate_draw(machine, draw)
    file, started = machine_of(machine, draw), time.monotonic()
    try:
        check_plausible(log, file)
    except ImplausibleError as error:
        return ScoredDiagnosis("unexplained", seconds=time.monotonic() - started, refused=str(error))
    except InputError:  # of a log in which nothing changes there is nothing to say
        return ScoredDiagnosis("unexplained", seconds=time.monotonic() - started)
    try:
        return ScoredDiagnosis.of(diagnose(file, log), noise, time.monotonic() - started)
    except Exception as error:
        return ScoredDiagnosis("", seconds=time.monotonic() - started, error=f"{type(error).__name__}: {error}")


def _kept_draw(machine: Machine, seed: int, index: int, diagnose: Diagnose) -> dict[str, bytes]:
    return kept_result(*run_draw(machine, seed, index, diagnose))


def kept_result(draw: Draw, found: ScoredDiagnosis) -> dict[str, bytes]:
    """The file of a log's result."""
    return {RESULT: json.dumps(plain_json({"draw": draw.to_json(), "found": found.to_json()})).encode()}


def read_result(folder: Path) -> tuple[Draw, ScoredDiagnosis]:
    """Return the result that `kept_result` wrote."""
    content = json.loads((folder / RESULT).read_bytes())
    return Draw.from_json(_back(content["draw"])), ScoredDiagnosis.from_json(content["found"])


def _key(machine: Machine, seed: int, index: int) -> str:
    return f"{index:05d}-{digest_of(machine, seed)}"


def digest_of(machine: Machine, seed: int) -> str:
    """Of all that a result of a series hangs on but its place in it."""
    # The digest is of what is emitted; thresholds change the results too.
    whole = f"{machine.digest} {json.dumps(plain_json(machine.diagnosis.changed), sort_keys=True)} {seed}"
    return hashlib.sha256(whole.encode()).hexdigest()[:_DIGITS]


def _score(outcome: Outcome, machine: Machine, seed: int, index: int) -> tuple[Draw, ScoredDiagnosis]:
    """A draw with what was found; a diagnosis that took its process with it is an error of its own."""
    if outcome.failure:
        return make_draw(machine, seed, index), ScoredDiagnosis("", seconds=outcome.seconds, error=outcome.failure)
    return read_result(outcome.value)


def plain_json(value: Any) -> Any:
    """JSON knows neither NaN nor infinity."""
    if isinstance(value, Mapping):
        return {key: plain_json(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _back(draw: Mapping[str, Any]) -> dict[str, Any]:
    hidden = [{k: math.nan if v is None else v for k, v in h.items()} for h in draw["hidden"]]
    return {**draw, "hidden": hidden}
