"""Rules of MISRA C:2012 that the addon of cppcheck checks: those without a hit, and the others with their reason."""

import re
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from sgms_bench.verification.outcome import AbsentError, CheckOutcome, require, run
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.machine import Machine

CHECK: Final = "MISRA C:2012, rules of cppcheck's addon"
KNOWN: Final = (
    *("FLT_RADIX=2", "FLT_MANT_DIG=24", "FLT_MAX_EXP=128", "DBL_MANT_DIG=53", "DBL_MAX_EXP=1024"),
    *("__STDC_VERSION__=199901L", "SGMS_FENCE()=((void)0)"),
)
"""Macros of the compiler and its headers, which cppcheck does not read."""
HIT: Final = re.compile(r"^([^\n:]+):(\d+): misra-c2012-(\d+\.\d+)", re.MULTILINE)

REQUIRED: Final[Mapping[str, str]] = {
    "2.2": "a column or an offset that is zero for one machine; compilers drop the term",
    "8.12": "false: every constant of them has a value, written as an expression",
    "9.3": "false: structures; and rows of a table that end in zeros on purpose",
    "10.6": "the constants -1, 0, 1 of a conditional, which the addon takes for 8 bits",
    "11.8": "false: a constant structure, whose member points to numbers that are not",
}
"""Required rules with hits, each with its reason."""
ADVISORY: Final[Mapping[str, str]] = {
    "2.4": "false: enumerations without a tag",
    "2.5": "macros for the application, and of a header that all packages share",
    "8.7": "functions that the application calls",
    "8.9": "tables stand at the top of a file, beside their description",
    "10.5": "a comparison as a mask of bits or as a count of 0 or 1, without a branch",
    "12.1": "the order of + and * of the printed mathematics",
    "12.3": "several variables of one kind in a declaration",
    "15.5": "an argument that is refused returns at once; one level of indentation less",
    "17.8": "a missing sample is filled in where it came; a pointer that walks",
    "18.4": "a pointer to a row of a matrix",
    "19.2": "the bits of a number, for compilers without __builtin_memcpy",
    "20.10": "the suffix of a number, by the package's precision",
}
"""Advisory rules with hits, each with its reason."""


def check_misra(machines: Sequence[Machine], progress: Callable[[str], None]) -> CheckOutcome:
    """Check that packages have no hit of a rule that is not on a list with its reason, and that no entry is idle."""
    try:
        require("cppcheck")
    except AbsentError as absent:
        return CheckOutcome(CHECK, "", skipped=f"{absent} (Debian: cppcheck)")
    hits: Counter[str] = Counter()
    failures: list[str] = []
    for machine in machines:
        found = find_hits(emit_package(machine, selftest=False))
        hits.update(rule for _, _, rule in found)
        failures += [
            f"{machine.name}: {file}:{line}: rule {rule}"
            for file, line, rule in sorted(found)
            if rule not in REQUIRED and rule not in ADVISORY
        ]
        progress(f"{CHECK}: {machine.name}, {len(found)} hits")
    failures += [f"no package has a hit of rule {rule} any more" for rule in (*REQUIRED, *ADVISORY) if not hits[rule]]
    required, advisory = (sum(hits[rule] for rule in of) for of in (REQUIRED, ADVISORY))
    tried = (
        f"{len(machines)} packages; {required} hits of {len(REQUIRED)} required rules and "
        f"{advisory} of {len(ADVISORY)} advisory ones, with a reason each"
    )
    return CheckOutcome(CHECK, tried, tuple(failures))


def find_hits(package: Package) -> set[tuple[str, int, str]]:
    """Return the places of a package, without its self-test, that break a rule: file, line, rule.

    Locals without a value are not its subject: it takes the first step of a recurrence for one.

    Raises:
        AbsentError: the addon did not run to its end; the message carries why.
    """
    name = package.machine.name
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / name
        write_package(package, folder)
        options = ["--addon=misra", "--std=c99", "--platform=unix64", "--quiet", "--error-exitcode=0", "-U__cplusplus"]
        known = [f"-D{macro}" for macro in KNOWN]
        template = ["--template={file}:{line}: {id}: {message}"]
        template += [f"--suppress={finding}" for finding in ("missingIncludeSystem", "uninitvar")]
        done = run(["cppcheck", *options, *known, *template, f"-I{folder}", folder / f"{name}.c"])
        other = [line for line in done.output.splitlines() if line and "misra-c2012-" not in line]
        if done.code != 0 or other:
            raise AbsentError(f"cppcheck did not end well: {' | '.join(other)[-2000:]}")
        return {(Path(file).name, int(line), rule) for file, line, rule in HIT.findall(done.output)}
