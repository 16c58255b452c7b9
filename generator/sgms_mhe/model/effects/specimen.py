"""How a benchmark hides a cause in a log: the ranges that its numbers are drawn from, and what sizes it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from numpy.random import Generator

from sgms_mhe.model.effects.scales import Scales
from sgms_mhe.model.effects.search import Values
from sgms_mhe.support.arrays import Array

Logged = Callable[[Array, float, Values], Array]
Concealing = Literal["presliding", "one_way"]
"""Motions that hide a cause: loops below break-away; sliding in one direction only."""


@dataclass(frozen=True)
class Scene:
    """A log to come.

    Attributes:
        scales: of the machine.
        numbers: of the base model, those that are one number each (`viscous`, ...) [SI].
        cutoff: of the chain's low-pass [Hz].
        travel: range of position [m].
        speed: largest [m/s].
        seconds: duration.
        random: what is drawn from.
    """

    scales: Scales
    numbers: Mapping[str, float]
    cutoff: float
    travel: float
    speed: float
    seconds: float
    random: Generator

    def sign(self) -> float:
        """-1 or 1."""
        return float(self.random.choice([-1.0, 1.0]))


def log_uniform(random: Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


@dataclass(frozen=True)
class Range:
    """Range to draw a number from, `low` to `high` times `of`.

    Attributes:
        name: of the number.
        low, high: limits; `high` may hang on the scene.
        of: unit of the limits; 1 where None.
        spacing: log or linear; `part`: `of` over a number between the limits, drawn as in log.
    """

    name: str
    low: float
    high: float | Callable[[Scene], float]
    of: Callable[[Scene], float] | None = None
    spacing: Literal["log", "linear", "part"] = "log"

    def draw(self, scene: Scene) -> float:
        """A number of the range."""
        high = self.high(scene) if callable(self.high) else self.high
        unit = 1.0 if self.of is None else self.of(scene)
        if self.spacing == "linear":
            return unit * float(scene.random.uniform(self.low, high))
        number = log_uniform(scene.random, self.low, high)
        return unit / number if self.spacing == "part" else unit * number


@dataclass(frozen=True)
class Concealed:
    """The cause in a log that cannot tell of it: what motion conceals it, and its parameters."""

    motion: Concealing
    values: Callable[[Scales], Values]


@dataclass(frozen=True)
class Specimen:
    """An effect to hide.

    Attributes:
        size: its parameters from the scene, the numbers drawn and x, what the force grows with; |x| is found by trial.
        ranges: numbers that are drawn, in this order.
        signed: whether x may be negative.
        least: what the machine's base numbers must at least be for the effect to have something to act on.
        logged: (force, step, values) -> what is logged of the force (n) that makes a prescribed motion, samples `step`
            apart: of an effect by which the log may lead the motion, which no plant does along a prescribed one.
        concealed: the same where a log cannot tell of it.
    """

    size: Callable[[Scene, Values, float], Values]
    ranges: tuple[Range, ...] = ()
    signed: bool = True
    least: Values | None = None
    logged: Logged | None = None
    concealed: Concealed | None = None

    def draw(self, scene: Scene) -> Callable[[float], Values]:
        """Parameters of a size."""
        drawn = {entry.name: entry.draw(scene) for entry in self.ranges}
        sign = scene.sign() if self.signed else 1.0
        return lambda x: self.size(scene, drawn, sign * x)


PHASE: Final = Range("phase_rad", -math.pi, math.pi, spacing="linear")
PITCH: Final = Range("pitch_m", 2.2, 30.0, lambda scene: scene.travel, "part")
TIME_CONSTANT: Final = Range("time_constant_s", 0.1, 0.6, lambda scene: scene.seconds)


def one_number(
    name: str,
    unit: Callable[[Scene], float],
    *,
    none: float = 0.0,
    signed: bool = True,
    concealed: Concealed | None = None,
) -> Specimen:
    """An effect of one parameter, `none` + x `unit`."""
    return Specimen(lambda scene, _, x: {name: none + x * unit(scene)}, signed=signed, concealed=concealed)


def ripple(size: str, unit: Callable[[Scene], float], ranges: tuple[Range, ...] = (PITCH, PHASE)) -> Specimen:
    """A sine of amplitude x `unit`; in position, unless other numbers are drawn."""
    return Specimen(lambda scene, drawn, x: {size: x * unit(scene), **drawn}, ranges, signed=False)
