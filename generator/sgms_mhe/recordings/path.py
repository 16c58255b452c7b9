"""The way of an axis, from readings of its encoder: the trajectory of elements, between the samples too."""

from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

from sgms_mhe.support.arrays import Array

DIFFERENCE: Final = (-1.0, 3.0, -3.0, 1.0)
"""Third difference: what of a way is smooth has little of it."""
BLOCK: Final = 32
"""Samples over which a way is told from its readings."""
CLOSE: Final = 1.75
"""RMS of readings minus way in any block, over the noise of a reading, at most."""
WEIGHTS: Final = (-3.0, 8.0)
"""Decimal logarithms of the weights of smoothness that are tried."""
HALVINGS: Final = 8
CLOSE_ALONE: Final = 1.2
"""The same of a block that has a weight of its own: errors of an encoder alone leave more in one of a hundred."""
REPAIRS: Final = 12
"""Times that blocks which are too far from their readings, and those beside them, get a tenth of the weight."""
FREE: Final = 1000.0
"""Largest error of a reading beyond the ends [its noise]: of none at all the equations are singular."""
ELSEWHERE: Final = 0.25
"""Steps between an encoder's lines and where they might be as well."""
ENCODERS: Final = 4
"""With their lines elsewhere each, that read a way once more: where it stops between lines, one alone says little."""
SEED: Final = 20261126
"""Of the lines' places: the same log gives the same noise."""
NOISE_SEED: Final = 20261127
"""Of what readings have beside it."""


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
    if noise == 0.0 or len(position) <= BLOCK:
        return position
    readings, larger = _extend(position, noise, course)
    low, high = WEIGHTS
    found = readings
    for _ in range(HALVINGS):
        weight = 0.5 * (low + high)
        way = _graduate(readings, 10.0**weight, larger)
        if _largest_residual(((readings - way) / larger)[BLOCK:-BLOCK]) <= CLOSE:
            low, found = weight, way
        else:
            high = weight
    return np.asarray(position[0] + noise * found[BLOCK:-BLOCK])


def smooth_blocks(position: Array, noise: float, course: Array | None = None) -> Array:
    """The way (n) [m] that is as smooth in every block as the block's own readings allow.

    `smooth_path` has one weight, that of the fastest part of a record: where the axis creeps it goes down every step of
    the encoder. To elements that is a reversal at each line, which the axis itself need not make. A trajectory that an
    encoder is to read once more has to be free of the first time's errors; but no better as an estimate, as
    detail finer than a step is lost where the axis makes it too. Arguments as of `smooth_path`.
    """
    if noise == 0.0 or len(position) <= BLOCK:
        return position
    readings, larger = _extend(position, noise, course)
    block = np.arange(len(readings)) // BLOCK
    rows = np.bincount(block)
    weighed = block[: len(readings) - len(DIFFERENCE) + 1]

    def smooth(weights: Array) -> tuple[Array, Array]:
        way = _graduate(readings, 10.0 ** weights[weighed], larger)
        far = np.bincount(block, weights=((readings - way) / larger) ** 2) > CLOSE_ALONE**2 * rows
        return way, np.asarray(far)

    low, high = (np.full(len(rows), end) for end in WEIGHTS)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        far = smooth(middle)[1]
        low, high = np.where(far, low, middle), np.where(far, middle, high)
    way, far = smooth(low)
    for _ in range(REPAIRS):
        if not far.any():
            break
        beside = np.convolve(far, np.ones(3), mode="same") > 0.0
        low = np.where(beside, np.maximum(WEIGHTS[0], low - 1.0), low)
        way, far = smooth(low)
    return np.asarray(position[0] + noise * way[BLOCK:-BLOCK])


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


def misread_paths(
    position: Array, step: float, noise: float, course: Array | None = None, beyond: Array | None = None
) -> list[Array]:
    """Return a way (n) [m] without an encoder's steps, and as each of ENCODERS such encoders has it, lines elsewhere.

    Args:
        position: readings (n) [m], without gaps.
        step: from line to line [m].
        noise, course: as of `smooth_path`.
        beyond: noise of each reading the steps do not make (n) [m]; None: none.
    """
    true = smooth_blocks(position, noise, course)
    paths = [true]
    for k in range(ENCODERS):
        noisy = true
        if beyond is not None:
            noisy = true + beyond * np.random.default_rng([NOISE_SEED, k]).standard_normal(len(true))
        read = noisy + reading_error(noisy, step, uneven=True, seed=SEED + k)
        paths.append(smooth_path(read, noise, course))
    return paths


def thin_path(way: Array) -> tuple[Array, Array]:
    """Return a way (n) [m] as a cubic spline through its even samples has it, and through its odd ones (n) each.

    Between samples an axis that breaks away or turns round is no spline: the change by halving them is about as much as
    they lack themselves.
    """
    at = np.arange(len(way))
    even, odd = (np.asarray(CubicSpline(at[k::2], way[k::2])(at)) for k in (0, 1))
    return even, odd


def _extend(position: Array, noise: float, course: Array | None) -> tuple[Array, Array]:
    """Return readings (n + 2 BLOCK) [noise] that go on at both ends as they came, and their errors [noise].

    A way that ends with its readings is free there to bend by more than a step, which elements take for a force. One
    that makes more than a measurement's noise a sample bends by less anyway, and is not held back where it speeds up.
    """
    readings = np.pad((position - position[0]) / noise, BLOCK, mode="reflect", reflect_type="odd")
    larger = np.ones(len(position)) if course is None else np.maximum(1.0, course / noise)
    errors = np.pad(larger, BLOCK, mode="reflect")
    for outwards, edge in ((slice(BLOCK - 1, None, -1), BLOCK), (slice(-BLOCK, None), -BLOCK - 1)):
        farthest = np.maximum.accumulate(np.abs(readings[outwards] - readings[edge]))
        errors[outwards] += np.clip(farthest - BLOCK, 0.0, FREE)
    return readings, errors


def _graduate(readings: Array, weight: float | Array, noise: Array) -> Array:
    """Solve (I / noise^2 + D' weight D) way = readings / noise^2, D being third differences (n - 3, n)."""
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
