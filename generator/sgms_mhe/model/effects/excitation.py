"""What a log must hold for an effect to be identified: a sentence, and numbers that a program can check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine
    from sgms_mhe.signals.chain import Signals

Measure = Literal[
    "travel_m",
    "speed_m_s",
    "speed_ratio",
    "both_directions",
    "reversals",
    "inertial_ratio",
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
        """Needs that a log with these measures does not meet; `parameters` are the effect's, fitted or assumed."""
        return tuple(
            need
            for need in self.needs
            if not found[need.measure] >= need.at_least * (abs(parameters[need.times]) if need.times else 1.0)
        )


def measures(signals: Signals, machine: Machine) -> dict[Measure, float]:
    """All measures of a log; the axis moves where it covers a tenth of its smallest deflection scale in 10 ms."""
    friction = machine.friction
    smallest = min(
        nu * friction.coulomb / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True)
    )
    velocity = np.asarray(signals.velocity)
    rate = machine.sampling.rate
    width = max(1, round(0.01 * rate))
    mean = np.convolve(velocity, np.full(width, 1.0 / width), mode="same")
    moving = np.abs(mean) > 0.1 * smallest / 0.01
    speed = np.abs(velocity[moving])
    direction = np.sign(mean[moving])
    rests = np.sort(_runs(~moving))[::-1] / rate
    slow, fast = np.percentile(speed, [25.0, 95.0]) if len(speed) else (0.0, 0.0)
    longest = float(rests[0]) if len(rests) else 0.0
    return {
        "travel_m": float(np.ptp(signals.position)) if len(velocity) else 0.0,
        "speed_m_s": float(speed.max(initial=0.0)),
        "speed_ratio": float(fast / slow) if slow > 0.0 else 0.0,
        "both_directions": float(min((direction > 0.0).mean(), (direction < 0.0).mean())) if len(direction) else 0.0,
        "reversals": float(np.count_nonzero(np.diff(direction))),
        "inertial_ratio": float(
            np.percentile(np.abs(signals.acceleration), 99.0) * machine.plant.mass / friction.coulomb
        )
        if len(velocity)
        else 0.0,
        "standstill_s": longest,
        "standstill_ratio": longest / float(rests[min(4, len(rests) - 1)]) if longest > 0.0 else 0.0,
        "moving_s": float(np.count_nonzero(moving)) / rate,
    }


def _runs(mask: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Lengths of the runs of true entries."""
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(np.int8)))
    return np.asarray(edges[1::2] - edges[::2], dtype=np.int64)
