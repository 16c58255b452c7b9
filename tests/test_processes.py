"""Tasks in processes: every one has its outcome once, whatever the others do; what is done is kept."""

import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import process_tasks as work
from dask_cluster import Cluster
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.kept import run_kept
from sgms_mhe.support.parallel import VARIABLE
from sgms_mhe.support.processes import HERE, Outcome, Task, TaskError, WorkerSlot, results, run_tasks

TWO = WorkerSlot(2)


def by_key(outcomes: Iterator[Outcome]) -> dict[str, Outcome]:
    """Outcomes by the keys of their tasks, each of which there is once."""
    found = list(outcomes)
    assert max(Counter(outcome.task.key for outcome in found).values()) == 1
    return {outcome.task.key: outcome for outcome in found}


def alive(process: int) -> bool:
    """Whether a process works still: one that has ended and was not asked for does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def gone(process: int, within_s: float = 60.0) -> bool:
    """Whether a process is gone, or goes."""
    end = time.monotonic() + within_s
    while alive(process) and time.monotonic() < end:
        time.sleep(0.05)
    return not alive(process)


# --- outcomes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [HERE, WorkerSlot(1), WorkerSlot(3)], ids=["here", "one", "three"])
def test_values_in_the_order_of_the_tasks(place: WorkerSlot) -> None:
    told: list[tuple[int, int]] = []
    tasks = [Task(str(k), work.squared, (k,)) for k in range(7)]
    assert results(tasks, place, lambda done, total: told.append((done, total))) == [k**2 for k in range(7)]
    assert told == [(k + 1, 7) for k in range(7)]
    assert results([], place) == []


def test_what_fails_has_its_sentence_and_the_rest_is_done(tmp_path: Path) -> None:
    tasks = [
        Task("good", work.squared, (3,)),
        Task("refused", work.refused, ("log.csv",)),
        Task("broken", work.broken),
        Task("crashed", work.crashed),
        Task("left", work.left),
        Task("unpicklable", work.unpicklable),
        Task("lambda", lambda: None),
        Task("once", work.crashed_once, (str(tmp_path / "mark"),)),
        Task("last", work.squared, (4,)),
    ]
    found = by_key(run_tasks(tasks, TWO))
    assert found.keys() == {task.key for task in tasks}
    assert {key: outcome.value for key, outcome in found.items() if not outcome.failure} == {
        "good": 9,
        "once": "alive",  # the next process did it
        "last": 16,
    }
    said = {key: outcome.failure for key, outcome in found.items() if outcome.failure}
    assert said["refused"] == "log.csv: row 3: a number"
    assert said["broken"].startswith("KeyError: 'mass' (process_tasks.py:")
    assert said["crashed"] == "the process that worked on it was killed by SIGSEGV, 2 times"
    assert said["left"] == "the process that worked on it ended with code 7, 2 times"
    assert said["unpicklable"].startswith("the result cannot be handed back")
    assert said["lambda"].startswith("the task cannot be handed to a process")
    with pytest.raises(TaskError, match=r"broken: KeyError"):
        results(tasks[:3:2], TWO)


def test_what_takes_too_long_is_stopped_and_the_next_begins() -> None:
    found = by_key(run_tasks([Task(name, work.hung) for name in "abc"], WorkerSlot(1, limit_s=1.0)))
    assert {outcome.failure for outcome in found.values()} == {"not done within 1 s, and stopped"}
    assert len(found) == 3


def test_a_process_works_on_many_tasks_and_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sgms_mhe.support.processes._TASKS_PER_CHILD", 3)
    numbers = results([Task(str(k), work.process) for k in range(6)], WorkerSlot(1))
    assert numbers[0] == numbers[1] == numbers[2] != numbers[3] == numbers[5]
    assert os.getpid() not in numbers


def test_processes_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(8)))

    def seen(name: str, jobs: int) -> Any:
        return results([Task(str(k), work.environment, (name,)) for k in range(jobs)], WorkerSlot(jobs))[0]

    assert seen(VARIABLE, 2) == "4"
    assert seen("OMP_NUM_THREADS", 2) == "1"
    monkeypatch.setenv(VARIABLE, "3")
    assert seen(VARIABLE, 2) == "3"


def test_whoever_stops_asking_ends_the_work() -> None:
    tasks = [Task("first", work.process), *(Task(str(k), work.hung) for k in range(5))]
    outcomes = run_tasks(tasks, WorkerSlot(1))
    process = next(outcomes).value
    assert alive(process)
    outcomes.close()  # type: ignore[attr-defined]
    assert gone(process)


def test_children_end_with_the_process_that_started_them(tmp_path: Path) -> None:
    code = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})
import process_tasks as work
from dask_cluster import Cluster
from sgms_mhe.support.processes import Task, WorkerSlot, run_tasks
outcomes = run_tasks([Task("a", work.process), Task("b", work.hung)], WorkerSlot(1))
print(next(outcomes).value, flush=True)
next(outcomes)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert alive(child)
        parent.kill()
    assert gone(child)


def test_a_script_need_not_guard_its_own_start(tmp_path: Path) -> None:
    """As a notebook's cells do: what a child runs is the task, not the script that asked for it."""
    script = tmp_path / "script.py"
    script.write_text(f"""
import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})
import process_tasks as work
from sgms_mhe.support.processes import Task, WorkerSlot, results
print(results([Task(str(k), work.squared, (k,)) for k in range(3)], WorkerSlot(2)))
""")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout == "[0, 1, 4]\n"


