"""Motion of a record for searches and fits: its extents, and the signals of an effect's force."""

from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np

from sgms_mhe.support.arrays import Array

Signal = TypeVar("Signal", ca.SX, Array)

PERIODS_TOLD = 1.5
"""Periods that a record must cover for a sine to be told from a slope."""
SHORTEST_TRAVEL = 1e-9  # m; keeps quotients finite where nothing moved
_REST = 1e-9  # m/s; slower is rest


@dataclass(frozen=True)
class Extents:
    """How far a record reaches.

    Attributes:
        travel: range of position on rows that count [m].
        speed: largest speed on rows that count [m/s].
        duration: from the first row to the last [s].
        end: time of the last row since the log's start [s]; drifts count from that start.
        rate: rows per second [Hz].
    """

    travel: float
    speed: float
    duration: float
    end: float
    rate: float

    @property
    def longest_pitch(self) -> float:
        """The longest period in position [m] that can be told from a slope."""
        return max(SHORTEST_TRAVEL, self.travel / PERIODS_TOLD)

    @property
    def lowest_frequency(self) -> float:
        """The lowest frequency [Hz] that can be told from a drift."""
        return PERIODS_TOLD / self.duration


@dataclass(frozen=True)
class MotionRecord:
    """Signals along a record and the model's friction there, all (m,).

    Attributes:
        time, position, velocity, acceleration, force: SI.
        friction: of the model [N].
        level: f_C d(friction)/d(f_C) [N], change of friction when its level changes by 100 %.
        damping: sigma_v [N s/m] (a typical value where the machine has none).
        mass: of the machine file [kg].
        deflection: of the element that breaks away last [m].
        extents: of the record.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    force: Array
    friction: Array
    level: Array
    damping: float
    mass: float
    deflection: float
    extents: Extents


def direction(velocity: Array) -> Array:
    """-1, 0 or 1: where an axis goes; 0 at rest."""
    return np.asarray(np.sign(np.where(np.abs(velocity) > _REST, velocity, 0.0)))


def shift_to_sample(velocity: Signal, acceleration: Signal, step: float) -> Signal:
    """Return the velocity at a sample's own time: a chain's is a mean over the sample before, half a sample older."""
    return velocity + 0.5 * step * acceleration
