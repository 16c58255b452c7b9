"""A force that sets in at some time: something was put down, a brake touches, a hose slipped."""

import casadi as ca

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need, Simpler
from sgms_mhe.model.effects.search import Step, Values

# The step as the signal chain passes it on; a sharp one would have no derivative in its time.
_RISE_S = 1e-3


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.add_force(p["force_N"] * (0.5 + 0.5 * ca.tanh((axis.time - p["time_s"]) / _RISE_S)))


DEFINITION = EffectDefinition(
    name="step_disturbance",
    summary="constant force from some time on",
    parameters=(
        EffectParameter("force_N", 0.0, 0.1, "force from then on", unit="coulomb"),
        EffectParameter("time_s", 0.0, 1e-3, "when it sets in", role="place", frozen=True),
    ),
    contribute=_contribute,
    loads=True,
    excitation=Excitation("motion in both directions before and after", (Need("both_directions", 0.1),)),
    confused_with={
        "constant_offset": "the same move at the beginning and at the end of the log",
        "friction_drift": "move in both directions afterwards: a force does not change sign",
        "position_spring": "return to the start: a spring's force comes back with the position",
    },
    moves=("again",),
    simpler=Simpler(("constant_offset",)),
    search=Step("force_N", "time_s"),
    linear=True,
)
