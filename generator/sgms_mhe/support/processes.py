"""Tasks in processes of their own: on this host, or on the workers of a Dask cluster.

One way for fleets, benchmarks and studies. Every task runs in a child process that works on nothing else meanwhile. So
a crash is the task's own and is put down to it, time that runs out ends that task alone, and code compiled and
loaded for one task is not shared with those beside it. A child works on many tasks, one after the other; it is
replaced before loaded libraries add up.
"""

import os
import pickle
import signal
import subprocess
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pipe
from typing import Any, Final

from sgms_mhe import __version__
from sgms_mhe.support.child import Answer, answer
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.libraries import optional_library
from sgms_mhe.support.parallel import VARIABLE, workers

ATTEMPTS: Final = 2
"""A task whose process dies is tried again once: a neighbour may have taken all memory."""

FIRST_WORKER_S: Final = 60.0
"""How long a cluster may take to bring its first worker."""

_TASKS_PER_CHILD: Final = 40
_LIBRARIES: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Task:
    """A call that depends on no other: a function of a module, or a partial of one, and its arguments.

    Attributes:
        key: its name; no two tasks of a run have the same.
    """

    key: str
    call: Callable[..., Any]
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """Outcome of a task.

    Attributes:
        value: that the call returned; None where it failed.
        failure: why, in one sentence; empty where it is done.
        seconds: computing time; 0 where a process died.
    """

    task: Task
    value: Any
    failure: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class WorkerSlot:
    """Where tasks run.

    Attributes:
        jobs: processes at a time on this host; 0: in this process, one after the other, without a limit of time.
        scheduler: address of a Dask scheduler, whose workers run them in place of this host.
        limit_s: of one task; it is stopped then, and has failed.
    """

    jobs: int = 0
    scheduler: str | None = None
    limit_s: float | None = None


HERE: Final = WorkerSlot()
"""In this process."""


def run_tasks(tasks: Sequence[Task], place: WorkerSlot) -> Iterator[Outcome]:
    """Outcome of every task, once, as they come.

    Whoever stops asking stops the rest: tasks under way are ended, those that wait are not begun.

    Raises:
        InputError: no such scheduler, or its workers have another version of this package.
    """
    if not tasks:
        return
    if place.scheduler is not None:
        yield from _on_cluster(tasks, place.scheduler, place.limit_s)
    elif place.jobs < 1:
        for task in tasks:
            yield Outcome(task, *answer(task.call, task.arguments))
    else:
        yield from _on_host(tasks, place)


def results(tasks: Sequence[Task], place: WorkerSlot, told: Callable[[int, int], object] | None = None) -> list[Any]:
    """Values of all tasks, in their order; for work of which no part may be missing.

    Args:
        tasks: calls.
        place: where they run.
        told: called with (tasks done, tasks in all).

    Raises:
        TaskError: one failed.
    """
    values: dict[str, Any] = {}
    for outcome in run_tasks(tasks, place):
        if outcome.failure:
            raise TaskError(f"{outcome.task.key}: {outcome.failure}")
        values[outcome.task.key] = outcome.value
        if told is not None:
            told(len(values), len(tasks))
    return [values[task.key] for task in tasks]


class TaskError(Exception):
    """A task failed whose result the rest cannot do without."""


# --- one child --------------------------------------------------------------------------------------------------


class _DeadError(Exception):
    """A child that ended with its task undone; says how."""


