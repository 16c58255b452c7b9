"""Weights of the estimator that a file from nothing starts with.

The measurement's noise is what the model leaves of the records' friction sample by sample: noise, and what the model
gets wrong. With it an innovation is about as large as the estimator expects. Everything else keeps its default; weights
by the likelihood of innovations are a matter of their own, and take this function's place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from sgms_mhe.configuration import override_machine
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import signals_of_record
from sgms_mhe.signals.logs import Log

LEAST: Final = 1e-4
"""Of the Coulomb level: a simulation without noise still has rounding and a sample's length."""


def measurement_noise(machine: Machine, logs: Sequence[Log]) -> float:
    """RMS [N] of measured minus simulated friction over all valid samples of all logs."""
    sampling = machine.sampling
    if sampling.integrator.substeps < sampling.samples_per_update:
        machine = override_machine(machine, {"sampling": {"integrator": {"substeps": sampling.samples_per_update}}})
    model = CompiledModel(machine)
    total, count = 0.0, 0
    for log in logs:
        signals = signals_of_record(log, machine)
        rest = (signals.friction - model.predict(signals).friction_N)[signals.valid]
        total, count = total + float(rest @ rest), count + len(rest)
    return max(float(np.sqrt(total / max(count, 1))), LEAST * machine.friction.coulomb)
