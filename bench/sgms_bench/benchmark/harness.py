"""The emitted C in `bench/c/harness.c`: compiled, timed, its instructions counted."""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sgms_bench import C_DIR
from sgms_mhe.emission.package import Package, write_package
from sgms_mhe.host.compiled import replay_definitions
from sgms_mhe.machine import Machine
from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, program

Array = NDArray[np.float64]


def build_harness(machine: Machine, package: Package, flags: Sequence[str] = DEFAULT_FLAGS) -> Path:
    """Compile `bench/c/harness.c` with a package; with its self-test where it brings one.

    Raises:
        BuildError: the compiler refused.
    """
    name = machine.name
    definitions = [*replay_definitions(name, machine.plant.kind), f'-DSGMS_CONFIG_HEADER="{name}_config.h"']
    own = [file for file in package.files if file.endswith(".c")]
    if f"{name}_selftest.c" in own:
        definitions.append("-DSGMS_SELFTEST")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / name
        write_package(package, folder)
        sources = [C_DIR / "harness.c", *(folder / file for file in own)]
        return program(sources, include_dirs=[folder], flags=[*flags, *definitions], libraries=["m"])


def fastest_runs(command: Sequence[str], count: int, header: int = 0) -> Array:
    """Numbers that a program prints, a row per update, without `header` lines: the smallest of `count` runs each."""
    runs = []
    for _ in range(count):
        lines = _output(command).splitlines()[header:]
        runs.append([[float(field) for field in line.split(",")] for line in lines])
    fastest: Array = np.min(np.array(runs), axis=0)
    return fastest


def instructions_of(command: Sequence[str], function: str) -> Array | None:
    """Instructions of every call of a function (u); None without valgrind or where it cannot run the program."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        dump = Path(folder) / "callgrind"
        counted = [valgrind, "--tool=callgrind", f"--toggle-collect={function}", f"--dump-after={function}"]
        try:
            _output([*counted, f"--callgrind-out-file={dump}", *command])
        except BuildError:  # an instruction that valgrind does not know
            return None
        totals = {}
        for part in Path(folder).glob("callgrind.*"):
            total = re.search(r"^totals: (\d+)", part.read_text(errors="replace"), re.MULTILINE)
            if total is not None and int(total[1]) > 0:  # not the rest after the last update
                totals[int(part.suffix[1:])] = float(total[1])
    return np.array([totals[k] for k in sorted(totals)]) if totals else None


def _output(command: Sequence[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BuildError(f"{command[0]}: exit code {done.returncode}\n{done.stderr}")
    return done.stdout
