"""Viscous friction that depends on the direction: a lubricant's supply, a worm or ball screw's flanks."""

import casadi as ca
import numpy as np

from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.scales import Scales
from sgms_mhe.model.effects.search import Columns, Values, one_size


def _brakes_both_ways(p: Values, scales: Scales) -> bool:
    """Return True if neither direction drives the axis, up to its largest speed."""
    return abs(p["difference_N_s_m"]) <= scales.damping + scales.coulomb_over_speed


DEFINITION = EffectDefinition(
    name="asymmetric_viscous",
    summary="viscous friction different in the two directions",
    parameters=(EffectParameter("difference_N_s_m", 0.0, 0.1, "sigma_v + difference sign(v)", unit="damping"),),
    contribute=lambda axis, p, _: axis.add_force(p["difference_N_s_m"] * ca.fabs(axis.velocity)),
    excitation=Excitation(
        "both directions at constant speeds that differ by a factor of three",
        (Need("both_directions", 0.1), Need("speed_ratio", 2.0)),
    ),
    confused_with={
        "asymmetric_coulomb": "both directions at two constant speeds",
        "constant_offset": "both directions at two constant speeds",
        "quadratic_drag": "both directions: drag is the same in both",
    },
    moves=("speeds",),
    search=Columns(lambda m, _: np.abs(m.velocity)[:, None], one_size("difference_N_s_m")),
    linear=True,
    possible=_brakes_both_ways,
    companion=True,
)
