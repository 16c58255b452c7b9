"""The model alone along a measured motion: friction that it says against friction that was measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.compiled import CompiledModel
from sgms_mhe.errors import InputError
from sgms_mhe.kinematics import Signals, signals_from_log
from sgms_mhe.logs import Log, write_columns
from sgms_mhe.machine import Machine, override_machine

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PredictedFriction:
    """Friction at the samples of a log, without any estimation; arrays (n).

    time [s]; measured [N], NaN where it is no measurement; friction [N] of the model at the machine file's parameters,
    which starts with all elements relaxed.
    """

    time_s: Array
    friction_measured_N: Array
    friction_N: Array

    @property
    def residual_N(self) -> Array:
        """Measured minus simulated at the valid samples."""
        difference = self.friction_measured_N - self.friction_N
        return difference[np.isfinite(difference)]

    @property
    def residual_rms_N(self) -> float:
        """RMS of measured minus simulated over the valid samples."""
        return float(np.sqrt(np.mean(self.residual_N**2)))

    @property
    def measured_rms_N(self) -> float:
        """RMS of the measured friction over the valid samples."""
        return float(np.sqrt(np.nanmean(self.friction_measured_N**2)))


def predict_log(machine: Machine, log: Log) -> PredictedFriction:
    """Run the model along a log.

    Raises:
        InputError: no sample of the log is a valid measurement of friction.
    """
    return predict_signals(machine, signals_from_log(log, machine), log.source)


def predict_signals(machine: Machine, signals: Signals, source: str = "log") -> PredictedFriction:
    """Run the model along aligned signals; `source` names them in messages."""
    if not signals.valid.any():
        raise InputError(
            source,
            "rows",
            len(signals),
            "a row that is valid: the filters settle first, and after every missing sample",
        )
    samples = machine.sampling.samples_per_update
    if machine.sampling.integrator.substeps < samples:
        # Steps of several samples have no state at the samples between.
        machine = override_machine(machine, {"sampling": {"integrator": {"substeps": samples}}})
    friction = CompiledModel(machine).predict(signals).friction_N
    measured = np.where(signals.valid, signals.friction, np.nan)
    return PredictedFriction(signals.time, measured, friction)


def write_prediction(path: str | Path, prediction: PredictedFriction) -> None:
    """Write time_s, friction_measured_N, friction_N as CSV, atomically."""
    columns = {
        "time_s": prediction.time_s,
        "friction_measured_N": prediction.friction_measured_N,
        "friction_N": prediction.friction_N,
    }
    write_columns(path, columns)
