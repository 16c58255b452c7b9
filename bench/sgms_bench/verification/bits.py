"""The same bits from every compiler, at every level, on every processor: `bench/c/exercise.c`."""

import struct
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sgms_bench import C_DIR
from sgms_bench.verification.outcome import AbsentError, CheckOutcome, definitions, require, run
from sgms_mhe.configuration import override_machine
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.host.targets import TARGETS, Target, emulate, link_program
from sgms_mhe.machine import Machine
from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.paths import runtime_dir

DOUBLE_FLAGS: Final[Mapping[str, tuple[str, ...]]] = {"cortex_m7": ("-mfpu=fpv5-d16",)}
"""For double precision, by target. Without such an FPU libgcc for Arm adds, and not always to the nearest number."""
BIG_ENDIAN: Final = Target(
    name="cortex_a15",
    title="Arm Cortex-A15, high byte first (QEMU virt)",
    prefix="arm-none-eabi-",
    flags=(
        *("-mbig-endian", "-Wl,--be8", "-mcpu=cortex-a15", "-marm", "-mfpu=vfpv4", "-mfloat-abi=hard"),
        "-mno-unaligned-access",
    ),
    emulator=("qemu-system-arm", "-machine", "virt", "-cpu", "cortex-a15"),
    ticks=1.0,
    packages="gcc-arm-none-eabi and qemu-system-arm",
    double=r"v\w+\.(?:\w+\.)*f64\b.*",
)
"""A processor of the other order of bytes, of 32 bits, with a start of its own in `bench/c/target`."""
STRICT: Final = ("-std=c99", "-ffp-contract=off")
LEVELS: Final = ("-O0", "-O1", "-O2", "-O3", "-Os")
WIDER: Final[Mapping[str, tuple[str, ...]]] = {"AVX2": ("-mavx2",), "no SSE4": ("-mno-sse4",)}
"""Other vector registers than the default's."""
SEEN: Final = 0x7FF
"""What an exercise has to see, a bit each: every status but that of tasks which overlap."""
BOUND, NUMERIC = 1 << 4, 1 << 10


@dataclass(frozen=True)
class Digest:
    """Digest of an exercise.

    Attributes:
        bits: digest of all numbers. numbers: how many.
        statuses: those that were seen, one bit each.
    """

    bits: int
    numbers: int
    statuses: int


@dataclass(frozen=True)
class Build:
    """A way to make a program of a package: a compiler, or a target, and a level."""

    compiler: str
    flags: tuple[str, ...]
    target: Target | None = None

    @property
    def title(self) -> str:
        """For messages."""
        return " ".join([self.target.title if self.target else self.compiler, *self.flags])


def host_builds() -> Iterator[Build]:
    """Compilers and levels of this host."""
    for compiler in ("gcc", "clang"):
        yield from (Build(compiler, (level,)) for level in LEVELS)
        yield from (Build(compiler, ("-O3", *wider)) for wider in WIDER.values())


def target_builds(levels: Sequence[str] = LEVELS) -> Iterator[Build]:
    """Levels of the emulated processors."""
    for target in (*TARGETS.values(), BIG_ENDIAN):
        yield from (Build(f"{target.prefix}gcc", (level,), target) for level in levels)


def same_bits(
    machines: Sequence[Machine], builds: Sequence[Build], progress: Callable[[str], None]
) -> list[CheckOutcome]:
    """Exercise packages in both precisions and compare what comes out of every build with that of gcc -O2 here.

    One outcome per processor; of a processor whose tools are absent, one that says so.
    """
    outcomes = []
    for processor, own in _group_by_processor(builds).items():
        check = f"bits equal: {processor}"
        try:
            require(*{build.compiler for build in own}, *{b.target.emulator[0] for b in own if b.target})
        except AbsentError as absent:
            outcomes.append(CheckOutcome(check, "", skipped=str(absent)))
            continue
        failures = [failure for machine in machines for failure in _compare(machine, own)]
        outcomes.append(CheckOutcome(check, f"{2 * len(machines)} packages, {len(own)} builds each", tuple(failures)))
        progress(f"{check}: {len(failures)} failures")
    return outcomes


def _group_by_processor(builds: Sequence[Build]) -> dict[str, list[Build]]:
    found: dict[str, list[Build]] = {}
    for build in builds:
        found.setdefault(build.target.title if build.target else "x86-64", []).append(build)
    return found


def _compare(machine: Machine, builds: Sequence[Build]) -> Iterator[str]:
    """Return the differences from the first build, in either precision."""
    first = Build("gcc", ("-O2",))
    for precision in ("double", "single"):
        package = emit_package(override_machine(machine, {"code": {"precision": precision}}), selftest=False)
        expected = exercise(package, first)
        named = f"{machine.name}, {precision}"
        wanted = required_statuses(machine)
        if expected.statuses & wanted != wanted:
            yield f"{named}: the exercise sees statuses {expected.statuses:#x} alone"
        for build in builds:
            found = exercise(package, build)
            if found != expected:
                yield f"{named}: {build.title} gives {found.bits:016x}, {first.title} {expected.bits:016x}"


def required_statuses(machine: Machine) -> int:
    """Return the statuses that an exercise has to see of a machine, a bit each.

    Where readings are doubted no wild one gets as far as a bound or a solution that is none.
    """
    wanted = SEEN
    if machine.estimator.noise.self_scaling:
        wanted &= ~(BOUND | NUMERIC)
    return wanted if machine.estimator.bounds else wanted & ~BOUND


def exercise(package: Package, build: Build) -> Digest:
    """Compile a package in one way, exercise it, and digest what comes out.

    Raises:
        BuildError: it does not compile, or does not run to its end.
    """
    name = package.machine.name
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_package(package, folder / name)
        if build.target is not None:
            return _on_target(package, build, build.target, folder)
        files: list[str | Path] = [C_DIR / "exercise.c", folder / name / f"{name}.c", "-o", folder / "exercise"]
        made = run([build.compiler, *STRICT, *build.flags, *definitions(package), f"-I{folder / name}", *files])
        done = run([folder / "exercise"]) if made.code == 0 else made
    if done.code != 0:
        raise BuildError(f"{build.title}: {done.output}")
    bits, numbers, statuses = done.output.split()
    return Digest(int(bits, 16), int(numbers), int(statuses))


def _on_target(package: Package, build: Build, target: Target, folder: Path) -> Digest:
    name, is_low_first = package.machine.name, target is not BIG_ENDIAN
    core = [*target.flags]
    if package.machine.code.precision == "double":
        core += DOUBLE_FLAGS.get(target.name, ())
    options = [*STRICT, *build.flags, "-ffreestanding", *core]
    parts: dict[str, list[str | Path]] = {
        "package.o": [*options, folder / name / f"{name}.c"],
        "exercise.o": [
            *(*options, "-DON_TARGET", *definitions(package), f"-I{folder / name}"),
            f"-I{runtime_dir() / 'target'}",
            C_DIR / "exercise.c",
        ],
    }
    results = folder / "results.bin"
    if not is_low_first:
        parts["conversions.o"] = [*options, C_DIR / "target" / "conversions.c"]
    start = None if is_low_first else C_DIR / "target"
    program = link_program(target, parts, options, folder / "exercise.elf", core, start)
    emulate(target, program, results, lambda _: None)
    content = results.read_bytes()
    layout = "<3Q" if is_low_first else ">3Q"
    if len(content) != struct.calcsize(layout):
        raise BuildError(f"{build.title}: {len(content)} bytes of results")
    return Digest(*struct.unpack(layout, content))
