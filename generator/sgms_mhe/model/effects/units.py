"""Units, which stand at the end of a parameter's name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

UNITS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "_N_s2_m2": "N s²/m²",
        "_N_s_m": "N s/m",
        "_N_m": "N/m",
        "_m_s": "m/s",
        "_kg": "kg",
        "_Hz": "Hz",
        "_rad": "rad",
        "_N": "N",
        "_m": "m",
        "_s": "s",
    }
)
"""Unit by the end of a name; the first that fits counts."""

PURE_NUMBERS: Final = ("ratio", "gain")
"""What the name of a parameter without a unit ends in."""


def suffix_of(name: str) -> str:
    """The end of a name that states its unit; empty where it has none."""
    return next((suffix for suffix in UNITS if name.endswith(suffix)), "")


def is_ratio(name: str) -> bool:
    """Whether a name is that of a ratio, which is read as percent."""
    return name.endswith(PURE_NUMBERS[0])


def is_pure_number(name: str) -> bool:
    """Whether a name says that there is no unit."""
    return name.rpartition("_")[2] in PURE_NUMBERS
