"""Independent pieces of work on all cores of this process, with the results of one after the other.

Threads: the work is in compiled code, which runs without the interpreter's lock. How many there are changes when a
piece is done and nothing else.
"""

import contextvars
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, Generic, TypeVar

from threadpoolctl import threadpool_limits

from sgms_mhe.support.errors import InputError

T = TypeVar("T")

VARIABLE: Final = "SGMS_MHE_WORKERS"
"""Environment variable that states how many pieces are worked on at a time."""


def workers() -> int:
    """How many pieces are worked on at a time: SGMS_MHE_WORKERS, or the cores this process may use.

    Raises:
        InputError: it states no positive number.
    """
    stated = os.environ.get(VARIABLE)
    if stated is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not stated.isdecimal() or int(stated) < 1:
        raise InputError("environment", VARIABLE, stated, "a whole number from 1 on")
    return int(stated)


@contextmanager
def one_library_thread() -> Iterator[None]:
    """Give linear algebra one thread.

    Its matrices are small here: more threads of it wait for each other, on cores that tasks have work for, and add up
    numbers in another order, so that a close decision would hang on the host's cores.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def run_parallel(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Results of tasks that do not depend on each other, in their order.

    Tasks started by a task are shared out likewise, among the cores that are free, or get free before all of it
    has begun. Of several errors the first task's is raised, once all that were begun are done.
    """
    if min(workers(), len(tasks)) < 2:
        return [task() for task in tasks]
    batch = _Batch(tasks)
    _cores.offer(batch)
    batch.work()
    batch.wait()
    return batch.outcome()


def beside(task: Callable[[], T], others: Sequence[Callable[[], object]]) -> T:
    """Result of a task; other ones, of which only that they are done counts, run at the same time."""
    found: list[T] = []
    run_parallel([lambda: found.append(task()), *others])
    return found[0]


class _Batch(Generic[T]):
    """Tasks that any number of threads take, the first ones first, until none is left or one has failed."""

    def __init__(self, tasks: Sequence[Callable[[], T]]) -> None:
        self._tasks = tasks
        self._context = contextvars.copy_context()  # tasks belong to whose work they are, in whatever thread
        self._changed = threading.Condition()
        self._begun = self._ended = 0
        self._waited_for = False
        self._results: dict[int, T] = {}
        self._errors: dict[int, BaseException] = {}

    @property
    def left(self) -> int:
        """Tasks that nobody has begun, and somebody still has to."""
        return 0 if self._errors else len(self._tasks) - self._begun

    def work(self) -> None:
        """Take tasks as long as there are any."""
        while True:
            with self._changed:
                if not self.left:
                    return
                number = self._begun
                self._begun += 1
            try:
                self._results[number] = self._context.copy().run(self._tasks[number])
            except BaseException as error:
                self._errors[number] = error
            with self._changed:
                self._ended += 1
                if self._waited_for and self._is_done():
                    self._waited_for = False
                    _cores.take_again()  # for who waits, before this one's own core is free for others
                    self._changed.notify_all()

    def _is_done(self) -> bool:
        """Return True if all that were begun have ended, and no more are to be."""
        return not self.left and self._ended == self._begun

    def wait(self) -> None:
        """Return when it is done. Others may have the core meanwhile."""
        with self._changed:
            if not self._is_done():
                self._waited_for = True
                _cores.give_back()
                self._changed.wait_for(self._is_done)

    def outcome(self) -> list[T]:
        """All results; of the errors the first task's, which was begun before any other that failed."""
        if self._errors:
            raise self._errors[min(self._errors)]
        return [self._results[number] for number in range(len(self._tasks))]


class _Cores:
    """How many pieces are at work beside the one that asked first, and those that wait for a core."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._busy = 0
        self._offered: list[_Batch[Any]] = []  # the outermost first, whose pieces are the largest

    def offer(self, batch: _Batch[Any]) -> None:
        """Have a batch worked on by as many cores as are free, and by others as soon as they are.

        One task is for who offers it.
        """
        with self._guard:
            self._offered.append(batch)
            for _ in range(batch.left - 1):
                self._employ()

    def give_back(self) -> None:
        """A piece is done, or waits."""
        with self._guard:
            self._busy -= 1
            self._employ()

    def take_again(self) -> None:
        """One that waited goes on, whoever has its core meanwhile."""
        with self._guard:
            self._busy += 1

    def _employ(self) -> None:
        """Give a core that is free, if one is, to the first batch that has work for it."""
        self._offered = [batch for batch in self._offered if batch.left]
        if self._offered and self._busy < workers() - 1:
            self._busy += 1
            threading.Thread(target=_help, args=(self._offered[0],), daemon=True).start()


_cores = _Cores()


def _help(batch: _Batch[Any]) -> None:
    """Work on a batch with a core taken for it."""
    try:
        batch.work()
    finally:
        _cores.give_back()