class _Child:
    """A process that works on one task after the other."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._ours, theirs = Pipe()
        with theirs:
            descriptor = theirs.fileno()
            # A session of its own: an interrupt from the keyboard is for the one who started it, who ends it.
            self._process = subprocess.Popen(
                [sys.executable, "-m", "sgms_mhe.support.child", str(descriptor)],
                pass_fds=[descriptor],
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        self.done = 0
        """Tasks that it was given."""

    def run(self, content: bytes, limit_s: float | None) -> Answer:
        """Answer to a pickled call.

        Raises:
            _DeadError: the process ended.
        """
        self.done += 1
        try:
            self._ours.send_bytes(content)
            if not self._ours.poll(limit_s):
                self.end()
                return Answer(None, f"not done within {limit_s:g} s, and stopped", limit_s or 0.0)
            return Answer(*pickle.loads(self._ours.recv_bytes()))
        except (EOFError, OSError):
            self.end(kill=False)
            raise _DeadError(_how(self._process.returncode)) from None

    def end(self, *, kill: bool = True) -> None:
        """End the process, at once or when it has read that there is nothing more."""
        if kill:
            self._process.kill()
        self._ours.close()
        self._process.wait()

    @property
    def spent(self) -> bool:
        """Return True if it has ended, or has worked long enough."""
        return self.done >= _TASKS_PER_CHILD or self._process.poll() is not None

    def kill(self) -> None:
        """From another thread: whoever waits for an answer hears the process died."""
        self._process.kill()
        self._process.wait()


def _how(code: int) -> str:
    if code >= 0:
        return f"ended with code {code}"
    name = signal.Signals(-code).name if -code in [*signal.Signals] else f"signal {-code}"
    return f"was killed by {name}{', perhaps for want of memory' if -code == signal.SIGKILL else ''}"


class Crew:
    """The children of this process: one for each thread that asks, replaced when they die or have worked long.

    Args:
        environment: of the children.
        limit_s: of one task; None: none.
    """

    def __init__(self, environment: Mapping[str, str], limit_s: float | None) -> None:
        self._environment, self._limit_s = environment, limit_s
        self._mine = threading.local()
        self._all: set[_Child] = set()
        self._lock = threading.Lock()
        self._closed = False

    def run(self, task: Task) -> Outcome:
        """Run a task in this thread's child."""
        try:
            content = pickle.dumps((task.call, task.arguments))
        except Exception as error:
            return Outcome(task, None, f"the task cannot be handed to a process: {error}")
        how = ""
        for _ in range(ATTEMPTS):
            child = self._child()
            if child is None:
                return Outcome(task, None, "stopped")
            try:
                answer = child.run(content, self._limit_s)
            except _DeadError as death:
                how = str(death)
                self._forget(child)
                continue
            if child.spent:
                child.end()
                self._forget(child)
            return Outcome(task, *answer)
        return Outcome(task, None, f"the process that worked on it {how}, {ATTEMPTS} times")

    def close(self) -> None:
        """End all workers, with their tasks."""
        with self._lock:
            self._closed = True
            children = tuple(self._all)
        for child in children:
            child.kill()

    def _child(self) -> _Child | None:
        child: _Child | None = getattr(self._mine, "child", None)
        if child is not None:
            return child
        with self._lock:
            if self._closed:
                return None
            child = _Child(self._environment)
            self._all.add(child)
        self._mine.child = child
        return child

    def _forget(self, child: _Child) -> None:
        self._mine.child = None
        with self._lock:
            self._all.discard(child)


def _environment(at_a_time: int) -> dict[str, str]:
    """Of a child: it has this process's environment, and leaves the other cores to the other children."""
    stated = os.environ.get(VARIABLE) or str(max(1, workers() // at_a_time))
    paths = os.pathsep.join(path for path in sys.path if path)
    return {**dict.fromkeys(_LIBRARIES, "1"), **os.environ, VARIABLE: stated, "PYTHONPATH": paths}


# --- this host --------------------------------------------------------------------------------------------------


def _on_host(tasks: Sequence[Task], place: WorkerSlot) -> Iterator[Outcome]:
    count = min(place.jobs, len(tasks))
    crew = Crew(_environment(count), place.limit_s)
    with ThreadPoolExecutor(count) as pool:
        waiting: set[Future[Outcome]] = {pool.submit(crew.run, task) for task in tasks}
        try:
            for future in as_completed(tuple(waiting)):
                waiting.discard(future)
                yield future.result()
        finally:
            for future in waiting:
                future.cancel()
            crew.close()


# --- a Dask cluster ---------------------------------------------------------------------------------------------

_crews: dict[float | None, Crew] = {}
_crews_lock = threading.Lock()


def _on_worker(task: Task, limit_s: float | None) -> Outcome:
    """Run a task on a worker of a cluster: in a child of it, which outlives the task and not the worker."""
    with _crews_lock:
        crew = _crews.setdefault(limit_s, Crew(_environment(workers()), limit_s))
    return crew.run(task)


def _version() -> str:
    return __version__


def _on_cluster(tasks: Sequence[Task], address: str, limit_s: float | None) -> Iterator[Outcome]:
    distributed = optional_library("distributed", "dask", "a Dask scheduler", "scheduler")
    try:
        client = distributed.Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError("scheduler", "address", address, f"that of a Dask scheduler that answers ({error})") from None
    with client:
        _check_versions(client, address)
        run = uuid.uuid4().hex  # results of another run are never taken for this one's
        waiting = {
            client.submit(partial(_on_worker, limit_s=limit_s), task, key=f"{run}-{task.key}", pure=False): task
            for task in tasks
        }
        try:
            for future in distributed.as_completed(tuple(waiting), loop=client.loop):
                task = waiting.pop(future)
                try:
                    outcome = future.result()
                except Exception as error:  # a worker that died with it too often, a scheduler that is gone
                    outcome = Outcome(task, None, f"the cluster gave it up: {type(error).__name__}: {error}")
                yield outcome
        finally:
            with suppress(Exception):
                client.cancel(tuple(waiting), force=True)


def _check_versions(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except TimeoutError:
        raise InputError("scheduler", "workers of", address, f"one at least within {FIRST_WORKER_S:g} s") from None
    try:
        found = client.run(_version)
    except Exception as error:
        allowed = f"workers that have sgms-mhe {__version__} ({type(error).__name__}: {error})"
        raise InputError("scheduler", "workers of", address, allowed) from None
    others = {worker: version for worker, version in found.items() if version != __version__}
    if others:
        worker, version = next(iter(others.items()))
        raise InputError("scheduler", f"sgms-mhe of worker {worker}", version, f"{__version__}, as here")
