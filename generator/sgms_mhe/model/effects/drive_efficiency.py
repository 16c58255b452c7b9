"""Losses of a gear's mesh: less arrives than is driven in, whichever side drives."""

import math

import casadi as ca

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Simpler
from sgms_mhe.model.effects.search import Columns, Values
from sgms_mhe.model.effects.transmission import friction_drag, load_excitation
from sgms_mhe.support.arrays import Array

_LEAST = 0.5


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    """T = eta u where the drive drives, T = u / eta where the load does; the loss is friction's.

    Lost is |T| (1 / eta - 1) and |T| (1 - eta), by the sign of T v. Below break-away friction takes the needed share.
    """
    efficiency, torque = p["efficiency_ratio"], axis.transmitted_force
    driving, driven = 1.0 / efficiency - 1.0, 1.0 - efficiency
    lost = (driving + driven) * ca.fabs(torque) + (driving - driven) * torque * ca.sign(axis.velocity)
    axis.level_force = axis.level_force + 0.5 * lost


def _efficiency(_: Values, size: Array) -> Values:
    """Return the eta whose mean loss of both sides, (1 / eta - eta) / 2, is the given one."""
    return {"efficiency_ratio": math.exp(math.asinh(float(size[0])))}


DEFINITION = EffectDefinition(
    name="drive_efficiency",
    summary="driving takes more than the load, braking less",
    kinds=("rotary",),
    parameters=(
        # A drive that loses more than half locks itself: a load cannot drive it back.
        EffectParameter(
            "efficiency_ratio",
            1.0,
            0.1,
            "torque that arrives over torque driven in, from either side",
            lower=_LEAST,
            upper=1.0,
            none=1.0,
        ),
    ),
    contribute=_contribute,
    excitation=load_excitation("sliding both ways under loads that the drive drives, and under loads that drive it"),
    confused_with={
        "load_dependent_friction": "hard braking, or a weight let down: there a drive loses less than where it drives",
        "force_gain": "constant speeds without a load: a gain scales friction too, a drive then loses nothing",
        "mass_mismatch": "the same acceleration forth and back: losses brake both, a mass brakes one and drives one",
        "coulomb": "the same speed under two loads: a Coulomb level does not change",
    },
    moves=("jerks", "speeds"),
    inertial=True,
    simpler=Simpler(("coulomb",)),
    # Per unit of efficiency where nothing is lost.
    search=Columns(lambda m, _: -friction_drag(m), _efficiency, exact="efficiency_ratio"),
    stage="level",
)
