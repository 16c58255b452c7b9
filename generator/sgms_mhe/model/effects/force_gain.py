"""A logged force that is not the force: a wrong motor constant or amplifier scale."""

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.search import Columns, Values


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.drive = p["gain"] * axis.drive


DEFINITION = EffectDefinition(
    name="force_gain",
    summary="logged force is a multiple of the real one",
    parameters=(EffectParameter("gain", 1.0, 0.05, "logged over real force", lower=0.01, upper=100.0, none=1.0),),
    contribute=_contribute,
    excitation=Excitation(
        "accelerations whose inertial force is seen: the mass is the only known force", (Need("inertial_ratio", 0.5),)
    ),
    confused_with={
        "mass_mismatch": "constant speed with known friction, or a known extra mass: a gain scales friction too",
        "coulomb": "one move with high acceleration: a gain scales the inertial force too",
        "viscous": "one move with high acceleration: a gain scales the inertial force too",
    },
    moves=("jerks",),
    excludes=("mass_mismatch",),  # a record tells their quotient
    inertial=True,
    # logged = gain real: the column is the logged force, its size 1 - 1 / gain
    search=Columns(lambda m, _: m.force[:, None], lambda _, size: {"gain": 1.0 / (1.0 - min(0.9, float(size[0])))}),
    linear=True,
    stage="log",
)
