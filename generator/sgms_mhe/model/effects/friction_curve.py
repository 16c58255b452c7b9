"""Friction over speed of any shape: laws with a root, a logarithm or an exponent of speed, films, seals.

Beyond the level, damping and the Stribeck effect of an axis there is a force over speed of any shape, in either
direction, between rest and a speed at which it is none again. A constant is the level and a line over speed is damping,
so that no sum of the curve's numbers is one of theirs; and as it is none at rest, it does not jump where motion turns.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final, TypeVar

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, MotionRecord, Need, Simpler
from sgms_mhe.model.effects.definition import Fault, Value
from sgms_mhe.model.effects.motion import direction, shift_to_sample
from sgms_mhe.model.effects.parameters import decided
from sgms_mhe.model.effects.scales import Scales
from sgms_mhe.model.effects.search import CurveColumns, Values
from sgms_mhe.support.arrays import Array

Number = TypeVar("Number", ca.SX, Array)
KNOTS: Final = 8
"""Knots that a search places at most, each at half the speed of the next."""
SPARSE: Final = (4, 2, 1)
"""Of them every so many are tried, few first."""
SLOW_ROWS: Final = 0.05
"""Share of the rows of a direction that are slower than the slowest knot, at least."""
LEAST: Final = 1e-9  # m/s: a knot is no rest

_SPEED: Final = decided("speed_m_s", 0.01, 0.01, "speed at which the curve bends", LEAST, role="place", array=True)
_FORWARD: Final = EffectParameter("forward_N", 0.0, 0.1, "friction added there, v > 0", unit="coulomb", array=True)
_BACKWARD: Final = EffectParameter("backward_N", 0.0, 0.1, "friction added there, v < 0", unit="coulomb", array=True)
_END: Final = decided("end_m_s", 1.0, 0.01, "speed from which on nothing is added", LEAST, role="place")


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    """sign(v) c(|v|), c smooth from 0 at rest through its knots to 0 at `end`, and 0 beyond.

    Written as a sum over the pieces, each a cubic in the part of |v| that lies within it: no piece has to be looked up,
    and at a knot both sides agree. A curve may be steep, so that v is that at the sample's own time. Of
    c = even + odd sign(v) the one part is alike in both directions.
    """
    count = (len(p) - 1) // 3
    knots = [(_SPEED.entry(i), _FORWARD.entry(i), _BACKWARD.entry(i)) for i in range(1, count + 1)]
    speeds = [ca.SX(0.0), *(p[name] for name, _, _ in knots), p[_END.name]]
    even = _cubics(speeds, [ca.SX(0.0), *(0.5 * (p[a] + p[b]) for _, a, b in knots), ca.SX(0.0)])
    odd = _cubics(speeds, [ca.SX(0.0), *(0.5 * (p[a] - p[b]) for _, a, b in knots), ca.SX(0.0)])
    velocity = shift_to_sample(axis.velocity, axis.acceleration, axis.step)
    speed, alike, unlike = ca.fabs(velocity), ca.SX(0.0), ca.SX(0.0)
    for i in range(count + 1):
        width = speeds[i + 1] - speeds[i]
        t = ca.fmin(ca.fmax(speed - speeds[i], 0.0), width) / width
        alike = alike + t * (even[i][0] + t * (even[i][1] + t * even[i][2]))
        unlike = unlike + t * (odd[i][0] + t * (odd[i][1] + t * odd[i][2]))
    axis.add_force(ca.sign(velocity) * alike + unlike)


def _cubics(speeds: Sequence[ca.SX], values: Sequence[ca.SX]) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
    """Coefficients of t, t^2, t^3 of each piece: t runs from 0 to 1, the piece from its own value on."""
    widths = [b - a for a, b in pairwise(speeds)]
    rises = [b - a for a, b in pairwise(values)]
    slopes = _slopes(widths, [rise / width for rise, width in zip(rises, widths, strict=True)])
    return [
        (w * a, 3.0 * rise - w * (2.0 * a + b), w * (a + b) - 2.0 * rise)
        for w, rise, (a, b) in zip(widths, rises, pairwise(slopes), strict=True)
    ]


def _slopes(widths: Sequence[Number], secants: Sequence[Number]) -> list[Number]:
    """Slopes at the knots and ends, each of the parabola through three of them: linear in the values."""
    found: list[Number] = [
        (a * w2 + b * w1) / (w1 + w2) for (w1, w2), (a, b) in zip(pairwise(widths), pairwise(secants), strict=True)
    ]
    first, last = 2.0 * secants[0] - found[0], 2.0 * secants[-1] - found[-1]
    found.insert(0, first)
    found.append(last)
    return found


def _halve_speeds(m: MotionRecord) -> Sequence[Values]:
    """Speeds that halve from the fastest that both directions have down to the slow rows of either: few, then more."""
    sides = [side for side in (m.velocity[m.velocity > LEAST], -m.velocity[m.velocity < -LEAST]) if len(side)]
    if len(sides) < 2:
        return ()
    end = min(float(side.max()) for side in sides)
    slow = max(float(np.quantile(side, SLOW_ROWS)) for side in sides)
    found: list[Values] = []
    for every in SPARSE:
        speeds = [speed for speed in (end * 0.5**k for k in range(KNOTS, 0, -every)) if speed > slow]
        named = {_SPEED.entry(i): speed for i, speed in enumerate(speeds, start=1)}
        if speeds and (not found or len(named) + 1 > len(found[-1])):
            found.append(named | {_END.name: end})
    return found


def _columns(m: MotionRecord, given: Values) -> Array:
    """Force per unit of every knot's, forward then backward (m, 2 knots)."""
    ends = np.array([0.0, *(given[_SPEED.entry(i)] for i in range(1, len(given))), given[_END.name]])
    values = np.eye(len(ends))[:, 1:-1]
    widths = np.diff(ends)[:, None]
    slopes = np.stack(_slopes([*widths], [*(np.diff(values, axis=0) / widths)]))
    curve = CubicHermiteSpline(ends, values, slopes)
    speed = np.abs(m.velocity)
    force = np.where((speed < ends[-1])[:, None], curve(np.minimum(speed, ends[-1])), 0.0)
    way = direction(m.velocity)[:, None]
    return np.hstack((force * (way > 0.0), -force * (way < 0.0)))


