"""Random motions for logs that a diagnosis is tried on: what an axis does at work, and what a test of it would do."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np
from numpy.random import Generator

from sgms_mhe.machine import Machine
from sgms_mhe.model.scales import scales_of
from sgms_mhe.plant.trajectories import Motion, Trajectory

STYLES: Final = ("workout", "strokes", "dies", "loops")
"""Motions that excite most effects: everything; long strokes; short moves and rests; much presliding."""
WEAK_STYLES: Final = ("still", "presliding", "one_way", "crawl")
"""Motions that leave causes undistinguished.

No motion; loops below break-away; sliding in one direction only; the same at one speed, where position is a clock.
"""

_TRAVEL_M: Final = 0.12  # to either side


def draw_motion(style: str, machine: Machine, seconds: float, random: Generator) -> Trajectory:
    """A motion of that style and about that length, at rest at both ends."""
    builder = _Builder(machine, random)
    styles: Mapping[str, Sequence[Callable[[], None]]] = {
        "workout": (builder.strokes, builder.loops, builder.dies, builder.strokes, builder.rest),
        "strokes": (builder.strokes, builder.strokes, builder.rest, builder.strokes, builder.loops),
        "dies": (builder.dies, builder.rest, builder.dies, builder.strokes, builder.loops),
        "loops": (builder.loops, builder.strokes, builder.loops, builder.rest),
        "still": (builder.rest,),
        "presliding": (builder.small_loops, builder.rest),
        "one_way": (builder.forward, builder.rest),
        "crawl": (partial(builder.crawl, seconds),),
    }
    segments = styles[style]
    builder.path.wait(0.2)
    k = 0
    while builder.path.duration_s < seconds:
        segments[k % len(segments)]()
        k += 1
    builder.path.wait(0.2)
    motion = builder.path.trajectory(style)
    return Trajectory(style, motion.rate, motion.position_m[: round((seconds + 0.2) * motion.rate)])


class _Builder:
    """Segments, each with numbers of its own."""

    def __init__(self, machine: Machine, random: Generator) -> None:
        self.random = random
        self.path = Motion(machine.sampling.rate)
        self.fastest = 0.9 * machine.sampling.max_velocity
        self.slowest = 2.0 * machine.friction.stribeck_velocity
        self.deflection = scales_of(machine).deflection

    def strokes(self) -> None:
        """Out and back over the same places, at speeds from the slowest to the fastest in turn."""
        speeds = np.geomspace(max(self.slowest, 0.02 * self.fastest), self.fastest, 4)
        for speed in self.random.permutation(speeds).tolist():
            speed *= self.random.uniform(0.7, 1.0)
            reach = min(2.0 * _TRAVEL_M, 0.5 * speed * self.random.uniform(0.8, 1.6))
            target = self._target(reach)
            back = self.path.position
            limits = self._limits(speed)
            self.path.move_to(target, *limits)
            self.path.wait(self.random.uniform(0.02, 0.1))
            self.path.move_to(back, *limits)

    def dies(self) -> None:
        """Equal short moves with a wait after each, one row forth and back."""
        step = float(self.random.uniform(3e-3, 15e-3))
        count = int(self.random.integers(3, 6))
        step *= -1.0 if self.path.position + count * step > _TRAVEL_M else 1.0
        limits = self._limits(self.fastest * self.random.uniform(0.3, 0.9))
        for direction in (1.0, -1.0):
            for _ in range(count):
                self.path.move_by(direction * step, *limits)
                self.path.wait(self.random.uniform(0.03, 0.12))

    def loops(self) -> None:
        """Reversals nested into each other, from beyond break-away down to a small part of it, fast and slow."""
        start = self.random.uniform(1.0, 2.5) * self.deflection
        amplitudes = tuple(float(start * 0.45**k) for k in range(4))
        speed = self.deflection * self.random.uniform(8.0, 30.0)
        self.path.loops(amplitudes, speed, 20.0 * speed, 800.0 * speed)
        self.path.swing(self.deflection * self.random.uniform(0.2, 1.0), self.random.uniform(4.0, 12.0), cycles=2)

    def small_loops(self) -> None:
        """Loops that stay well below break-away."""
        amplitude = self.deflection * self.random.uniform(0.05, 0.15)
        self.path.swing(amplitude, self.random.uniform(2.0, 8.0), cycles=4)

    def forward(self) -> None:
        """On, never back."""
        speed = float(np.exp(self.random.uniform(math.log(5.0 * self.slowest), math.log(0.1 * self.fastest))))
        self.path.move_by(speed * self.random.uniform(0.5, 1.0), *self._limits(speed))

    def crawl(self, seconds: float) -> None:
        """On at one speed, to the end."""
        speed = self.slowest * self.random.uniform(3.0, 12.0)
        self.path.move_by(speed * seconds, *self._limits(speed))

    def rest(self) -> None:
        """Stand still, shortly or long."""
        self.path.wait(float(np.exp(self.random.uniform(math.log(0.05), math.log(1.5)))))

    def _limits(self, speed: float) -> tuple[float, float, float]:
        acceleration = 10.0 * self.fastest * self.random.uniform(0.3, 1.0)
        return speed, acceleration, 40.0 * acceleration

    def _target(self, reach: float) -> float:
        here = self.path.position
        inside = [t for t in (here + reach, here - reach) if abs(t) <= _TRAVEL_M]
        if not inside:
            return -math.copysign(_TRAVEL_M, here) if here != 0.0 else reach
        return float(inside[int(self.random.integers(len(inside)))])
