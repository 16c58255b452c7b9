"""Result of an identification: the machine, its numbers with intervals, and the open questions."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from sgms_mhe.identification.elements import Law
from sgms_mhe.machine import Machine, Units
from sgms_mhe.support.json_values import finite
from sgms_mhe.support.libraries import data_frame
from sgms_mhe.support.notebooks import Presentation, Shown, labelled_axes
from sgms_mhe.support.numbers import interval
from sgms_mhe.support.statements import Rule, Statement, list_open

UNITS_OF: Final[Mapping[str, str]] = {
    "mass": "mass",
    "coulomb": "force",
    "viscous": "damping",
    "stribeck_velocity": "velocity",
    "stiffness": "stiffness",
}
"""Fields of `Units` by the numbers of a machine file whose names do not end in their unit."""


@dataclass(frozen=True)
class Number:
    """A number of the machine file.

    Attributes:
        name: as in the file of a linear axis, with an index for arrays (`stiffness_1`) and an effect's name before its
            parameters.
        value: SI; the default where the records do not determine it.
        std: one standard deviation; NaN where the number is a default or was given.
        rule: by which it is determined, or why not.
        words: numbers and names the rule's text takes.
        next: move that would determine it.
    """

    name: str
    value: float
    std: float
    rule: Rule = Rule.DETERMINED
    words: Mapping[str, float | str] = field(default_factory=dict)
    next: str | None = None

    @property
    def determined(self) -> bool:
        """Return True if the records determine it, or it was given and they do not contradict."""
        return self.rule.sure == "yes"

    @property
    def interval(self) -> str:
        """The value with two standard deviations, for people."""
        return interval(self.value, self.std)

    @property
    def note(self) -> str:
        """Why it is not determined, or where it comes from; empty where there is nothing to say."""
        return self.rule.text.format(**self.words)

    def state(self, units: Units) -> Statement:
        """Return the statement on it."""
        stem = self.name.rstrip("0123456789").rstrip("_")
        unit = getattr(units, UNITS_OF.get(stem, ""), "") or units.unit(self.name)
        stated = Statement.of_number(self.rule, units.named(self.name), self.value, self.std, unit, **self.words)
        return replace(stated, next=self.next)

    def to_json(self, units: Units) -> dict[str, Any]:
        """Plain data, named as in a file of this kind of axis."""
        name = units.named(self.name)
        return {"name": name, "value": self.value, "std": self.std, "identified": self.determined, "note": self.note}


@dataclass(frozen=True, repr=False)
class Identification(Shown):
    """A machine from measurements alone.

    Attributes:
        machine: as it is written.
        toml: its file.
        numbers: with intervals.
        others: statements on law, elements, timing, residual and the file as a whole.
        sources: the logs, in the order of their content.
        law: of its elements.
        law_decided: whether the records tell the laws apart.
        warnings: to the user about the logs.
        rms_N: residual of all rows.
        held_out_rms_N: on a third of the blocks the fit had not seen.
        stated_rms_N: the same without errors of timing, which a machine file does not state.
        plain_rms_N: the same of least squares of mass, Coulomb and viscous friction and forces over the place.
        is_plain: whether its residual was smaller, and the machine has it.
        noise_floor_N: of a row.
        friction_rms_N: of the measured friction.
        by_count: cross-validated residual by number of elements tried [N].

    Forces are NaN where none was recorded.
    """

    machine: Machine
    toml: str
    numbers: tuple[Number, ...]
    others: tuple[Statement, ...]
    sources: tuple[str, ...]
    law: Law = "switching"
    law_decided: bool = False
    warnings: tuple[str, ...] = ()
    rms_N: float = math.nan
    held_out_rms_N: float = math.nan
    stated_rms_N: float = math.nan
    plain_rms_N: float = math.nan
    is_plain: bool = False
    noise_floor_N: float = math.nan
    friction_rms_N: float = math.nan
    by_count: Mapping[int, float] = field(default_factory=dict)

    @property
    def statements(self) -> tuple[Statement, ...]:
        """Return every judgement, the numbers first."""
        return (*(number.state(self.machine.plant.units) for number in self.numbers), *self.others)

    @property
    def limits(self) -> tuple[str, ...]:
        """Sentences on undetermined numbers, with the move needed for each."""
        return tuple(statement.advice for statement in list_open(self.statements))

    def number(self, name: str) -> Number:
        """The number of a name; KeyError if there is none."""
        for number in self.numbers:
            if number.name == name:
                return number
        raise KeyError(name)

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row per number of the machine file: value, deviation, whether it is determined."""
        names = self.machine.plant.units.named
        columns = {
            "name": np.array([names(number.name) for number in self.numbers]),
            "value": np.array([number.value for number in self.numbers]),
            "std": np.array([number.std for number in self.numbers]),
            "identified": np.array([number.determined for number in self.numbers]),
            "note": np.array([number.note for number in self.numbers]),
        }
        return data_frame(columns)

    def plot(self, axes: Any | None = None) -> Any:
        """Draw friction over displacement from rest, slowly; return the matplotlib axes, those given or new ones."""
        friction, units = self.machine.friction, self.machine.plant.units
        levels = self.machine.friction.coulomb * (1.0 + friction.stribeck_ratio) * np.array(friction.fraction)
        stiffness = np.array(friction.stiffness)
        way = np.union1d(0.0, np.append(levels / stiffness, 1.5 * np.max(levels / stiffness)))
        axes = labelled_axes(axes, f"displacement [{units.position}]", f"friction [{units.force}]")
        axes.plot(way, np.minimum(way[:, None] * stiffness, levels).sum(axis=1), marker=".")
        return axes

    def _shown(self) -> Presentation:
        rows = [(self.machine.plant.units.named(n.name), n.interval, n.note) for n in self.numbers]
        return f"{self.machine.name}: {self.others[-1].sentence}", ("number", "value +- 2 sigma", ""), rows

    def to_json(self) -> dict[str, Any]:
        """Plain data; None where a number has no deviation."""
        units = self.machine.plant.units
        content = {
            "machine": self.machine.name,
            "law": self.law,
            "law_decided": self.law_decided,
            "elements": self.machine.friction.n_z,
            "numbers": [number.to_json(units) for number in self.numbers],
            "residual_rms_N": {
                "all": self.rms_N,
                "held_out": self.held_out_rms_N,
                "noise_floor": self.noise_floor_N,
                "friction": self.friction_rms_N,
                "stated": self.stated_rms_N,
                "by_elements": {str(count): rms for count, rms in self.by_count.items()},
            },
            "plain": {"held_out_N": self.plain_rms_N, "written": self.is_plain},
            "statements": [statement.to_json() for statement in self.statements],
            "limits": list(self.limits),
            "warnings": list(self.warnings),
            "logs": list(self.sources),
        }
        keyed: dict[str, Any] = finite(units.keyed(content))
        return keyed
