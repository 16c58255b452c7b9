"""Names of the same quantities for the two kinds of axis: units, and names that end in a unit.

A rotary axis is a linear one with an angle for the position, a torque for the force and an inertia for the mass. The
model, the estimator and the diagnosis know generalised coordinates alone, under the linear axis's names; files and
texts of a user have the names of their axis. This is the one place where the two meet.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Literal

Kind = Literal["linear", "rotary"]
"""Kinds of axis."""

UNITS: Final[Mapping[str, str]] = {
    "_Nm_s2_rad2": "N m s²/rad²",
    "_Nm_s_rad": "N m s/rad",
    "_Nm_rad": "N m/rad",
    "_rad_s2": "rad/s²",
    "_rad_s": "rad/s",
    "_kg_m2": "kg m²",
    "_Nm": "N m",
    "_N_s2_m2": "N s²/m²",
    "_N_s_m": "N s/m",
    "_N_m": "N/m",
    "_m_s2": "m/s²",
    "_m_s": "m/s",
    "_kg": "kg",
    "_Hz": "Hz",
    "_rad": "rad",
    "_N": "N",
    "_m": "m",
    "_s": "s",
}
"""Unit by the end of a name; the first that fits counts."""

_ROTARY_ENDS: Final[Mapping[str, str]] = {
    "_N_s2_m2": "_Nm_s2_rad2",
    "_N_s_m": "_Nm_s_rad",
    "_N_m": "_Nm_rad",
    "_m_s2": "_rad_s2",
    "_m_s": "_rad_s",
    "_kg": "_kg_m2",
    "_N": "_Nm",
    "_m": "_rad",
}
_ROTARY_NAMES: Final[Mapping[str, str]] = {"force_N": "torque_Nm", "mass_kg": "inertia_kg_m2", "mass": "inertia"}
"""Names of which more than the unit differs."""

CATALOGUE_ENDS: Final = tuple(end for end in UNITS if end == "_rad" or end not in _ROTARY_ENDS.values())
"""Ends of names in the catalogue of effects, which names things as a linear axis does."""

PURE_NUMBERS: Final = ("ratio", "gain", "order", "cells")
"""What the name of a number without a unit ends in."""


@cache
def suffix_of(name: str) -> str:
    """The end of a name that states its unit; empty where it has none."""
    return next((suffix for suffix in UNITS if name.endswith(suffix)), "")


def is_ratio(name: str) -> bool:
    """Return True if a name is that of a ratio, which is shown as percent."""
    return name.endswith(PURE_NUMBERS[0])


def is_pure_number(name: str) -> bool:
    """Return True if a name says that there is no unit."""
    return name.rpartition("_")[2] in PURE_NUMBERS


@dataclass(frozen=True)
class Units:
    """Units and words of one kind of axis.

    Attributes:
        kind: of the axis.
        position, velocity, acceleration, force, stiffness, damping, mass: units.
        push: force or torque.
        inert: mass or inertia, which resists acceleration.
        metre: the unit of position as a word, `metres` of several.
        pico: name of the smallest step of a position in single precision.
    """

    kind: Kind
    position: str
    velocity: str
    acceleration: str
    force: str
    stiffness: str
    damping: str
    mass: str
    push: str
    inert: str
    metre: str
    metres: str
    pico: str

    @property
    def balance(self) -> str:
        """Label of the friction of estimates: it holds every force of the axis but that of inertia, gravity too."""
        return f"{self.push} less inertia [{self.force}]"

    def named(self, name: str) -> str:
        """A name (`pitch_m`, `force_ripple.amplitude_N`, `stiffness_2`) as this kind of axis has it."""
        if self.kind == "linear":
            return name
        owner, dot, own = name.rpartition(".")
        if own in _ROTARY_NAMES:
            return owner + dot + _ROTARY_NAMES[own]
        end = next((end for end in _ROTARY_ENDS if own.endswith(end)), "")
        return owner + dot + own.removesuffix(end) + _ROTARY_ENDS.get(end, "")

    def keyed(self, content: Any) -> Any:
        """Content of a JSON file with every key as this kind of axis names it."""
        if isinstance(content, Mapping):
            return {self.named(key): self.keyed(value) for key, value in content.items()}
        if isinstance(content, Sequence) and not isinstance(content, str):
            return [self.keyed(value) for value in content]
        return content

    def unit(self, name: str) -> str:
        """Unit of a quantity by the end of its (linear) name; empty where it has none."""
        return UNITS.get(suffix_of(self.named(name)), "")


LINEAR: Final = Units(
    kind="linear",
    position="m",
    velocity="m/s",
    acceleration="m/s^2",
    force="N",
    stiffness="N/m",
    damping="N s/m",
    mass="kg",
    push="force",
    inert="mass",
    metre="metre",
    metres="metres",
    pico="pm",
)
ROTARY: Final = Units(
    kind="rotary",
    position="rad",
    velocity="rad/s",
    acceleration="rad/s^2",
    force="N m",
    stiffness="N m/rad",
    damping="N m s/rad",
    mass="kg m^2",
    push="torque",
    inert="inertia",
    metre="radian",
    metres="radians",
    pico="prad",
)
OF_KIND: Final[Mapping[Kind, Units]] = {"linear": LINEAR, "rotary": ROTARY}
"""Units by the kind of the axis."""
