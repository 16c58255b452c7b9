"""A logged force that is not the force: a wrong motor constant or amplifier scale."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import EffectDefinition, EffectParameter, Start
from sgms_mhe.model.effects.excitation import Excitation, Need


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], _: Mapping[str, float]) -> None:
    axis.drive = p["gain"] * axis.drive


DEFINITION = EffectDefinition(
    name="force_gain",
    summary="logged force is a multiple of the real one",
    parameters=(EffectParameter("gain", 1.0, 0.05, "logged over real force", lower=0.01, upper=100.0),),
    contribute=_contribute,
    excitation=Excitation(
        "accelerations whose inertial force is seen: the mass is the only known force", (Need("inertial_ratio", 0.5),)
    ),
    confused_with={
        "mass_mismatch": "constant speed with known friction, or a known extra mass: a gain scales friction too",
        "coulomb": "one move with high acceleration: a gain scales the inertial force too",
        "viscous": "one move with high acceleration: a gain scales the inertial force too",
    },
    start=Start(note="linear; with Coulomb, viscous and stiffness free it is the mass alone that fixes it"),
    stage="log",
)
