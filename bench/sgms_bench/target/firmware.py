"""A package cross-compiled and linked for a microcontroller: its size, and what precision its code computes in."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sgms_bench import C_DIR
from sgms_bench.target.stacks import call_paths
from sgms_mhe.emission.package import Package, write_package
from sgms_mhe.host.compiled import replay_definitions
from sgms_mhe.host.targets import TARGET_FLAGS, Target, link_program, run_tool
from sgms_mhe.support.paths import runtime_dir

SECTIONS: Final = ("-ffunction-sections", "-fdata-sections")
"""A section of its own for each function: a firmware takes those that it calls, and is charged for them alone."""

LOOPS: Final = (1, 10, 1000, 100_000)
"""Counts of the loops that calibrate the counter; one turn is two instructions, each loop two more."""


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
    start, name = runtime_dir() / "target", package.machine.name
    headers = folder / name
    write_package(package, headers)
    options: list[str | Path] = [*flags, "-ffreestanding", *target.flags]
    definitions = [*replay_definitions(name, package.machine.plant.kind), f"-DSGMS_LOOPS={','.join(map(str, LOOPS))}"]
    parts: dict[str, list[str | Path]] = {
        "package.o": [*options, *SECTIONS, "-fcallgraph-info=su", headers / f"{name}.c"],
        "trial.o": [*options, *definitions, f"-I{headers}", f"-I{start}", C_DIR / "trial.c"],
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
