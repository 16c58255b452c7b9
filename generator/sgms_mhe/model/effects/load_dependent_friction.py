"""Friction that grows with the torque at the mesh: teeth and bearings of a gear, pressed by their load.

Behind the mesh are the load and the inertia behind it; before it the rotor's, and friction of bearings there.
A mesh in the middle of an axis carries the load, and shares of inertial torque and friction.
"""

from collections.abc import Sequence
from typing import Final

import casadi as ca

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, MotionRecord, Simpler
from sgms_mhe.model.effects.parameters import decided
from sgms_mhe.model.effects.search import Columns, Values, one_size
from sgms_mhe.model.effects.transmission import friction_drag, load_excitation

SHARES: Final = ("inertia_ratio", "friction_ratio")
MOST: Final = 0.95
"""Largest ratio: from 1 on a load could not be driven back, and the friction that holds it would have no one value."""
TRIED: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares that are tried: inertia and friction before the mesh alike."""


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    """Add r |T|, T = load + a_J J a + a_f f, with f all of the friction: this effect included.

    Along the motion T is sign(v) T_0 + a_f (f_0 + r |T|), with f_0 the friction without it, which one division solves.
    """
    ratio = p["ratio"] + p["rise_ratio"] * axis.stribeck_share
    torque = axis.transmitted_force - (1.0 - p["inertia_ratio"]) * axis.mass * axis.acceleration
    share = p["friction_ratio"]
    if nominal["friction_ratio"] == 0.0 and share.is_constant():
        added = ratio * ca.fabs(torque)
    else:
        along = ca.sign(axis.velocity) * torque + share * axis.sliding_friction
        added = ratio * ca.fabs(along) / (1.0 - ca.sign(along) * share * ca.fmin(ratio, MOST))
    axis.level_force = axis.level_force + added


def _share(name: str, default: float, of: str) -> EffectParameter:
    said = f"share of {of} that the teeth transmit: of what is behind them"
    return decided(name, default, 1.0, said, 0.0, 1.0, role="shape")


def _shares(_: MotionRecord) -> Sequence[Values]:
    """Where the mesh may be: behind all friction, first, or before a share of it and of the inertia."""
    return ({}, *(dict.fromkeys(SHARES, share) for share in TRIED))


DEFINITION = EffectDefinition(
    name="load_dependent_friction",
    summary="friction level grows with the torque at the mesh",
    kinds=("rotary",),
    parameters=(
        EffectParameter("ratio", 0.0, 0.1, "level added over the torque at the mesh", lower=0.0, upper=MOST),
        EffectParameter(
            "rise_ratio",
            0.0,
            0.1,
            "what the ratio grows by towards low speed, as the Stribeck effect does",
            lower=0.0,
            main=False,
        ),
        _share("inertia_ratio", 1.0, "the inertial torque"),
        _share("friction_ratio", 0.0, "all friction"),
    ),
    contribute=_contribute,
    excitation=load_excitation("sliding both ways under loads from none to several times the Coulomb level"),
    confused_with={
        "coulomb": "the same speed under two loads: a Coulomb level does not change",
        "mass_mismatch": "the same acceleration forth and back: friction brakes both, a mass brakes one and drives one",
        "force_gain": "constant speeds under gravity forth and back: friction changes sign, a gain scales gravity too",
        "drive_efficiency": "hard braking, or a weight let down: there a drive loses less than where it drives",
        "position_dependent_friction": "the same angles with another acceleration",
    },
    moves=("jerks", "speeds"),
    inertial=True,
    simpler=Simpler(("coulomb",)),
    search=Columns(
        lambda m, p: friction_drag(m, **p), one_size("ratio"), exact="ratio", variants=_shares, rise="rise_ratio"
    ),
    stage="level",
    companion=True,
)
