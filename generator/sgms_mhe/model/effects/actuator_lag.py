"""A drive whose force lags the logged one: the current loop, where the log has its command."""

import math

import numpy as np
from scipy.signal import lfilter

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, MotionRecord
from sgms_mhe.model.effects.lag import JERK, LAG_DISPLACEMENT, add_lag, no_shorter, shortest_lag, time_apart
from sgms_mhe.model.effects.search import Columns, Values
from sgms_mhe.support.arrays import Array


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    """Real force = logged force behind a first-order lag, so the log is ahead by (logged - lagged).

    Time constants below a quarter sample are lengthened to one the integrator follows, and the difference is scaled
    down instead: right to first order, and no effect at zero.
    """
    lag = no_shorter(axis, p["time_constant_s"])
    longest = math.hypot(nominal["time_constant_s"], shortest_lag(axis))
    lagged = add_lag(axis, "lagged_force", axis.force, lag, longest)
    axis.drive = axis.drive + p["time_constant_s"] / lag * (axis.force - lagged)


def _lag(motion: MotionRecord, time_constant: float) -> Array:
    """The logged force behind a first-order lag (m) [N], bilinear."""
    k = 2.0 * time_constant * motion.extents.rate
    b, a = np.array([1.0, 1.0]) / (1.0 + k), np.array([1.0, (1.0 - k) / (1.0 + k)])
    return np.asarray(lfilter(b, a, motion.force - motion.force[0]) + motion.force[0])


DEFINITION = EffectDefinition(
    name="actuator_lag",
    summary="force on the mass lags the logged one",
    parameters=(time_apart("time_constant_s", 1.0, "first-order lag", upper=1.0, proportional=False),),
    contribute=_contribute,
    excitation=JERK,
    confused_with={
        "force_delay": "force with frequencies beyond 1 / (4 time constants): a lag loses amplitude, a delay does not",
        "mass_mismatch": "moves of constant acceleration: a lag is over after a few time constants",
        "structural_resonance": "wide-band force, such as noise on the command: a resonance has a peak",
    },
    moves=("jerks",),
    inertial=True,
    # One makes the log late, the other the force.
    excludes=("force_delay",),
    search=Columns(
        lambda m, p: ((m.force - _lag(m, p["time_constant_s"])) / p["time_constant_s"])[:, None],
        lambda _, size: {"time_constant_s": float(size[0])},
        lambda m: [{"time_constant_s": x / m.extents.rate} for x in (0.1, 1.0, 3.0, 10.0, 30.0)],
        tests=2.0,
        own_size="time_constant_s",
    ),
    full_rate=True,
    fit_displacement=LAG_DISPLACEMENT,
    stage="actuator",
    states=("lagged_force",),
)
