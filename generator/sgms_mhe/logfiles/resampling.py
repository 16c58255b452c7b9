"""Uneven time onto a uniform grid, and its error."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from sgms_mhe.logfiles.timing import GAP, Timing
from sgms_mhe.machine import COMMANDS
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError

FASTEST: Final = 2.0
"""Largest rate of the grid over the mean rate of the log: beyond it most samples would be invented."""
SLOWEST: Final = 0.5
"""Smallest: below it what is faster than the grid would be folded into it."""
_METHODS: Final = ("line", "cubic spline")


@dataclass(frozen=True)
class Interpolation:
    """How a column was taken to the grid.

    Attributes:
        method: a line between neighbours, or a cubic spline; the one that leaves less.
        error: of the interpolation at most, RMS in the column's unit: every other sample, against the values the ones
            between them give. The grid's neighbours are twice as near.
        relative: the same over the column's standard deviation.
    """

    method: str
    error: float
    relative: float


@dataclass(frozen=True)
class Resampling:
    """A log of uneven time, resampled: columns (m,) on a grid of `rate`; NaN in `missing` samples."""

    rate: float
    columns: Mapping[str, Array]
    interpolations: Mapping[str, Interpolation]
    missing: int

    @property
    def note(self) -> str:
        """One sentence for people."""
        errors = ", ".join(
            f"{name} {i.error:.2g} rms ({100 * i.relative:.2g} %, {i.method})"
            for name, i in self.interpolations.items()
        )
        return f"uneven time: interpolated onto a grid of {self.rate:.6g} Hz; error at most {errors}"


def resample(path: Path, columns: Mapping[str, Array], timing: Timing, rate: float | None) -> Resampling:
    """Interpolate every column to a grid that begins at the first sample; `rate` [Hz], or the log's own mean.

    Samples within a gap are missing. Raises InputError for a rate too far from that of the log.
    """
    chosen = rate or timing.rate
    if not SLOWEST * timing.rate <= chosen <= FASTEST * timing.rate:
        allowed = f"sampling.rate from {SLOWEST * timing.rate:.4g} to {FASTEST * timing.rate:.4g} Hz for such a log"
        raise InputError(path, "time_s, resampled", f"{timing.rate:.6g} Hz to {chosen:g} Hz", allowed)
    time = columns["time_s"]
    grid = time[0] + np.arange(int(np.floor(timing.duration * chosen * (1.0 + 1e-12))) + 1) / chosen
    taken = {"time_s": grid}
    interpolations = {}
    missing = np.zeros(len(grid), dtype=bool)
    for name, values in columns.items():
        if name == "time_s":
            continue
        good = np.isfinite(values)
        at, known = time[good], values[good]
        if len(known) < 8:
            raise InputError(path, f"column {name}", f"{len(known)} numbers", "at least 8, to interpolate between them")
        if name in COMMANDS:  # held, not moved from one to the next
            taken[name] = known[np.searchsorted(0.5 * (at[1:] + at[:-1]), grid)]
            continue
        gap = _find_gap_points(grid, at, GAP * timing.step)
        interpolations[name] = best = _best(at, known, float(np.std(known)))
        missing |= gap
        taken[name] = np.where(gap, np.nan, _interpolate(best.method, at, known, grid))
    return Resampling(chosen, taken, interpolations, int(np.count_nonzero(missing)))


def _best(at: Array, known: Array, spread: float) -> Interpolation:
    errors = {}
    for method in _METHODS:
        inner = slice(1, -1 if len(at) % 2 else -2)
        left = known[1::2] - _interpolate(method, at[::2], known[::2], at[1::2])
        errors[method] = float(np.sqrt(np.mean(left[inner] ** 2)))
    method = min(errors, key=lambda name: errors[name])
    return Interpolation(method, errors[method], errors[method] / spread if spread else 0.0)


def _interpolate(method: str, at: Array, known: Array, grid: Array) -> Array:
    if method == "line":
        return np.interp(grid, at, known)
    return np.asarray(CubicSpline(at, known)(np.clip(grid, at[0], at[-1])))


def _find_gap_points(grid: Array, at: Array, longest: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Grid points between samples further apart than `longest`, or beyond the samples."""
    right = np.clip(np.searchsorted(at, grid), 1, len(at) - 1)
    inside = (grid >= at[0]) & (grid <= at[-1] * (1 + 1e-12) + 1e-12)
    return np.asarray(~inside | (at[right] - at[right - 1] > longest))
