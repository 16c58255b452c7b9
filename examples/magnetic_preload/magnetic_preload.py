"""Preload magnets that pull the axis towards the middle of their stroke, with a force that saturates beyond a reach."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Extents, MotionRecord, Need, Simpler
from sgms_mhe.model.effects.parameters import step_by_factor
from sgms_mhe.model.effects.search import Columns, Values, one_size


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], _: Mapping[str, float]) -> None:
    axis.add_force(p["force_N"] * ca.tanh((axis.position - p["centre_m"]) / p["reach_m"]))


def _plant_force(position: float, _: float, __: float, p: Values) -> float:
    return p["force_N"] * math.tanh((position - p["centre_m"]) / p["reach_m"])


def _trials(motion: MotionRecord) -> list[Values]:
    """Reaches and centres within the travel."""
    travel, middle = motion.extents.travel, 0.5 * float(np.min(motion.position) + np.max(motion.position))
    return [
        {"reach_m": float(reach * travel), "centre_m": float(middle + place * travel)}
        for reach in np.geomspace(0.02, 0.5, 8)
        for place in np.linspace(-0.4, 0.4, 9)
    ]


def _is_spring(p: Values, extents: Extents) -> bool:
    return abs(p["reach_m"]) > extents.travel


DEFINITION = EffectDefinition(
    name="magnetic_preload",
    summary="pull of preload magnets towards the middle of their stroke",
    parameters=(
        EffectParameter("force_N", 0.0, 0.1, "force far from the middle", unit="coulomb"),
        EffectParameter("reach_m", 0.01, 0.001, "way to 76 % of it", lower=1e-6, role="shape", step=step_by_factor),
        EffectParameter("centre_m", 0.0, 0.001, "position without force", role="place", step=step_by_factor),
    ),
    contribute=_contribute,
    excitation=Excitation("travel to both sides, over several times the reach", (Need("travel_m", 3.0, "reach_m"),)),
    confused_with={
        "position_spring": "travel beyond the reach: a spring's force goes on rising, a magnet's does not",
        "force_ripple": "travel over several pitches: the pull does not come back",
    },
    moves=("travel",),
    simpler=Simpler(("constant_offset", "position_spring"), _is_spring),
    search=Columns(
        lambda m, p: np.tanh((m.position - p["centre_m"]) / p["reach_m"])[:, None],
        one_size("force_N"),
        _trials,
        tests=20.0,
    ),
    linear=True,
    plant_force=_plant_force,
)
