"""The loop closed: gain of the estimator generated from the extended model."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.status import FLAGS, has_measurement
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.statements import Rule, Statement

BLOCKS: Final = 30
DRAWS: Final = 2000


@dataclass(frozen=True)
class Wander:
    """An estimated parameter: its mean over the log [SI], and how far it wanders about that [relative, 1 sigma]."""

    name: str
    mean: float
    wander: float


@dataclass(frozen=True)
class EstimatorRun:
    """An estimator on a log.

    Attributes:
        predicted_rms_N: RMS of measured friction minus the estimator's output at every sample (`compensation_N`).
            That is the model from the newest estimate along the motion; the force measured since has not been used. It
            is the residual of friction compensation, and a wrong model cannot hide in it.
        filtered_rms_N: RMS of measured friction minus the estimate at the updates, which has used that measurement:
            small wherever the estimator trusts the measurement, whatever its model. Worth less.
        parameters: of the estimates.
        refused: share of updates that kept an older estimate.
    """

    predicted_rms_N: float
    filtered_rms_N: float
    parameters: tuple[Wander, ...]
    refused: float


@dataclass(frozen=True)
class EstimatorGain:
    """Two estimators on a log no fit has seen: of the machine as it was, and of the extended one.

    `reduction` of the prediction's error, 1 - extended / base, with its 95 % interval over pieces of the log.
    """

    source: str
    duration_s: float
    base: EstimatorRun
    extended: EstimatorRun
    reduction: float
    reduction_interval: tuple[float, float]

    def state(self, unit: str) -> Statement:
        """Return the statement on it, in the unit of a force."""
        before, after = self.base.predicted_rms_N, self.extended.predicted_rms_N
        numbers = {"before_N": before, "percent": 100.0 * self.reduction}
        return Statement(Rule.PREDICTION, self.source or "a log", after, None, unit, numbers)


def closed_loop_gain(machine: Machine, extended_machine: Machine, log_unseen: Log) -> EstimatorGain:
    """Generate both machines' estimators, run them on a log, compare their friction with the measured one.

    Args:
        machine: as it was.
        extended_machine: of a diagnosis.
        log_unseen: a log the diagnosis did not use.

    Raises:
        InputError: the log holds no second of motion that both estimators could use.
    """
    axes = machine, extended_machine
    signals = [signals_from_log(log_unseen, axis) for axis in axes]
    estimates = [CompiledEstimator(axis).estimate(along) for axis, along in zip(axes, signals, strict=True)]
    used = _usable(machine, signals[0], estimates[0]) & _usable(extended_machine, signals[1], estimates[1])
    rate = machine.sampling.rate
    if used.sum() < rate:
        raise InputError(log_unseen.source or "log", "usable time", used.sum() / rate, "at least one second")
    errors = [s.friction - e.extra["compensation_N"][: len(s)] for s, e in zip(signals, estimates, strict=True)]
    base, extended = (_run(error, used, e) for error, e in zip(errors, estimates, strict=True))

    kept = _blocks(np.ones(len(used)), used) > 0
    squares = [_blocks(error**2, used)[kept] for error in errors]
    draws = np.random.default_rng(1).integers(0, kept.sum(), (DRAWS, kept.sum()))
    left = [s[draws].sum(axis=1) for s in squares]
    low, high = np.quantile(1.0 - np.sqrt(left[1] / np.maximum(left[0], 1e-300)), (0.025, 0.975))
    return EstimatorGain(
        source=log_unseen.source,
        duration_s=len(used) / rate,
        base=base,
        extended=extended,
        reduction=1.0 - extended.predicted_rms_N / base.predicted_rms_N if base.predicted_rms_N > 0.0 else 0.0,
        reduction_interval=(float(low), float(high)),
    )


def _usable(machine: Machine, signals: Signals, estimates: Estimates) -> Mask:
    """Samples that count (n): measured, within the machine's speed, and predicted from a horizon that is full."""
    filling = estimates.status & FLAGS["filling"] != 0
    filling |= estimates.status < 0
    warm = np.ones(len(signals), dtype=np.bool_)
    full = np.flatnonzero(~filling)
    warm[: int(machine.sampling.samples_per_update * (1 + full[0])) if len(full) else len(warm)] = False
    return np.asarray(warm & signals.valid & (np.abs(signals.velocity) <= machine.sampling.max_velocity))


def _run(error: Array, used: Mask, estimates: Estimates) -> EstimatorRun:
    taken = has_measurement(estimates.status) & (estimates.status & FLAGS["filling"] == 0)
    left = (estimates.friction_measured_N - estimates.friction_N)[taken]
    values = estimates.parameters[taken]
    return EstimatorRun(
        predicted_rms_N=_rms(error[used]),
        filtered_rms_N=_rms(left),
        parameters=tuple(
            Wander(name, float(column.mean()), float(column.std() / max(abs(column.mean()), 1e-300)))
            for name, column in zip(estimates.parameter_names, values.T, strict=True)
            if len(column)
        ),
        refused=float(np.mean(estimates.status < 0)) if len(estimates.status) else 0.0,
    )


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2))) if len(values) else math.nan


def _blocks(values: Array, used: Mask) -> Array:
    """Sum over the used samples of each of `BLOCKS` pieces of equal time."""
    piece = np.minimum(np.arange(len(used)) * BLOCKS // max(1, len(used)), BLOCKS - 1)
    return np.asarray(np.bincount(piece[used], weights=values[used], minlength=BLOCKS), dtype=np.float64)
