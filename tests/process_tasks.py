"""Tasks that tests hand to processes: what goes well, fails, crashes, hangs and counts its calls."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sgms_mhe.support.errors import InputError

if TYPE_CHECKING:
    from sgms_mhe.api.fleet.table import Row, Verb
    from sgms_mhe.machine import Machine


def squared(number: int) -> int:
    return number**2


def refused(file: str) -> None:
    raise InputError(file, "row 3", None, "a number")


def broken() -> None:
    raise KeyError("mass")


def crashed() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def crashed_once(mark: str) -> str:
    """Dies where nobody has died before."""
    path = Path(mark)
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def left() -> None:
    os._exit(7)


def hung() -> None:
    threading.Event().wait()


def unpicklable() -> object:
    return lambda: None


def environment(name: str) -> str | None:
    return os.environ.get(name)


def process() -> int:
    return os.getpid()


def files(folder: str, name: str, seconds: float = 0.0) -> dict[str, bytes]:
    """A result of two files; a line in `calls` of the folder says that it was made."""
    time.sleep(seconds)
    with (Path(folder) / "calls").open("a") as stream:
        stream.write(f"{name}\n")
    return {"name.txt": name.encode(), "empty": b""}


def no_files() -> dict[str, bytes]:
    raise ValueError("no result")


def hung_work(*_: object) -> dict[str, bytes]:
    hung()
    return {}


def work_on_the_first(verb: Verb, row: Row, machine: Machine | None, table: Mapping[str, Any]) -> dict[str, bytes]:
    """The work on the first row of a fleet's table; on any other it never ends."""
    from sgms_mhe.api.fleet.work import work

    return work(verb, row, machine, table) if row.number == 2 else hung_work()
