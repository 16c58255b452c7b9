"""Force and position less than a sample apart: that is of how a drive holds and logs its force, and no delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition
from sgms_mhe.signals.logs import Log


def sampling_offset(diagnosis: Diagnosis) -> float:
    """Time [s] that a diagnosis names as a delay or lag of the axis, but that sampling alone makes; 0: none.

    A drive that holds its force over a sample logs one that is half a sample old on average, or half a sample young,
    depending on when it writes it down. What is less than that and a margin says nothing about the axis.
    """
    machine = diagnosis.machine
    most = machine.diagnosis.timing_most * machine.sampling.step
    for cause in diagnosis.causes:
        if cause.name not in EFFECT_NAMES:
            continue
        for parameter in effect_definition(cause.name).parameters:
            value = cause.parameters.get(parameter.name, 0.0)
            if parameter.timing and 0.0 < value <= most:
                return value
    return 0.0


def in_step(log: Log, offset: float) -> Log:
    """The log with its force that time [s] younger: of the cubic through four samples (Lagrange).

    What the controller computed itself stays. Samples next to gaps are missing; beyond the end the last one goes on.
    """
    samples = offset * log.rate
    whole = int(np.floor(samples))
    u, n = samples - whole, len(log)
    weights = (
        -u * (u - 1.0) * (u - 2.0) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        -(u + 1.0) * u * (u - 2.0) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    )
    padded = np.pad(log.force_N, (1, whole + 2), mode="edge")
    force = sum(weight * padded[whole + k : whole + k + n] for k, weight in enumerate(weights))
    return replace(log, force_N=np.asarray(force))


def offset_notes(machine: Machine, offset: float) -> tuple[str, ...]:
    """What a user should know of a force that was put in step with the position by that time [s]."""
    if offset == 0.0:
        return ()
    return (
        f"the logged force is {offset * machine.sampling.rate:.2f} samples ({offset:.2g} s) older than the position, "
        "as where a drive holds its force over a sample: taken out, and no delay of the axis",
    )
