"""Eddy currents in a linear motor's track: damping that falls off beyond a corner velocity."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import EffectDefinition, EffectParameter, Search, Start
from sgms_mhe.model.effects.excitation import Excitation, Need


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], _: Mapping[str, float]) -> None:
    ratio = axis.velocity / p["corner_velocity_m_s"]
    axis.add_force(p["damping_N_s_m"] * axis.velocity / (1.0 + ratio * ratio))


DEFINITION = EffectDefinition(
    name="eddy_current_damping",
    summary="damping by eddy currents, falling off with speed",
    parameters=(
        EffectParameter("damping_N_s_m", 0.0, 0.5, "damping at low speed", unit="damping"),
        EffectParameter("corner_velocity_m_s", 0.5, 0.1, "speed of the largest force", lower=1e-6),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "constant speeds from well below to beyond the corner velocity",
        (Need("speed_m_s", 1.0, times="corner_velocity_m_s"), Need("speed_ratio", 2.5)),
    ),
    confused_with={
        "viscous": "constant speeds up to twice the corner velocity: damping falls off beyond it",
        "quadratic_drag": "speeds up to the fastest: drag bends up, eddy currents bend down",
        "stribeck": "speeds below the Stribeck velocity",
    },
    start=Start(
        values={"damping_N_s_m": 1.0},
        searches=(Search("corner_velocity_m_s", low=0.1, high=2.0, low_of="speed", high_of="speed", points=5),),
        note="linear in damping where the corner is given; with viscous free only the bend is left",
    ),
)
