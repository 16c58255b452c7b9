"""A force periodic in position: cogging of a linear motor, a ball screw's pitch."""

import numpy as np

from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need, Simpler
from sgms_mhe.model.effects.sines import phase, pitch, ripple_search, sine

DEFINITION = EffectDefinition(
    name="force_ripple",
    summary="force periodic in position",
    parameters=(
        EffectParameter("amplitude_N", 0.0, 0.1, "amplitude of the sine", unit="coulomb"),
        pitch(0.032, 0.001),
        phase("position"),
    ),
    contribute=lambda axis, p, _: axis.add_force(p["amplitude_N"] * sine(axis.position, p["pitch_m"], p["phase_rad"])),
    excitation=Excitation(
        "travel over at least one and a half pitches, so slow that samples resolve the pitch",
        (Need("travel_m", 1.5, times="pitch_m"), Need("moving_s", 0.3)),
    ),
    confused_with={
        "force_constant_ripple": "the same stroke with another acceleration: a force constant's ripple grows with it",
        "position_dependent_friction": "the same stroke in both directions: friction changes sign, cogging does not",
        "periodic_disturbance": "the same stroke at another speed: the pattern stays in place or stays in time",
        "encoder_periodic_error": "the same stroke at twice the speed: an encoder's error makes four times the force",
        "position_spring": "travel over several pitches",
    },
    moves=("travel",),
    simpler=Simpler(("constant_offset", "position_spring", "unbalance")),
    search=ripple_search("amplitude_N", lambda m: np.ones(len(m.time))),
    repeatable=True,
)
