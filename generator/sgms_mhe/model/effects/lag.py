"""Lags of first order, and common parts of time shifts between force and position."""

import math
from typing import Final

import casadi as ca

from sgms_mhe.model.axis import AxisState, Expressions, SymbolicAxis
from sgms_mhe.model.effects.excitation import Excitation, Need
from sgms_mhe.model.effects.motion import Extents
from sgms_mhe.model.effects.parameters import EffectParameter, step_by_factor
from sgms_mhe.model.effects.search import Values
from sgms_mhe.model.effects.states import EffectState, add_effect_state

LAG_DISPLACEMENT: Final = 0.2
"""`fit_displacement` of delays and lags: the states behind them are the derivatives of the force."""
_LONGEST_LAG = 0.05  # s; a current loop that is later does not hold an axis
_LAG_PER_SUBSTEP = 0.2
"""A lag decays by exp(-0.5) in a substep of rk4: it is linear, so the error is 3e-4 of what is left of a transient."""
_SHORTEST_LAG = 0.25  # of a sample

JERK: Final = Excitation(
    "jerk: short acceleration times, many of them", (Need("inertial_ratio", 1.0), Need("reversals", 2.0))
)
"""What shows that force and position are apart."""

FILM_LAG: Final = EffectParameter(
    "time_constant_s", 0.0, 0.005, "first-order lag", lower=0.0, upper=100.0, proportional=False, step=step_by_factor
)
"""How late friction follows speed [s]: a film of lubricant builds up in time."""


def longest_lag(_: Extents) -> float:
    """Return the longest delay or lag of the force to search for [s]."""
    return _LONGEST_LAG


def longest_lead(_: Extents) -> float:
    """The same where the logged force is early, below zero [s]."""
    return -_LONGEST_LAG


def time_apart(
    name: str, scale: float, description: str, *, upper: float, signed: bool = False, proportional: bool = True
) -> EffectParameter:
    """A time [s] that force and position are apart, none by default; `scale` counts samples."""
    return EffectParameter(
        name,
        0.0,
        scale,
        description,
        lower=-upper if signed else 0.0,
        upper=upper,
        unit="step",
        proportional=proportional,
        timing=True,
        step=step_by_factor,
        least=longest_lead if signed else None,
        most=longest_lag,
    )


def add_lag(axis: SymbolicAxis, name: str, signal: ca.SX, time_constant: ca.SX | float, nominal: float) -> ca.SX:
    """A first-order lag of a signal, in a state of its own that counts in f_C; returns the lagged signal [N].

    The integrator holds the signal's value at the end of a step of length h all through it. At the steps' ends the
    rate ln(1 + h/T)/h then gives x1 = (T x0 + h u1) / (T + h): its ramp response lags by exactly T, for any T >= 0.
    """
    h = axis.step

    def rate(t: ca.SX | float) -> ca.SX:
        return ca.log(1.0 + h / ca.SX(t)) / h

    state = add_effect_state(
        axis, EffectState(name, rate_per_second=_LAG_PER_SUBSTEP * float(ca.evalf(rate(nominal))), initial_state=1.0)
    )
    state.rate = rate(time_constant) * (signal / axis.coulomb - state.chi)
    return state.chi * axis.coulomb


def shortest_lag(axis: SymbolicAxis) -> float:
    """The shortest time constant [s] integrated as it is."""
    return _SHORTEST_LAG * axis.step


def no_shorter(axis: SymbolicAxis, time_constant: ca.SX) -> ca.SX:
    """A time constant as it is, but never shorter than the integrator can follow: a smooth maximum."""
    return ca.sqrt(time_constant * time_constant + shortest_lag(axis) ** 2)


def add_film(axis: SymbolicAxis, name: str, p: Expressions, nominal: Values) -> tuple[AxisState, ca.SX]:
    """Declare the state of a film with the parameter `FILM_LAG`; returns it and its lag [s] that steps can follow."""
    lag = no_shorter(axis, p[FILM_LAG.name])
    shortest = math.hypot(nominal[FILM_LAG.name], shortest_lag(axis))
    state = EffectState(name, rate_per_second=1.0 / shortest, noise=1e-4, initial_state=0.03)
    return add_effect_state(axis, state), lag
