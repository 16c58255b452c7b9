"""Friction that grows with the torque transmitted: teeth and bearings of a gear, pressed on by the load."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.causes import Simpler
from sgms_mhe.model.effects.definition import EffectDefinition
from sgms_mhe.model.effects.parameters import EffectParameter
from sgms_mhe.model.effects.search import Columns, one_size
from sgms_mhe.model.effects.specimen import Specimen
from sgms_mhe.model.effects.transmission import friction_drag, load_excitation


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], _: Mapping[str, float]) -> None:
    ratio = p["ratio"] + p["rise_ratio"] * axis.stribeck_share
    axis.level_force = axis.level_force + ratio * ca.fabs(axis.transmitted_force)


DEFINITION = EffectDefinition(
    name="load_dependent_friction",
    summary="friction level grows with the torque transmitted",
    kinds=("rotary",),
    parameters=(
        # From 1 on a load could not be driven back, and the friction that holds it would have no one value.
        EffectParameter("ratio", 0.0, 0.1, "level added over the torque transmitted", lower=0.0, upper=0.95),
        EffectParameter(
            "rise_ratio",
            0.0,
            0.1,
            "what the ratio grows by towards low speed, as the Stribeck effect does",
            lower=0.0,
            main=False,
        ),
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
    search=Columns(lambda m, _: friction_drag(m), one_size("ratio"), exact="ratio"),
    stage="level",
    companion=True,
    rises="rise_ratio",
    specimen=Specimen(lambda _, __, x: {"ratio": 0.1 * x, "rise_ratio": 0.0}, signed=False),
)
