"""An estimator in the loop of a simulated axis, called without the interpreter in between: `bench/c/loop.c`."""

import ctypes

import numpy as np
from numpy.typing import NDArray

from sgms_bench import C_DIR
from sgms_mhe.host.compiled import CompiledEstimator, ReplayedUpdates
from sgms_mhe.machine import Machine
from sgms_mhe.plant.native import COMPENSATION, NativeCompensation
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]


class _Loop(ctypes.Structure):
    """sgms_loop."""

    _fields_ = (
        ("memory", ctypes.c_void_p),
        ("velocity", ctypes.c_void_p),
        ("acceleration", ctypes.c_void_p),
        ("force", ctypes.c_void_p),
        ("rows", ctypes.c_void_p),
        ("statuses", ctypes.c_void_p),
        ("samples", ctypes.c_long),
        ("sample", ctypes.c_long),
        ("updates", ctypes.c_long),
    )


class LoopedEstimator(CompiledEstimator):
    """A machine's package compiled with the callback of the simulated axis.

    Raises:
        BuildError: the compiler refused.
    """

    def __init__(self, machine: Machine) -> None:
        super().__init__(machine, beside=(C_DIR / "loop.c",))


class LoopCompensation:
    """One estimator, a fresh one, in the loop of a simulated axis.

    Args:
        estimator: its package; serves any number of axes.
        velocity: set-point ahead of each sample (n) [m/s], mean over the loop's delay; None: the drive does not tell.
        acceleration: likewise (n) [m/s^2].
        samples: n.
        force: fed forward instead of what the estimator says (n) [N].
    """

    def __init__(
        self,
        estimator: LoopedEstimator,
        samples: int,
        *,
        velocity: Array | None = None,
        acceleration: Array | None = None,
        force: Array | None = None,
    ) -> None:
        self._estimator = estimator
        updates = samples // estimator.machine.sampling.samples_per_update + 1
        self._rows = np.zeros((updates, estimator.library.sgms_replay_columns()))
        self._status = np.zeros(updates, dtype=np.int32)
        self.force_N: Array = np.zeros(samples) if force is None else np.array(force, dtype=np.float64)
        self._memory = estimator.start() if force is None else None
        held = [None if a is None else np.ascontiguousarray(a, dtype=np.float64) for a in (velocity, acceleration)]
        for array in (*held, self.force_N):
            if array is not None and array.shape != (samples,):
                raise ValueError(f"an array of shape {array.shape} for {samples} samples")
        if velocity is not None and acceleration is None:
            held[1] = np.zeros(samples)
        self._held = held
        self._loop = _Loop(
            memory=None if self._memory is None else ctypes.addressof(self._memory),
            velocity=None if held[0] is None else held[0].ctypes.data,
            acceleration=None if held[1] is None else held[1].ctypes.data,
            force=self.force_N.ctypes.data,
            rows=self._rows.ctypes.data,
            statuses=self._status.ctypes.data,
            samples=samples,
        )

    @property
    def native(self) -> NativeCompensation:
        """For `simulate_axis`; `force_N` (n) then holds what was fed forward."""
        function = ctypes.cast(self._estimator.library.sgms_loop_compensate, COMPENSATION)
        return NativeCompensation(function, ctypes.addressof(self._loop))

    def estimates(self, log: Log) -> Estimates:
        """Return the estimates at the updates, once the run that left `log` is over."""
        done = int(self._loop.updates)
        run = ReplayedUpdates(self._rows[:done], self._status[:done].astype(np.int64), self.force_N)
        samples = self._estimator.machine.sampling.samples_per_update
        return self._estimator.estimates_of(run, log.time_s[samples::samples])
