"""Motion of the self-test in whole numbers, which every processor adds up alike, and the log it makes."""

import math
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array

_STROKE_PART = 1.7
"""Duration of a stroke over that of an interval: no whole number, so that updates meet it everywhere."""
_FIRST, _LAST = 0.02, 0.8
"""Lengths of the first and of a late stroke over the softest element's deflection scale."""
_GROWING = 8
"""Strokes until they are that long."""
_STIFFER = 1.15
"""Stiffness of the axis over the machine file's: the parameters have something to follow."""
_SEGMENTS = 6
"""Of half a stroke."""
_UNIT = 1e-7
"""Force of one count over the Coulomb level's power of ten."""
_FASTEST = 0.9
"""Largest speed over `max_velocity`."""
_OFF = 10.0
"""Force of half a stroke that contradicts the model, over the noise of a measurement."""
_MISSING = 3
"""Samples of each gap."""


class Segment(NamedTuple):
    """Samples of constant acceleration.

    Attributes:
        samples: number of them.
        acceleration: [pm per sample squared].
        rise: of friction [counts of `CountedMotion.unit` per sample].
    """

    samples: int
    acceleration: int
    rise: int


@dataclass(frozen=True)
class CountedMotion:
    """Segments one after the other, and the samples of no value among them.

    Attributes:
        segments: of the motion; before it the axis stands at zero.
        unit: force of one count [N].
        gap: first sample without a position, samples without one; then as many without a force.
    """

    segments: tuple[Segment, ...]
    unit: float
    gap: tuple[int, int]

    @property
    def samples(self) -> int:
        """Samples in all, the first one at rest included."""
        return 1 + sum(segment.samples for segment in self.segments)

    def log(self, machine: Machine) -> Log:
        """Return the log: positions, and the force of inertia and friction, NaN in the gap."""
        _, acceleration, rise = np.repeat(self.segments, [segment.samples for segment in self.segments], axis=0).T
        position = np.concatenate(([0], np.cumsum(np.cumsum(acceleration))))
        friction = np.concatenate(([0], np.cumsum(rise))) * self.unit
        rate, n = machine.sampling.rate, self.samples
        # The force acts from its sample to the next one: a second difference of positions tells of the sample before.
        inertia = machine.plant.moved * np.concatenate((acceleration, [0])) * (1e-12 * rate * rate)
        position_m, force = position * 1e-12, inertia + friction
        first, count = self.gap
        position_m[first : first + count] = np.nan
        force[first + count : first + 2 * count] = np.nan
        return Log(np.arange(n) / rate, position_m, force, rate, kind=machine.plant.kind)


def selftest_motion(machine: Machine, updates: int, settle: int) -> CountedMotion:
    """Make strokes of growing length through presliding, from which the axis of a stiffer machine answers.

    They grow to 0.8 deflection scales of the softest element, no faster than the axis may be. The friction is that of
    plain Maxwell-slip elements, piecewise linear, so that the estimator has something to learn; for half a stroke it is
    off. The last interval stands, and the sample after it, with which tick() makes its update.

    Args:
        machine: the axis.
        updates: of the motion.
        settle: samples until the signal chain has settled: the gap comes later.
    """
    friction, samples = machine.friction, machine.sampling.samples_per_update
    softest = max(nu * friction.coulomb / k for nu, k in zip(friction.fraction, friction.stiffness, strict=True))
    unit = _UNIT * 10.0 ** math.floor(math.log10(friction.coulomb))
    moving = (updates - 1) * samples
    half = max(4, round(0.5 * _STROKE_PART * samples))
    fastest = _FASTEST * machine.sampling.max_velocity / machine.sampling.rate * half
    parts: list[tuple[int, int]] = []
    for stroke in range(moving // (2 * half)):
        length = min(softest * (_FIRST + (_LAST - _FIRST) * min(1.0, stroke / _GROWING) ** 2), fastest)
        acceleration = (-1 if stroke % 2 else 1) * max(1, round(1e12 * length / half**2))
        parts += [(count, sign * acceleration) for sign in (1, -1) for count in _share_samples(half)]
    parts.append((updates * samples + 1 - sum(count for count, _ in parts), 0))
    counts = np.array([count for count, _ in parts])
    velocity = np.cumsum(np.repeat([acceleration for _, acceleration in parts], counts)) * 1e-12
    ends = np.cumsum(counts) - 1
    forces = (_maxwell_slip(machine, velocity) + friction.viscous * velocity * machine.sampling.rate)[ends] / unit
    later = len(parts) * 2 // 3
    forces[later : later + _SEGMENTS] += _OFF * machine.estimator.noise.measurement / unit
    segments, reached = [], 0
    for (count, acceleration), force in zip(parts, forces, strict=True):
        rise = round((force - reached) / count) if acceleration else 0
        segments.append(Segment(count, acceleration, rise))
        reached += count * rise
    # Its end is close before an update, which then has no measurement.
    node = (math.ceil((settle + 4 * _MISSING) / samples) + 1) * samples
    return CountedMotion(tuple(segments), unit, (node - 2 * _MISSING, _MISSING if node < moving else 0))


def _share_samples(half: int) -> list[int]:
    """Samples of the segments of half a stroke."""
    edges = [round(half * k / _SEGMENTS) for k in range(_SEGMENTS + 1)]
    return [last - first for first, last in pairwise(edges) if last > first]


def _maxwell_slip(machine: Machine, moves: Array) -> Array:
    """Friction [N] of elements that are stiffer than the machine's, after each move (n) [m]."""
    friction = machine.friction
    stiffness = _STIFFER * np.array(friction.stiffness)
    most = np.array(friction.fraction) * friction.coulomb
    moved = accumulate(moves, lambda force, move: np.clip(force + stiffness * move, -most, most), initial=0.0 * most)
    return np.asarray(np.sum(list(moved)[1:], axis=1))


def round_values(values: Array) -> tuple[float, ...]:
    """Eight significant digits: far from the last ones, which depend on the machine."""
    return tuple(float(f"{value:.8g}") for value in values)
