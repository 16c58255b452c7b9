"""Damping of the presliding deflection: the sigma_i of equation (2), shared out by nu_i."""

import numpy as np

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.search import Columns, Values, one_size


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.micro_viscous = axis.micro_viscous + p["damping_N_s_m"]


DEFINITION = EffectDefinition(
    name="micro_viscous",
    summary="damping of the elements below break-away",
    parameters=(
        EffectParameter(
            "damping_N_s_m", 0.0, 1.0, "sum of sigma_i beyond the machine file's", lower=0.0, unit="damping"
        ),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "fast reversals, and loops below break-away at several frequencies", (Need("reversals", 6.0),)
    ),
    confused_with={
        "stiffness": "the same presliding loop at two speeds: a spring's force does not change with speed",
        "viscous": "constant speed: the elements rest there, and their damping has no force",
        "mass_mismatch": "loops below break-away: an inertial force is in phase with the spring",
    },
    moves=("loops",),
    search=Columns(
        lambda m, _: np.gradient(m.level)[:, None] * m.extents.rate, one_size("damping_N_s_m"), exact="damping_N_s_m"
    ),
    stage="level",
    smooth_only="the damping of an element would jump where it breaks away",
)