# --- what is kept -----------------------------------------------------------------------------------------------


def test_what_is_kept_is_not_done_again_and_what_failed_is(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    tasks = [Task(name, work.files, (str(tmp_path), name)) for name in "abc"]
    first = run_kept([*tasks, Task("never", work.no_files)], kept, HERE)
    taken = [next(first), next(first)]
    first.close()  # type: ignore[attr-defined]
    assert [outcome.task.key for outcome in taken] == ["a", "b"]
    again = by_key(run_kept([*tasks, Task("never", work.no_files)], kept, HERE))
    assert (tmp_path / "calls").read_text().split() == ["a", "b", "c"]
    assert again["never"].failure.startswith("ValueError: no result")
    assert {path.name for path in kept.iterdir()} == {"a", "b", "c"}
    for key in "abc":
        assert again[key].value == kept / key
        assert (kept / key / "name.txt").read_text() == key
        assert {path.name for path in (kept / key).iterdir()} == {"name.txt", "empty"}


def test_two_that_keep_the_same_do_no_harm(tmp_path: Path) -> None:
    tasks = [Task("same", work.files, (str(tmp_path), "same", 0.2))]
    found: list[Outcome] = []

    def run() -> None:
        found.extend(run_kept(tasks, tmp_path / "kept", HERE))

    threads = [threading.Thread(target=run) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [outcome.failure for outcome in found] == [""] * 3
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {"same"}


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="a folder that can be made"):
        list(run_kept([], tmp_path / "file" / "kept", HERE))


# --- a cluster --------------------------------------------------------------------------------------------------


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    (tmp_path / "dask").mkdir()
    found = Cluster(tmp_path / "dask")
    yield found
    found.close()


ignored_by_dask = pytest.mark.filterwarnings("ignore")  # its own warnings on closing are nobody's here


@ignored_by_dask
@pytest.mark.slow
def test_a_worker_killed_in_the_middle_loses_nothing_and_doubles_nothing(cluster: Cluster, tmp_path: Path) -> None:
    first, _ = cluster.worker(), cluster.worker()
    names = [f"log{k}" for k in range(12)]
    tasks = [Task(name, work.files, (str(tmp_path), name, 0.3)) for name in names]
    tasks += [Task("broken", work.broken), Task("crashed", work.crashed)]
    found: list[Outcome] = []
    for outcome in run_kept(tasks, tmp_path / "kept", WorkerSlot(scheduler=cluster.address)):
        found.append(outcome)
        if len(found) == 3:
            first.kill()  # with a task in its hands, and results that were not fetched perhaps
    assert Counter(outcome.task.key for outcome in found) == Counter(task.key for task in tasks)
    failed = {outcome.task.key: outcome.failure for outcome in found if outcome.failure}
    assert failed.keys() == {"broken", "crashed"}
    assert failed["crashed"] == "the process that worked on it was killed by SIGSEGV, 2 times"
    assert {path.name for path in (tmp_path / "kept").iterdir()} == set(names)
    assert all((tmp_path / "kept" / name / "name.txt").read_text() == name for name in names)
    (hung,) = run_tasks([Task("hung", work.hung)], WorkerSlot(scheduler=cluster.address, limit_s=1.0))
    assert hung.failure == "not done within 1 s, and stopped"


@ignored_by_dask
def test_a_cluster_without_workers_is_refused(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sgms_mhe.support.processes.FIRST_WORKER_S", 1.0)
    with pytest.raises(InputError, match=r"workers of = 'tcp://.*': one at least within 1 s"):
        list(run_tasks([Task("a", work.process)], WorkerSlot(scheduler=cluster.address)))


@ignored_by_dask
def test_a_scheduler_that_does_not_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match="scheduler: address = 'nonsense': that of a Dask scheduler that answers"):
        list(run_tasks([Task("a", work.process)], WorkerSlot(scheduler="nonsense")))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"'distributed': not installed, .* needs it: pip install 'sgms-mhe\[dask\]'"):
        list(run_tasks([Task("a", work.process)], WorkerSlot(scheduler="tcp://127.0.0.1:1")))
