"""The emitted package on an emulated microcontroller: its numbers, its instructions, its memory.

A package in single precision is cross-compiled, linked with `bench/c/trial.c` and run by QEMU over a log. The
emulator advances its clock by a fixed time per instruction, so a timer of the board counts instructions: exactly, and
the same on every host. They are instructions of the emulated core, not cycles of a real one, which also waits for its
flash memory and its divider, and issues two at a time where it can.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.target.firmware import Program, build_program
from sgms_mhe.configuration import override_machine
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.evaluation.comparison import Comparison, compare_estimates
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.host.targets import TARGET_FLAGS, Target, emulate
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import BuildError

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Progress = Callable[[int, int], None]
"""Called with (updates done, updates in all)."""

CALLS: Final = ("init", "sample", "feedback", "prepare", "tick", "estimate")
"""Functions of the package, each on a stack of its own, in the order of `trial.c`."""

DRIVE_CALLS: Final = ("drive_init", "drive_force", "drive_command")
"""Of a commanded axis besides, which no run calls."""

_SAMPLE: Final = np.dtype([("position", "<i8"), ("force", "<f4"), ("unused", "<f4")])


@dataclass(frozen=True)
class TargetMemory:
    """Memory of the package on the target, in bytes.

    Attributes:
        package: its code and constants.
        helpers: what it needs besides, from the compiler's own library and memcpy, memset.
        axis: one estimator.
        data: writable memory of its own, which it does not have.
        stack: of every function, those of a drive too, by name: its deepest call path, as the compiler states the
            frames.
        used: the same of those called, as it was written in the run, never more.
    """

    package: int
    helpers: int
    axis: int
    data: int
    stack: Mapping[str, int]
    used: Mapping[str, int]

    @property
    def flash(self) -> int:
        """Code, constants and helpers."""
        return self.package + self.helpers

    @property
    def ram(self) -> int:
        """One axis and the deepest stack."""
        return self.axis + self.data + max(self.stack.values())


@dataclass(frozen=True)
class TargetTrial:
    """One run of a package on a target: u updates of M samples.

    Attributes:
        target: the target.
        machine: the machine in single precision.
        estimates: of an estimator called as by two tasks.
        tick_estimates: of one called by `tick` alone.
        sample, tick: instructions of every call (u, M).
        feedback, prepare, estimate: instructions of every call (u,).
        calibration: loops of known length that checked the counter, (instructions, counted) each.
        memory: flash, RAM, stack.
        double_arithmetic: helpers and instructions of double precision that the package's code uses; there are none.
    """

    target: Target
    machine: Machine
    estimates: Estimates
    tick_estimates: Estimates
    sample: Counts
    tick: Counts
    feedback: Counts
    prepare: Counts
    estimate: Counts
    calibration: tuple[tuple[int, int], ...]
    memory: TargetMemory
    double_arithmetic: tuple[str, ...]

    @property
    def update(self) -> Counts:
        """Instructions of an update in two tasks (u,): its samples, feedback, prepare."""
        counts: Counts = self.sample.sum(axis=1) + self.feedback + self.prepare
        return counts


def single_precision(machine: Machine) -> Machine:
    """The machine with its numbers in single precision, which is what the FPU of a target has."""
    return override_machine(machine, {"code": {"precision": "single"}})


# --- run ---------------------------------------------------------------------------------------------------------


def run_trial(
    machine: Machine,
    log: Log,
    target: Target,
    *,
    package: Package | None = None,
    flags: Sequence[str] = TARGET_FLAGS,
    progress: Progress | None = None,
) -> TargetTrial:
    """Run a machine's package on an emulated target over position and force of a log.

    Args:
        machine: in single precision.
        log: at least one update long.
        target: the target.
        package: the machine's package, if it was generated already.
        flags: of the compiler, besides the target's.
        progress: called while it runs.

    Raises:
        BuildError: compiler or emulator is not there or refused, the program faulted, or the emulator's clock does not
            count instructions.
    """
    if machine.code.precision != "single":
        raise ValueError("a target runs single precision: single_precision(machine)")
    package = package or emit_package(machine, selftest=False)
    model, M = build_model(machine), machine.sampling.samples_per_update
    updates = (len(log) - 1) // M
    estimate = _estimate_type(model)
    update_bytes = 4 * (2 * M + 3) + 2 * estimate.itemsize
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        program = build_program(target, package, folder, flags)
        (folder / "samples.bin").write_bytes(encode_samples(log, updates * M + 1).tobytes())
        results = folder / "results.bin"

        def report(written: int) -> None:
            if progress is not None:
                progress(min(updates, written // update_bytes), updates)

        emulate(target, program.path, results, report)
        content = results.read_bytes()
    return _trial(target, machine, model, program, content, log.time_s[M : updates * M + 1 : M])


def encode_samples(log: Log, count: int) -> NDArray[Any]:
    """The first samples as the package takes them: position in whole picometres, force in N."""
    metres = log.position_m[:count]
    good = np.abs(metres) < 4e6
    picometres = np.full(count, np.iinfo(np.int64).max)
    picometres[good] = (metres[good] * 1e12 + np.where(metres[good] < 0.0, -0.5, 0.5)).astype(np.int64)
    samples = np.zeros(count, dtype=_SAMPLE)
    samples["position"] = picometres
    samples["force"] = log.force_N[:count]
    return samples


def _estimate_type(model: Model) -> np.dtype[Any]:
    """The package's estimate_t, as it lies in memory."""
    n_z, n_p = model.n_z, model.n_p
    return np.dtype(
        [
            ("friction", "<f4"),
            ("friction_measured", "<f4"),
            ("deflection", "<f4", (n_z,)),
            ("parameter", "<f4", (n_p,)),
            ("deviation", "<f4", (n_p,)),
            ("innovation", "<f4"),
            ("test_ratio", "<f4"),
            ("noise_scale", "<f4"),
            ("status", "<i4"),
            ("update", "<u4"),
            ("age", "<u4"),
            ("numeric", "<i4"),
        ]
    )


