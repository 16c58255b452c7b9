"""A small machine and how the tests of the command line run it."""

import os
import pty
import subprocess
import sys
from pathlib import Path
from typing import Final

import numpy as np
from click.testing import CliRunner, Result
from numpy.typing import NDArray

from sgms_mhe.cli import cli

# Two elements and short intervals: everything that the shipped machines have, in a tenth of the time.
SMALL = """
name = "small"
description = "two elements, 1 kHz"
[plant]
mass = 20.0
[friction]
stiffness = [3e4, 1e4]
fraction = [0.25, 0.75]
viscous = 20.0
coulomb = 4.0
[sampling]
rate = 1000.0
update_rate = 50.0
velocity_cutoff = 100.0
integrator = { scheme = "flow" }
[estimator]
horizon = 5
parameters = ["stiffness", "coulomb"]
[estimator.bounds]
stiffness = [0.2, 5.0]
"""


SCRIPT: Final = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # whoever runs the tests may ignore it
    "from sgms_mhe.cli import main; main()"
)
"""The command as a process of its own, for `python -c`."""


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def done(*arguments: str | Path) -> Result:
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    return result


def refused(*arguments: str | Path) -> str:
    """The message of a run that ends with exit code 2 and says nothing on stdout."""
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    return result.stderr


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def on_terminal(*arguments: str | Path, **variables: str) -> str:
    """What a command writes to stderr where that is a terminal."""
    ours, theirs = pty.openpty()
    plain = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "FORCE_COLOR")}
    environment = plain | {"TERM": "xterm-256color", "COLUMNS": "120", "LINES": "40"} | variables
    command = [sys.executable, "-c", SCRIPT, *map(str, arguments)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=theirs) as process:
        os.close(theirs)
        written = b""
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            written += part
    os.close(ours)
    assert process.returncode == 0, written
    return written.decode()


def read_columns(path: Path) -> dict[str, NDArray[np.float64]]:
    """Columns (n,) of a file that a command wrote, by name."""
    with path.open() as stream:
        names = stream.readline().rstrip("\n").split(",")
        return dict(zip(names, np.loadtxt(stream, delimiter=",", ndmin=2).T, strict=True))
