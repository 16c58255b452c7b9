"""A force periodic in time: a pump, a fan, mains hum, a neighbouring axis."""

import math

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Simpler
from sgms_mhe.model.effects.parameters import step_of_frequency
from sgms_mhe.model.effects.search import Harmonic, Values, ones
from sgms_mhe.model.effects.sines import phase


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.add_force(p["amplitude_N"] * ca.sin(2.0 * math.pi * p["frequency_Hz"] * axis.time + p["phase_rad"]))


DEFINITION = EffectDefinition(
    name="periodic_disturbance",
    summary="force periodic in time",
    parameters=(
        EffectParameter("amplitude_N", 0.0, 0.1, "amplitude of the sine", unit="coulomb"),
        EffectParameter(
            "frequency_Hz",
            50.0,
            0.1,
            "frequency",
            lower=1e-4,
            role="period",
            step=step_of_frequency,
            least=lambda extents: extents.lowest_frequency,
        ),
        phase("time"),
    ),
    contribute=_contribute,
    loads=True,
    excitation=Excitation("a log over several periods; motion is not needed", ()),
    confused_with={
        "force_ripple": "the same stroke at another speed: the pattern stays in place or stays in time",
        "structural_resonance": "a standstill long after the last move: a resonance has died away",
        "encoder_periodic_error": "the same stroke at another speed: the frequency follows speed or stays",
    },
    moves=("travel", "again"),
    simpler=Simpler(("constant_offset", "step_disturbance")),
    # The phase found is that of the signals, which leave the signal chain with its delay.
    search=Harmonic(
        "time", "amplitude_N", "frequency_Hz", weights=lambda m: [np.ones(len(m.time))], factors=lambda _, k: [ones(k)]
    ),
    linear=True,
    repeatable=True,
)
