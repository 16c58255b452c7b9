"""Independent pieces of work on all cores of this process, with the results of one after the other.

Threads: the work is in compiled code, which runs without the interpreter's lock. How many there are changes when a
piece is done and nothing else.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

from sgms_mhe.support.errors import InputError

T = TypeVar("T")

VARIABLE: Final = "SGMS_MHE_WORKERS"
"""Environment variable that states how many pieces are worked on at a time."""

LIBRARIES: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that state how many threads a numerical library takes."""

_here = threading.local()


def workers() -> int:
    """How many pieces are worked on at a time: what SGMS_MHE_WORKERS states, or the cores that this process may use.

    Raises:
        InputError: it states no positive number.
    """
    stated = os.environ.get(VARIABLE)
    if stated is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not stated.isdecimal() or int(stated) < 1:
        raise InputError("environment", VARIABLE, stated, "a whole number from 1 on")
    return int(stated)


def leave_cores_to_tasks() -> None:
    """Ask numerical libraries that are not loaded yet for one thread each, unless the environment says otherwise.

    Their matrices are small here: more threads of theirs wait for each other, on cores that tasks have work for.
    """
    for name in LIBRARIES:
        os.environ.setdefault(name, "1")


def in_parallel(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Results of tasks that do not depend on each other, in their order.

    What a task starts in its turn runs within it, one after the other. Of several errors the first task's is raised,
    once all that were begun are done.
    """
    count = min(workers(), len(tasks))
    if count < 2 or getattr(_here, "busy", False):
        return [task() for task in tasks]
    with ThreadPoolExecutor(count, initializer=_begin) as pool:
        futures = [pool.submit(task) for task in tasks]
        try:
            return [future.result() for future in futures]
        finally:
            for future in futures:
                future.cancel()


def _begin() -> None:
    """Mark a thread as one that works on a piece."""
    _here.busy = True
