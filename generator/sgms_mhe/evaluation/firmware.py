"""A package cross-compiled and linked for a microcontroller: its size, and what precision its code computes in."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from sgms_mhe.emission.package import Package, write_package
from sgms_mhe.evaluation.stacks import call_paths
from sgms_mhe.host.compiled import replay_definitions
from sgms_mhe.support.paths import runtime_dir
from sgms_mhe.support.toolchain import tool_output

TARGET_FLAGS: Final = ("-std=c99", "-O2", "-ffp-contract=off")
"""A multiply and an add stay two roundings: what the target computes is then what a host computes."""

SECTIONS: Final = ("-ffunction-sections", "-fdata-sections")
"""A section of its own for each function: a firmware takes those that it calls, and is charged for them alone."""

LOOPS: Final = (1, 10, 1000, 100_000)
"""Counts of the loops that calibrate the counter; one turn is two instructions, each loop two more."""


@dataclass(frozen=True)
class Target:
    """A microcontroller: how to compile for it and how to emulate it.

    Attributes:
        name: as in the names of its start code and linker script.
        title: what it is.
        prefix: of the compiler and its tools.
        flags: of the compiler, for the core and its FPU.
        emulator: command and arguments of the board, clock included.
        ticks: of the counter per instruction.
        packages: Debian packages that bring both.
        double: mnemonics of double-precision instructions (regular expression).
    """

    name: str
    title: str
    prefix: str
    flags: tuple[str, ...]
    emulator: tuple[str, ...]
    ticks: float
    packages: str
    double: str

    @property
    def remedy(self) -> str:
        """What to do where they are absent."""
        return f"the Debian packages {self.packages} bring what the target takes"


TARGETS: Final[Mapping[str, Target]] = MappingProxyType(
    {
        target.name: target
        for target in (
            Target(
                name="cortex_m7",
                title="Arm Cortex-M7 (QEMU mps2-an500)",
                prefix="arm-none-eabi-",
                # The emulated FPU has both precisions, as some parts have; code for the smaller one runs on all.
                flags=("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard"),
                # 512 ns per instruction, and a timer of 25 MHz.
                emulator=("qemu-system-arm", "-machine", "mps2-an500", "-icount", "shift=9"),
                ticks=12.8,
                packages="gcc-arm-none-eabi and qemu-system-arm",
                double=r"v\w+\.(?:\w+\.)*f64\b.*",
            ),
            Target(
                name="riscv32",
                title="RISC-V RV32IMAFC (QEMU virt)",
                prefix="riscv64-unknown-elf-",
                flags=("-march=rv32imafc", "-mabi=ilp32f"),
                # minstret counts nanoseconds of emulated time: here, instructions.
                emulator=("qemu-system-riscv32", "-machine", "virt", "-bios", "none", "-icount", "shift=0"),
                ticks=1.0,
                packages="gcc-riscv64-unknown-elf and qemu-system-misc",
                double=r"(?:c\.)?f(?:ld|sd|\w*(?:\.\w+)*\.d(?:\.\w+)*)(?:sp)?",
            ),
        )
    }
)
"""Targets by name."""


@dataclass(frozen=True)
class Program:
    """A linked trial and what is known without running it.

    Attributes:
        path: the executable.
        package, helpers, data: bytes, as `Memory` has them.
        paths: bytes of stack of the deepest call path from every function of the package, by name.
        double_arithmetic: library functions and instructions of double precision that the package uses.
        loops: rounds of the loops that calibrate the counter.
    """

    path: Path
    package: int
    helpers: int
    data: int
    paths: Mapping[str, int]
    double_arithmetic: tuple[str, ...]
    loops: tuple[int, ...]


def build_program(target: Target, package: Package, folder: Path, flags: Sequence[str] = TARGET_FLAGS) -> Program:
    """Cross-compile a package and link it with the trial.

    Args:
        target: the target.
        package: the package, in any precision.
        folder: receives the files.
        flags: of the compiler, besides the target's.

    Raises:
        BuildError: the compiler is not there, or it refused.
    """
    source, name = runtime_dir() / "target", package.machine.name
    headers = folder / name
    write_package(package, headers)
    options: list[str | Path] = [*flags, "-ffreestanding", *target.flags]
    definitions = [*replay_definitions(name, package.machine.plant.kind), f"-DSGMS_LOOPS={','.join(map(str, LOOPS))}"]
    parts: dict[str, list[str | Path]] = {
        "package.o": [*options, *SECTIONS, "-fcallgraph-info=su", headers / f"{name}.c"],
        "trial.o": [*options, *definitions, f"-I{headers}", f"-I{source}", source / "trial.c"],
    }
    linked = link_program(target, parts, options, folder / "trial.elf")
    sizes = section_sizes(target, linked)
    return Program(
        path=linked,
        package=sizes.get(".package", 0),
        helpers=sizes.get(".helpers", 0),
        data=sizes.get(".package_data", 0),
        paths=call_paths((folder / "package.ci").read_text()),
        double_arithmetic=double_arithmetic(target, folder / "package.o"),
        loops=LOOPS,
    )


def link_program(
    target: Target,
    parts: Mapping[str, Sequence[str | Path]],
    options: Sequence[str | Path],
    program: Path,
    core: Sequence[str] | None = None,
) -> Path:
    """Compile the parts of a program, and link them with the start code and no library.

    Args:
        target: the target.
        parts: arguments of the compiler by name of the object, which is left beside the program.
        options: of the compiler, for the functions of memory that code without a library needs.
        program: the executable.
        core: flags for the core; None: the target's.

    Returns:
        The program.

    Raises:
        BuildError: the compiler is not there, or it refused.
    """
    source, flags = runtime_dir() / "target", target.flags if core is None else core
    own: dict[str, Sequence[str | Path]] = {
        # Otherwise a compiler recognises the loop in memcpy and calls memcpy for it.
        "helpers.o": [*options, "-fno-tree-loop-distribute-patterns", source / "helpers.c"],
        "start.o": [*flags, source / f"{target.name}.S"],
    }
    objects = []
    for part, arguments in {**parts, **own}.items():
        objects.append(program.parent / part)
        run_tool(target, "gcc", *arguments, "-c", "-o", objects[-1])
    script = source / f"{target.name}.ld"
    run_tool(
        target, "gcc", *flags, "-nostdlib", "-Wl,--gc-sections", f"-Wl,-T,{script}", *objects, "-lgcc", "-o", program
    )
    return program


def section_sizes(target: Target, path: Path) -> dict[str, int]:
    """Bytes of every section of an object or a program."""
    rows = re.findall(r"^(\.\S+)\s+(\d+)\s+\d+$", run_tool(target, "size", "-A", path), re.MULTILINE)
    return {name: int(size) for name, size in rows}


def double_arithmetic(target: Target, path: Path) -> tuple[str, ...]:
    """Library functions and instructions of double precision that an object uses, sorted."""
    needed = [line.split()[-1] for line in run_tool(target, "nm", "-u", path).splitlines() if line.split()]
    # __aeabi_dadd, __aeabi_cdcmple, __aeabi_f2d; __adddf3, __floatdidf, __truncdfsf2
    helpers = {name for name in needed if re.fullmatch(r"__aeabi_c?d\w+|__aeabi_\w+2d|__\w+df\w*", name)}
    listing = run_tool(target, "objdump", "-d", "--no-show-raw-insn", path)
    mnemonics = set(re.findall(r"^ *[0-9a-f]+:\t(\S+)", listing, re.MULTILINE))
    return tuple(sorted(helpers | {word for word in mnemonics if re.fullmatch(target.double, word)}))


def run_tool(target: Target, tool: str, *arguments: str | Path) -> str:
    """What one of the target's tools (`gcc`, `size`) prints. Raises BuildError where it is not there, or refused."""
    return tool_output([f"{target.prefix}{tool}", *map(str, arguments)], target.remedy)
