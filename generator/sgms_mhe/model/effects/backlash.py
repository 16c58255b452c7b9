"""A gap between the mass and the rubbing part: a coupling, a carrier of the guide's cover."""

import math

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, MotionRecord, Need
from sgms_mhe.model.effects.parameters import step_by_factor
from sgms_mhe.model.effects.search import Trials, Values
from sgms_mhe.model.effects.states import EffectState, add_effect_state
from sgms_mhe.support.arrays import Array

_EDGE, _SHARPNESS = 0.9, 35.0
# b settles beyond 1 by a logarithm of the way, but contact is there from 0.93 on: so much that gaps of 1/40 of the
# deflection scale to half of it are as long as their parameter says, to 4 %.
_WIDENING = 0.995
_RELEASE = 40.0  # over f_C: how sharply contact ends where the elements' force does
_LEAST_GAP = 3e-7


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    """Position in the gap b, -1 to 1: db/dt = (2 / gap) v (1 - e), and the elements move with e v.

    Contact e: on the + side while the mass pushes on (v > 0) or the elements still push back; so on the other side.
    """
    gap = ca.sqrt(p["gap_m"] * p["gap_m"] + _LEAST_GAP**2)
    per_metre = 2.0 * _WIDENING / math.hypot(nominal["gap_m"], _LEAST_GAP)
    # The edge is 1/35 wide in b: five times the rate keeps a substep within it.
    state = add_effect_state(axis, EffectState("place", rate_per_metre=5.0 * per_metre, noise=1e-3, initial_state=1.0))
    v, b = axis.velocity, state.chi
    forward = 0.5 + 0.5 * ca.tanh(axis.gate_per_velocity * v)
    loaded = 0.5 + 0.5 * ca.tanh(_RELEASE * axis.element_force)
    upper = 0.5 + 0.5 * ca.tanh(_SHARPNESS * (b - _EDGE))
    lower = 0.5 - 0.5 * ca.tanh(_SHARPNESS * (b + _EDGE))
    contact = upper * (1.0 - (1.0 - forward) * (1.0 - loaded)) + lower * (1.0 - forward * loaded)
    state.rate = 2.0 * _WIDENING / gap * v * (1.0 - contact)
    state.names.update(contact=contact)
    # A gap of nothing is no gap: the share of `contact` goes with the gap over the least one.
    share = p["gap_m"] * p["gap_m"] / (gap * gap)
    axis.engagement = axis.engagement * (1.0 - share * (1.0 - contact))


def _gaps(motion: MotionRecord) -> list[Values]:
    return [{"gap_m": x} for x in (1e-6, 3e-6, 1e-5, 3e-5, 1e-4) if x < 0.3 * motion.extents.travel]


def _gap_moves(moved: Array, push: Array, values: Values) -> Array:
    """The mass's moves without moves that cross the gap (n) [m]; the gap opens where it turns from elements at rest."""
    gap = values["gap_m"]
    engaged = np.empty(len(moved))
    side, left = 1, 0.0  # way left to the side that the mass moves towards
    for k, (step, force) in enumerate(zip(moved.tolist(), push.tolist(), strict=True)):
        if side > 0 and step < 0.0 and force <= 0.0:
            side, left = 0, gap  # measured from the minus side
        elif side < 0 and step > 0.0 and force >= 0.0:
            side, left = 0, 0.0
        if side == 0:
            left += step
            if left > gap:
                side, step = 1, left - gap
            elif left < 0.0:
                side, step = -1, left
            else:
                step = 0.0
        engaged[k] = step
    return engaged


DEFINITION = EffectDefinition(
    name="backlash",
    summary="gap between the mass and what rubs",
    parameters=(
        EffectParameter(
            "gap_m", 0.0, 0.5, "width of the gap", lower=0.0, unit="deflection", proportional=False, step=step_by_factor
        ),
    ),
    contribute=_contribute,
    excitation=Excitation("slow reversals after sliding, several of them", (Need("reversals", 4.0),)),
    confused_with={
        "stiffness": "one slow reversal: a gap has no force at all, a soft element a low slope",
        "frictional_lag": "reversals at two speeds: a gap is a way, a lag is a time",
        "hose_hysteresis": "one slow reversal: behind a gap the force is zero, behind a hose it changes slowly",
    },
    moves=("loops",),
    # Its derivative is zero at zero: every trial is a gap.
    search=Trials(_gaps, _gap_moves),
    # The place in the gap moves within micrometres: shorter steps would be hundreds per sample.
    fit_displacement=2.0,
    stage="level",
    smooth_only="what crosses the gap depends on the elements' force: they have no displacement of their own",
    states=("place",),
)
