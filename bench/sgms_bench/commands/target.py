"""`sgms-mhe target`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from sgms_bench.commands.common import split_flags
from sgms_mhe.commands.common import json_text, note, progress_bar, recorded_log, show, table_text
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sgms_bench.target.trial import HostComparison, TargetTrial
    from sgms_mhe.machine import Machine


@make_command("target etel_xy", "target etel_xy axis.csv --core riscv32 --json")
def command(
    machine: Machine,
    log: Path | None = None,
    *,
    core: Literal["cortex_m7", "riscv32"] = "cortex_m7",
    trajectory: Annotated[str, Option("NAME")] = "mixed",
    updates: Annotated[int, Option("N", 1, 100_000)] = 500,
    cflags: Annotated[str | None, Option("FLAGS")] = None,
    json: bool = False,
) -> bool:
    """Run on an emulated microcontroller: instructions, flash, RAM.

    MACHINE's package runs over LOG, or over a simulated motion. It is compiled for the core in single precision,
    whatever the machine file says, and run by QEMU with position and force of the log; other columns are not used.
    Printed are the instructions of every function, flash, RAM and stack, and whether the estimates are those of the
    same package on this host. Instructions are those of an emulated core, the same in every run; a real one's cycles
    also depend on its memory and its pipeline.

    An update is all the work between two estimates where two tasks share it: the samples, feedback, prepare. A tick is
    one sample where one task does everything.

    Exit code 1 where the target's estimates are further from the host's than rounding explains, or the package holds
    double-precision arithmetic.

    Args:
        core: Arm Cortex-M7, or RISC-V RV32IMAFC; both with a single-precision FPU.
        trajectory: simulated motion, where there is no LOG.
        updates: their number.
        cflags: compiler flags; None: -std=c99 -O2 -ffp-contract=off.
    """
    own_flags = split_flags(cflags)

    from sgms_bench.motions import simulated_log
    from sgms_bench.target.trial import compare_with_host, run_trial, single_precision
    from sgms_mhe.api.estimation import check_length
    from sgms_mhe.emission.package import emit_package
    from sgms_mhe.host.targets import TARGET_FLAGS, TARGETS

    if log is None:
        recorded = simulated_log(machine, trajectory, updates)
    else:
        recorded = recorded_log(log, machine)
        check_length(len(recorded), recorded.source, machine)
    if machine.code.precision != "single":
        note(f"{machine.name}: {machine.code.precision} precision, taken as single for this core")
    variant = single_precision(machine)
    package = emit_package(variant, selftest=False)
    flags = TARGET_FLAGS if own_flags is None else own_flags
    with progress_bar(f"target {machine.name}") as progress:
        trial = run_trial(variant, recorded, TARGETS[core], package=package, flags=flags, progress=progress)
    host = compare_with_host(trial, recorded, package=package)
    show(json_text(_content(trial, host)) if json else _text(trial, host, flags))
    return not host.agrees or bool(trial.double_arithmetic)


def _calls(trial: TargetTrial) -> dict[str, NDArray[np.int64]]:
    """Instructions by what a user reads of them."""
    return {
        "update": trial.update,
        "feedback": trial.feedback,
        "prepare": trial.prepare,
        "sample": trial.sample,
        "tick": trial.tick,
        "estimate": trial.estimate,
    }


def _content(trial: TargetTrial, host: HostComparison) -> dict[str, Any]:
    memory = trial.memory
    return {
        "machine": trial.machine.name,
        "core": trial.target.name,
        "updates": len(trial.estimates),
        "instructions": {
            name: {"mean": float(counts.mean()), "max": int(counts.max())} for name, counts in _calls(trial).items()
        },
        "calibration": [{"expected": expected, "counted": counted} for expected, counted in trial.calibration],
        "bytes": {
            "flash": memory.flash,
            "package": memory.package,
            "helpers": memory.helpers,
            "ram": memory.ram,
            "axis": memory.axis,
            "stack": dict(memory.stack),
        },
        "double_arithmetic": list(trial.double_arithmetic),
        "host": {
            "identical": host.identical,
            "identical_updates": host.identical_updates,
            "agrees": host.agrees,
            "status_mismatches": host.comparison.status_mismatches,
            "relative": {quantity.name: quantity.relative for quantity in host.comparison.quantities},
        },
    }


def _text(trial: TargetTrial, host: HostComparison, flags: tuple[str, ...] | list[str]) -> str:
    from sgms_bench.target.trial import DRIVE_CALLS

    memory = trial.memory
    meaning = {"update": "update", "sample": "sample, of an update", "tick": "tick, alone"}
    rows = [
        (meaning.get(name, name), f"{counts.mean():.0f}", str(counts.max()), str(memory.stack.get(name, "")))
        for name, counts in _calls(trial).items()
    ]
    rows += [(call, "", "", str(memory.stack[call])) for call in DRIVE_CALLS if call in memory.stack]
    worst = max(host.comparison.quantities, key=lambda quantity: quantity.relative / quantity.tolerance)
    if host.identical:
        verdict = "the same as on this host to the last bit"
    else:
        same = f"{host.identical_updates} updates the same as on this host to the last bit"
        verdict = (
            f"{same}; {worst.name} off by {worst.relative:.1e}, {worst.tolerance:.0e} allowed; status differs at "
            f"{host.comparison.status_mismatches}"
        )
    double = ", ".join(trial.double_arithmetic) or "none"
    return "\n".join(
        [
            f"{trial.machine.name} on {trial.target.title}, {' '.join(flags)}: {len(trial.estimates)} updates",
            table_text(("instructions", "mean", "at most", "stack B"), rows),
            f"flash {memory.flash} B: package {memory.package}, helpers {memory.helpers}",
            f"RAM {memory.ram} B: axis {memory.axis}, deepest stack {max(memory.stack.values())}",
            f"double-precision arithmetic: {double}",
            f"estimates: {verdict}",
        ]
    )
