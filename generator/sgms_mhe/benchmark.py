"""What an update costs and how exact its integration is: time and instructions of the emitted C, errors of its steps.

Time and instructions are those of all the work between two updates, as `runtime_c/harness.c` calls it: the samples of
one interval through the signal chain and the newest interval, feedback, prepare. Only mean instruction counts compare
between machines; time is that of this host.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.build import DEFAULT_FLAGS, program
from sgms_mhe.compiled import CompiledModel, replay_definitions
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.errors import BuildError
from sgms_mhe.kinematics import Signals, signals_from_log
from sgms_mhe.logs import Log, write_log
from sgms_mhe.machine import Machine, override_machine
from sgms_mhe.model import build_model
from sgms_mhe.paths import runtime_dir
from sgms_mhe.reference import Integrator
from sgms_mhe.simulation import AxisConfig, simulate_axis
from sgms_mhe.trajectories import make_trajectory

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

PRECISIONS: Final = ("double", "single")
RUNS: Final = 5
"""Timed runs; of each update the fastest counts, which leaves out what else the host does."""

CONVERGED: Final[Mapping[str, Any]] = {"scheme": "rk4", "displacement": 0.004}
"""Integrator that errors are measured against: it leaves about 1e-9 in the state, 1e-8 in its derivatives."""

_UPDATE: Final = "harness_update"


@dataclass(frozen=True)
class Variant:
    """One variant of the emitted estimator.

    Attributes:
        name: of the variant.
        precision: double or single.
        relinearise: which intervals are linearised anew in an update: "all".
        update_us: mean time of an update and its samples [us].
        feedback_us: mean time from the newest sample to the estimate [us].
        instructions_mean, instructions_max: of an update and its samples; None without valgrind.
        state_error: largest error of a node state after one interval, in units of its scale; None where several samples
            make one step.
        sensitivity_error: largest error of its derivatives in the scaled parameters.
    """

    name: str
    precision: str
    relinearise: str
    update_us: float
    feedback_us: float
    instructions_mean: float | None
    instructions_max: int | None
    state_error: float | None
    sensitivity_error: float | None


@dataclass(frozen=True)
class Peer:
    """The same problem by another tool's exported code."""

    name: str
    update_us: float
    instructions_mean: float | None


@dataclass(frozen=True)
class Benchmark:
    """Variants of the machine's estimator, and peers."""

    variants: tuple[Variant, ...]
    peers: tuple[Peer, ...]


def run_benchmark(
    machine: Machine,
    *,
    trajectory: str = "paper",
    updates: int = 500,
    checked: int = 50,
    flags: Sequence[str] = DEFAULT_FLAGS,
    progress: Progress | None = None,
) -> Benchmark:
    """Time, count and check every variant on a simulated log.

    Args:
        machine: the machine.
        trajectory: name of the motion.
        updates: how many updates are timed.
        checked: how many intervals, evenly spread, have their integration checked.
        flags: of the compiler, for time and instructions.
        progress: called after every step.

    Raises:
        BuildError: the compiler refused.
    """
    log = simulated_log(machine, trajectory, updates)
    exact = _exact_intervals(machine, signals_from_log(log, machine), checked)
    steps = 3 * len(PRECISIONS)
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, steps)

    variants = []
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "log.csv"
        write_log(path, log)
        for precision in PRECISIONS:
            variant = override_machine(machine, {"code": {"precision": precision}})
            package = emit_package(variant)
            harness = build_harness(variant, package, flags)
            times = _times(harness, path)
            step()
            instructions = _instructions(harness, path)
            step()
            errors = _errors(variant, package, exact)
            step()
            variants.append(
                Variant(
                    name=precision,
                    precision=precision,
                    relinearise="all",
                    update_us=float(times.sum(axis=1).mean()),
                    feedback_us=float(times[:, 1].mean()),
                    instructions_mean=None if instructions is None else float(instructions.mean()),
                    instructions_max=None if instructions is None else int(instructions.max()),
                    state_error=errors[0],
                    sensitivity_error=errors[1],
                )
            )
    return Benchmark(tuple(variants), ())


def simulated_log(machine: Machine, trajectory: str, updates: int) -> Log:
    """Log of the machine's axis in closed loop, as long as so many updates take.

    Raises:
        InputError: no trajectory of that name.
    """
    sampling = machine.sampling
    reference = make_trajectory(
        trajectory,
        sampling.rate,
        duration_s=(updates * sampling.samples_per_update + 1) / sampling.rate,
        max_velocity=0.95 * sampling.max_velocity,
    )
    return simulate_axis(machine, reference, AxisConfig(seed=1), truth=False).log


