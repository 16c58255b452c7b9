"""Random calls of random packages under sanitizers: `bench/c/fuzz.c` and its parts."""

import math
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from sgms_bench import C_DIR
from sgms_bench.verification.machines import random_package
from sgms_bench.verification.outcome import AbsentError, CheckOutcome, Run, definitions, run
from sgms_mhe.emission.package import Package, write_package

Progress = Callable[[str], None]
"""Called with a line on what has been done."""

DIALECT: Final = ("-std=c99", "-g", "-ffp-contract=off")
CLANGS: Final = ("clang", "clang-19")
LONGEST_INPUT: Final = 2048
SLOWEST_INPUT_S: Final = 120
MESSAGE_LINES: Final = 12
MOST_CALLS: Final = 20_000
"""Of one input."""
MOST_OPERATIONS: Final = 5e7
"""Of the calls of one input, as stated."""

LEAST_SHARE: Final = 0.02
"""Of as many calls of each machine: what one of large calls gets at least."""

PARTS: Final = ("fuzz.c", "fuzz_input.c", "fuzz_checks.c", "fuzz_others.c")
"""The program but for the package."""


@dataclass(frozen=True)
class Sanitizer:
    """A way to compile the fuzzed program.

    Attributes:
        title: for the table.
        compilers: commands; the first that has the sanitizer is taken.
        flags: of the compiler.
        guided: inputs come from libFuzzer, which follows what they cover; otherwise from the program's own generator.
    """

    title: str
    compilers: tuple[str, ...]
    flags: tuple[str, ...]
    guided: bool


