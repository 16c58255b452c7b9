"""A Coulomb level that changes over time: lubricant running in, warming up."""

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, Excitation, Need
from sgms_mhe.model.effects.drift import drift_factor, drift_limit, drift_parameters, drift_search
from sgms_mhe.model.effects.search import Values


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.coulomb_factor = axis.coulomb_factor * drift_factor(axis, p)


DEFINITION = EffectDefinition(
    name="friction_drift",
    summary="Coulomb level that settles at another value over time",
    parameters=drift_parameters("Coulomb level"),
    contribute=_contribute,
    excitation=Excitation(
        "the same move again and again, over more than a time constant", (Need("moving_s", 1.0), Need("reversals", 4.0))
    ),
    confused_with={
        "coulomb": "the same move at the beginning and at the end of the log",
        "viscous_drift": "two constant speeds at the beginning, and again at the end of the log",
        "position_dependent_friction": "the same stroke twice: what belongs to the place comes back",
        "dwell_dependence": "rests of different length in the middle of the log",
    },
    moves=("again",),
    simpler=drift_limit("coulomb"),
    search=drift_search(lambda m: m.level),
    linear=True,
    stage="level",
)
