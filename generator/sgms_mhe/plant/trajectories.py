"""Reference trajectories: smooth position series for simulated axes, by name.

A move is a velocity pulse smoothed by two running means, of the acceleration time and of the jerk time. That is the
classical seven-segment profile with piecewise constant jerk, exact in distance on the sample grid.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError


def _each(function: Callable[[float], float], angles: Array) -> Array:
    """Return a function of the C library at angles (n), alike on every processor; numpy's hang on its vectors.

    In a closed loop with an encoder's steps a last digit grows to another course of the noise.
    """
    return np.array([function(angle) for angle in angles.tolist()])


@dataclass(frozen=True)
class Trajectory:
    """A reference for the position controller.

    Attributes:
        name: as in the registry.
        rate: samples per second [Hz].
        position_m: reference position (n) [m].
    """

    name: str
    rate: float
    position_m: Array

    @property
    def duration_s(self) -> float:
        """Time covered [s]."""
        return len(self.position_m) / self.rate

    @property
    def time_s(self) -> Array:
        """Time of the samples (n) [s], from 0."""
        return np.arange(len(self.position_m)) / self.rate

    @property
    def velocity_m_s(self) -> Array:
        """Velocity over the sample that leads to each position (n) [m/s]; 0 at the first."""
        return np.diff(self.position_m, prepend=self.position_m[:1]) * self.rate

    @property
    def acceleration_m_s2(self) -> Array:
        """Central second difference (n) [m/s^2]; at rest before the first and after the last position."""
        return np.diff(self.position_m, n=2, prepend=self.position_m[:1], append=self.position_m[-1:]) * self.rate**2

    def repeat(self, duration_s: float) -> "Trajectory":
        """The trajectory repeated from its end on, cut to `duration_s`; periodic where it ends at its start."""
        n = max(1, round(duration_s * self.rate))
        period = len(self.position_m)
        advance = self.position_m[-1] - self.position_m[0]
        laps = -(-n // period)
        position = self.position_m[:n] if laps == 1 else np.tile(self.position_m, laps)[:n]
        if laps > 1 and advance != 0.0:
            position = position + advance * (np.arange(n) // period)
        return Trajectory(self.name, self.rate, position)


MOST_SAMPLES: Final = 50_000_000
"""Of a trajectory: an hour and a half at 10 kHz, a log of some two gigabytes in memory."""


class Motion:
    """A position series under construction: moves, waits and waves one after the other, all at rest at both ends."""

    def __init__(self, rate: float, start_m: float = 0.0) -> None:
        self.rate = rate
        self.position = start_m
        self._parts: list[Array] = [np.array([start_m])]

    def move_to(self, target_m: float, velocity: float, acceleration: float, jerk: float) -> None:
        """Go to a position within limits [m/s, m/s^2, m/s^3]; a short way does not reach them all."""
        distance = target_m - self.position
        if distance == 0.0:
            return
        pulse, rise, smooth = (
            max(1, math.ceil(t * self.rate)) for t in _move_times(abs(distance), velocity, acceleration, jerk)
        )
        pulse = max(pulse, rise + smooth)  # rounded times must not let segments of jerk overlap
        steps = np.full(pulse, distance / pulse)
        for width in (rise, smooth):
            # By sums in turn: a convolution's hang on the processor, as numpy's sines do.
            sums = np.cumsum(np.pad(steps, (width, width - 1)))
            steps = (sums[width:] - sums[:-width]) / width
        way = np.cumsum(steps)
        # The sum's rounding is spread over the way: a jump at its end would be a kick, and would pile up over moves.
        self._parts.append(self.position + way * (distance / way[-1]))
        self._parts[-1][-1] = self.position = target_m

    def move_by(self, distance_m: float, velocity: float, acceleration: float, jerk: float) -> None:
        """Go on by a distance; see `move_to`."""
        self.move_to(self.position + distance_m, velocity, acceleration, jerk)

    def wait(self, seconds: float) -> None:
        """Stand still."""
        self._parts.append(np.full(round(seconds * self.rate), self.position))

    def swing(self, amplitude_m: float, frequency_Hz: float, cycles: int = 1) -> None:
        """Sine about the position; its amplitude grows over the first half cycle and decays over half an added one."""
        n = max(4, round((cycles + 1) * self.rate / frequency_Hz))
        t = np.arange(1, n + 1) / n * (cycles + 1)
        fade = np.minimum(1.0, np.minimum(2.0 * t, 2.0 * (cycles + 1 - t)))
        smooth = fade * fade * fade * (10.0 - 15.0 * fade + 6.0 * fade * fade)
        self._parts.append(self.position + amplitude_m * smooth * _each(math.sin, 2.0 * np.pi * t))
        self._parts[-1][-1] = self.position

    def loops(self, amplitudes_m: tuple[float, ...], velocity: float, acceleration: float, jerk: float) -> None:
        """Reversals nested into each other about the position: to +a1, -a1, +a2, ... and back."""
        centre = self.position
        for amplitude in amplitudes_m:
            self.move_to(centre + amplitude, velocity, acceleration, jerk)
            self.move_to(centre - amplitude, velocity, acceleration, jerk)
        self.move_to(centre, velocity, acceleration, jerk)

    @property
    def duration_s(self) -> float:
        """Time of the trajectory so far."""
        return sum(map(len, self._parts)) / self.rate

    def trajectory(self, name: str) -> Trajectory:
        """Return the trajectory that has been put together so far."""
        return Trajectory(name, self.rate, np.concatenate(self._parts))


def _move_times(distance: float, velocity: float, acceleration: float, jerk: float) -> tuple[float, float, float]:
    """Widths of pulse and running means [s] that cover a distance within the limits."""
    smooth = acceleration / jerk
    rise = velocity / acceleration
    if rise < smooth:
        # The limit of acceleration is not reached before that of velocity.
        rise = smooth = math.sqrt(velocity / jerk)
    pulse = distance / velocity
    if pulse < rise + smooth:
        # No constant velocity: the shortest profile has pulse = rise + smooth with distance = jerk pulse rise smooth
        # where acceleration is reached, pulse = 2 rise = 2 smooth where it is not.
        cube = (distance / (2.0 * jerk)) ** (1.0 / 3.0)
        if cube <= acceleration / jerk:
            return 2.0 * cube, cube, cube
        smooth = acceleration / jerk
        rise = 0.5 * (-smooth + math.sqrt(smooth**2 + 4.0 * distance / acceleration))
        pulse = rise + smooth
    return pulse, rise, smooth


# Limits [m/s, m/s^2, m/s^3] of moves.
CREEP: Final = (0.2e-3, 0.02, 2.0)
SLOW: Final = (2e-3, 0.1, 5.0)
QUICK: Final = (0.3, 3.0, 100.0)
FAST: Final = (1.0, 10.0, 400.0)


def paper(rate: float) -> Trajectory:
    """Presliding to sliding with many reversals at up to 2 mm/s.

    Loops of a few micrometres nested into loops of 100 um, strokes of sliding with reversals between, standstill: every
    element of the table I parameters sticks and slips.
    """
    path = Motion(rate)
    path.wait(0.3)
    path.loops((3e-6, 2e-6, 1e-6), *CREEP)
    path.wait(0.2)
    for stroke in (1.5e-3, -1.0e-3, 2.0e-3):
        path.move_by(stroke, *SLOW)
        path.loops((8e-6, 4e-6, 2e-6), *CREEP)
        path.loops((100e-6, 60e-6, 30e-6, 12e-6), *SLOW)
    path.loops((400e-6, 200e-6, 100e-6, 50e-6, 25e-6), *SLOW)
    path.wait(0.3)
    for _ in range(3):
        path.move_by(1.2e-3, *SLOW)
        path.move_by(-0.4e-3, *SLOW)
    path.loops((30e-6, 20e-6, 10e-6, 5e-6), *CREEP)
    for amplitude, frequency in ((20e-6, 10.0), (60e-6, 5.0), (5e-6, 4.0)):
        path.swing(amplitude, frequency, cycles=4)
    path.move_to(-2e-3, *SLOW)
    path.loops((150e-6, 40e-6), *SLOW)
    path.move_to(0.0, *SLOW)
    path.wait(0.3)
    return path.trajectory("paper")


def mixed(rate: float, max_velocity: float = 1.0) -> Trajectory:
    """Presliding loops between moves at 2 mm/s, 0.3 m/s and `max_velocity`, and standstill."""
    quick, fast = _limit(QUICK, max_velocity), _limit(FAST, max_velocity)
    path = Motion(rate)
    path.wait(0.2)
    path.loops((5e-6, 3e-6, 1e-6), *CREEP)
    path.move_to(0.10, *quick)
    path.wait(0.1)
    path.loops((100e-6, 40e-6, 15e-6), *SLOW)
    path.move_to(0.35, *fast)
    path.wait(0.15)
    path.swing(10e-6, 8.0, cycles=3)
    path.move_to(0.352, *SLOW)
    path.move_to(-0.05, *fast)
    path.wait(0.1)
    path.move_to(-0.12, *quick)
    path.loops((300e-6, 80e-6, 20e-6, 6e-6), *SLOW)
    path.move_to(0.02, *quick)
    path.move_to(-0.01, *quick)
    path.move_to(0.25, *fast)
    path.move_to(0.0, *fast)
    path.wait(0.2)
    path.loops((60e-6, 25e-6, 10e-6), *SLOW)
    path.wait(0.3)
    return path.trajectory("mixed")


def long_mixed(rate: float, max_velocity: float = 1.0) -> Trajectory:
    """One period of a long run: the paper's motion and the mixed one, back at the start."""
    first, second = paper(rate).position_m, mixed(rate, max_velocity).position_m
    return Trajectory("long_mixed", rate, np.concatenate((first, second)))


