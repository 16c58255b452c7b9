"""The emitted C, compiled for this host and called from Python."""

import ctypes
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from sgms_mhe.emission.package import Package, write_package
from sgms_mhe.emission.variant import variant_of
from sgms_mhe.host.packages import SYMBOLIC, cached_package
from sgms_mhe.host.shared_code import share_numbers
from sgms_mhe.machine import Kind, Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.signals.chain import Signals, mean_samples, signal_array
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import AnyArray, Array, Index
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.paths import runtime_dir
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, QUICK_FLAGS, load_library, shared_library, wide_flags

Progress = Callable[[int, int], None]
"""Called with (updates done, updates in all)."""

_CHUNK = 20  # updates between two calls of progress


class _Series(ctypes.Structure):
    _fields_ = (
        ("samples", ctypes.c_long),
        ("position", ctypes.c_void_p),
        ("force", ctypes.c_void_p),
        ("velocity", ctypes.c_void_p),
        ("acceleration", ctypes.c_void_p),
        ("friction", ctypes.c_void_p),
        ("valid", ctypes.c_void_p),
        ("delay", ctypes.c_double),
    )


@dataclass(frozen=True)
class ReplayedUpdates:
    """Updates of a replay as the C writes them: `rows` (u, columns), `status` (u), `compensation` [N] (n)."""

    rows: Array
    status: Index
    compensation: Array


class CompiledModel:
    """The emitted model of a machine without its estimator: integrator, sensitivities, output.

    Args:
        machine: the machine file.
        package: its package, if it was generated already; it runs as it was emitted.
        states: whether `advance` gives the states in place of the friction: of an element its force over its level.

    Attributes:
        library: the compiled code, which models of one structure have in common.
    """

    def __init__(self, machine: Machine, package: Package | None = None, *, states: bool = False) -> None:
        self.machine = machine
        with SYMBOLIC:
            self.model = build_model(machine)
            shared = package is None and machine.code.precision == "double"
            package = package or cached_package(machine, self.model)
        flags = (*DEFAULT_FLAGS, *wide_flags())
        self._numbers = np.empty(0)
        if shared:
            files, self._numbers = share_numbers(package.files, machine.name)
            package = replace(package, files=files)
            flags += (f"-DSGMS_NUMBERS={len(self._numbers)}",)
        if states:
            flags += ("-DSGMS_STATES",)
        self.library = _compile(package, flags, "predict.c")
        self._predict = load_library(self.library).sgms_predict

    def predict(self, signals: Signals, theta: Array | None = None, slopes: Array | None = None) -> Array:
        """Friction [N] (n) by the model alone, along signals from relaxed elements on.

        Args:
            signals: n samples.
            theta: scaled parameters (n_p), 1 is nominal; None: nominal.
            slopes: takes the derivatives in theta (n, n_p); None: not asked for.

        Raises:
            InputError: the machine merges samples into steps.
        """
        if self.machine.sampling.merged > 1:
            substeps = self.machine.sampling.integrator.substeps
            allowed = "at least one per sample to run the model alone"
            raise InputError(self.machine.source, "sampling.integrator.substeps", substeps, allowed)
        n_x, n_p = self.model.n_x, self.model.n_p
        w = signal_array(signals, self.machine.sampling.step, mean=mean_samples(self.machine))
        values = np.ones(n_p) if theta is None else np.ascontiguousarray(theta, dtype=np.float64)
        friction = np.empty(len(signals))
        self.advance(w, values, np.zeros(n_x), np.zeros((n_x, n_p)), friction, slopes)
        return friction

    def advance(
        self, w: Array, theta: Array, state: Array, sensitivity: Array, force: Array | None, slopes: Array | None
    ) -> None:
        """Run the model along signals w (n, 5; 6 with a mean acceleration), in place; all arrays contiguous.

        Args:
            w: position, velocity, acceleration, force, time of every sample.
            theta: scaled parameters (n_p).
            state: node state (n_x), from the first sample's to the last's.
            sensitivity: its derivatives in theta (n_x, n_p), likewise.
            force: takes the friction (k) [N], or the states (k, n_x), at the last of every n / k samples; None: not
                asked for.
            slopes: takes its derivatives in theta (k, n_p), or of each state in those that enter it (k, n_x, entered);
                None: not asked for.

        Raises:
            ValueError: no whole number of integration steps.
        """
        arrays = (w, theta, state, sensitivity, force, slopes, self._numbers)
        pointers = [None if array is None else ctypes.c_void_p(array.ctypes.data) for array in arrays]
        every = 1 if force is None else len(w) // max(1, len(force))
        done = self._predict(ctypes.c_long(len(w)), ctypes.c_long(every), *pointers)
        if done != 0:
            raise ValueError(f"{len(w)} samples are no whole number of steps of {self.machine.sampling.merged}")


