"""A Coulomb level that changes over time: lubricant running in, warming up."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import EffectDefinition, EffectParameter, Search, Start
from sgms_mhe.model.effects.excitation import Excitation, Need


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], _: Mapping[str, float]) -> None:
    axis.coulomb_factor = axis.coulomb_factor * (1.0 + p["ratio"] * (1.0 - ca.exp(-axis.time / p["time_constant_s"])))


DEFINITION = EffectDefinition(
    name="friction_drift",
    summary="Coulomb level that settles at another value over time",
    parameters=(
        EffectParameter("ratio", 0.0, 0.1, "final change over the initial Coulomb level", lower=-0.95),
        EffectParameter("time_constant_s", 10.0, 1.0, "time to 63 % of the change", lower=1e-3),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "the same move again and again, over more than a time constant",
        (Need("moving_s", 1.0), Need("reversals", 4.0)),
    ),
    confused_with={
        "coulomb": "the same move at the beginning and at the end of the log",
        "viscous_drift": "two constant speeds at the beginning, and again at the end of the log",
        "position_dependent_friction": "the same stroke twice: what belongs to the place comes back",
        "dwell_dependence": "rests of different length in the middle of the log",
    },
    start=Start(
        values={"ratio": 0.5},
        searches=(Search("time_constant_s", low=0.05, high=3.0, low_of="duration", high_of="duration", points=5),),
        note="linear in ratio at a given time constant; far beyond the log only ratio / time constant counts",
    ),
    stage="level",
)
