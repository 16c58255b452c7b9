"""A drive whose force lags the logged one: the current loop, where the log has its command."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import (
    EffectDefinition,
    EffectParameter,
    Search,
    Start,
    add_lag,
    no_shorter,
    shortest_lag,
)
from sgms_mhe.model.effects.excitation import Excitation, Need


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], nominal: Mapping[str, float]) -> None:
    """Real force = logged force behind a first-order lag, so the log is ahead by (logged - lagged).

    Time constants below a quarter sample are lengthened to what the integrator follows, and the difference is scaled
    down instead: right to first order, and no effect at zero.
    """
    lag = no_shorter(axis, p["time_constant_s"])
    longest = math.hypot(nominal["time_constant_s"], shortest_lag(axis))
    lagged = add_lag(axis, "lagged_force", axis.force, lag, longest)
    axis.drive = axis.drive + p["time_constant_s"] / lag * (axis.force - lagged)


DEFINITION = EffectDefinition(
    name="actuator_lag",
    summary="force on the mass lags the logged one",
    parameters=(EffectParameter("time_constant_s", 0.0, 1.0, "first-order lag", lower=0.0, upper=1.0, unit="sample"),),
    contribute=_contribute,
    excitation=Excitation(
        "jerk: short acceleration times, many of them", (Need("inertial_ratio", 1.0), Need("reversals", 2.0))
    ),
    confused_with={
        "force_delay": "force with frequencies beyond 1 / (4 time constants): a lag loses amplitude, a delay does not",
        "mass_mismatch": "moves of constant acceleration: a lag is over after a few time constants",
        "structural_resonance": "wide-band force, such as noise on the command: a resonance has a peak",
    },
    start=Start(
        values={"time_constant_s": 2.0},
        searches=(Search("time_constant_s", low=0.5, high=30.0, low_of="sample", high_of="sample", points=6),),
    ),
    stage="actuator",
    states=("lagged_force",),
)
