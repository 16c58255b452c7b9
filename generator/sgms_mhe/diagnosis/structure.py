"""Maps of a residual over position, velocity, acceleration, time, distance after reversals, frequency."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy import stats
from scipy.signal import welch

from sgms_mhe.recordings.excitation import find_steady_blocks
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.signals.chain import apply_chain
from sgms_mhe.support.arrays import Array

REST: Final = 1e-9  # m in a row that are no motion
MAP_BINS: Final = 40
"""Bins of a map of the residual [1]: a curve to look at."""
CURVE_SHARE: Final = 0.4
"""RMS of what is left as a curve over speed, from which a curve is taken for another one [gain that matters, and RMS
beyond noise]: curves over speed add up to nearly any other one, and what they miss of it is such a curve. Where much
else is left the map over speed shows some of that."""
LINE_POWER: Final = 3.0
"""Power of a spectrum's bin that counts as structure [median power]: above the scatter of the bins."""


@dataclass(frozen=True)
class ResidualStructure:
    """Dependence of the residual on one coordinate.

    Attributes:
        coordinate: position, velocity, acceleration, time, after_reversal or frequency.
        rms_N: RMS of the residual that is a function of that coordinate (bin means beyond noise; peak of the spectrum).
        p_value: of no dependence.
        peak: coordinate of its maximum.
        centres: bins (k).
        mean_N: residual's mean in each bin (k); for frequency its amplitude spectrum [N].
        encoder_N: `rms_N` of the force the encoder's steps leave; 0 where they do not show, and for frequency.
    """

    coordinate: str
    rms_N: float
    p_value: float
    peak: float
    centres: Array
    mean_N: Array
    encoder_N: float = 0.0


def structure_map(recording: Recording, residual: Array, encoder: Array | None = None) -> tuple[ResidualStructure, ...]:
    """All maps of a residual (m) on the used rows; `encoder`: force the encoder's steps leave (m)."""
    found = [_binned(recording, residual, name, x) for name, x in _coordinates(recording).items()]
    if encoder is not None and recording.noise is not None and recording.unfiltered is not None:
        # An acceleration that is read wrong is wrong in the measured friction too, so that the one goes with the other.
        motion = apply_chain(recording.machine, recording.unfiltered[:, :3]) + recording.noise
        position, velocity, acceleration = recording.reduce(motion).T
        read = replace(recording, position=position, velocity=velocity, acceleration=acceleration)
        made = [_binned(recording, encoder, name, x).rms_N for name, x in _coordinates(read).items()]
        found = [replace(s, encoder_N=rms) for s, rms in zip(found, made, strict=True)]
    return (*found, _spectrum(recording, np.where(recording.used, residual, 0.0)))


def _coordinates(recording: Recording) -> dict[str, Array]:
    """Return the coordinates of the maps (m), by name."""
    return {
        "position": recording.position,
        "velocity": recording.velocity,
        "acceleration": recording.acceleration,
        "time": recording.time,
        "after_reversal": _way_after_reversal(recording),
    }


def force_over_speed(recording: Recording, residual: Array) -> float:
    """RMS of a residual's (m) function of velocity, on the used rows and beyond their noise [N]."""
    return _binned(recording, residual, "velocity", recording.velocity).rms_N


def leaves_curve(
    recording: Recording, residual: Array, floor: float, material: float, encoder: Array | None = None
) -> bool:
    """Return True if a good part of a residual (m) is a curve over speed, and it matters.

    Of one speed there is no curve: a curve over the encoder's noise is none over speed.

    Args:
        recording: the record.
        residual: measured minus model (m) [N].
        floor: noise of the measured friction [N].
        material: RMS gain that matters [N].
        encoder: force the encoder's steps leave (m) [N], whose own curve is none of the axis; None: none shows.
    """
    if find_steady_blocks(recording) is not None:
        return False
    beyond = math.sqrt(max(0.0, recording.rms(residual) ** 2 - floor**2))
    least = CURVE_SHARE * max(material, beyond)
    read = 0.0 if encoder is None else force_over_speed(recording, encoder)
    return force_over_speed(recording, residual) > math.hypot(least, read)


def _way_after_reversal(recording: Recording) -> Array:
    """Distance travelled since the last change of direction (m) [m], as its decimal logarithm."""
    moved = np.diff(recording.position, prepend=recording.position[:1])
    quiet = np.abs(moved) < REST
    sign = np.sign(np.where(quiet, 0.0, moved))
    index = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(sign)), 0))
    held = sign[index]
    turn = np.concatenate(([True], held[1:] != held[:-1]))
    path = np.cumsum(np.abs(moved))
    start = np.maximum.accumulate(np.where(turn, path, -np.inf))
    return np.asarray(np.log10(np.maximum(path - start, 1e-8)))


def _binned(recording: Recording, residual: Array, coordinate: str, series: Array) -> ResidualStructure:
    used = recording.used
    x, e, block = series[used], residual[used], recording.block[used]
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, MAP_BINS + 1)))
    if len(edges) < 3:
        return ResidualStructure(coordinate, 0.0, 1.0, math.nan, np.empty(0), np.empty(0))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    bins = len(edges) - 1
    count = np.bincount(index, minlength=bins)
    mean = np.bincount(index, weights=e, minlength=bins) / np.maximum(count, 1)
    # A bin's mean scatters as its sums over blocks do.
    cell = index * recording.blocks + block
    sums = np.bincount(cell, weights=e - mean[index], minlength=bins * recording.blocks).reshape(bins, -1)
    variance = np.sum(sums**2, axis=1) / np.maximum(count, 1) ** 2
    share = count / count.sum()
    power = float(np.sum(share * (mean**2 - variance)))
    filled = (count > 0) & (variance > 0.0)
    statistic = float(np.sum(mean[filled] ** 2 / variance[filled]))
    degrees = int(filled.sum())
    centres = np.bincount(index, weights=x, minlength=bins) / np.maximum(count, 1)
    peak = float(centres[int(np.argmax(np.abs(mean)))])
    p = float(stats.f.sf(statistic / max(1, degrees), max(1, degrees), max(2, recording.blocks - 1)))
    return ResidualStructure(coordinate, math.sqrt(max(0.0, power)), p, peak, centres, mean)


def _spectrum(recording: Recording, residual: Array) -> ResidualStructure:
    length = int(min(len(residual), max(256, 2.0 * recording.rate)))
    frequency, power = welch(residual, fs=recording.rate, nperseg=length)
    width = float(frequency[1] - frequency[0])
    inside = frequency > 0.0
    frequency, power = frequency[inside], power[inside]
    typical = float(np.median(power))
    peak = int(np.argmax(power))
    segments = max(1.0, 2.0 * len(residual) / length - 1.0)
    ratio = float(power[peak] / max(typical, 1e-300))
    p = min(1.0, len(power) * float(stats.chi2.sf(2.0 * segments * 0.7 * ratio, 1.4 * segments)))
    excess = float(np.sum(np.maximum(0.0, power - LINE_POWER * typical))) * width
    return ResidualStructure(
        "frequency", math.sqrt(excess), p, float(frequency[peak]), frequency, np.sqrt(power * width)
    )