def _parameters(given: Values, sizes: Array) -> Values:
    count = len(given) - 1
    found = dict(given)
    for i in range(1, count + 1):
        found[_FORWARD.entry(i)] = float(sizes[i - 1])
        found[_BACKWARD.entry(i)] = float(sizes[count + i - 1])
    return found


def _find_fault(values: Mapping[str, Value]) -> Fault | None:
    """Knots that do not ascend to the curve's end."""
    speeds, end = values[_SPEED.name], values[_END.name]
    if isinstance(speeds, tuple) and isinstance(end, float) and all(a < b for a, b in pairwise((*speeds, end))):
        return None
    return Fault(_SPEED.name, f"numbers that ascend, all below {end:g}, the curve's end")


def _is_friction(p: Values, scales: Scales) -> bool:
    """Return True if the curve takes no more than the level away: a curve that takes more would drive the axis."""
    return all(value > -scales.coulomb for name, value in p.items() if _FORWARD.holds(name) or _BACKWARD.holds(name))


DEFINITION = EffectDefinition(
    name="friction_curve",
    summary="friction over speed, of any shape, in either direction",
    parameters=(_SPEED, _FORWARD, _BACKWARD, _END),
    contribute=_contribute,
    excitation=Excitation(
        "constant speeds in both directions, five or more from slow to the fastest",
        (Need("speed_ratio", 3.0), Need("both_directions", 0.1), Need("moving_s", 0.5)),
    ),
    confused_with={
        "viscous": "three constant speeds or more: is the force over speed a line",
        "stribeck": "speeds below the Stribeck velocity",
        "quadratic_drag": "five constant speeds or more: is the force over speed a parabola",
        "eddy_current_damping": "five constant speeds or more, up to the fastest",
    },
    moves=("speeds",),
    simpler=Simpler(
        (
            "coulomb",
            "viscous",
            "stribeck",
            "quadratic_drag",
            "eddy_current_damping",
            "asymmetric_coulomb",
            "asymmetric_viscous",
        )
    ),
    search=CurveColumns(_columns, _parameters, _halve_speeds),
    excludes=("quadratic_drag", "eddy_current_damping"),
    linear=True,
    possible=_is_friction,
    fault=_find_fault,
)
