"""A Coulomb level that depends on the direction: preload, seals, a guide that tilts."""

import casadi as ca

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.motion import direction
from sgms_mhe.model.effects.search import Columns, Values, one_size


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.coulomb_factor = axis.coulomb_factor * (1.0 + p["ratio"] * ca.sign(axis.velocity))


DEFINITION = EffectDefinition(
    name="asymmetric_coulomb",
    summary="Coulomb level different in the two directions",
    parameters=(EffectParameter("ratio", 0.0, 0.1, "s(v) (1 + ratio sign(v))", lower=-0.95, upper=0.95),),
    contribute=_contribute,
    excitation=Excitation("sliding in both directions", (Need("both_directions", 0.1), Need("reversals", 2.0))),
    confused_with={
        "constant_offset": "loops below break-away: an offset shifts them, an asymmetric level does not",
        "asymmetric_viscous": "both directions at two constant speeds",
        "position_spring": "both directions at the same place",
    },
    moves=("speeds", "loops"),
    search=Columns(lambda m, _: (m.level * direction(m.velocity))[:, None], one_size("ratio"), exact="ratio"),
    linear=True,
    stage="level",
    companion=True,
)
