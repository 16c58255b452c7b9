"""Work and stack that a package states, held on emulated processors."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from sgms_bench.motions import simulated_log
from sgms_bench.target.trial import TargetTrial, run_trial, single_precision
from sgms_bench.verification.outcome import AbsentError, CheckOutcome, require
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.host.targets import TARGETS, Target
from sgms_mhe.machine import Machine

UPDATES: Final = 40
INSTRUCTIONS_PER_OPERATION: Final = 4.0
"""At most, in the longest call of a kind: an operation with the loads and stores around it."""
STATED: Final = ("sample", "tick", "prepare", "feedback")


def stated_operations(package: Package) -> Mapping[str, int]:
    """Operations at most of every call, as the public header says."""
    header = package.files[f"{package.machine.name}.h"]
    found = re.findall(rf"^ \*   ({'|'.join(STATED)})\(\) +(\d+)", header, re.MULTILINE)
    return {call: int(count) for call, count in found}


def check_limits(machines: Sequence[Machine], progress: Callable[[str], None]) -> list[CheckOutcome]:
    """Check that no call takes more stack than its deepest path, or more work than stated; per target."""
    outcomes = []
    for target in TARGETS.values():
        check = f"work and stack within what is stated: {target.title}"
        try:
            require(f"{target.prefix}gcc", target.emulator[0])
        except AbsentError as absent:
            outcomes.append(CheckOutcome(check, "", skipped=str(absent)))
            continue
        failures = [f"{m.name}: {text}" for m in machines for text in _beyond(single_precision(m), target)]
        outcomes.append(CheckOutcome(check, f"{len(machines)} packages, {UPDATES} updates each", tuple(failures)))
        progress(f"{check}: {len(failures)} failures")
    return outcomes


def _beyond(machine: Machine, target: Target) -> list[str]:
    package = emit_package(machine, selftest=False)
    trial = run_trial(machine, simulated_log(machine, "mixed", UPDATES), target, package=package)
    found = [
        f"{call} writes {used} bytes of stack, its deepest call path has {trial.memory.stack[call]}"
        for call, used in trial.memory.used.items()
        if used > trial.memory.stack[call]
    ]
    for call, operations in stated_operations(package).items():
        instructions = _most_instructions(trial, call)
        if instructions > INSTRUCTIONS_PER_OPERATION * max(operations, UPDATES):
            found.append(f"{call} takes {instructions} instructions, {operations} operations are stated")
    return found


def _most_instructions(trial: TargetTrial, call: str) -> int:
    counts = {"sample": trial.sample, "tick": trial.tick, "prepare": trial.prepare, "feedback": trial.feedback}
    return int(counts[call].max())
