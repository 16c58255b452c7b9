"""A logged force that is later than the motion, or earlier.

Late by sampling order and filters of the measured current; early where the log has the command, which a bus or the
drive's own cycles bring to the motor later.
"""

import math

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition
from sgms_mhe.model.effects.lag import JERK, LAG_DISPLACEMENT, add_lag, no_shorter, shortest_lag, time_apart
from sgms_mhe.model.effects.search import Columns, Values, one_size


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    if nominal["delay_s"] < 0.0:
        _advance(axis, -p["delay_s"], -nominal["delay_s"])
    else:
        _delay(axis, p["delay_s"], nominal["delay_s"])


def _advance(axis: SymbolicAxis, early: ca.SX, nominal: float) -> None:
    """Real force = logged force, `early` seconds ago: Pade's (1 - s T) / (1 + s T) with T half of that.

    Exact to second order. The logged force is known, so the log is ahead by logged - delayed = 2 (logged - lagged).
    """
    half = 0.5 * early
    lag = no_shorter(axis, half)
    lagged = add_lag(axis, "lagged_force", axis.force, lag, math.hypot(0.5 * nominal, shortest_lag(axis)))
    axis.drive = axis.drive + 2.0 * half / lag * (axis.force - lagged)


def _delay(axis: SymbolicAxis, d: ca.SX, late: float) -> None:
    """u(t - d) = u - d du/dt, exact to first order in d for any sign of d.

    Of du/dt, everything but the jerk is known: states have their rates, the signals q, v, t their derivatives. The
    jerk is (a - a_lagged) / T; T = (d - h) / 2 makes the inertial part exact to second order (h / 2: the lag's
    own sampling).
    """
    lag = max(0.5 * (late - axis.step), shortest_lag(axis))
    w = ca.vertsplit(axis.measured)
    inertial = axis.mass * w[2]
    jerk_force = (inertial - add_lag(axis, "lagged_force", inertial, lag, lag)) / lag
    drive = axis.drive
    change = ca.gradient(drive, axis.measured)
    slope = change[0] * w[1] + change[1] * w[2] + change[4]
    slope += change[2] / axis.mass * jerk_force
    for state in axis.states[:-1]:
        if state.rate is None:
            continue
        part = ca.gradient(drive, state.chi)
        rate = state.rate
        if state.spec.element is not None:
            # An element that relaxes within the delay was at most a full turn-round away, not d times its rate.
            reach = max(abs(late), axis.step) * state.spec.rate_per_metre
            rate = rate / (1.0 + 0.5 * reach * ca.fabs(axis.velocity))
        slope += part * rate
    axis.drive = drive - d * slope


DEFINITION = EffectDefinition(
    name="force_delay",
    summary="logged force is later or earlier than the motion",
    parameters=(
        time_apart(
            "delay_s",
            0.5,
            "how late the force is; below zero: how early, as a command that is obeyed later",
            upper=0.1,
            signed=True,
        ),
    ),
    contribute=_contribute,
    excitation=JERK,
    confused_with={
        "actuator_lag": "force with frequencies up to a quarter of 1 / delay: a lag loses amplitude, a delay does not",
        "viscous": "constant speed: a delay has no effect there",
        "structural_resonance": "wide-band force, such as noise on the command: a resonance has a peak",
        "frictional_lag": "high acceleration while sliding: a delayed force is late with the inertial force too",
    },
    moves=("jerks",),
    inertial=True,
    # One may make the log late, the other makes the force.
    excludes=("actuator_lag",),
    search=Columns(lambda m, _: -np.gradient(m.force)[:, None] * m.extents.rate, one_size("delay_s")),
    full_rate=True,
    fit_displacement=LAG_DISPLACEMENT,
    stage="log",
    states=("lagged_force",),
)
