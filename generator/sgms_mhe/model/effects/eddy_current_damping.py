"""Eddy currents in a linear motor's track: damping that falls off beyond a corner velocity."""

import numpy as np

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need, Simpler
from sgms_mhe.model.effects.parameters import shape
from sgms_mhe.model.effects.search import Columns, Values, one_size


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    ratio = axis.velocity / p["corner_velocity_m_s"]
    axis.add_force(p["damping_N_s_m"] * axis.velocity / (1.0 + ratio * ratio))


DEFINITION = EffectDefinition(
    name="eddy_current_damping",
    summary="damping by eddy currents, falling off with speed",
    parameters=(
        EffectParameter("damping_N_s_m", 0.0, 0.5, "damping at low speed", lower=0.0, unit="damping"),
        shape("corner_velocity_m_s", 0.5, 0.1, "speed of the largest force", 1e-6),
    ),
    contribute=_contribute,
    over_speed=True,
    excitation=Excitation(
        "constant speeds from well below to beyond the corner velocity",
        (Need("speed_m_s", 1.0, times="corner_velocity_m_s"), Need("speed_ratio", 2.5)),
    ),
    confused_with={
        "viscous": "constant speeds up to twice the corner velocity: damping falls off beyond it",
        "quadratic_drag": "speeds up to the fastest: drag bends up, eddy currents bend down",
        "stribeck": "speeds below the Stribeck velocity",
    },
    moves=("speeds",),
    excludes=("friction_curve",),
    simpler=Simpler(("viscous",), lambda p, extents: p["corner_velocity_m_s"] > 2.0 * extents.speed),
    search=Columns(
        lambda m, p: (m.velocity / (1.0 + (m.velocity / p["corner_velocity_m_s"]) ** 2))[:, None],
        one_size("damping_N_s_m"),
        lambda m: [{"corner_velocity_m_s": float(x)} for x in m.extents.speed * np.geomspace(0.02, 1.0, 8)],
        tests=3.0,
    ),
    linear=True,
)
