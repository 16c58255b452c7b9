"""Break-away that rises with the time at rest: the contact ages, motion renews it."""

from __future__ import annotations

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
    # Age d, 0 to 1: dd/dt = (1 - d) / time_constant - |v| d / length, on s(v) (1 + ratio d)
    state = add_effect_state(
        axis,
        EffectState(
            "age",
            rate_per_metre=1.0 / nominal["length_m"],
            rate_per_second=1.0 / nominal["time_constant_s"],
            noise=1e-3,
            initial_state=0.1,
        ),
    )
    age = state.chi
    state.rate = (1.0 - age) / p["time_constant_s"] - ca.fabs(axis.velocity) * age / p["length_m"]
    axis.coulomb_factor = axis.coulomb_factor * (1.0 + p["ratio"] * age)


DEFINITION = EffectDefinition(
    name="dwell_dependence",
    summary="break-away rises with the time at rest",
    parameters=(
        EffectParameter("ratio", 0.0, 0.1, "rise after a long rest over the level", lower=-0.95),
        EffectParameter("time_constant_s", 1.0, 0.3, "time to 63 % of the rise", lower=1e-3),
        EffectParameter("length_m", 1e-4, 1e-5, "way that renews the contact", lower=1e-8, main=False),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "rests from a tenth to several times the time constant, each followed by a slow break-away",
        (Need("standstill_s", 1.0, times="time_constant_s"), Need("standstill_ratio", 3.0)),
    ),
    confused_with={
        "stribeck": "break away after rests of different length, at the same speed",
        "friction_drift": "rests of different length in the middle of the log",
        "frictional_lag": "break away after rests of different length",
    },
    start=Start(
        values={"ratio": 1.0},
        searches=(
            Search("time_constant_s", low=0.05, high=20.0, points=5),
            Search("length_m", low=0.1, high=10.0, low_of="deflection", high_of="deflection", points=4),
        ),
        note="linear in ratio while sliding",
    ),
    stage="level",
    states=("age",),
)
