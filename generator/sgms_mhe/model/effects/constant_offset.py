"""A constant force: an amplifier's offset, a cable's pull, gravity on a tilted axis."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import EffectDefinition, EffectParameter


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX]) -> None:
    axis.add_force(p["force_N"])


DEFINITION = EffectDefinition(
    name="constant_offset",
    summary="constant force, independent of motion",
    parameters=(EffectParameter("force_N", default=0.0, scale=0.1, description="force opposing positive drive force"),),
    contribute=_contribute,
)
