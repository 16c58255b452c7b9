"""Whether a motion repeats itself: time and the motion are then one clock."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from sgms_mhe.recordings.recording import Recording

Array = NDArray[np.float64]

ALIKE: Final = 0.95
"""Correlation of a motion with itself a lap later from which it repeats itself."""
UNLIKE: Final = 0.5
"""Correlation that it has fallen below before a lap is over."""
SLOWEST: Final = 0.5
"""Turns in a lap from which a frequency may be a multiple of one over it."""
LAPS: Final = 8
"""Of a record, at least: with fewer, nearly every frequency is near a multiple of one over a lap."""
APART: Final = 0.6
"""Frequencies that a record tells apart, over one over its length."""


@lru_cache(maxsize=8)
def lap(recording: Recording) -> float | None:
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


def in_step(recording: Recording, frequency: Array) -> NDArray[np.bool_]:
    """Which frequencies (n) [Hz] are multiples of one over a lap, as far as the record can tell."""
    period = lap(recording)
    if period is None:
        return np.zeros(frequency.shape, dtype=np.bool_)
    turns = frequency * period
    length = len(recording.time) / recording.rate
    return np.asarray(np.abs(turns - np.round(turns)) < APART * period / length) & (turns > SLOWEST)


def repetition_note(recording: Recording) -> tuple[str, ...]:
    """What a record cannot decide whose motion repeats itself."""
    period = lap(recording)
    if period is None:
        return ()
    return (
        f"the motion repeats itself every {period:.3g} s: whether a force comes again in time or with the motion "
        "shows only at another speed",
    )
