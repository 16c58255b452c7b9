"""Series of a report's plots: residuals over every coordinate, their spectrum, arrays small enough for a page."""

import base64
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from scipy.signal import welch

from sgms_mhe.diagnosis import Traces
from sgms_mhe.report.units import axis_units
from sgms_mhe.signals.noise import position_noise
from sgms_mhe.support.arrays import Array

POINTS: Final = 3000  # of a cloud
BINS: Final = 60
LEAST_IN_BIN: Final = 8
LARGEST: Final = 32767
MISSING: Final = -32768


@dataclass(frozen=True)
class View:
    """The residual over one coordinate.

    Attributes:
        key: coordinate, as in `diagnosis.Structure`.
        title, unit: of the horizontal axis, in SI units times `factor`.
        logarithmic: horizontal axis.
        x, before, after: a cloud of samples (p); empty for the spectrum.
        centres, mean_before, mean_after: means in bins, or amplitudes of the spectrum (k).
    """

    key: str
    title: str
    unit: str
    logarithmic: bool
    x: Array
    before: Array
    after: Array
    centres: Array
    mean_before: Array
    mean_after: Array


def since_reversal(traces: Traces) -> Array:
    """Way covered since the direction last changed (m) [m]; NaN before the first change."""
    # Noise at rest is no reversal: the position has to come back by more than its own jitter.
    position = traces.position_m
    threshold = max(5.0 * position_noise(position), 1e-12)
    way, turns = np.full(len(position), np.nan), _turning_points(position, threshold)
    for start, end in pairwise([*turns, len(position)]):
        way[start:end] = np.abs(position[start:end] - position[start])
    return way


def views(traces: Traces) -> list[View]:
    """Residual before and after over position, velocity, acceleration, time, way since a reversal, and frequency."""
    used, length = traces.used, axis_units().position
    shown: list[View] = []
    coordinates = (
        ("position", "position", traces.position_m, length, False),
        ("velocity", "velocity", traces.velocity_m_s, f"{length}/s", False),
        ("acceleration", "acceleration", traces.acceleration_m_s2, f"{length}/s²", False),
        ("time", "time", traces.time_s, "s", False),
        ("after_reversal", "way since the last reversal", since_reversal(traces), length, True),
    )
    before, after = traces.residual_before, traces.residual_after
    for key, title, x, unit, logarithmic in coordinates:
        good = used & np.isfinite(x)
        if logarithmic:
            good &= x > 0.0
        shown.append(bin_view(key, title, unit, x[good], before[good], after[good], logarithmic=logarithmic))
    shown.append(_spectrum(traces))
    return shown


def bin_view(
    key: str, title: str, unit: str, x: Array, before: Array, after: Array, *, logarithmic: bool = False
) -> View:
    """Return two series over a coordinate: a cloud of their samples, and means in bins."""
    factor, unit = _scale_unit(unit, x)
    x = x * factor
    empty = np.empty(0)
    if len(x) < 2 * LEAST_IN_BIN or np.ptp(x) == 0.0:
        return View(key, title, unit, logarithmic, empty, empty, empty, empty, empty, empty)
    if logarithmic:
        # Of the way since a reversal the shortest hundredth is noise.
        edges = np.geomspace(max(np.quantile(x, 0.01), x.max() * 1e-7), x.max(), BINS + 1)
    else:
        edges = np.linspace(x.min(), x.max(), BINS + 1)
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    count = np.bincount(index, minlength=BINS)
    kept = count >= LEAST_IN_BIN
    divisor = np.maximum(count, 1)

    def mean(values: Array) -> Array:
        return np.asarray((np.bincount(index, weights=values, minlength=BINS) / divisor)[kept])

    centres = np.sqrt(edges[1:] * edges[:-1]) if logarithmic else 0.5 * (edges[1:] + edges[:-1])
    inside = np.flatnonzero(x >= edges[0])
    # The same points with every run of the program, and no beat with the motion's period.
    chosen = np.sort(np.random.default_rng(3).permutation(inside)[:POINTS])
    return View(
        key,
        title,
        unit,
        logarithmic,
        x[chosen],
        before[chosen],
        after[chosen],
        centres[kept],
        mean(before),
        mean(after),
    )


def _spectrum(traces: Traces) -> View:
    """Amplitude of a sine at each frequency that would make the spectrum's line [N]."""
    length = int(min(2 ** math.ceil(math.log2(max(16.0, 2.0 * traces.rate))), len(traces.time_s)))
    rows = []
    for residual in (traces.residual_before, traces.residual_after):
        values = np.where(traces.used, residual, 0.0)
        frequency, power = welch(values, fs=traces.rate, nperseg=length, scaling="spectrum", detrend=False)
        rows.append(np.sqrt(2.0 * power))
    empty = np.empty(0)
    return View("frequency", "frequency", "Hz", True, empty, empty, empty, frequency[1:], rows[0][1:], rows[1][1:])


def pack(values: Array) -> dict[str, Any]:
    """An array as 16-bit integers in base64: value = offset + scale * integer; a non-finite value is missing."""
    finite = np.isfinite(values)
    low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
    offset, scale = 0.5 * (low + high), (high - low) / (2.0 * LARGEST) or 1.0
    integers = np.full(len(values), MISSING, dtype="<i2")
    integers[finite] = np.clip(np.rint((values[finite] - offset) / scale), -LARGEST, LARGEST)
    return {"offset": offset, "scale": scale, "data": base64.b64encode(integers.tobytes()).decode("ascii")}


def numbers(values: Array) -> list[float | None]:
    """A short array for JSON, five digits."""
    return [float(f"{v:.5g}") if math.isfinite(v) else None for v in values.tolist()]


def _scale_unit(unit: str, x: Array) -> tuple[float, str]:
    """Factor and unit in which the largest value reads well."""
    largest = float(np.max(np.abs(x))) if len(x) else 0.0
    if unit.startswith(axis_units().position) and 0.0 < largest < 1.0:
        return (1e3, "m" + unit) if largest >= 1e-3 else (1e6, "µ" + unit)
    return 1.0, unit


def _turning_points(position: Array, threshold: float) -> list[int]:
    """Indices of extremes between which the position moves by more than the threshold."""
    turns: list[int] = []
    direction, extreme, at = 0, float(position[0]), 0
    low = high = float(position[0])
    for k, q in enumerate(position.tolist()):
        if direction == 0:
            low, high = min(low, q), max(high, q)
            if high - low > threshold:
                direction = 1 if q == high else -1
                extreme, at = q, k
        elif (q - extreme) * direction > 0.0:
            extreme, at = q, k
        elif (extreme - q) * direction > threshold:
            turns.append(at)
            direction, extreme, at = -direction, q, k
    return turns
