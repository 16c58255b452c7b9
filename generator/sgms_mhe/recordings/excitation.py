"""How much of what effects need a record holds."""

from __future__ import annotations

from typing import Final

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import Measure
from sgms_mhe.model.scales import scales_of
from sgms_mhe.signals.chain import Signals

MOVING_WAY: Final = 0.1
"""Way within MOVING_TIME from which the axis moves, for what excites an effect [smallest deflection scale]: less is
rest and noise."""
MOVING_TIME: Final = 0.01
"""Time that MOVING_WAY is covered in [s]: averages the noise of the position."""


def measures(signals: Signals, machine: Machine) -> dict[Measure, float]:
    """All measures of a log; the axis moves where it covers MOVING_WAY in MOVING_TIME."""
    scales = scales_of(machine)
    velocity = np.asarray(signals.velocity)
    rate = machine.sampling.rate
    width = max(1, round(MOVING_TIME * rate))
    mean = np.convolve(velocity, np.full(width, 1.0 / width), mode="same")
    moving = np.abs(mean) > MOVING_WAY * scales.least_deflection / MOVING_TIME
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
        "inertial_ratio": float(np.percentile(np.abs(signals.acceleration), 99.0) * scales.mass / scales.coulomb)
        if len(velocity)
        else 0.0,
        "load_ratio": float(np.percentile(np.abs(signals.force), 99.0) / scales.coulomb) - 1.0
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
