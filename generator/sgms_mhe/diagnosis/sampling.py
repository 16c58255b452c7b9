"""Force and position less than a sample apart: that is of how a drive holds and logs its force, and no delay."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.diagnosis.shifting import Shift
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition
from sgms_mhe.signals.logs import Log

TIMING: Final = 0.1
"""Time that force and position may be apart without that being a delay [sample]: no two signals are sampled at quite
the same instant."""
TIMING_MOST: Final = 0.6
"""Delay up to which it is the sampling's and not the axis's [sample]: a force that is held over a sample is half a
sample old on average; and a margin."""


def sampling_offset(diagnosis: Diagnosis) -> float:
    """How old [s] the logged force is by a delay or lag that a diagnosis names, but that sampling alone makes; 0: none.

    A drive that holds its force over a sample logs one that is half a sample old on average, or half a sample young
    (below zero), depending on when it writes it down. What is less than that and a margin says nothing about the axis.
    """
    machine = diagnosis.machine
    most = TIMING_MOST * machine.sampling.step
    for cause in diagnosis.causes:
        if cause.name not in EFFECT_NAMES:
            continue
        definition = effect_definition(cause.name)
        for parameter in definition.parameters:
            value = cause.parameters.get(parameter.name, 0.0)
            if parameter.timing and abs(value) <= most:
                return value if definition.delays else -value  # a force that lags the logged one makes that one young
    return 0.0


def in_step(log: Log, offset: float) -> Log:
    """The log with its force that time [s] younger.

    What the controller computed itself stays. Samples next to gaps are missing.
    """
    return replace(log, force_N=Shift.of(-offset, log.rate).of_series(log.force_N))


def offset_notes(machine: Machine, offset: float) -> tuple[str, ...]:
    """What a user should know of a force that was put in step with the position by that time [s]."""
    if offset == 0.0:
        return ()
    age = "older" if offset > 0.0 else "younger"
    return (
        f"the logged force is {abs(offset) * machine.sampling.rate:.2f} samples ({abs(offset):.2g} s) {age} than the "
        "position, as where a drive holds its force over a sample: taken out, and no delay of the axis",
    )