def _trial(
    target: Target, machine: Machine, model: Model, program: Program, content: bytes, times: Array
) -> TargetTrial:
    """Take the results apart; their layout stands in `trial.c`."""
    M, updates, estimate = machine.sampling.samples_per_update, len(times), _estimate_type(model)
    row = np.dtype(
        [
            ("samples", "<u4", (M, 2)),
            ("feedback", "<u4"),
            ("prepare", "<u4"),
            ("estimate", "<u4"),
            ("two_tasks", estimate),
            ("one_task", estimate),
        ]
    )
    head, first, tail = 3 + len(program.loops), 2, len(CALLS)
    expected = 4 * (head + first + tail) + updates * row.itemsize
    words = np.frombuffer(content[: 4 * head], dtype="<u4").astype(np.int64)
    if len(content) != expected or words[1] != estimate.itemsize:
        raise BuildError(f"{target.name}: {len(content)} bytes of results where {expected} were expected")
    rows = np.frombuffer(content[4 * (head + first) : -4 * tail], dtype=row)
    used = dict(zip(CALLS, map(int, np.frombuffer(content[-4 * tail :], dtype="<u4")), strict=True))
    stack = {call: program.paths[f"{machine.name}_{call}"] for call in CALLS}
    if machine.drive.kind != "force":
        stack |= {call: program.paths[f"{machine.name}_{call}"] for call in DRIVE_CALLS}
    nothing = int(words[2])

    def counted(ticks: NDArray[Any]) -> Counts:
        return np.rint((ticks.astype(np.int64) - nothing) / target.ticks).astype(np.int64)

    calibration = tuple(
        (2 + 2 * count, int(loop)) for count, loop in zip(program.loops, counted(words[3:]), strict=True)
    )
    for instructions, found in calibration:
        if found != instructions:
            raise BuildError(f"{target.emulator[0]}: its clock counts {found} instructions where {instructions} ran")
    samples = counted(rows["samples"])
    return TargetTrial(
        target=target,
        machine=machine,
        estimates=_estimates(model, rows["two_tasks"], times),
        tick_estimates=_estimates(model, rows["one_task"], times),
        sample=samples[:, :, 0],
        tick=samples[:, :, 1],
        feedback=counted(rows["feedback"]),
        prepare=counted(rows["prepare"]),
        estimate=counted(rows["estimate"]),
        calibration=calibration,
        memory=TargetMemory(
            package=program.package,
            helpers=program.helpers,
            axis=int(words[0]),
            data=program.data,
            stack=MappingProxyType(stack),
            used=MappingProxyType(used),
        ),
        double_arithmetic=program.double_arithmetic,
    )


def _estimates(model: Model, rows: NDArray[Any], times: Array) -> Estimates:
    return Estimates(
        time_s=times,
        friction_measured_N=rows["friction_measured"].astype(np.float64),
        friction_N=rows["friction"].astype(np.float64),
        z_m=rows["deflection"].astype(np.float64),
        parameters=rows["parameter"].astype(np.float64),
        std=rows["deviation"].astype(np.float64),
        innovation_N=rows["innovation"].astype(np.float64),
        test_ratio=rows["test_ratio"].astype(np.float64),
        noise_scale=rows["noise_scale"].astype(np.float64),
        status=rows["status"].astype(np.int64),
        parameter_names=tuple(p.column for p in model.parameters),
        kind=model.machine.plant.kind,
    )


# --- host --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HostComparison:
    """The target's estimates beside those of the same package compiled for this host.

    Attributes:
        identical: whether every number and every status is the same to the last bit.
        identical_updates: how many updates are.
        comparison: differences, with the tolerances of single precision.
    """

    identical: bool
    identical_updates: int
    comparison: Comparison

    @property
    def agrees(self) -> bool:
        """Return True if the differences are those of rounding."""
        return self.comparison.agrees


def compare_with_host(trial: TargetTrial, log: Log, *, package: Package | None = None) -> HostComparison:
    """Run the package on this host over the same log and compare with what the target made of it.

    Raises:
        BuildError: the host's compiler refused.
    """
    estimator = CompiledEstimator(trial.machine, package)
    host = estimator.estimate_log(log, mode="tasks")
    same = identical_updates(trial.estimates, host)
    return HostComparison(
        identical=bool(same.all()),
        identical_updates=int(np.count_nonzero(same)),
        comparison=compare_estimates(trial.machine, trial.estimates, host, estimator.model.prior_std),
    )


def identical_updates(ours: Estimates, theirs: Estimates) -> NDArray[np.bool_]:
    """At which updates (u) every number and the status are the same."""
    names = ("friction_measured_N", "friction_N", "z_m", "parameters", "std", "status")
    same = np.ones(len(ours), dtype=np.bool_)
    for name in names:
        a, b = getattr(ours, name), getattr(theirs, name)
        same &= (a == b).reshape(len(same), -1).all(axis=1)
    return same
