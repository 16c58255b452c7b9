"""Conditions of emitted C that its self-test and the exercise see decide alone (MC/DC)."""

import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from sgms_bench.verification.coverage import list_programs
from sgms_bench.verification.outcome import AbsentError, CheckOutcome, definitions, measure_packages, run, run_or_raise
from sgms_mhe.emission.package import Package, write_package
from sgms_mhe.machine import Machine

VERSIONS: Final = ("", "-18", "-19", "-20", "-21")
"""Of clang and its tools, as Debian names them; 18 is the first that counts conditions."""
FLAGS: Final = ("-std=c99", "-O1", "-ffp-contract=off", "-DSGMS_VECTORS=1")
COUNTED: Final = ("-fprofile-instr-generate", "-fcoverage-mapping", "-fcoverage-mcdc")

UNDECIDED: Final[Mapping[tuple[str, str], str]] = {
    (
        "!(none == none) && least * SGMS_R(0.5) > SGMS_R(0.0) && whole + down + up == SGMS_EPSILON",
        "!(none == none)",
    ): "a NaN is itself in builds alone that assume that there is none; tests/test_package.py has them",
    (
        "self->calls.phase == PREPARING && next_cost(self) > 0",
        "self->calls.phase == PREPARING",
    ): "a reset comes in between two units of work; tests/test_tasks.py lets it, at every function",
    (
        "version % 2u == 0u && version == self->calls.version",
        "version == self->calls.version",
    ): "an update comes in while the estimate is read; tests/test_tasks.py lets it, at every function",
}
"""Conditions that none sees decide alone, by the code of decision and condition, each with the reason why that is as it
should be: one that is missing, and one that decides, fails the verification."""


@dataclass(frozen=True)
class Decision:
    """A decision of emitted C as packages have it in common: text of it, in which file."""

    file: str
    code: str


Conditions = dict[Decision, tuple[bool, ...]]
"""Conditions of each decision: true if one was seen to decide alone."""


def check_conditions(machines: Sequence[Machine], progress: Callable[[str], None]) -> CheckOutcome:
    """Check that every condition decides alone in one of the packages at least, or not for a reason."""
    check = "conditions that alone decide (MC/DC)"
    try:
        version = find_version()
    except AbsentError as absent:
        return CheckOutcome(check, "", skipped=str(absent))
    measured = measure_packages(check, machines, lambda package: measure(package, version), progress)
    if isinstance(measured, CheckOutcome):
        return measured
    found: Conditions = {}
    for of_package in measured:
        merge(found, of_package)
    deciding, count = sum(map(sum, found.values())), sum(map(len, found.values()))
    tried = (
        f"{deciding} of {count} conditions in {len(found)} decisions of {len(machines)} packages; "
        f"{count - deciding} not, with a reason each"
    )
    return CheckOutcome(check, tried, find_unexplained(found))


def find_unexplained(found: Conditions) -> tuple[str, ...]:
    """Conditions that do not decide and have no reason, and reasons of those that do."""
    left = {
        (decision.code, condition): decision.file
        for decision, seen in found.items()
        for condition, alone in zip(re.split(r" (?:&&|\|\|) ", decision.code), seen, strict=True)
        if not alone
    }
    missing = [
        f"{file}: {code}: {condition}" for (code, condition), file in left.items() if (code, condition) not in UNDECIDED
    ]
    return (
        *missing,
        *(f"decides in a package: {condition}" for code, condition in UNDECIDED if (code, condition) not in left),
    )


def find_version() -> str:
    """Return the suffix of a clang that counts conditions.

    Raises:
        AbsentError: there is none.
    """
    for version in VERSIONS:
        tools = [f"{tool}{version}" for tool in ("clang", "llvm-profdata", "llvm-cov")]
        if all(shutil.which(tool) for tool in tools):
            asked = run([tools[0], *COUNTED, "-fsyntax-only", "-x", "c", os.devnull])
            if asked.code == 0:
                return version
    raise AbsentError("tool absent: clang, llvm-profdata and llvm-cov of version 18 or later")


def measure(package: Package, version: str) -> Conditions:
    """Count conditions of one package.

    Raises:
        BuildError: a program does not compile, or fails.
    """
    name = package.machine.name
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_package(package, folder / name)
        compile_c = [f"clang{version}", *FLAGS, *definitions(package), f"-I{folder / name}"]
        compiled, merged = folder / "package.o", folder / "merged.profdata"
        run_or_raise([*compile_c, *COUNTED, "-c", folder / name / f"{name}.c", "-o", compiled])
        programs = list_programs(folder / name, name)
        for program, (parts, defined, arguments) in programs.items():
            run_or_raise([*compile_c, COUNTED[0], *defined, *parts, compiled, "-lm", "-o", folder / program])
            profile = os.environ | {"LLVM_PROFILE_FILE": str(folder / f"{program}.profraw")}
            run_or_raise([folder / program, *arguments], profile)
        profiles = [folder / f"{program}.profraw" for program in programs]
        run_or_raise([f"llvm-profdata{version}", "merge", *profiles, "-o", merged])
        export = run_or_raise([f"llvm-cov{version}", "export", "-instr-profile", merged, compiled])
        return conditions_of(json.loads(export), name)


def conditions_of(export: Mapping[str, Any], name: str) -> Conditions:
    """Read conditions from what llvm-cov exports of a package of that name."""
    found: Conditions = {}
    for file in export["data"][0]["files"]:
        path = Path(file["filename"])
        lines = path.read_text().splitlines() if file.get("mcdc_records") else []
        for record in file.get("mcdc_records", []):
            first, left, last, right = record[:4]
            texts = lines[first - 1 : last]
            texts[-1] = texts[-1][: right - 1]
            texts[0] = texts[0][left - 1 :]
            decision = Decision(_common(path.name, name), _common(" ".join(text.strip() for text in texts), name))
            merge(found, {decision: tuple(map(bool, record[-1]))})
    return found


def merge(into: Conditions, more: Conditions) -> None:
    """Add what other calls or packages have seen: a condition that decides in one of them does."""
    for decision, seen in more.items():
        before = into.get(decision, (False,) * len(seen))
        into[decision] = tuple(a or b for a, b in zip(before, seen, strict=True))


def _common(text: str, name: str) -> str:
    """Code as packages of all names and precisions have it."""
    text = text.replace(f"{name.upper()}_", "NAME_").replace(name, "NAME")
    return re.sub(r"(\d)f\b", r"\1", text)