class CompiledEstimator:
    """One emitted package, compiled; every run starts an estimator of its own.

    Args:
        machine: the machine file.
        package: its package, if it was generated already.
        flags: compiler flags.
        model: the model the package was generated from, where that is not the machine's own.
        beside: C files of the caller that are compiled into `library`; they may include `replay.h`.

    Raises:
        BuildError: the compiler refused.
    """

    def __init__(
        self,
        machine: Machine,
        package: Package | None = None,
        flags: Sequence[str] = QUICK_FLAGS,
        model: Model | None = None,
        beside: Sequence[Path] = (),
    ) -> None:
        self.machine = machine
        self.model = model or build_model(machine)
        sources = ("replay.c", *map(str, beside))
        self.library = load_library(_compile(package or cached_package(machine), flags, *sources, whole=True))
        self.library.sgms_replay_memory.restype = ctypes.c_size_t
        self.library.sgms_replay_run.restype = ctypes.c_long
        self._columns = int(self.library.sgms_replay_columns())
        self._samples = machine.sampling.samples_per_update

    @property
    def memory_bytes(self) -> int:
        """Size of one estimator."""
        return int(self.library.sgms_replay_memory())

    def start(self, weights: Model | None = None) -> ctypes.Array[ctypes.c_char]:
        """Memory of a fresh estimator, for `run`, with noise and drift of another model (of a package of doubles).

        Raises:
            ValueError: the package refuses these weights.
        """
        memory = ctypes.create_string_buffer(self.memory_bytes + 64)
        self.library.sgms_replay_start(memory)
        if weights is not None:
            settings = np.zeros(self.memory_bytes // 8)  # the numbers of NAME_settings_t one after the other
            pointer = settings.ctypes.data_as(ctypes.c_void_p)
            self.library[f"{self.machine.name}_settings"](pointer)
            noise, n_x, n_p = weights.machine.estimator.noise, self.model.n_x, self.model.n_p
            settings[: 1 + n_x] = noise.measurement, *weights.state_noise
            if variant_of(self.model).drifts:
                settings[1 + n_x + n_p : 1 + n_x + 2 * n_p] = weights.drift
            if self.library[f"{self.machine.name}_init_with"](memory, pointer) != 0:
                raise ValueError(f"{self.machine.name} refuses the weights of {weights.machine.source}")
        return memory

    def estimate(self, signals: Signals, weights: Model | None = None, progress: Progress | None = None) -> Estimates:
        """Estimate from aligned signals (the Python signal chain), prepare and feedback; `weights` as of `start`."""
        run = self._run(self.start(weights), signals, "tasks", progress)
        return self.estimates_of(run, signals.time[self._samples :: self._samples])

    def estimate_log(
        self, log: Log, *, mode: Literal["tasks", "tick"] = "tick", progress: Progress | None = None
    ) -> Estimates:
        """Estimate from position and force with the package's own signal chain; `extra` holds `compensation_N` (n)."""
        run = self._run(self.start(), log, mode, progress)
        return self.estimates_of(run, log.time_s[self._samples :: self._samples])

    def running(self) -> "RunningEstimator":
        """A fresh estimator for samples that come one piece after the other."""
        return RunningEstimator(self)

    def _run(
        self, memory: ctypes.Array[ctypes.c_char], piece: Log | Signals, mode: str, progress: Progress | None = None
    ) -> ReplayedUpdates:
        samples, delay = len(piece), 0.0 if isinstance(piece, Log) else piece.delay
        total = max(0, (samples - 1) // self._samples)
        rows = np.zeros((total + 1, self._columns))
        status = np.zeros(total + 1, dtype=np.int32)
        compensation = np.zeros(samples)
        held = {name: np.ascontiguousarray(a, dtype=np.float64) for name, a in _arrays(piece).items()}
        done = 0
        chunk = max(samples, 1) if progress is None else _CHUNK * self._samples
        for first in range(0, samples, chunk):
            count = min(chunk, samples - first)
            series = _Series(samples=count, delay=delay)
            for name, array in held.items():
                setattr(series, name, array.ctypes.data + first * array.itemsize)
            done += self.library.sgms_replay_run(
                memory,
                ctypes.byref(series),
                int(mode == "tick"),
                ctypes.c_void_p(rows.ctypes.data + done * rows.itemsize * self._columns),
                ctypes.c_void_p(status.ctypes.data + done * status.itemsize),
                ctypes.c_void_p(compensation.ctypes.data + first * compensation.itemsize),
            )
            if progress is not None:
                progress(done, total)
        return ReplayedUpdates(rows[:done], status[:done].astype(np.int64), compensation)

    def estimates_of(self, run: ReplayedUpdates, time: Array) -> Estimates:
        """Estimates of a run; `time` of the samples that end an interval, as many as there were updates."""
        n_z, n_p = self.model.n_z, self.model.n_p
        columns = np.split(run.rows, np.cumsum([1, 1, n_z, n_p, n_p]), axis=1)
        return Estimates(
            time_s=time[: len(run.rows)],
            friction_measured_N=columns[0][:, 0],
            friction_N=columns[1][:, 0],
            z_m=columns[2],
            parameters=columns[3],
            std=columns[4],
            innovation_N=columns[5][:, 0],
            test_ratio=columns[5][:, 1],
            noise_scale=columns[5][:, 2],
            status=run.status,
            parameter_names=tuple(p.column for p in self.model.parameters),
            kind=self.model.machine.plant.kind,
            extra={"compensation_N": run.compensation},
        )


class RunningEstimator:
    """An estimator that goes on where it was: the numbers are those of one run over all pieces, to the last bit."""

    def __init__(self, estimator: CompiledEstimator) -> None:
        self._estimator = estimator
        self._memory = estimator.start()
        self._taken = 0

    def take(self, piece: Log | Signals) -> Estimates:
        """The updates of the samples that follow; of one kind throughout, through the package's chain or past it.

        Args:
            piece: position and force, as of `estimate_log`, or aligned signals, as of `estimate`; of any length.
        """
        mode, time = ("tick", piece.time_s) if isinstance(piece, Log) else ("tasks", piece.time)
        run = self._estimator._run(self._memory, piece, mode)
        samples = self._estimator._samples
        # Updates are at the samples number 1, 2, ... times `samples`, counted from 0.
        first = samples if self._taken == 0 else -self._taken % samples
        self._taken += len(piece)
        return self._estimator.estimates_of(run, time[first::samples])

    def state(self) -> tuple[bytes, int]:
        """Where it is: its memory and how many samples it has taken."""
        return self._memory.raw, self._taken

    def go_back(self, state: tuple[bytes, int]) -> None:
        """Be where it was when it said `state`; of this estimator alone, whose memory stays in its place."""
        memory, self._taken = state
        ctypes.memmove(self._memory, memory, len(memory))


def _arrays(signals: Log | Signals) -> dict[str, AnyArray]:
    """Position and force, or aligned signals, as the replay takes them."""
    if isinstance(signals, Log):
        return {"position": signals.position_m, "force": signals.force_N}
    return {
        "position": signals.position,
        "force": signals.force,
        "velocity": signals.velocity,
        "acceleration": signals.acceleration,
        "friction": signals.friction,
        "valid": signals.certainty,
    }


def _compile(package: Package, flags: Sequence[str], *sources: str, whole: bool = False) -> Path:
    """Compile sources of the runtime against a package's headers, with its own if `whole`; return the library."""
    machine = package.machine
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / machine.name
        write_package(package, folder)
        paths = [folder / f"{machine.name}.c"] * whole + [runtime_dir() / name for name in sources]
        return shared_library(
            paths,
            include_dirs=[folder, runtime_dir()],
            flags=[*flags, *replay_definitions(machine.name, machine.plant.kind)],
        )


def replay_definitions(name: str, kind: Kind = "linear") -> list[str]:
    """Compiler definitions that bind the replay and the harness to a package."""
    return [
        *(["-DSGMS_ROTARY"] if kind == "rotary" else []),
        f"-DSGMS_MACHINE={name}",
        f"-DSGMS_MACHINE_UPPER={name.upper()}",
        # In angles: beside a source there may be a header of the same name.
        f"-DSGMS_MACHINE_HEADER=<{name}.h>",
        f"-DSGMS_INTEGRATOR_HEADER=<{name}_integrator.h>",
    ]