SANITIZERS: Final[Mapping[str, Sanitizer]] = MappingProxyType(
    {
        "address": Sanitizer(
            "random calls: addresses, undefined behaviour, conversions",
            CLANGS,
            ("-O1", "-fsanitize=fuzzer,address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"),
            guided=True,
        ),
        "memory": Sanitizer(
            "random calls: memory that nothing has written",
            CLANGS,
            ("-O1", "-fsanitize=fuzzer,memory", "-fsanitize-memory-track-origins"),
            guided=True,
        ),
        "plain": Sanitizer(
            "random calls: addresses, undefined behaviour, conversions (gcc, unguided)",
            ("gcc",),
            ("-O0", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all", "-DOWN_DRIVER"),
            guided=False,
        ),
    }
)
"""Sanitizers by name."""


def fuzz_machines(
    sanitizer: Sanitizer, seeds: Sequence[int], calls: int, keep: Path, progress: Progress = lambda _: None
) -> CheckOutcome:
    """Make calls of the packages of random machines.

    A call of one machine may take a thousand times that of another. So each machine gets as much work, as its package
    states it, but no less than a share `LEAST_SHARE` of the calls that were to be its.

    Args:
        sanitizer: how they are compiled.
        seeds: of the machines.
        calls: in all.
        keep: folder for inputs that failed, and the packages that they failed.
        progress: called after every machine.
    """
    done, failures = 0, []
    try:
        find_compiler(sanitizer)
        packages = [random_package(seed) for seed in seeds]
        cheapness = [1.0 / _operations(package) for package in packages]
        for seed, package, cheap in zip(seeds, packages, cheapness, strict=True):
            share = math.ceil(calls * max(cheap / sum(cheapness), LEAST_SHARE / len(packages)))
            made, failure = fuzz_package(sanitizer, package, share, seed, keep / f"machine{seed}")
            done += made
            failures += [f"machine of seed {seed}: {failure}"] if failure else []
            progress(f"{sanitizer.title}: machine {seed}, {done} calls, {len(failures)} failures")
    except AbsentError as absent:
        return CheckOutcome(sanitizer.title, "", skipped=str(absent))
    return CheckOutcome(sanitizer.title, f"{done} calls of {len(seeds)} machines", tuple(failures))


def find_compiler(sanitizer: Sanitizer) -> str:
    """Return the first of its compilers that has it.

    Raises:
        AbsentError: none has.
    """
    entry = "#include <stdint.h>\n#include <stddef.h>\nint LLVMFuzzerTestOneInput(const uint8_t *d, size_t n);\n"
    entry += "int LLVMFuzzerTestOneInput(const uint8_t *d, size_t n) { return d == 0 && n > 0; }\n"
    absent = ""
    for compiler in sanitizer.compilers:
        if shutil.which(compiler) is None:
            absent = absent or f"tool absent: {compiler}"
            continue
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "empty.c"
            source.write_text(entry if sanitizer.guided else "int main(void) { return 0; }\n")
            if run([compiler, *sanitizer.flags, source, "-o", Path(folder) / "empty"]).code == 0:
                return compiler
        absent = f"{compiler} has no {sanitizer.flags[1]} here (Debian: libclang-rt-dev)"
    raise AbsentError(absent)


def build_fuzzer(sanitizer: Sanitizer, package: Package, folder: Path) -> Path:
    """The program that fuzzes a package, below `folder`, with the package.

    Raises:
        RuntimeError: it did not compile; the message carries why.
    """
    name, limit = package.machine.name, package.machine.compensation.limit
    write_package(package, folder / name)
    program = folder / "fuzz"
    own = [f"-DMOST_CALLS={_most_calls(package)}"]
    own += [f"-DFORCE_LIMIT=((machine_real){limit!r})"] if limit is not None else []
    compiler = find_compiler(sanitizer)
    flags = [*DIALECT, *sanitizer.flags, *definitions(package), *own, f"-I{folder / name}"]
    compiled = folder / "package.o"
    # every function of it tells where it is entered: there an interrupt may come in
    made = run([compiler, *flags, "-finstrument-functions", "-c", folder / name / f"{name}.c", "-o", compiled])
    if made.code == 0:
        made = run([compiler, *flags, *(C_DIR / part for part in PARTS), compiled, "-o", program])
    if made.code != 0:
        raise RuntimeError(f"{compiler} refused: {made.output}")
    return program


def _most_calls(package: Package) -> int:
    """So many that an input does not take long, as most of them are samples."""
    return max(100, min(MOST_CALLS, int(MOST_OPERATIONS / _operations(package))))


def _operations(package: Package) -> float:
    """Of a sample on average, as stated."""
    stated = re.search(r"^ \*   an update +(\d+)", package.files[f"{package.machine.name}.h"], re.MULTILINE)
    if stated is None:
        raise ValueError("the package states no work")
    return int(stated[1]) / package.machine.sampling.samples_per_update


def fuzz_package(sanitizer: Sanitizer, package: Package, calls: int, seed: int, keep: Path) -> tuple[int, str]:
    """Make calls of one package.

    Args:
        sanitizer: how it is compiled.
        package: the package.
        calls: how many.
        seed: of the inputs.
        keep: receives the program, the package and the input where it fails, and nothing otherwise.

    Returns:
        Calls made, and what went wrong; "" where nothing did.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        program = build_fuzzer(sanitizer, package, folder)
        found = _run_fuzzer(sanitizer, program, calls, seed)
        if found.code == 0:
            counted = re.search(r"^(\d+) calls$", found.output, re.MULTILINE)
            return (int(counted[1]), "") if counted else (0, "no calls were counted")
        keep.parent.mkdir(parents=True, exist_ok=True)
        folder.rename(keep)
        folder.mkdir()
    return 0, f"{_message(found)} (kept in {keep})"


def _run_fuzzer(sanitizer: Sanitizer, program: Path, calls: int, seed: int) -> Run:
    if not sanitizer.guided:
        return run([program, str(seed), str(calls)])
    options = [f"-seed={seed + 1}", f"-max_len={LONGEST_INPUT}", "-len_control=0", f"-timeout={SLOWEST_INPUT_S}"]
    options.append(f"-artifact_prefix={program.parent}/")
    return run([program, *options], {**os.environ, "CALLS": str(calls)})


def _message(found: Run) -> str:
    """The lines that say what failed."""
    said = r"runtime error|^fuzz: |ERROR|WARNING: MemorySanitizer|^ +#\d+ 0x\w+ in \w+ .*\.[ch]:"
    lines = [line.strip() for line in found.output.splitlines() if re.search(said, line)]
    return f"exit code {found.code}: " + " | ".join(lines[:MESSAGE_LINES])
