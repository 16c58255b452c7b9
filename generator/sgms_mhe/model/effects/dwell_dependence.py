"""Break-away that rises with the time at rest: the contact ages, motion renews it."""

import casadi as ca

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Extents, MotionRecord, Need, Simpler
from sgms_mhe.model.effects.parameters import shape
from sgms_mhe.model.effects.scales import Scales
from sgms_mhe.model.effects.search import Derivative, Values
from sgms_mhe.model.effects.states import EffectState, add_effect_state


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    # Age d, 0 to 1: dd/dt = (1 - d) / time_constant - |v| d / length, on s(v) (1 + ratio d)
    state = add_effect_state(
        axis,
        EffectState(
            "age",
            rate_per_metre=1.0 / nominal["length_m"],
            rate_per_second=1.0 / nominal["time_constant_s"],
            noise=1e-3,
            initial_state=0.1,
        ),
    )
    age = state.chi
    state.rate = (1.0 - age) / p["time_constant_s"] - ca.fabs(axis.velocity) * age / p["length_m"]
    axis.coulomb_factor = axis.coulomb_factor * (1.0 + p["ratio"] * age)


def _trials(motion: MotionRecord) -> list[Values]:
    lengths = [share * motion.deflection for share in (0.1, 0.4, 1.6)]
    return [{"time_constant_s": time, "length_m": length} for length in lengths for time in (0.04, 0.12, 0.4, 1.2)]


def _shortest_way(extents: Extents) -> float:
    """At top speed a contact is renewed a hundred times in a row: a shorter way costs steps and tells nothing."""
    return 0.01 * extents.speed / extents.rate


def _rises(p: Values, _: Scales) -> bool:
    """A contact that rests grows stronger."""
    return p["ratio"] >= 0.0


def _is_speed_alone(p: Values, extents: Extents) -> bool:
    """The contact's age is then that of the speed of the moment, and the level a curve over speed."""
    return p["time_constant_s"] < 5.0 / extents.rate


DEFINITION = EffectDefinition(
    name="dwell_dependence",
    summary="break-away rises with the time at rest",
    parameters=(
        EffectParameter("ratio", 0.0, 0.1, "rise after a long rest over the level", lower=-0.95),
        shape("time_constant_s", 1.0, 0.3, "time to 63 % of the rise", 1e-3),
        shape("length_m", 1e-4, 1e-5, "way that renews the contact", 1e-8, main=False, least=_shortest_way),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "rests from a tenth to several times the time constant, each followed by a slow break-away",
        (Need("standstill_s", 1.0, times="time_constant_s"), Need("standstill_ratio", 3.0)),
    ),
    confused_with={
        "stribeck": "break away after rests of different length, at the same speed",
        "friction_drift": "rests of different length in the middle of the log",
        "frictional_lag": "break away after rests of different length",
    },
    moves=("rests",),
    simpler=Simpler(reached=_is_speed_alone),
    possible=_rises,
    # The level's rise dies away within the way over which the elements come up to it: nothing short of the model itself
    # says what is left.
    search=Derivative("ratio", _trials, tests=6.0, costly=True),
    stage="level",
    states=("age",),
)
