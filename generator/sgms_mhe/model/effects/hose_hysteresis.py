"""A hose or cable chain that creeps against itself: a soft hysteresis far wider than presliding (Dahl)."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import (
    EffectDefinition,
    EffectParameter,
    EffectState,
    Search,
    Start,
    add_effect_state,
)
from sgms_mhe.model.effects.excitation import Excitation, Need

# Below this level [N] the state's rate would be infinite.
_LEAST_LEVEL = 1e-6


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], nominal: Mapping[str, float]) -> None:
    # F = force_N chi, dF/dq = stiffness (1 - F sign(v) / force_N)
    rho = p["stiffness_N_m"] / p["force_N"]
    state = add_effect_state(
        axis,
        EffectState(
            "force",
            rate_per_metre=abs(nominal["stiffness_N_m"]) / nominal["force_N"],
            noise=1e-3,
            initial_state=1.0,
        ),
    )
    v = axis.velocity
    state.rate = rho * (v - ca.fabs(v) * state.chi)
    axis.add_force(p["force_N"] * state.chi)


DEFINITION = EffectDefinition(
    name="hose_hysteresis",
    summary="soft hysteresis of a hose or cable chain",
    parameters=(
        EffectParameter("stiffness_N_m", 0.0, 1e-4, "slope after a reversal", lower=0.0, unit="stiffness"),
        EffectParameter("force_N", 1.0, 0.1, "force it saturates at", lower=_LEAST_LEVEL, unit="coulomb"),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "strokes forth and back, from the size of break-away to the whole travel",
        (Need("reversals", 3.0), Need("travel_m", 0.01)),
    ),
    confused_with={
        "stiffness": "strokes far beyond break-away: only a hose's force goes on rising there",
        "position_spring": "the same long stroke forth and back: a spring has no loop",
        "asymmetric_coulomb": "reversals within the travel: a hose needs a way to build up",
        "coulomb": "short and long strokes: Coulomb friction is there after micrometres",
    },
    start=Start(
        values={"stiffness_N_m": 1.0, "force_N": 2.0},
        searches=(
            Search("stiffness_N_m", low=3.0, high=300.0, low_of="level_over_travel", high_of="level_over_travel"),
        ),
        note="linear in force_N where stiffness_N_m / force_N is given",
    ),
    states=("force",),
)
