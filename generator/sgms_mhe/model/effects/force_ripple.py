"""A force periodic in position: cogging of a linear motor, a ball screw's pitch."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import EffectDefinition, EffectParameter


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX]) -> None:
    axis.add_force(p["amplitude_N"] * ca.sin(2.0 * math.pi / p["pitch_m"] * axis.position + p["phase_rad"]))


DEFINITION = EffectDefinition(
    name="force_ripple",
    summary="force periodic in position",
    parameters=(
        EffectParameter("amplitude_N", default=0.0, scale=0.1, description="amplitude of the sine"),
        EffectParameter("pitch_m", default=0.032, scale=0.001, description="period in position", lower=1e-6),
        EffectParameter("phase_rad", default=0.0, scale=0.1, description="phase at position zero"),
    ),
    contribute=_contribute,
)