def trapezoids(rate: float, max_velocity: float = 1.0) -> Trajectory:
    """There and back at rising velocities up to `max_velocity`, each long enough to reach it."""
    path = Motion(rate)
    path.wait(0.1)
    for share in (0.02, 0.1, 0.3, 1.0):
        velocity = share * max_velocity
        limits = (velocity, 10.0 * max_velocity, 400.0 * max_velocity)
        distance = velocity * (0.1 + 2.0 * (0.1 * share + 0.025))
        path.move_to(distance, *limits)
        path.wait(0.1)
        path.move_to(0.0, *limits)
        path.wait(0.1)
    return path.trajectory("trapezoids")


def step_and_settle(rate: float, max_velocity: float = 1.0) -> Trajectory:
    """Steps from die to die: 8 mm moves with a wait for the position to settle, one row forth and back."""
    path = Motion(rate)
    path.wait(0.1)
    for step in 6 * (8e-3,) + 6 * (-8e-3,):
        path.move_by(step, *_limit(QUICK, max_velocity))
        path.wait(0.1)
    return path.trajectory("step_and_settle")


def circle(rate: float, radius_m: float = 5e-3, velocity: float = 0.02, laps: int = 2) -> tuple[Trajectory, Trajectory]:
    """Two axes on a circle through the origin at a path velocity, with a smooth start and stop."""
    path = Motion(rate)
    path.wait(0.1)
    path.move_to(2.0 * np.pi * radius_m * laps, velocity, 10.0 * velocity, 400.0 * velocity)
    path.wait(0.1)
    angle = path.trajectory("angle").position_m / radius_m
    return (
        Trajectory("circle_x", rate, radius_m * _each(math.sin, angle)),
        Trajectory("circle_y", rate, radius_m * (1.0 - _each(math.cos, angle))),
    )


