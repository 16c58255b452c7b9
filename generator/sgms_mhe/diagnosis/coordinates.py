"""Coordinates a learned residual may depend on, and cubic B-splines over them that end in zero."""

import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.signal import lfilter

from sgms_mhe.support.arrays import Array

Kind = Literal["place", "speed", "late speed", "travel"]

LENGTHS: Final = (0.1, 0.01)
"""Lengths over which friction may remember a reversal [travel of the record]."""
LAGS: Final = (0.3, 0.1, 0.03, 0.01)
"""Times by which it may follow speed late [time of that travel at the record's typical speed]."""
MOVING: Final = 0.03
"""Speed from which an axis moves, for its typical one, and about which a late speed is finest [largest speed]."""
DEGREE: Final = 3


class Warp(NamedTuple):
    """Transformation of a motion to values of a coordinate.

    Attributes:
        kind: place [m]; speed [m/s] with its sign, as v / (|v| + scale); late speed, the same of w that follows v with
            dw/dt = (v - w) / lag; travel since a reversal as the state r of dr/ds = (sign v - r) / scale, s being the
            distance, from -1 to 1.
        scale: speed or length of the warp; 1 where there is none.
        lag: of a late speed [s]; 0 of any other.
    """

    kind: Kind
    scale: float
    lag: float = 0.0

    def along(self, position: Array, velocity: Array, step: float) -> Array:
        """Return the warped coordinate (m) along a motion (m) with rows of `step` [s]."""
        if self.kind == "place":
            return position
        if self.kind == "travel":
            return memory_of_reversals(velocity * step, self.scale)
        speed = follow_late(velocity, step, self.lag) if self.lag else velocity
        return speed / (np.abs(speed) + self.scale)

    def unwarp(self, warped: Array) -> Array:
        """Values of the coordinate in its unit; of travel the state itself."""
        is_speed = self.kind in ("speed", "late speed")
        return warped * self.scale / (1.0 - np.abs(warped)) if is_speed else warped


@dataclass(frozen=True)
class Coordinate:
    """A coordinate of a learned residual, warped so that its grid is even.

    Attributes:
        warp: of the motion.
        low, high: of the warped data.
        cells: of the grid between them.
    """

    warp: Warp
    low: float
    high: float
    cells: int

    @property
    def kind(self) -> Kind:
        """Kind of its warp."""
        return self.warp.kind

    @property
    def size(self) -> int:
        """Number of splines that are not zero between `low` and `high`."""
        return self.cells + DEGREE

    def splines(self, warped: Array) -> Array:
        """All splines at warped values (m): (m, size). Beyond the grid they fall to zero within four cells."""
        place = (warped - self.low) * (self.cells / (self.high - self.low))
        # Spline k covers the cells k - 3 to k.
        return cubic(place[:, None] - (np.arange(self.size) - DEGREE))


def cubic(u: Array) -> Array:
    """Return the cubic B-spline on the knots 0, 1, 2, 3, 4 at u; zero elsewhere."""
    # (2 - |u - 2|)^3 / 6 with the middle's hump taken off: one formula for its four parts.
    outer = np.maximum(0.0, 2.0 - np.abs(u - 2.0))
    inner = np.maximum(0.0, 1.0 - np.abs(u - 2.0))
    return np.asarray((outer**3 - 4.0 * inner**3) / 6.0)


def memory_of_reversals(moved: Array, length: float) -> Array:
    """Return the state r (m) of dr/ds = (sign v - r) / length behind moves (m) [m], 0 before the first.

    It is 1 - 2 exp(-s / length) a distance s after a reversal to positive velocity that followed a long stroke.
    """
    directions, kept = np.sign(moved).tolist(), np.exp(-np.abs(moved) / length).tolist()
    state, r = np.empty(len(moved)), 0.0
    for k, (direction, share) in enumerate(zip(directions, kept, strict=True)):
        r = direction + (r - direction) * share
        state[k] = r
    return state


def follow_late(velocity: Array, step: float, lag: float) -> Array:
    """Return the speed w (m) of dw/dt = (v - w) / lag, 0 before the first row; v (m) is held over a `step` [s]."""
    kept = math.exp(-step / lag)
    return np.asarray(lfilter([1.0 - kept], [1.0, -kept], velocity))


def warp_motion(position: Array, velocity: Array, step: float) -> dict[Warp, Array]:
    """Return the warped coordinates of a motion (m) with rows of `step` [s], where they change.

    No time: a force that wanders is a curve over it, which predicts the blocks between those that it was learned from
    and nothing after the record. No acceleration: an encoder's noise is one, and is read into the friction as well.
    """
    speed, travel = np.abs(velocity), float(np.ptp(position))
    moving = speed[speed > MOVING * float(speed.max(initial=0.0))]
    if not len(moving) or travel == 0.0:
        return {}
    slowest, typical = MOVING * float(speed.max()), float(np.median(moving))
    lags = [share * travel / typical for share in LAGS]
    warps = [
        Warp("place", 1.0),
        Warp("speed", typical),
        *(Warp("late speed", slowest, lag) for lag in lags if lag >= step),
        *(Warp("travel", share * travel) for share in LENGTHS),
    ]
    found = {warp: warp.along(position, velocity, step) for warp in warps}
    return {warp: x for warp, x in found.items() if np.ptp(x) > 0.0}
