"""The way of an axis, from readings of its encoder: what elements ran along, between the samples too."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

Array = NDArray[np.float64]

DIFFERENCE: Final = (-1.0, 3.0, -3.0, 1.0)
"""Third difference: what of a way is smooth has little of it."""
BLOCK: Final = 32
"""Samples over which a way is told from its readings."""
CLOSE: Final = 1.75
"""RMS of readings minus way in any block, over the noise of a reading, at most."""
WEIGHTS: Final = (-3.0, 8.0)
"""Decimal logarithms of the weights of smoothness that are tried."""
HALVINGS: Final = 8
ELSEWHERE: Final = 0.25
"""Steps between an encoder's lines and where they might be as well."""
SEED: Final = 20261126
"""Of the lines' places: the same log gives the same noise."""


def smooth_path(position: Array, noise: float, course: Array | None = None) -> Array:
    """The smoothest way (n) [m] that explains the readings of an encoder (n) [m].

    It minimises the sum of squares of readings minus way, in deviations of a reading, plus a weight times that of its
    third differences (Whittaker's graduation). The weight is the largest with which no part of the way is further from
    its readings than their noise is.

    An encoder's step, or its noise, is a speed to elements: theirs turn round, and break away, where the axis does not.

    Args:
        position: readings, without gaps.
        noise: of a reading, one standard deviation [m]; 0: they are the way.
        course: of each reading (n) [m], where some have more; None: all have as much.
    """
    if noise == 0.0 or len(position) < BLOCK:
        return position
    readings = (position - position[0]) / noise
    larger = np.ones(len(position)) if course is None else np.maximum(1.0, course / noise)
    low, high = WEIGHTS
    found = readings
    for _ in range(HALVINGS):
        weight = 0.5 * (low + high)
        way = _graduate(readings, 10.0**weight, larger)
        if _largest_residual((readings - way) / larger) <= CLOSE:
            low, found = weight, way
        else:
            high = weight
    return np.asarray(position[0] + noise * found)


def bridge_gaps(position: Array) -> Array:
    """Readings (n) [m] with straight lines over those that are missing (NaN)."""
    good, at = np.isfinite(position), np.arange(len(position))
    return position if good.all() else np.interp(at, at[good], position[good])


def reading_error(way: Array, step: float, *, uneven: bool = False, seed: int = SEED) -> Array:
    """Return the error of an encoder of this step along a trajectory (n) [m] with its lines elsewhere (n) [m].

    The trajectory is known to a quarter of a step: about its own lines an axis at rest would show no error, and a slow
    one too little.

    Args:
        way: the smooth trajectory behind its readings (n) [m].
        step: from line to line [m].
        uneven: each line is up to half a step elsewhere, by chance: where an axis stops between two lines is another
            place each time.
        seed: of that chance.
    """
    way = way / step
    if not uneven:
        way = way + ELSEWHERE
    else:
        below = np.floor(way)
        lines, which = np.unique(np.concatenate((below, below + 1.0)), return_inverse=True)
        before, behind = np.random.default_rng(seed).uniform(-0.5, 0.5, len(lines))[which].reshape(2, -1)
        way = way + before + (behind - before) * (way - below)
    return np.asarray(step * (np.round(way) - way))


def thin_path(way: Array) -> tuple[Array, Array]:
    """Return a way (n) [m] as a cubic spline through its even samples has it, and through its odd ones (n) each.

    Between samples an axis that breaks away or turns round is no spline: what halving them changes is about as much as
    they lack themselves.
    """
    at = np.arange(len(way))
    even, odd = (np.asarray(CubicSpline(at[k::2], way[k::2])(at)) for k in (0, 1))
    return even, odd


def _graduate(readings: Array, weight: float, noise: Array) -> Array:
    """Solve (I / noise^2 + weight D'D) way = readings / noise^2, D being third differences."""
    order, n = len(DIFFERENCE) - 1, len(readings)
    bands = np.zeros((order + 1, n))
    for i, one in enumerate(DIFFERENCE):
        for j, other in enumerate(DIFFERENCE[: i + 1]):
            bands[order - (i - j), i : i + n - order] += weight * one * other
    bands[order] += noise**-2
    return np.asarray(solveh_banded(bands, readings * noise**-2, overwrite_ab=True, check_finite=False))


def _largest_residual(rest: Array) -> float:
    blocks = rest[: len(rest) // BLOCK * BLOCK].reshape(-1, BLOCK)
    return float(np.sqrt(np.max(np.mean(blocks**2, axis=1))))


def displacements(position: Array, steps: int) -> Array:
    """Return the displacements in so many steps to each sample from the one before, none to the first: (n steps) [m].

    Between two samples of a slow log an axis may turn round, and elements of small break-away distances let go. A
    straight line from sample to sample leaves out the turning point; a cubic spline through the samples has it.
    """
    if steps > 1:
        samples = np.arange(len(position))
        instants = samples[1:, None] - np.arange(steps - 1, -1, -1) / steps
        between = CubicSpline(samples, position)(instants)
        between[:, -1] = position[1:]
        position = np.concatenate((np.full(steps, position[0]), between.ravel()))
    return np.diff(position, prepend=position[:1])
