"""A force periodic in time: a pump, a fan, mains hum, a neighbouring axis."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import EffectDefinition, EffectParameter, Search, Start
from sgms_mhe.model.effects.excitation import Excitation


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], _: Mapping[str, float]) -> None:
    axis.add_force(p["amplitude_N"] * ca.sin(2.0 * math.pi * p["frequency_Hz"] * axis.time + p["phase_rad"]))


DEFINITION = EffectDefinition(
    name="periodic_disturbance",
    summary="force periodic in time",
    parameters=(
        EffectParameter("amplitude_N", 0.0, 0.1, "amplitude of the sine", unit="coulomb"),
        EffectParameter("frequency_Hz", 50.0, 0.1, "frequency", lower=1e-4, role="period"),
        EffectParameter("phase_rad", 0.0, 0.1, "phase at time zero", role="place"),
    ),
    contribute=_contribute,
    excitation=Excitation("a log over several periods; motion is not needed", ()),
    confused_with={
        "force_ripple": "the same stroke at another speed: the pattern stays in place or stays in time",
        "structural_resonance": "a standstill long after the last move: a resonance has died away",
        "encoder_periodic_error": "the same stroke at another speed: the frequency follows speed or stays",
    },
    start=Start(
        values={"amplitude_N": 0.5},
        searches=(
            Search(
                "frequency_Hz",
                low=1.5,
                high=0.4,
                low_of="per_duration",
                high_of="rate",
                spacing="linear",
                points=0,
                harmonic=("amplitude_N", "phase_rad"),
            ),
        ),
        note="the phase is that of the signals, which leave the signal chain with its delay",
    ),
)
