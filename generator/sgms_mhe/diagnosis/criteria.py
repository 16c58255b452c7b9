"""What a search for causes weighs a gain against."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from sgms_mhe.diagnosis.course import Course
from sgms_mhe.diagnosis.groups import Extra
from sgms_mhe.diagnosis.subject import Fit
from sgms_mhe.machine import DiagnosisTable, Machine
from sgms_mhe.model.effects import EFFECT_NAMES, Measure, cause, effect_definition, effect_names
from sgms_mhe.recordings.evidence import gain_force

_ANY: Final[Mapping[str, float]] = defaultdict(float)
MATERIAL_NOISE: Final = 0.25
"""RMS gain that matters, at least this and `material` of the machine file [noise floor]: a smaller gain drowns."""
SMALL_GAIN: Final = 0.007
"""Gain from which on more than an effect explains may be left beside it, and of any wrong number [f_C]: a smaller one
may be a part of what is left, or of what the law gets wrong."""
GAIN_SHARE: Final = 0.25
"""Gain that an effect must have to be added [RMS beyond noise]: a small share of a lot only imitates a part of what is
really there."""
MOST_ALIKE: Final = 2
"""Effects of one name, at most [1]: more sines are the Fourier series of something else."""


@dataclass(frozen=True)
class Criteria:
    """What a gain must be, on this record, to count.

    Attributes:
        table: [diagnosis] of the machine file.
        floor: noise of the measured friction [N].
        material: RMS gain that matters [N].
        excited: effects that the record can show.
        one_speed: whether the motion has but one speed: what comes again in place comes again in time.
        course: told of each step.
    """

    table: DiagnosisTable
    floor: float
    material: float
    excited: tuple[str, ...]
    one_speed: bool
    course: Course

    def same_clock(self, first: str, second: str) -> bool:
        """Whether two causes come again with the same clock: at one speed place is one, and so is time."""
        return self.one_speed and _is_periodic(first) and _is_periodic(second)

    def alike(self, first: str, second: str) -> bool:
        """Whether two causes are known to be confused, or this record's motion makes one of them."""
        known = first in cause(second).confused_with or second in cause(first).confused_with
        return known or self.same_clock(first, second)

    def excess(self, fit: Fit) -> float:
        """RMS of what a fit leaves beyond noise [N].

        Of the rows that it has seen: where a record turns round but once, a fit without that fold predicts anything.
        """
        return math.sqrt(max(0.0, fit.rms**2 - self.floor**2))

    def costs_nothing(self, fit: Fit, other: Fit) -> bool:
        """Whether another fit leaves no more than this one that matters, on unseen folds."""
        return gain_force(other.cross, fit.cross, fit.rows) < self.material

    def enough(self, fit: Fit) -> float:
        """What an effect must explain to be added to a fit [N]: what matters, and a fair share of what is left.

        Where a lot is left, something with a small share of it only imitates a part of what is really there.
        """
        return max(self.material, GAIN_SHARE * self.excess(fit))


def material_force(machine: Machine, floor: float) -> float:
    """RMS of a force that matters on a record of this noise floor [N]."""
    return max(machine.diagnosis.material * machine.friction.coulomb, MATERIAL_NOISE * floor)


def small_force(machine: Machine) -> float:
    """RMS of a force that matters only where nothing else is left [N]."""
    return SMALL_GAIN * machine.friction.coulomb


def criteria_of(
    machine: Machine, floor: float, excitation: Mapping[Measure, float], course: Course, *, one_speed: bool = False
) -> Criteria:
    """The criteria of a record of this noise floor [N] and these measures."""
    # What a record does not excite cannot be found in it; what only imitates it can.
    excited = tuple(
        name
        for name in effect_names(machine.plant.kind)
        if not any(need.times is None for need in effect_definition(name).excitation.unmet(excitation, _ANY))
    )
    return Criteria(machine.diagnosis, floor, material_force(machine, floor), excited, one_speed, course)


def addable(
    machine: Machine, extras: Sequence[Extra], criteria: Criteria, *, instead_of: str | None = None
) -> list[str]:
    """Effects that may still be added to a machine with others under test.

    `instead_of`: the cause whose place one would take. Its look-alikes count then though the record does not excite
    them: on a motion in one direction nothing tells a wrong level from an asymmetric one.
    """
    tested = [extra.name for extra in extras]
    taken = {*tested, *(effect.name for effect in machine.effects)}
    taken |= {other for name in taken for other in cause(name).excludes}
    full = {name for name in tested if tested.count(name) >= MOST_ALIKE}
    return [
        name
        for name in effect_names(machine.plant.kind)
        if (name in criteria.excited or (instead_of is not None and criteria.alike(name, instead_of)))
        and (name not in taken or (effect_definition(name).repeatable and name not in full))
    ]


def _is_periodic(name: str) -> bool:
    return name in EFFECT_NAMES and effect_definition(name).periodic
