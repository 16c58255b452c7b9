"""Outcome of a check, and the tools and programs that checks take."""

import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.host.compiled import replay_definitions
from sgms_mhe.machine import Machine
from sgms_mhe.support.errors import BuildError

T = TypeVar("T")


@dataclass(frozen=True)
class CheckOutcome:
    """Outcome of one check.

    Attributes:
        check: its name.
        tried: how many of what.
        failures: what failed, a text each.
        skipped: why it could not run; None: it did.
    """

    check: str
    tried: str
    failures: tuple[str, ...] = ()
    skipped: str | None = None


class AbsentError(Exception):
    """A tool is not there; the message says which, and what brings it."""


def require(*tools: str) -> None:
    """Make sure that commands are there.

    Raises:
        AbsentError: one is not.
    """
    absent = [tool for tool in tools if shutil.which(tool) is None]
    if absent:
        raise AbsentError(f"tool absent: {', '.join(absent)}")


def measure_packages(
    check: str,
    machines: Sequence[Machine],
    measure: Callable[[Package], T],
    progress: Callable[[str], None],
    told: Callable[[T], str] = lambda _: "",
) -> list[T] | CheckOutcome:
    """Measure the package of each machine; the outcome of the check where one does not compile, or fails.

    Args:
        check: its name.
        machines: of the packages.
        measure: of one package; raises BuildError.
        progress: called after every package.
        told: what it says of what was measured.
    """
    found = []
    for machine in machines:
        try:
            found.append(measure(emit_package(machine)))
        except BuildError as error:
            return CheckOutcome(check, f"nothing beyond {machine.name}", (f"{machine.name}: {error}",))
        progress(f"{check}: {machine.name}{told(found[-1])}")
    return found


def definitions(package: Package) -> list[str]:
    """Compiler definitions that bind a program of the verification to a package."""
    name = package.machine.name
    header, config = (package.files[f"{name}{end}.h"] for end in ("", "_config"))
    own = {
        "HAS_TIME": "int64_t elapsed;" in header,
        "WINDOW": "int32_t complete, cursor;" in header,
        "BOUNDED": "lower_bound[" in config,
        "DRIFTS": "drift_sd[" in config,
        "HAS_ORIGIN": f"{name}_set_origin(" in header,
        "SPREADS": "real spread[" in header,
        "RESUMES": "int32_t back;" in header,
        "HAS_INNER": "int32_t folded" in header,
        "HAS_CHOSEN": "int32_t slot;" in header,
    }
    return [
        *replay_definitions(name),
        f'-DSGMS_CONFIG_HEADER="{name}_config.h"',
        *(f"-D{key}={int(value)}" for key, value in own.items()),
    ]


@dataclass(frozen=True)
class Run:
    """Outcome of a program."""

    code: int
    output: str


def run(
    command: Sequence[str | Path],
    environment: Mapping[str, str] | None = None,
    folder: Path | None = None,
    seconds: float = 3600.0,
) -> Run:
    """Run a program; its exit code, and all that it printed. One that does not end in time has code 124."""
    words = [str(word) for word in command]
    try:
        done = subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            check=False,
            env=environment,
            cwd=folder,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        return Run(124, f"did not end within {seconds:g} s")
    return Run(done.returncode, done.stdout)


def run_or_raise(
    command: Sequence[str | Path], environment: Mapping[str, str] | None = None, folder: Path | None = None
) -> str:
    """Run a program that has to succeed; what it printed.

    Raises:
        BuildError: it failed.
    """
    done = run(command, environment, folder)
    if done.code != 0:
        raise BuildError(f"{command[0]}: exit code {done.code}\n{done.output}")
    return done.output
