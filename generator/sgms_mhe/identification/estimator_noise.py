"""Noise of an estimator by its model's residual on the logs: its size and correlation time."""

import ctypes
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from sgms_mhe.configuration import step_every_sample
from sgms_mhe.host.compiled import CompiledEstimator, CompiledModel
from sgms_mhe.host.packages import cached_package
from sgms_mhe.host.shared_code import free_numbers
from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import signals_from_log, signals_of_record
from sgms_mhe.signals.innovations import find_colour
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.status import MOST_DOUBT, measure_doubt
from sgms_mhe.support.toolchain import QUICK_FLAGS

TRIALS: Final = 6
"""Colours that are tried at most."""
LEAST_NOISE: Final = 1e-4
"""Of the Coulomb level: a simulation without noise still has rounding and a sample's length."""


def measure_noise(machine: Machine, logs: Sequence[Log], followed: Collection[str] = ()) -> float:
    """Return the RMS [N] of measured minus simulated friction over all valid samples of all logs.

    Beside what an estimator is told of a record, or finds in it: the parameters `followed`. Noise, and the model's
    error: with it an innovation is about as large as the estimator expects.
    """
    model = CompiledModel(step_every_sample(machine))
    found = [k for k, free in enumerate(model.model.parameters) if free.column in followed]
    total, count = 0.0, 0
    for log in logs:
        signals = signals_of_record(log, machine)
        slopes = np.empty((len(signals), model.model.n_p))
        rest = (signals.friction - model.predict(signals, slopes=slopes))[signals.valid]
        known = np.column_stack([slopes[:, found], *([signals.acceleration] if log.payload else [])])[signals.valid]
        rest = rest - known @ np.linalg.lstsq(known, rest)[0]
        total, count = total + float(rest @ rest), count + len(rest)
    return max(float(np.sqrt(total / max(count, 1))), LEAST_NOISE * machine.friction.coulomb)


def measure_colour(machine: Machine, logs: Sequence[Log]) -> float:
    """Return the colour of the innovations of the machine's own estimator, as a factor of variances.

    Wandering parameters count in its doubt too: twice as much, where they have it in doubt of the logs that made it.
    """
    signals = [signals_from_log(log, machine) for log in logs]
    package, colour = cached_package(machine), 1.0
    files, numbers = free_numbers(package.files, ("COLOUR_KNOWN", "DOUBTED_SPREAD"))
    estimator = CompiledEstimator(machine, replace(package, files=files), (*QUICK_FLAGS, f"-DSGMS_FREE={len(numbers)}"))
    known = (ctypes.c_double * len(numbers)).in_dll(estimator.library, "sgms_free")
    for trial in range(TRIALS):
        known[:] = (colour / machine.estimator.noise.colour * numbers).tolist()
        records = [estimator.estimate(each) for each in signals]
        if measure_doubt(np.concatenate([estimates.status for estimates in records])) <= MOST_DOUBT:
            break
        colour = 2.0 * colour if trial else max(2.0, find_colour(records))
    return colour