def hysteresis(rate: float, amplitude_m: float = 1e-6, frequency_Hz: float = 1.0) -> Trajectory:
    """Loops nested into each other over +-`amplitude_m`, as in the paper's figure 3, at one velocity throughout."""
    velocity = 4.0 * amplitude_m * frequency_Hz
    limits = (velocity, 40.0 * velocity * frequency_Hz, 4000.0 * velocity * frequency_Hz**2)
    path = Motion(rate)
    for outer, inner in ((1.0, 0.0), (-1.0, 0.4), (0.6, -0.2), (0.2, -0.6), (-0.4, 1.0), (-1.0, 1.0), (-1.0, 0.0)):
        path.move_to(outer * amplitude_m, *limits)
        path.move_to(inner * amplitude_m, *limits)
    return path.trajectory("hysteresis")


def _limit(limits: tuple[float, float, float], max_velocity: float) -> tuple[float, float, float]:
    """Limits of a move on an axis that is slower than they are: all scaled down, the shape kept."""
    share = min(1.0, max_velocity / limits[0])
    return limits[0] * share, limits[1] * share, limits[2] * share


TRAJECTORIES: Final[Mapping[str, Callable[[float, float], Trajectory]]] = MappingProxyType(
    {
        "paper": lambda rate, max_velocity: paper(rate),
        "mixed": mixed,
        "long_mixed": long_mixed,
        "trapezoids": trapezoids,
        "step_and_settle": step_and_settle,
        "circle_x": lambda rate, max_velocity: circle(rate)[0],
        "circle_y": lambda rate, max_velocity: circle(rate)[1],
        "hysteresis": lambda rate, max_velocity: hysteresis(rate),
    }
)
"""Trajectories by name: (rate, max_velocity) -> Trajectory."""


def make_trajectory(
    name: str, rate: float, *, duration_s: float | None = None, max_velocity: float = 1.0
) -> Trajectory:
    """The named trajectory at a sample rate [Hz], repeated or cut to `duration_s` where that is given.

    Raises:
        InputError: no trajectory of that name, or a number that cannot be meant.
    """
    if name not in TRAJECTORIES:
        raise InputError("trajectory", "name", name, f"one of {', '.join(TRAJECTORIES)}, or a CSV file")
    for where, value in (("rate", rate), ("max_velocity", max_velocity)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError("trajectory", where, value, "a positive number")
    return lasting(TRAJECTORIES[name](rate, max_velocity), duration_s)


def lasting(trajectory: Trajectory, duration_s: float | None) -> Trajectory:
    """The trajectory repeated or cut to a duration; as it is where none is given.

    Raises:
        InputError: a duration that cannot be meant.
    """
    if duration_s is None:
        return trajectory
    rate = trajectory.rate
    if not (math.isfinite(duration_s) and duration_s > 0.0):
        raise InputError("trajectory", "duration", duration_s, "a positive number")
    if duration_s * rate > MOST_SAMPLES:
        raise InputError("trajectory", "duration", duration_s, f"at most {MOST_SAMPLES / rate:g} s at {rate:g} Hz")
    return trajectory.repeat(duration_s)
