"""The emitted C, compiled for this host and called from Python."""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.build import DEFAULT_FLAGS, shared_library
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.errors import InputError
from sgms_mhe.estimates import Estimates
from sgms_mhe.kinematics import Signals
from sgms_mhe.logs import Log
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.paths import runtime_dir

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
"""Called with (updates done, updates in all)."""

_MODES = {"tasks": 0, "tick": 1}
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
    )


@dataclass(frozen=True)
class _Run:
    rows: Array
    status: NDArray[np.int64]
    compensation: Array


@dataclass(frozen=True)
class Prediction:
    """The model alone along a motion.

    Attributes:
        friction_N: (n).
        d_friction: derivatives in the scaled parameters theta (n, n_p), None where not asked for.
        x: node state at the last sample (n_x).
        d_x: its derivatives in theta (n_x, n_p).
    """

    friction_N: Array
    d_friction: Array | None
    x: Array
    d_x: Array


class CompiledModel:
    """The emitted model of a machine without its estimator: integrator, sensitivities, output."""

    def __init__(self, machine: Machine, package: Package | None = None) -> None:
        self.machine = machine
        self.model = build_model(machine)
        self._library = ctypes.CDLL(str(_compile(machine, package, DEFAULT_FLAGS, "predict.c")))

    def predict(
        self,
        signals: Signals,
        theta: Array | None = None,
        *,
        derivatives: bool = False,
        x: Array | None = None,
        d_x: Array | None = None,
        first: int = 0,
    ) -> Prediction:
        """Run the model along the signals.

        Args:
            signals: n samples.
            theta: scaled parameters (n_p), 1 is nominal; None: nominal.
            derivatives: also return d(friction)/d(theta).
            x: node state at the first sample (n_x); None: zero.
            d_x: its derivatives in theta (n_x, n_p); None: zero.
            first: index of the first sample in its record, from which the model's time counts.

        Raises:
            InputError: the machine merges samples into steps.
        """
        n, n_x, n_p = len(signals), self.model.n_x, self.model.n_p
        w = np.column_stack(
            [
                signals.position,
                signals.velocity,
                signals.acceleration,
                signals.force,
                np.arange(first, first + n) * self.machine.sampling.step,
            ]
        )
        values = np.ones(n_p) if theta is None else np.ascontiguousarray(theta, dtype=np.float64)
        state = np.zeros(n_x) if x is None else np.array(x, dtype=np.float64)
        sensitivity = np.zeros((n_x, n_p)) if d_x is None else np.array(d_x, dtype=np.float64, order="C")
        force = np.empty(n)
        slopes = np.empty((n, n_p)) if derivatives else None
        done = self._library.sgms_predict(
            ctypes.c_long(n),
            ctypes.c_void_p(w.ctypes.data),
            ctypes.c_void_p(values.ctypes.data),
            ctypes.c_void_p(state.ctypes.data),
            ctypes.c_void_p(sensitivity.ctypes.data),
            ctypes.c_void_p(force.ctypes.data),
            None if slopes is None else ctypes.c_void_p(slopes.ctypes.data),
        )
        if done != 0:
            raise InputError(
                self.machine.source,
                "sampling.integrator.substeps",
                self.machine.sampling.integrator.substeps,
                "at least one per sample to run the model alone",
            )
        return Prediction(force, slopes, state, sensitivity)


