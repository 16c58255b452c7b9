"""A process that works on tasks of another: started by `support/processes.py`, `python -m sgms_mhe.support.child`.

It takes pickled calls from a pipe and answers each. It ends when the pipe does, and when the process that started it
is gone, whatever it works on.
"""

import os
import pickle
import sys
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, NamedTuple

from sgms_mhe.support.errors import BuildError, InputError, speak_to_command_line

_LOOKS_EVERY_S: Final = 0.5


class Answer(NamedTuple):
    """Answer to a call: its value, or why there is none, in one sentence; and its duration [s]."""

    value: Any
    failure: str
    seconds: float


def answer(call: Callable[..., Any], arguments: tuple[Any, ...]) -> Answer:
    """Call it. Whatever it raises is an answer too; an interrupt goes on."""
    started = time.monotonic()
    try:
        value, failure = call(*arguments), ""
    except Exception as error:
        value, failure = None, _sentence(error)
    return Answer(value, failure, time.monotonic() - started)


def _sentence(error: Exception) -> str:
    if isinstance(error, InputError | BuildError):
        with speak_to_command_line():  # a fleet's row has a machine file, and no Python argument
            return str(error)
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{place}"


def _load(content: bytes) -> Answer:
    try:
        call, arguments = pickle.loads(content)
    except Exception as error:
        return Answer(None, f"the task cannot be read by the process that is to do it: {error}", 0.0)
    return answer(call, arguments)


def _leave_with(parent: int) -> None:
    """End this process when the one that started it has ended: nobody waits for the answer."""
    while os.getppid() == parent:
        time.sleep(_LOOKS_EVERY_S)
    os._exit(1)


def main(descriptor: int) -> None:
    """Answer calls until there are no more."""
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    with Connection(descriptor) as asked:
        while True:
            try:
                content = asked.recv_bytes()
            except EOFError:
                return
            answer = _load(content)
            try:
                reply = pickle.dumps(tuple(answer))
            except Exception as error:
                reply = pickle.dumps((None, f"the result cannot be handed back: {error}", answer.seconds))
            asked.send_bytes(reply)


if __name__ == "__main__":
    main(int(sys.argv[1]))
