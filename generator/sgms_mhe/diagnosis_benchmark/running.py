"""The benchmark as a whole: draws, diagnoses in a pool of processes, results on disk as they come."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from sgms_mhe import diagnosis
from sgms_mhe.diagnosis import Diagnosis
from sgms_mhe.diagnosis_benchmark.draws import Draw, machine_of, make_draw, simulate_draw
from sgms_mhe.diagnosis_benchmark.scoring import Found, Summary, confusion_table, summarise, summary_json, summary_text
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import ImplausibleError, InputError
from sgms_mhe.support.files import write_text

Diagnose = Callable[[Machine, Log], Diagnosis]
Progress = Callable[[int, int], None]
"""Called with (logs done, logs in all)."""

RESULTS: Final = "results.jsonl"
_TASKS_PER_PROCESS: Final = 40  # compiled models stay loaded: a process is replaced before they add up
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


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

    Every result is appended to results.jsonl in the folder as it comes: an interrupted run goes on where it stopped,
    and more draws continue a smaller run. summary.json, summary.txt and confusion.csv are written at the end.

    Args:
        machine: whose axis is simulated and whose file is diagnosed.
        out: folder.
        draws: how many logs.
        seed: of everything.
        jobs: processes; 1 runs here.
        diagnose: instead of `sgms_mhe.diagnosis.diagnose` (a function of a module, or `jobs` = 1).
        progress: as `Progress`.

    Raises:
        InputError: the folder holds results of another machine or seed.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / RESULTS
    done = _read(path, machine, seed)
    wanted = [k for k in range(draws) if k not in done]
    if progress is not None:
        progress(draws - len(wanted), draws)
    with path.open("a", encoding="utf-8") as stream:
        if stream.tell() == 0:
            _append(stream, _header(machine, seed))
        for count, (index, draw, found) in enumerate(_results(machine, seed, wanted, jobs, diagnose), start=1):
            _append(stream, {"index": index, "draw": draw.to_json(), "found": found.to_json()})
            done[index] = (draw, found)
            if progress is not None:
                progress(draws - len(wanted) + count, draws)
    summary = summarise(machine, [done[k] for k in sorted(done) if k < draws])
    write_text(folder / "summary.json", json.dumps(_plain(summary_json(summary)), indent=1) + "\n")
    write_text(folder / "summary.txt", summary_text(summary) + "\n")
    rows, columns, counts = confusion_table(summary.confusion)
    lines = [["hidden", *columns], *([row, *map(str, line)] for row, line in zip(rows, counts, strict=True))]
    write_text(folder / "confusion.csv", "".join(",".join(line) + "\n" for line in lines))
    return summary


def run_draw(machine: Machine, seed: int, index: int, diagnose: Diagnose = diagnosis.diagnose) -> tuple[Draw, Found]:
    """One log: drawn, simulated, read, diagnosed. What goes wrong in a diagnosis is a result too."""
    draw = make_draw(machine, seed, index)
    log, noise = simulate_draw(machine, draw)
    file, started = machine_of(machine, draw), time.monotonic()
    try:
        check_plausible(log, file)
        found = Found.of(diagnose(file, log), noise, time.monotonic() - started)
    except ImplausibleError as error:
        found = Found("unexplained", seconds=time.monotonic() - started, refused=str(error))
    except Exception as error:
        found = Found("", seconds=time.monotonic() - started, error=f"{type(error).__name__}: {error}")
    return draw, found


def _results(
    machine: Machine, seed: int, wanted: list[int], jobs: int, diagnose: Diagnose
) -> Iterator[tuple[int, Draw, Found]]:
    if jobs <= 1 or len(wanted) <= 1:
        for index in wanted:
            yield index, *run_draw(machine, seed, index, diagnose)
        return
    # Fresh processes: what is compiled and loaded here must not be shared. A pool is replaced as a whole: one that
    # replaces its processes by itself (max_tasks_per_child) can stop for good.
    context = multiprocessing.get_context("spawn")
    batch = jobs * _TASKS_PER_PROCESS
    for first in range(0, len(wanted), batch):
        with _one_thread_each(), ProcessPoolExecutor(jobs, mp_context=context) as pool:
            try:
                tasks = {
                    pool.submit(run_draw, machine, seed, index, diagnose): index
                    for index in wanted[first : first + batch]
                }
                for task in as_completed(tasks):
                    yield tasks[task], *task.result()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Numerical libraries that each take all cores slow each other down; they read this when they are loaded."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _header(machine: Machine, seed: int) -> dict[str, Any]:
    header = {"benchmark": "diagnosis", "machine": machine.name, "digest": machine.digest, "seed": seed}
    # The digest is of what is emitted; thresholds change the results too.
    return {**header, "diagnosis": machine.diagnosis.changed} if machine.diagnosis.changed else header


def _read(path: Path, machine: Machine, seed: int) -> dict[int, tuple[Draw, Found]]:
    """Results so far; a last line that an interrupt cut off is taken away."""
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        write_text(path, whole)
    lines = [json.loads(line) for line in whole.splitlines()]
    if not lines:
        return {}
    if lines[0] != _header(machine, seed):
        raise InputError(path, "results of", lines[0], f"{_header(machine, seed)}, or another folder")
    return {line["index"]: (Draw.from_json(_back(line["draw"])), Found.from_json(line["found"])) for line in lines[1:]}


def _append(stream: Any, content: Mapping[str, Any]) -> None:
    stream.write(json.dumps(_plain(content), separators=(",", ":")) + "\n")
    stream.flush()


def _plain(value: Any) -> Any:
    """JSON knows neither NaN nor infinity."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _back(draw: Mapping[str, Any]) -> dict[str, Any]:
    hidden = [{k: math.nan if v is None else v for k, v in h.items()} for h in draw["hidden"]]
    return {**draw, "hidden": hidden}
