"""Excitation of a record: measures of its motion, and whether time and the motion are one clock."""

from functools import lru_cache
from typing import Final

import numpy as np
from scipy.signal import correlate

from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import Measure
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.recordings.series import find_runs
from sgms_mhe.signals.chain import Signals
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.statements import Rule, Statement

MOVING_WAY: Final = 0.1
"""Way within MOVING_TIME from which the axis moves, for what excites an effect [smallest deflection scale]: less is
rest and noise."""
MOVING_TIME: Final = 0.01
"""Time that MOVING_WAY is covered in [s]: averages the noise of the position."""
ALIKE: Final = 0.95
"""Correlation of a motion with itself a lap later from which it repeats itself."""
UNLIKE: Final = 0.5
"""Correlation that it has fallen below before a lap is over."""
SLOWEST: Final = 0.5
"""Turns in a lap from which a frequency may be a multiple of one over it."""
LAPS: Final = 4
"""Of a record, at least: with fewer, nearly every frequency is near a multiple of one over a lap."""
APART: Final = 0.6
"""Frequencies that a record tells apart, over one over its length."""
MOVING: Final = 0.05
"""Of the largest speed: the axis moves from there on."""
ONE_SPEED: Final = 0.05
"""Of a speed, to either side: the same one."""
MOST: Final = 0.85
"""Share of the rows in motion, from which on a motion at one speed is one."""
BOTH_WAYS: Final = 0.05
"""Share of the rows in motion that a direction has, at the least, if the axis moves both ways."""
COMMON: Final = 0.1
"""Share of the rows of either direction at speeds of the other, up to which they have none in common."""


def measure_excitation(signals: Signals, machine: Machine) -> dict[Measure, float]:
    """All measures of a log; the axis moves where it covers MOVING_WAY in MOVING_TIME."""
    scales = scales_of(machine)
    velocity = np.asarray(signals.velocity)
    rate = machine.sampling.rate
    width = max(1, round(MOVING_TIME * rate))
    mean = np.convolve(velocity, np.full(width, 1.0 / width), mode="same")
    moving = np.abs(mean) > MOVING_WAY * scales.least_deflection / MOVING_TIME
    speed = np.abs(velocity[moving])
    direction = np.sign(mean[moving])
    rests = np.sort([end - start for start, end in find_runs(~moving)])[::-1] / rate
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


@lru_cache(maxsize=8)
def find_lap(recording: Recording) -> float | None:
    """Time after which the motion comes again [s]; None where it does not, or moves on at one speed.

    The least lag at which the velocity's correlation with itself has a maximum near 1.
    """
    velocity = recording.velocity
    n = len(velocity)
    power = np.concatenate(([0.0], np.cumsum(velocity**2)))
    most = n // LAPS
    if most < 2 or power[-1] <= 0.0:
        return None
    product = correlate(velocity, velocity, method="fft")[n - 1 : n + most]
    lags = np.arange(most + 1)
    head, tail = power[n - lags], power[n] - power[lags]
    alike = product / np.sqrt(np.maximum(head * tail, 1e-300))
    apart = np.flatnonzero(alike < UNLIKE)
    if not len(apart):
        return None
    after = alike[apart[0] :]
    peaks = np.flatnonzero((after[1:-1] >= ALIKE) & (after[1:-1] >= after[:-2]) & (after[1:-1] >= after[2:]))
    return float(apart[0] + 1 + peaks[0]) / recording.rate if len(peaks) else None


def in_step(recording: Recording, frequency: Array) -> Mask:
    """Return the frequencies (n) [Hz] that are multiples of one over a lap, as far as the record can show."""
    period = find_lap(recording)
    if period is None:
        return np.zeros(frequency.shape, dtype=np.bool_)
    turns = frequency * period
    length = len(recording.time) / recording.rate
    return np.asarray(np.abs(turns - np.round(turns)) < APART * period / length) & (turns > SLOWEST)


@lru_cache(maxsize=8)
def find_steady_blocks(recording: Recording) -> Mask | None:
    """Blocks (b) all of whose rows go on at one speed; None where the motion has more than one.

    Besides, such a motion starts and stops. There a force that goes with place parts from one that goes
    with time; but there an axis also moves as nowhere else, so that is no evidence for either.
    """
    used, velocity = recording.used, recording.velocity
    speed = np.abs(velocity)
    moving = used & (speed > MOVING * float(speed[used].max(initial=0.0)))
    if not moving.any():
        return None
    usual = float(np.median(velocity[moving]))
    same = np.abs(velocity - usual) <= ONE_SPEED * abs(usual)
    if np.count_nonzero(same & moving) < MOST * np.count_nonzero(moving):
        return None
    steady = recording.sum_blocks((~same).astype(np.float64)) == 0.0
    return steady if np.count_nonzero(steady) >= LAPS else None


def find_speeds_apart(recording: Recording) -> tuple[float, float] | None:
    """Return the median speeds [m/s] forth and back where all of one direction are below all of the other; else None.

    The direction then tells the speed: a force that does not change with direction, and friction that differs between
    the speeds, are one. Where the speeds interlace a curve over speed tells them apart.
    """
    velocity = recording.velocity[recording.used]
    moving = np.abs(velocity) > MOVING * float(np.abs(velocity).max(initial=0.0))
    forth, back = velocity[moving & (velocity > 0.0)], -velocity[moving & (velocity < 0.0)]
    if min(len(forth), len(back)) <= BOTH_WAYS * np.count_nonzero(moving):
        return None
    first, second = (np.quantile(way, (COMMON, 1.0 - COMMON)) for way in (forth, back))
    is_apart = first[1] < second[0] or second[1] < first[0]
    return (float(np.median(forth)), float(np.median(back))) if is_apart else None


def clock_note(recording: Recording) -> tuple[Statement, ...]:
    """Return the question a record whose motion and time are one clock does not decide."""
    period = find_lap(recording)
    if period is not None:
        return (Statement(Rule.ONE_CLOCK, "motion", period, unit="s"),)
    return (Statement(Rule.ONE_SPEED, "motion"),) if find_steady_blocks(recording) is not None else ()
