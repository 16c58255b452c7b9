"""A logged force that is later than the motion: sampling order, bus cycles, filters of the current."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.definition import EffectDefinition
from sgms_mhe.model.effects.lag import JERK, LAG_DISPLACEMENT, add_lag, shortest_lag, time_apart
from sgms_mhe.model.effects.search import Columns, one_size
from sgms_mhe.model.effects.specimen import one_number


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], nominal: Mapping[str, float]) -> None:
    """u(t - d) = u - d du/dt, exact to first order in d for any sign of d.

    Of du/dt, everything but the jerk is known: states have their rates, the signals q, v, t their derivatives. The
    jerk is (a - a_lagged) / T; T = (d - h) / 2 makes the inertial part exact to second order (h / 2: the lag's
    own sampling).
    """
    d, late = p["delay_s"], nominal["delay_s"]
    lag = max(0.5 * (late - axis.hold), shortest_lag(axis))
    w = ca.vertsplit(axis.measured)
    inertial = axis.mass * w[2]
    jerk_force = (inertial - add_lag(axis, "inertial_force", inertial, lag, lag)) / lag
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
    summary="logged force is later than the motion",
    parameters=(time_apart("delay_s", 0.5, "how late the force is", upper=0.1),),
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
    # One makes the log late, the other the force.
    excludes=("actuator_lag",),
    search=Columns(lambda m, _: -np.gradient(m.force)[:, None] * m.extents.rate, one_size("delay_s")),
    full_rate=True,
    delays="delay_s",
    fit_displacement=LAG_DISPLACEMENT,
    stage="log",
    states=("inertial_force",),
    specimen=one_number("delay_s", lambda scene: scene.scales.step, signed=False),
)
