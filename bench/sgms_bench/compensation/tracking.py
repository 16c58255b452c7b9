"""How well a reference is followed: runs of an axis, their errors after reversals and at rest, the contour's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.machine import Units
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]

PEAK_WINDOW_S: Final = 0.15
"""After a reversal the largest error is looked for until the next one, but no longer than this."""
LEAST_WAIT_S: Final = 0.02
"""Shorter rests of the reference are no place to settle."""

NONE, STATIC, EKF, MHE, TRUE = "none", "static", "EKF", "MHE", "true friction"
METHODS: Final = (NONE, STATIC, EKF, MHE, TRUE)


@dataclass(frozen=True)
class TrackingTruth:
    """True over nominal parameters: at the start, and by which part of that they change until the end of the run."""

    scale: Mapping[str, float]
    drift: Mapping[str, float]

    def mirror(self) -> TrackingTruth:
        """Off, and drifting, the other way round."""
        return TrackingTruth({k: 2.0 - v for k, v in self.scale.items()}, {k: -v for k, v in self.drift.items()})


@dataclass(frozen=True)
class Scenario:
    """A motion of one axis, or of two: their trajectories and what is true of each."""

    name: str
    axes: tuple[tuple[Trajectory, TrackingTruth], ...]


@dataclass(frozen=True)
class AxisRun:
    """One axis with one compensation.

    Attributes:
        trajectory: the reference.
        error_m: true minus reference position (n).
        compensation_N: fed forward (n).
        friction_N: of the plant (n).
        estimates: of the estimator in the loop, None without one.
    """

    trajectory: Trajectory
    error_m: Array
    compensation_N: Array
    friction_N: Array
    estimates: Estimates | None


@dataclass(frozen=True)
class Measures:
    """How well a reference was followed: RMS error [m], largest error after each reversal [m], settling times [s]."""

    rms_m: float
    peaks_m: Array
    settling_s: Array

    @property
    def peak_m(self) -> float:
        """Mean of the peaks after reversals [m]; NaN without one."""
        return float(self.peaks_m.mean()) if len(self.peaks_m) else math.nan

    @property
    def worst_m(self) -> float:
        """The largest of them [m]."""
        return float(self.peaks_m.max(initial=0.0)) if len(self.peaks_m) else math.nan


@dataclass(frozen=True)
class TrackingComparison:
    """Everything that was run.

    Attributes:
        table: results.
        runs: by scenario and method, one per axis.
        measures: by row name (a scenario, or an axis or the contour of one) and method.
        scenarios: by name.
        nominal: value of every estimated parameter in the machine file.
        units: of the axis.
        figures: files written.
    """

    table: CsvTable
    runs: Mapping[tuple[str, str], tuple[AxisRun, ...]]
    measures: Mapping[tuple[str, str], Measures]
    scenarios: Mapping[str, Scenario]
    nominal: Mapping[str, float]
    units: Units
    figures: tuple[Path, ...] = ()


# --- measures -----------------------------------------------------------------------------------------------------


def reversals(trajectory: Trajectory) -> NDArray[np.int64]:
    """Samples at which the reference first moves in the other direction; a rest in between counts as none."""
    velocity = trajectory.velocity_m_s
    moving = np.flatnonzero(np.abs(velocity) > 1e-9 * np.abs(velocity).max(initial=0.0))
    sign = np.sign(velocity[moving])
    return np.asarray(moving[1:][sign[1:] != sign[:-1]])


def peaks_after(samples: NDArray[np.int64], error_m: Array, rate: float) -> Array:
    """Largest |error| after each of these samples, until the next one or the end of PEAK_WINDOW_S."""
    ends = np.minimum(np.append(samples[1:], len(error_m)), samples + round(PEAK_WINDOW_S * rate))
    return np.array([np.abs(error_m[a:b]).max() for a, b in zip(samples, ends, strict=True)])


def rests(trajectory: Trajectory) -> list[tuple[int, int]]:
    """(first, after the last) sample of every wait of the reference after a move."""
    still = np.append(np.diff(trajectory.position_m) == 0.0, True)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    least = LEAST_WAIT_S * trajectory.rate
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if a > 0 and b - a >= least]


def settling_times(trajectory: Trajectory, error_m: Array, window_m: float) -> Array:
    """Time from every arrival until the error stays within the window [s]; the whole wait where it does not."""
    times = []
    for first, end in rests(trajectory):
        outside = np.flatnonzero(np.abs(error_m[first:end]) > window_m)
        times.append((int(outside[-1]) + 1 if len(outside) else 0) / trajectory.rate)
    return np.array(times)


def measure(run: AxisRun, window_m: float) -> Measures:
    """Measures of one axis."""
    return Measures(
        float(np.sqrt(np.mean(run.error_m**2))),
        peaks_after(reversals(run.trajectory), run.error_m, run.trajectory.rate),
        settling_times(run.trajectory, run.error_m, window_m),
    )


def contour_error(x: AxisRun, y: AxisRun) -> Array:
    """Distance of the true position from the circle, outside positive (n) [m]."""
    centre, radius = _circle_of(x.trajectory, y.trajectory)
    px = x.trajectory.position_m + x.error_m - centre[0]
    py = y.trajectory.position_m + y.error_m - centre[1]
    return np.asarray(np.hypot(px, py) - radius)


def _circle_of(x: Trajectory, y: Trajectory) -> tuple[tuple[float, float], float]:
    """Centre and radius [m] of two trajectories that describe a circle."""
    radius = 0.5 * float(np.ptp(y.position_m))
    return (0.5 * float(x.position_m.max() + x.position_m.min()), float(y.position_m.min()) + radius), radius


def measure_contour(x: AxisRun, y: AxisRun) -> Measures:
    """Measures of the contour error; reversals are those of either axis."""
    error = contour_error(x, y)
    turns = np.union1d(reversals(x.trajectory), reversals(y.trajectory))
    return Measures(float(np.sqrt(np.mean(error**2))), peaks_after(turns, error, x.trajectory.rate), np.zeros(0))
