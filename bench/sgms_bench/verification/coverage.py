"""Lines and branches of emitted C that its self-test and an exercise of all calls reach; the rest has a reason each."""

import gzip
import json
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_bench import C_DIR
from sgms_bench.verification.gaps import GAPS, Gap
from sgms_bench.verification.outcome import (
    AbsentError,
    CheckOutcome,
    definitions,
    measure_packages,
    require,
    run_or_raise,
)
from sgms_mhe.emission.package import Package, write_package
from sgms_mhe.machine import Machine

# Without inlining every branch of a function stands for all of its callers, once; several lanes have most lines.
FLAGS: Final = ("-std=c99", "-O0", "-ffp-contract=off", "-DSGMS_VECTORS=1", "--coverage", "-fno-inline")
INLINED: Final = "__attribute__((always_inline)) inline"


@dataclass(frozen=True)
class SourceLine:
    """A line of emitted C as packages have it in common.

    Attributes:
        function: in which; the machine's name in it is NAME.
        code: text of the line, likewise, without what tells single precision.
        nth: of the same text in the function.
        branches: that it has.
    """

    function: str
    code: str
    nth: int
    branches: int


@dataclass(frozen=True)
class Coverage:
    """Of one package: how often every line was executed, and its branches taken."""

    counts: Mapping[SourceLine, tuple[int, ...]]

    @property
    def lines(self) -> tuple[int, int]:
        """(executed, all)."""
        return sum(line > 0 for line, *_ in self.counts.values()), len(self.counts)

    @property
    def branches(self) -> tuple[int, int]:
        """(taken, all)."""
        taken = sum(count > 0 for _, *branches in self.counts.values() for count in branches)
        return taken, sum(place.branches for place in self.counts)


def check_coverage(machines: Sequence[Machine], progress: Callable[[str], None]) -> CheckOutcome:
    """Check that every line and branch of packages is reached: in each, in another, or not for a reason."""
    check = "coverage: every line and branch, or a reason"
    try:
        require("gcc", "gcov")
    except AbsentError as absent:
        return CheckOutcome(check, "", skipped=str(absent))
    found = measure_packages(
        check, machines, measure, progress, lambda of: f", {of.lines} lines, {of.branches} branches"
    )
    if isinstance(found, CheckOutcome):
        return found
    lines, branches = (np.sum([getattr(of, name) for of in found], axis=0) for name in ("lines", "branches"))
    left = find_gaps(found)
    explained = {place: reason_of(place) for place in left}
    failures = [f"{place.function}: {place.code}" for place, reason in explained.items() if reason is None]
    used = set(explained.values())
    failures += [f"no package has this gap any more: {gap.function}: {gap.code}" for gap in GAPS if gap not in used]
    tried = (
        f"{lines[0]} of {lines[1]} lines, {branches[0]} of {branches[1]} branches of {len(found)} packages; "
        f"{len(left)} lines in none of them, for {len(GAPS)} reasons"
    )
    return CheckOutcome(check, tried, tuple(failures))


def find_gaps(found: Sequence[Coverage]) -> list[SourceLine]:
    """Lines that no package executes, or of which a branch is taken in none."""
    most: dict[SourceLine, tuple[int, ...]] = {}
    for coverage in found:
        for place, counts in coverage.counts.items():
            most[place] = tuple(map(max, most.get(place, counts), counts))
    return [place for place, counts in most.items() if 0 in counts]


def reason_of(place: SourceLine) -> Gap | None:
    """The entry of the list that explains it."""
    return next((gap for gap in GAPS if gap.explains(place.function, place.code)), None)


def measure(package: Package, *, exercised: bool = True) -> Coverage:
    """Run a package's self-test, and the exercise of all its calls, and count what they reach.

    Args:
        package: with self-test vectors.
        exercised: with the exercise; without, the self-test alone.

    Raises:
        BuildError: a program does not compile, or fails.
    """
    name = package.machine.name
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_package(package, folder / name)
        header = folder / name / "sgms_real.h"
        header.write_text(header.read_text().replace(INLINED, "inline"))
        options: list[str | Path] = [*FLAGS, *definitions(package), f"-I{folder / name}"]
        run_or_raise(["gcc", *options, "-c", folder / name / f"{name}.c", "-o", folder / "package.o"])
        programs = list_programs(folder / name, name)
        if not exercised:
            del programs["exercise"]
        for program, (parts, defined, arguments) in programs.items():
            bare: list[str | Path] = [*(option for option in options if option != "--coverage"), *defined]
            objects: list[str | Path] = [folder / f"{program}_{part}.o" for part in range(len(parts))]
            for source, compiled in zip(parts, objects, strict=True):
                run_or_raise(["gcc", *bare, source, "-c", "-o", compiled])
            run_or_raise(["gcc", "--coverage", *objects, folder / "package.o", "-o", folder / program, "-lm"])
            run_or_raise([folder / program, *arguments])
        run_or_raise(
            ["gcov", "--json-format", "--branch-probabilities", "-o", folder, folder / "package.o"], folder=folder
        )
        reports = list(folder.glob("*.gcov.json.gz"))
        content = json.loads(gzip.decompress(reports[0].read_bytes()))
        return _coverage(content, folder / name, name)


def list_programs(folder: Path, name: str) -> dict[str, tuple[list[Path], list[str], list[str]]]:
    """Return the programs that reach a package's C, by name: sources, definitions, arguments.

    Args:
        folder: of the package.
        name: of its machine.
    """
    selftest = [C_DIR / "harness.c", folder / f"{name}_selftest.c"]
    return {"selftest": (selftest, ["-DSGMS_SELFTEST"], ["--selftest"]), "exercise": ([C_DIR / "exercise.c"], [], [])}


def _coverage(content: Mapping[str, Any], folder: Path, name: str) -> Coverage:
    counts: dict[SourceLine, tuple[int, ...]] = {}
    seen = Counter[tuple[str, str]]()
    for line, text in _lines(content, folder):
        function = line.get("function_name", "")
        own = (line["count"], *(branch["count"] for branch in line["branches"]))
        place = SourceLine(common_code(function, name), common_code(text, name), seen[function, text], len(own) - 1)
        seen[function, text] += 1
        counts[place] = tuple(map(max, counts.get(place, own), own))  # groups of blocks have the same function
    return Coverage(counts)


def _lines(content: Mapping[str, Any], folder: Path) -> Iterator[tuple[Mapping[str, Any], str]]:
    """Lines of the package's files that hold code, with their text."""
    for file in content["files"]:
        path = Path(file["file"])
        if path.parent != folder:
            continue
        texts = path.read_text().splitlines()
        yield from ((line, texts[line["line_number"] - 1].strip()) for line in file["lines"])


def common_code(text: str, name: str) -> str:
    """Code as packages of all names, groups of blocks and precisions have it."""
    text = re.sub(rf"\b{name.upper()}_", "NAME_", re.sub(rf"\b{name}_", "NAME_", text))
    text = re.sub(r"\b(?:element|block\d+)_", "GROUP_", re.sub(r"\b(?:ELEMENT|BLOCK\d+)_", "GROUP_", text))
    return re.sub(r"(\d)f\b", r"\1", text)
