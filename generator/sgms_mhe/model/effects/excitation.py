"""Excitation that identifies an effect: a sentence, and numbers a program can check."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

Measure = Literal[
    "travel_m",
    "speed_m_s",
    "speed_ratio",
    "both_directions",
    "reversals",
    "inertial_ratio",
    "load_ratio",
    "standstill_s",
    "standstill_ratio",
    "moving_s",
]
MEASURES: Final[Mapping[Measure, str]] = {
    "travel_m": "range of position",
    "speed_m_s": "largest speed",
    "speed_ratio": "fast over slow: 95th over 25th percentile of the speed while moving",
    "both_directions": "share of the moving time that goes the rarer way",
    "reversals": "changes of direction",
    "inertial_ratio": "largest inertial force over the Coulomb level",
    "load_ratio": "largest drive force beyond the Coulomb level, over it",
    "standstill_s": "longest standstill",
    "standstill_ratio": "longest standstill over the shortest of the five longest",
    "moving_s": "time in motion",
}


@dataclass(frozen=True)
class Need:
    """A measure must reach `at_least`, times the value of the effect's parameter `times` where one is named."""

    measure: Measure
    at_least: float
    times: str | None = None


@dataclass(frozen=True)
class Excitation:
    """The sentence a person reads and the needs a program checks."""

    text: str
    needs: tuple[Need, ...] = ()

    def unmet(self, found: Mapping[Measure, float], parameters: Mapping[str, float]) -> tuple[Need, ...]:
        """Needs a log with these measures does not meet; `parameters` are the effect's, fitted or assumed."""
        return tuple(
            need
            for need in self.needs
            if not found[need.measure] >= need.at_least * (abs(parameters[need.times]) if need.times else 1.0)
        )
