"""Forces that no effects of the catalogue can represent: what is left has to be called unexplained."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

Array = NDArray[np.float64]
Unmodelled = Callable[[Generator, Array, Array, Array], Array]
"""(random, time, position, velocity) -> force (n), of any size."""


def _narrow_band(random: Generator, t: Array, _: Array, __: Array) -> Array:
    """Noise within a tenth of its frequency: rings without a phase that lasts."""
    rate = 1.0 / (t[1] - t[0])
    centre = math.exp(random.uniform(math.log(3.0), math.log(min(60.0, 0.1 * rate))))
    band = np.array([0.94, 1.06]) * centre
    return np.asarray(sosfilt(butter(2, band, "bandpass", fs=rate, output="sos"), random.standard_normal(len(t))))


def _bursts(random: Generator, t: Array, _: Array, __: Array) -> Array:
    """Pulses of either sign at random times."""
    force = np.zeros(len(t))
    for at in random.uniform(t[0], t[-1], max(10, round(1.5 * (t[-1] - t[0])))):
        force += random.choice([-1.0, 1.0]) * np.exp(-(((t - at) / random.uniform(0.02, 0.12)) ** 2))
    return force


def _telegraph(random: Generator, t: Array, _: Array, __: Array) -> Array:
    """A force that jumps between two values again and again."""
    edges = np.sort(random.uniform(t[0], t[-1], max(14, round(2.0 * (t[-1] - t[0])))))
    return np.where(np.searchsorted(edges, t) % 2 == 0, 1.0, -1.0)


def _random_walk(random: Generator, t: Array, _: Array, __: Array) -> Array:
    """An offset that wanders."""
    steps = random.standard_normal(len(t)) * math.sqrt(t[1] - t[0])
    walk = np.cumsum(steps)
    return np.asarray(walk - walk.mean())


def _chirp(random: Generator, t: Array, _: Array, __: Array) -> Array:
    """A sine whose frequency rises."""
    low, high = random.uniform(0.5, 3.0), random.uniform(10.0, 40.0)
    rise = math.log(high / low) / (t[-1] - t[0])
    return np.asarray(np.sin(2.0 * math.pi * low * np.expm1(rise * (t - t[0])) / rise))


def _place_and_time(random: Generator, t: Array, q: Array, _: Array) -> Array:
    """A pattern in position that swells and fades in time."""
    pitch = np.ptp(q) / random.uniform(3.0, 8.0)
    return np.asarray(np.sin(2.0 * math.pi * q / pitch) * np.sin(2.0 * math.pi * random.uniform(0.3, 1.5) * t))


def _speed_bump(random: Generator, t: Array, _: Array, v: Array) -> Array:
    """Friction that rises within a narrow band of speed only."""
    fast = float(np.quantile(np.abs(v), 0.95))
    at = random.uniform(0.25, 0.7) * fast
    return np.asarray(np.sign(v) * np.exp(-(((np.abs(v) - at) / (0.12 * at)) ** 2)))


def _speed_power(random: Generator, _: Array, __: Array, v: Array) -> Array:
    """Friction that rises with a power of speed well below 1."""
    return np.asarray(np.sign(v) * np.abs(v) ** random.uniform(0.35, 0.6))


def _speed_logarithm(random: Generator, _: Array, __: Array, v: Array) -> Array:
    """Friction that rises with the logarithm of speed, as that of rubber and of hard contacts does."""
    slow = float(np.quantile(np.abs(v), 0.95)) * math.exp(random.uniform(math.log(2e-3), math.log(2e-2)))
    return np.asarray(np.sign(v) * np.log1p(np.abs(v) / slow))


def _spots(random: Generator, t: Array, q: Array, _: Array) -> Array:
    """A few places that push, not in a row, each for a part of the time: all the time they would be a map."""
    low, high = float(q.min()), float(q.max())
    force = np.zeros(len(t))
    for at in random.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), 3):
        place = np.exp(-(((q - at) / (random.uniform(0.02, 0.05) * (high - low))) ** 2))
        begin, end = np.sort(random.uniform(t[0], t[-1], 2))
        force += random.choice([-1.0, 1.0]) * place * ((t >= begin) & (t < end))
    return force


UNMODELLED: Final[Mapping[str, Unmodelled]] = MappingProxyType(
    {
        "narrow_band_noise": _narrow_band,
        "bursts": _bursts,
        "telegraph": _telegraph,
        "random_walk": _random_walk,
        "chirp": _chirp,
        "place_and_time": _place_and_time,
        "bump_in_speed": _speed_bump,
        "spots": _spots,
        "power_of_speed": _speed_power,
        "log_of_speed": _speed_logarithm,
    }
)
"""Unmodelled forces by name."""

CURVES: Final = ("bump_in_speed", "power_of_speed", "log_of_speed")
"""Those that the effect which may have any shape over speed names: their laws are none of the catalogue's."""

SMOOTH_CURVES: Final = ("power_of_speed", "log_of_speed")
"""Those that numbers of the base model and the catalogue's curves over speed nearly add up to. Only a large one leaves
enough beside them to be told from their sum."""


def curves_over_speed(v: Array) -> Array:
    """The catalogue's curves over speed (n, 6): drag, and eddy currents of many corners, of velocity (n)."""
    fastest = float(np.max(np.abs(v)))
    eddies = [v / (1.0 + (v / (corner * fastest)) ** 2) for corner in (0.05, 0.1, 0.2, 0.4, 0.8)]
    return np.column_stack((v * np.abs(v), *eddies))
