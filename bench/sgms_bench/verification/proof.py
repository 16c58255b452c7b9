"""Static proof by Frama-C/Eva: no call reads or writes outside of its memory, whatever memory and arguments hold."""

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sgms_bench import C_DIR
from sgms_bench.verification.outcome import AbsentError, CheckOutcome, definitions, require, run
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.machine import Machine

CALLS: Final = ("TICK", "SAMPLE", "INSERT", "PREPARE", "FEEDBACK", "ESTIMATE", "SAVE_LOAD", "SET", "INIT")
"""Of `bench/c/proof.c`."""
TOOLS: Final = ("frama-c", "gcc")
PREPROCESSOR: Final = (
    *("-E", "-C", "-nostdinc", "-D__FRAMAC__", "-D__FC_MACHDEP_X86_64", "-U__SSE2__", "-U__GNUC__", "-w"),
    "-U__OPTIMIZE__",
)
EVA: Final = (
    *("-machdep", "gcc_x86_64", "-c11", "-eva", "-eva-precision", "0", "-eva-auto-loop-unroll", "150"),
    *("-warn-special-float", "none", "-eva-no-print", "-eva-verbose", "0"),
    "-eva-initialized-locals",
)
SECONDS: Final = 1800.0
"""Of one call: `prepare()` of the slowest specimen, `fixed`, took 1240 s beside other work."""


@dataclass(frozen=True)
class Alarm:
    """A property that the analysis could not decide.

    Attributes:
        code: of the alarm, as the analyser words it, the machine's name in it being NAME.
        function: in which.
    """

    code: str
    function: str


ALARMS: Final[Mapping[Alarm, str]] = {
    Alarm(
        "is_nan_or_infinite: \\is_finite(x)", "sgms_index"
    ): "x is above zero and below a whole number there: a number it is"
}
"""Alarms that are left, each with the reason why it cannot happen."""


def check_proof(
    machines: Sequence[Machine], progress: Callable[[str], None], calls: Sequence[str] = CALLS
) -> CheckOutcome:
    """Check that the analysis has no alarm in any call of packages but those that have a reason."""
    check = "static proof: no call leaves its memory or overflows"
    failures, left = [], set()
    try:
        require(*TOOLS)
    except AbsentError as absent:
        return CheckOutcome(check, "", skipped=f"{absent} (Debian: frama-c-base)")
    for machine in machines:
        package = emit_package(machine, selftest=False)
        for call in calls:
            try:
                found = analyse_call(package, call)
            except AbsentError as undecided:
                failures.append(f"{machine.name}, {call}: {undecided}")
                continue
            left |= set(found)
            failures += [
                f"{machine.name}, {call}: {alarm.function}: {alarm.code}" for alarm in found if alarm not in ALARMS
            ]
            progress(f"{check}: {machine.name}, {call}: {len(found)} alarms")
    tried = f"{len(machines)} packages, {len(calls)} groups of calls each; {len(left)} alarms left, with a reason each"
    return CheckOutcome(check, tried, tuple(failures))


def analyse_call(package: Package, call: str) -> list[Alarm]:
    """Return the alarms of one group of calls on memory of any content.

    Raises:
        AbsentError: the analyser did not run to its end; the message carries why.
    """
    name = package.machine.name
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_package(package, folder / name)
        options = [*PREPROCESSOR, *definitions(package), f'-DSGMS_SOURCE="{name}.c"', f"-DPROVED={call}"]
        share = run(["frama-c-config", "-print-share-path"]).output.strip()
        program = folder / "proof.i"
        made = run(["gcc", *options, f"-I{folder / name}", f"-I{share}/libc", C_DIR / "proof.c", "-o", program])
        if made.code != 0:
            raise AbsentError(f"the preprocessor refused: {made.output}")
        report = folder / "report.csv"
        done = run(["frama-c", *EVA, program, "-then", "-report-csv", report], folder=folder, seconds=SECONDS)
        if done.code != 0 or not report.exists():
            raise AbsentError(f"frama-c did not end well: {done.output[-2000:]}")
        return _alarms(report.read_text(), name)


def _alarms(report: str, name: str) -> list[Alarm]:
    """Alarms of a report of properties: those that are not decided, preconditions of the call itself aside."""
    found = []
    for row in report.splitlines()[1:]:
        _, _, _, function, kind, status, text = row.split("\t")
        if status not in ("Valid", "Considered valid") and function != "main":
            found.append(Alarm(re.sub(rf"\b{name}", "NAME", f"{kind}: {text}"), function))
    return found
