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
from sgms_mhe.machine import Machine, Thresholds
from sgms_mhe.model.effects import Measure, cause, effect_definition, effect_names

_ANY: Final[Mapping[str, float]] = defaultdict(float)


@dataclass(frozen=True)
class Criteria:
    """What a gain must be, on this record, to count.

    Attributes:
        thresholds: of the machine file.
        floor: noise of the measured friction [N].
        material: RMS gain that matters [N].
        excited: effects that the record can show.
        course: told of each step.
    """

    thresholds: Thresholds
    floor: float
    material: float
    excited: tuple[str, ...]
    course: Course

    def excess(self, fit: Fit) -> float:
        """RMS of what a fit leaves beyond noise [N].

        Of the rows that it has seen: where a record turns round but once, a fit without that fold predicts anything.
        """
        return math.sqrt(max(0.0, fit.rms**2 - self.floor**2))

    def enough(self, fit: Fit) -> float:
        """What an effect must explain to be added to a fit [N]: what matters, and a fair share of what is left.

        Where a lot is left, something with a small share of it only imitates a part of what is really there.
        """
        return max(self.material, self.thresholds.share * self.excess(fit))


def material_force(machine: Machine, floor: float) -> float:
    """RMS of a force that matters on a record of this noise floor [N]."""
    thresholds = machine.diagnosis
    return max(thresholds.material * machine.friction.coulomb, thresholds.material_noise * floor)


def criteria_of(machine: Machine, floor: float, excitation: Mapping[Measure, float], course: Course) -> Criteria:
    """The criteria of a record of this noise floor [N] and these measures."""
    thresholds = machine.diagnosis
    # What a record does not excite cannot be found in it; what only imitates it can.
    excited = tuple(
        name
        for name in effect_names(machine.plant.kind)
        if not any(need.times is None for need in effect_definition(name).excitation.unmet(excitation, _ANY))
    )
    return Criteria(thresholds, floor, material_force(machine, floor), excited, course)


def addable(machine: Machine, extras: Sequence[Extra], criteria: Criteria) -> list[str]:
    """Effects that may still be added to a machine with others under test."""
    tested = [extra.name for extra in extras]
    taken = {*tested, *(effect.name for effect in machine.effects)}
    taken |= {other for name in taken for other in cause(name).excludes}
    full = {name for name in tested if tested.count(name) >= criteria.thresholds.alike}
    return [
        name
        for name in criteria.excited
        if name not in taken or (effect_definition(name).repeatable and name not in full)
    ]
