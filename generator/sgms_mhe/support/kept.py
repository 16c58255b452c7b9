"""Results of tasks in a folder, each kept as soon as it is there: a run that was stopped goes on where it was.

A result is a few files in a folder of the task's key. It appears whole or not at all. A key says all that its result
hangs on, so a result found under it need not be computed again.
"""

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

from sgms_mhe.support.errors import InputError
from sgms_mhe.support.processes import Outcome, Task, WorkerSlot, run_tasks

Files = Mapping[str, bytes]
"""Content by file name."""


def run_kept(tasks: Sequence[Task], folder: Path, place: WorkerSlot) -> Iterator[Outcome]:
    """Outcome of every task, once: those that the folder holds first, then the others as they come.

    Args:
        tasks: calls that return `Files`; their keys are names of folders.
        folder: made where it does not exist.
        place: where those run that are not there yet.

    Yields:
        Outcomes whose value is the result's folder. Failures are not cached: the next run tries it again.

    Raises:
        InputError: the folder cannot be written to; as run_tasks does.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, "results", None, f"a folder that can be made ({error.strerror})") from None
    missing = []
    for task in tasks:
        if (folder / task.key).is_dir():
            yield Outcome(task, folder / task.key)
        else:
            missing.append(task)
    for outcome in run_tasks(missing, place):
        if outcome.failure:
            yield outcome
        else:
            yield replace(outcome, value=_keep(folder, outcome.task.key, outcome.value))


def _keep(folder: Path, key: str, files: Files) -> Path:
    place = folder / key
    try:
        part = Path(mkdtemp(dir=folder, prefix=f".{key}.", suffix=".part"))
        try:
            for name, content in files.items():
                with (part / name).open("wb") as stream:
                    stream.write(content)
                    stream.flush()
                    os.fsync(stream.fileno())
            part.chmod(0o755)
            try:
                part.rename(place)
            except OSError:
                if not place.is_dir():  # whoever else keeps the same result at the same time may be first
                    raise
        finally:
            shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        raise InputError(folder, "results", None, f"a folder that can be written ({error.strerror})") from None
    return place
