"""Drag proportional to the square of the speed: air, coolant, a fan effect."""

import casadi as ca
import numpy as np

from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.search import Columns, one_size

DEFINITION = EffectDefinition(
    name="quadratic_drag",
    summary="drag proportional to speed squared",
    parameters=(EffectParameter("coefficient_N_s2_m2", 0.0, 0.1, "force over v |v|", lower=0.0, unit="coulomb"),),
    contribute=lambda axis, p, _: axis.add_force(p["coefficient_N_s2_m2"] * axis.velocity * ca.fabs(axis.velocity)),
    over_speed=True,
    excitation=Excitation(
        "three constant speeds or more, up to the fastest", (Need("speed_ratio", 2.5), Need("moving_s", 0.5))
    ),
    confused_with={
        "viscous": "three constant speeds or more: is the force over speed a line or a parabola",
        "eddy_current_damping": "speeds up to the fastest: drag bends up, eddy currents bend down",
    },
    moves=("speeds",),
    excludes=("friction_curve",),
    search=Columns(lambda m, _: (m.velocity * np.abs(m.velocity))[:, None], one_size("coefficient_N_s2_m2")),
    linear=True,
)
