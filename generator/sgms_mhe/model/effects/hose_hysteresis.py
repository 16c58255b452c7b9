"""A hose or cable chain that creeps against itself: a soft hysteresis far wider than presliding (Dahl)."""

import casadi as ca
import numpy as np
from scipy.linalg.blas import dtbsv

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, MotionRecord, Need, Simpler
from sgms_mhe.model.effects.search import Columns, Values
from sgms_mhe.model.effects.states import EffectState, add_effect_state
from sgms_mhe.support.arrays import Array

# Below this level [N] the state's rate would be infinite.
_LEAST_LEVEL = 1e-6


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    # F = force_N chi, dF/dq = stiffness (1 - F sign(v) / force_N)
    rho = p["stiffness_N_m"] / p["force_N"]
    state = add_effect_state(
        axis,
        EffectState(
            "force", rate_per_metre=abs(nominal["stiffness_N_m"]) / nominal["force_N"], noise=1e-3, initial_state=1.0
        ),
    )
    v = axis.velocity
    state.rate = rho * (v - ca.fabs(v) * state.chi)
    axis.add_force(p["force_N"] * state.chi)


def _dahl(motion: MotionRecord, length: float) -> Array:
    """Force of a unit Dahl element along the motion (m): dF/dq = (1 - F sign(v)) / length."""
    moved = np.diff(motion.position, prepend=motion.position[:1])
    keep = np.exp(-np.abs(moved) / length)
    add = np.sign(moved) * (1.0 - keep)
    # F_k - keep_k F_(k-1) = add_k: a triangular system of two diagonals, solved forwards.
    diagonals = np.ones((2, len(moved)), order="F")
    diagonals[1, :-1] = -keep[1:]
    return np.asarray(dtbsv(1, diagonals, add, lower=1, diag=1))


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
    moves=("loops", "travel", "places"),
    simpler=Simpler(("position_spring",), lambda p, m: p["force_N"] > 0.7 * m.travel * abs(p["stiffness_N_m"])),
    search=Columns(
        lambda m, p: _dahl(m, p["length"])[:, None],
        lambda p, size: {"force_N": float(size[0]), "stiffness_N_m": float(size[0]) / p["length"]},
        lambda m: [{"length": float(x)} for x in m.extents.travel * np.geomspace(0.003, 1.0, 9)],
        tests=4.0,
    ),
    states=("force",),
)
