"""What the free parameters of a model under diagnosis belong to, and what a fit may do with each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Self

from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES
from sgms_mhe.model.effects.parameters import RecordLimit, StepLimit


@dataclass(frozen=True)
class Extra:
    """An effect under test and where its fit starts."""

    name: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Group:
    """Parameters that are wrong, or there, together: what a cause is made of.

    Attributes:
        kind: base: numbers of the base model; own: an effect that the machine has; extra: an effect under test.
        cause: what a diagnosis calls it: the wrong number or the effect.
        label: what the machine calls its effect (`force_ripple_2`); empty for the others.
        index: of an effect under test, its place among them.
    """

    kind: Literal["base", "own", "extra"]
    cause: str
    label: str = ""
    index: int = 0

    @classmethod
    def base(cls, cause: str) -> Self:
        """A wrong number of the base model."""
        return cls("base", cause)

    @classmethod
    def own(cls, cause: str, label: str) -> Self:
        """An effect that the machine has."""
        return cls("own", cause, label)

    @classmethod
    def extra(cls, cause: str, index: int) -> Self:
        """An effect under test."""
        return cls("extra", cause, index=index)

    @property
    def is_extra(self) -> bool:
        """Whether it is an effect under test; otherwise its numbers stand in the machine file."""
        return self.kind == "extra"

    @property
    def name(self) -> str:
        """What its numbers are listed under: the machine's own label where there is one."""
        return self.label or self.cause


def machine_groups(machine: Machine) -> tuple[Group, ...]:
    """All groups of the machine's own numbers: those of the base model, then its effects."""
    return (
        *(
            Group.base(name)
            for name, cause in BASE_CAUSES.items()
            if machine.friction.n_z > 1 or not any(number.shares for number in cause.numbers)
        ),
        *(Group.own(effect.name, effect.label) for effect in machine.effects),
    )


def without_extra(extras: tuple[Extra, ...], group: Group) -> tuple[Extra, ...]:
    """The effects under test but the one of a group; all of them where it is none."""
    return tuple(extra for i, extra in enumerate(extras) if not (group.is_extra and i == group.index))


def without_group(groups: tuple[Group, ...], group: Group) -> tuple[Group, ...]:
    """The groups but one; all of them where it is not among them."""
    return tuple(other for other in groups if other != group)


@dataclass(frozen=True)
class Column:
    """One free parameter of the compiled model.

    Attributes:
        group: what it belongs to.
        name: in SI results (`stiffness_1`, `coulomb`, `amplitude_N`).
        nominal, scale: p = nominal + scale (theta - 1).
        machine_theta: value that the machine file states (of an effect under test: 1).
        lower, upper: of theta.
        least, most: what a record can tell of it [SI]; None: whatever the bounds say.
        step: how far a step of a fit may move it, of an effect's; None: as a number of the base model.
        frozen: its search decides it, no fit moves it.
        timing: it is a time that force and position are apart.
        proportional: the force is proportional to it, from `none` on.
        none: value [SI] at which its effect is none.
        times: name of the size of its group that it is multiplied with.
    """

    group: Group
    name: str
    nominal: float
    scale: float
    machine_theta: float
    lower: float
    upper: float
    least: RecordLimit | None = None
    most: RecordLimit | None = None
    step: StepLimit | None = None
    frozen: bool = False
    timing: bool = False
    proportional: bool = False
    none: float = 0.0
    times: str = ""

    def si(self, theta: float) -> float:
        """Value in SI units."""
        return self.nominal + self.scale * (theta - 1.0)

    def theta(self, si: float) -> float:
        """Scaled value."""
        return (si - self.nominal) / self.scale + 1.0
