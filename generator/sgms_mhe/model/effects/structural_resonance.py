"""A part of the mass that hangs on a spring: payload, chuck, a bridge's yaw."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import (
    EffectDefinition,
    EffectParameter,
    EffectState,
    Search,
    Start,
    add_effect_state,
)
from sgms_mhe.model.effects.excitation import Excitation, Need


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], nominal: Mapping[str, float]) -> None:
    """The hanging mass in coordinates relative to the rest, e = q - x: e'' = a - omega^2 e - 2 zeta omega e'.

    chi = (omega^2 e, omega e') mass / f_C. The rest is lighter by m2 and pulled by m2 (omega^2 e + 2 zeta omega e').
    """
    omega = 2.0 * math.pi * p["frequency_Hz"]
    fast = 2.0 * math.pi * nominal["frequency_Hz"]
    scale = axis.mass / axis.coulomb
    specs = (
        EffectState(name, rate_per_second=0.5 * fast, noise=1e-3, initial_state=1.0)
        for name in ("stretch", "stretch_rate")
    )
    stretch, speed = (add_effect_state(axis, spec) for spec in specs)
    stretch.rate = omega * speed.chi
    speed.rate = omega * (scale * axis.acceleration - stretch.chi - 2.0 * p["damping_ratio"] * speed.chi)
    # The integrator holds the acceleration of a step's end all through it, so its states are half a step ahead.
    ahead = 0.5 * axis.hold
    pull = stretch.chi - ahead * stretch.rate + 2.0 * p["damping_ratio"] * (speed.chi - ahead * speed.rate)
    axis.add_force(p["mass_kg"] * (pull / scale - axis.acceleration))


DEFINITION = EffectDefinition(
    name="structural_resonance",
    summary="part of the mass on a spring",
    parameters=(
        EffectParameter("frequency_Hz", 100.0, 1.0, "natural frequency with the rest held", lower=0.1, role="period"),
        EffectParameter("damping_ratio", 0.02, 0.01, "damping ratio with the rest held", lower=0.0, upper=2.0),
        EffectParameter("mass_kg", 0.0, 0.1, "hanging part of the mass", lower=0.0, unit="mass"),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "jerk with frequencies around the resonance, and rest after it",
        (Need("inertial_ratio", 1.0), Need("reversals", 2.0)),
    ),
    confused_with={
        "mass_mismatch": "moves with little jerk, and jerk at the resonance: a mass alone does not ring",
        "periodic_disturbance": "a standstill long after the last move: a resonance has died away",
        "force_delay": "wide-band force, such as noise on the command: a resonance has a peak",
        "encoder_periodic_error": "the same stroke at another speed: the frequency follows speed or stays",
    },
    start=Start(
        values={"mass_kg": 1.0},
        searches=(Search("frequency_Hz", low=10.0, high=0.2, low_of="one", high_of="rate", points=16),),
        note="linear in mass where frequency and damping are given",
    ),
    states=("stretch", "stretch_rate"),
)