def build_harness(machine: Machine, package: Package, flags: Sequence[str] = DEFAULT_FLAGS) -> Path:
    """Compile `runtime_c/harness.c` with a package; with its self-test vectors where it brings them.

    Raises:
        BuildError: the compiler refused.
    """
    name = machine.name
    definitions = [*replay_definitions(name), f'-DSGMS_CONFIG_HEADER="{name}_config.h"']
    if f"{name}_selftest.h" in package.files:
        definitions.append(f'-DSGMS_SELFTEST_HEADER="{name}_selftest.h"')
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / name
        write_package(package, folder)
        sources = [runtime_dir() / "harness.c", folder / f"{name}.c"]
        return program(sources, include_dirs=[folder], flags=[*flags, *definitions], libraries=["m"])


def _times(harness: Path, log: Path) -> Array:
    """Microseconds of every update (u, 3): samples, feedback, prepare. The fastest of all runs each."""
    runs = []
    for _ in range(RUNS):
        lines = _output([str(harness), "--log", str(log), "--time"]).splitlines()[1:]
        runs.append([[float(field) for field in line.split(",")] for line in lines])
    fastest: Array = np.min(np.array(runs), axis=0)
    return fastest


def _instructions(harness: Path, log: Path) -> Array | None:
    """Instructions of every update (u), not in order; None without valgrind or where it cannot run the program."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        dump = Path(folder) / "callgrind"
        command = [valgrind, "--tool=callgrind", f"--toggle-collect={_UPDATE}", f"--dump-after={_UPDATE}"]
        command += [f"--callgrind-out-file={dump}", str(harness), "--log", str(log)]
        try:
            _output(command)
        except BuildError:  # an instruction that valgrind does not know
            return None
        totals = []
        for part in Path(folder).glob("callgrind.*"):
            total = re.search(r"^totals: (\d+)", part.read_text(errors="replace"), re.MULTILINE)
            if total is not None and int(total[1]) > 0:  # not the rest after the last update
                totals.append(float(total[1]))
    return np.array(totals) if totals else None


def _output(command: Sequence[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BuildError(f"{command[0]}: exit code {done.returncode}\n{done.stderr}")
    return done.stdout


# --- errors of the integration ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Exact:
    """A converged interval: its M + 1 samples, index of the first, state before and after (n_x), d(after)/d(theta)."""

    signals: Signals
    first: int
    x0: Array
    x1: Array
    B: Array


def _exact_intervals(machine: Machine, signals: Signals, checked: int) -> list[_Exact]:
    """Intervals of a log, evenly spread, from states that lie on its way, integrated at nominal parameters."""
    samples = machine.sampling.samples_per_update
    # The velocity between samples is part of the problem, not of its solution.
    settings = {**CONVERGED, "velocity": machine.sampling.integrator.velocity, "substeps": 8 * samples}
    model = build_model(machine)
    own = Integrator(model)
    fine = Integrator(build_model(override_machine(machine, {"sampling": {"integrator": settings}})))
    own_plan, fine_plan = own.plan(signals), fine.plan(signals)
    intervals = len(own_plan.path)
    wanted = set(np.linspace(0, intervals - 1, min(checked, intervals)).astype(int).tolist())
    theta, x = np.ones(model.n_p), np.zeros((1, model.n_x))
    exact = []
    for k in range(intervals):
        if k in wanted:
            moved = fine.intervals(fine_plan, k, x, theta)
            piece = slice(k * samples, (k + 1) * samples + 1)
            part = Signals(**{name: values[piece] for name, values in vars(signals).items()})
            exact.append(_Exact(part, k * samples, x[0], moved.x1[0], moved.B[0]))
        x = own.intervals(own_plan, k, x, theta).x1
    return exact


def _errors(machine: Machine, package: Package, exact: Sequence[_Exact]) -> tuple[float | None, float | None]:
    """Largest errors of state and of its derivatives in theta over the intervals."""
    sampling = machine.sampling
    if sampling.integrator.substeps < sampling.samples_per_update:
        return None, None
    model = CompiledModel(machine, package)
    state = sensitivity = 0.0
    for interval in exact:
        moved = model.predict(interval.signals, x=interval.x0, first=interval.first)
        state = max(state, float(np.abs(moved.x - interval.x1).max()))
        sensitivity = max(sensitivity, float(np.abs(moved.d_x - interval.B).max()))
    return state, sensitivity
