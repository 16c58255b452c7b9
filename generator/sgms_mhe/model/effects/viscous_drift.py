"""Viscous friction that changes over time: a lubricant that warms up."""

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, Excitation, Need
from sgms_mhe.model.effects.drift import drift_factor, drift_limit, drift_parameters, drift_search
from sgms_mhe.model.effects.search import Values


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.viscous_factor = axis.viscous_factor * drift_factor(axis, p)


DEFINITION = EffectDefinition(
    name="viscous_drift",
    summary="viscous friction that settles at another value over time",
    parameters=drift_parameters("viscous friction"),
    contribute=_contribute,
    excitation=Excitation(
        "the same fast move again and again, over more than a time constant",
        (Need("moving_s", 1.0), Need("reversals", 4.0)),
    ),
    confused_with={
        "viscous": "the same fast move at the beginning and at the end of the log",
        "friction_drift": "two constant speeds at the beginning, and again at the end of the log",
        "eddy_current_damping": "the same fast move at the beginning and at the end of the log",
    },
    moves=("again",),
    simpler=drift_limit("viscous"),
    search=drift_search(lambda m: m.damping * m.velocity),
    linear=True,
    stage="level",
)
