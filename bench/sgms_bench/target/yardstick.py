"""One estimation problem for friction observers of any origin, on emulated microcontrollers (bench/yardstick)."""

import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

from sgms_bench import C_DIR
from sgms_bench.motions import timed_motion
from sgms_bench.target.firmware import section_sizes
from sgms_bench.target.trial import encode_samples, single_precision
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import emit_package, write_package
from sgms_mhe.host.targets import TARGET_FLAGS, TARGETS, Target, emulate, link_program
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.paths import runtime_dir

FOLDER: Final = C_DIR.parent / "yardstick"
MACHINE: Final = "etel_xy"
TRUE_STIFFNESS: Final = (0.7, 1.3, 0.8, 1.25)
"""Stiffness of the axis over that of its file."""
UPDATES: Final = 400
"""Of the record, in hundredths of a second."""
M7: Final = TARGETS["cortex_m7"]
CORES: Final[Mapping[str, Target]] = {
    "Cortex-M4F": replace(
        M7,
        title="Arm Cortex-M4F (QEMU mps2-an386)",
        flags=("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
        emulator=("qemu-system-arm", "-machine", "mps2-an386", "-icount", "shift=9"),
    ),
    "Cortex-M7": M7,
}


@dataclass(frozen=True)
class Entry:
    """One observer: its C files in the folder of the yardstick.

    Attributes:
        title: what it is.
        source: of `entry.h`'s functions.
        exporter: a program in Python that writes further C files into the folder it is given.
    """

    title: str
    source: str
    exporter: str = ""


ENTRIES: Final[Mapping[str, Entry]] = {
    "sgms-mhe": Entry("this package, horizon 20", "sgms_mhe.c"),
    "ekf": Entry("EKF by hand, dense matrix code", "ekf.c"),
    "casadi": Entry("the same EKF, its step by CasADi", "casadi_filter.c", "casadi_filter.py"),
    "none": Entry("no observer: the force that mass leaves", "measured.c"),
}


@dataclass(frozen=True)
class Score:
    """One entry on one core.

    Attributes:
        instructions: of every sample (n,).
        flash, ram: bytes; RAM with the deepest stack that was written.
        friction: what it says at every sample (n,) [N].
    """

    instructions: NDArray[np.int64]
    flash: int
    ram: int
    friction: NDArray[np.float64]

    def error(self, truth: NDArray[np.float64]) -> float:
        """RMS of its friction minus the true one over the second half, over the RMS of that [1]."""
        late = slice(len(truth) // 2, None)
        return float(np.sqrt(np.mean((self.friction - truth)[late] ** 2) / np.mean(truth[late] ** 2)))


def encode_problem() -> tuple[bytes, NDArray[np.float64]]:
    """Return the samples that every entry gets, as it gets them, and the true friction at each (n,) [N]."""
    machine = load_machine(MACHINE)
    config = AxisConfig(seed=1, force_noise_N=0.05, encoder_resolution_m=1e-9)
    scale = {"stiffness": TRUE_STIFFNESS}
    run = simulate_axis(machine, timed_motion(machine, "mixed", UPDATES), config, scale=scale)
    if run.truth is None:
        raise BuildError(f"{MACHINE}: simulated without its truth")
    return encode_samples(run.log, len(run.log)).tobytes(), run.truth.friction_N


def run_entry(name: str, core: str, samples: bytes) -> Score:
    """Build an entry for a core, and run it over the samples. Raises BuildError."""
    entry, target = ENTRIES[name], CORES[core]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        options: list[str | Path] = [*TARGET_FLAGS, "-ffreestanding", *target.flags, f"-I{FOLDER}", f"-I{folder}"]
        sources: list[Path] = []
        if entry.exporter:
            subprocess.run([sys.executable, FOLDER / entry.exporter, folder], check=True, cwd=folder)
            sources = sorted(folder.glob("*.c"))
        elif name == "sgms-mhe":
            write_package(emit_package(single_precision(load_machine(MACHINE)), selftest=False), folder)
            sources = [folder / f"{MACHINE}.c"]
        # One object, so that the linker script charges it with all that it brings.
        whole = folder / "whole.c"
        whole.write_text("".join(f'#include "{source}"\n' for source in (*sources, FOLDER / entry.source)))
        parts: dict[str, Sequence[str | Path]] = {
            "package.o": [*options, "-ffunction-sections", "-fdata-sections", whole],
            "yardstick.o": [*options, f"-I{C_DIR}", f"-I{runtime_dir() / 'target'}", FOLDER / "yardstick.c"],
        }
        program = link_program(target, parts, options, folder / "yardstick.elf")
        sizes = section_sizes(target, program)
        (folder / "samples.bin").write_bytes(samples)
        results = folder / "results.bin"
        emulate(target, program, results, lambda _: None)
        words = np.frombuffer(results.read_bytes(), dtype="<u4")
    if len(words) % 2 == 0:
        raise BuildError(f"{name} on {core}: {len(words)} words of results")
    rows = words[2:-1].reshape(-1, 2)
    return Score(
        instructions=np.rint((rows[:, 0].astype(np.int64) - int(words[1])) / target.ticks).astype(np.int64),
        flash=sizes.get(".package", 0) + sizes.get(".helpers", 0),
        ram=int(words[0]) + sizes.get(".package_data", 0) + int(words[-1]),
        friction=np.ascontiguousarray(rows[:, 1]).view("<f4").astype(np.float64),
    )


def main() -> None:
    """Print the table of all entries on all cores."""
    samples, truth = encode_problem()
    click.echo("| entry | core | error | instructions a sample | longest | flash | RAM |")
    click.echo("|---|---|---|---|---|---|---|")
    for name, entry in ENTRIES.items():
        for core in CORES:
            score = run_entry(name, core, samples)
            count = score.instructions
            click.echo(
                f"| {entry.title} | {core} | {100.0 * score.error(truth):.2f} % | {count.mean():.0f} | {count.max()} "
                f"| {score.flash / 1000:.1f} kB | {score.ram / 1000:.1f} kB |"
            )


if __name__ == "__main__":
    main()
