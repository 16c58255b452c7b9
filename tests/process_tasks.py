"""Tasks that tests hand to processes: what goes well, fails, crashes, hangs and counts its calls."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from sgms_mhe.support.errors import InputError


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


def hung(seconds: float) -> str:
    time.sleep(seconds)
    return "woke up"


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


def slow_work(*_: object) -> dict[str, bytes]:
    time.sleep(60.0)
    return {}