class CompiledEstimator:
    """One emitted package, compiled; every run starts an estimator of its own.

    Args:
        machine: the machine file.
        package: its package, if it was generated already.
        flags: compiler flags.
        model: the model that the package was generated from, where that is not the machine's own.

    Raises:
        BuildError: the compiler refused.
    """

    def __init__(
        self,
        machine: Machine,
        package: Package | None = None,
        flags: Sequence[str] = DEFAULT_FLAGS,
        model: Model | None = None,
    ) -> None:
        self.machine = machine
        self.model = model or build_model(machine)
        self._library = ctypes.CDLL(str(_compile(machine, package, flags, f"{machine.name}.c", "replay.c")))
        self._library.sgms_replay_memory.restype = ctypes.c_size_t
        self._library.sgms_replay_run.restype = ctypes.c_long
        self._columns = int(self._library.sgms_replay_columns())
        self._samples = machine.sampling.samples_per_update

    @property
    def memory_bytes(self) -> int:
        """Size of one estimator."""
        return int(self._library.sgms_replay_memory())

    def start(self) -> ctypes.Array[ctypes.c_char]:
        """Memory of a fresh estimator, for `run`."""
        memory = ctypes.create_string_buffer(self.memory_bytes + 64)
        self._library.sgms_replay_start(memory)
        return memory

    def estimate(self, signals: Signals, *, progress: Progress | None = None) -> Estimates:
        """Estimate from aligned signals (the Python signal chain), prepare and feedback."""
        arrays: dict[str, NDArray[Any]] = {
            "position": signals.position,
            "force": signals.force,
            "velocity": signals.velocity,
            "acceleration": signals.acceleration,
            "friction": signals.friction,
            "valid": signals.valid.astype(np.uint8),
        }
        run = self._run(self.start(), arrays, len(signals), "tasks", progress)
        return self._estimates(run, signals.time)

    def estimate_log(
        self, log: Log, *, mode: Literal["tasks", "tick"] = "tick", progress: Progress | None = None
    ) -> Estimates:
        """Estimate from position and force with the package's own signal chain; `extra` holds `compensation_N` (n)."""
        run = self._run(
            self.start(), {"position": log.position_m, "force": log.force_N}, len(log.time_s), mode, progress
        )
        return self._estimates(run, log.time_s)

    def _run(
        self,
        memory: ctypes.Array[ctypes.c_char],
        arrays: dict[str, NDArray[Any]],
        samples: int,
        mode: str,
        progress: Progress | None,
    ) -> _Run:
        total = max(0, (samples - 1) // self._samples)
        rows = np.zeros((total + 1, self._columns))
        status = np.zeros(total + 1, dtype=np.int32)
        compensation = np.zeros(samples)
        held = {
            name: np.ascontiguousarray(a, dtype=np.uint8 if name == "valid" else np.float64)
            for name, a in arrays.items()
        }
        done = 0
        chunk = samples if progress is None else _CHUNK * self._samples
        for first in range(0, samples, chunk):
            count = min(chunk, samples - first)
            series = _Series(samples=count)
            for name, array in held.items():
                setattr(series, name, array.ctypes.data + first * array.itemsize)
            done += self._library.sgms_replay_run(
                memory,
                ctypes.byref(series),
                _MODES[mode],
                ctypes.c_void_p(rows.ctypes.data + done * rows.itemsize * self._columns),
                ctypes.c_void_p(status.ctypes.data + done * status.itemsize),
                ctypes.c_void_p(compensation.ctypes.data + first * compensation.itemsize),
            )
            if progress is not None:
                progress(done, total)
        return _Run(rows[:done], status[:done].astype(np.int64), compensation)

    def _estimates(self, run: _Run, time: Array) -> Estimates:
        n_z, n_p = self.model.n_z, self.model.n_p
        nodes = self._samples * np.arange(1, len(run.rows) + 1)
        columns = np.split(run.rows, np.cumsum([1, 1, n_z, n_p]), axis=1)
        return Estimates(
            time_s=time[nodes],
            friction_measured_N=columns[0][:, 0],
            friction_N=columns[1][:, 0],
            z_m=columns[2],
            parameters=columns[3],
            std=columns[4],
            status=run.status,
            parameter_names=tuple(p.column for p in self.model.parameters),
            extra={"compensation_N": run.compensation},
        )


def _compile(machine: Machine, package: Package | None, flags: Sequence[str], *sources: str) -> Path:
    """Compile sources of a package, or of the runtime, against the package's headers; return the shared library."""
    package = package or emit_package(machine, selftest=False)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / machine.name
        write_package(package, folder)
        paths = [folder / name if name in package.files else runtime_dir() / name for name in sources]
        return shared_library(paths, include_dirs=[folder], flags=[*flags, *replay_definitions(machine.name)])


def replay_definitions(name: str) -> list[str]:
    """Compiler definitions that bind the replay and the harness to a package."""
    return [
        f"-DSGMS_MACHINE={name}",
        f"-DSGMS_MACHINE_UPPER={name.upper()}",
        f'-DSGMS_MACHINE_HEADER="{name}.h"',
        f'-DSGMS_INTEGRATOR_HEADER="{name}_integrator.h"',
    ]
