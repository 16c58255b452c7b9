"""A small machine and how the tests of the command line run it."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner, Result

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
