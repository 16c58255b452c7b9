"""Noise of a measured signal, told from the signal itself."""

import math
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

MEDIAN_OF_NORMAL: Final = 0.6745
"""Median size of a normal variable over its standard deviation."""


ORDERS: Final = (3, 5, 7)
"""Differences that tell noise from motion: of motion the higher ones hold less, of white noise they say the same."""

ROUNDING: Final = 1e-9
"""Of the largest step of a position: smaller ones are none."""
SMALL: Final = 20.0
OTHERS: Final = 0.05
"""Share of changes other than of one step from which on they tell whether it is one."""
ALONE: Final = 0.5
"""Share of changes with none beside them from which on they are steps, where there are no others."""
UNEVEN: Final = 0.1
EVEN: Final = 0.9
"""Changes of up to so many steps are multiples of an encoder's step, within so much of it; so many of them have to."""
DIGITS: Final = 1e-3  # of the largest change of a change: smaller ones are of a file's digits
MANY: Final = 1e4  # steps a sample up to which changes are compared with the step
JUMP: Final = 10.0
BESIDE: Final = 3  # samples
PIECE: Final = 200
"""Samples that noise is told from where it changes over a record: a median of so many is sure to a tenth."""


def position_noise(position: NDArray[np.float64]) -> float:
    """Standard deviation of the noise in a position (n) [its unit]; 0 where too few samples are there.

    The median size of differences over that of white noise, sqrt(C(2 k, k)) standard deviations for order k: a motion
    is smooth over a few samples where it is slow, and most of a record is. Where it is not, differences of a higher
    order say less; the least counts. Missing samples are NaN.
    """
    found = []
    for order in ORDERS:
        difference = np.abs(np.diff(position, n=order))
        difference = difference[np.isfinite(difference)]
        if len(difference):
            found.append(float(np.median(difference)) / _median_of_noise(order))
    return min(found, default=0.0)


def noise_course(series: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviation of a series' noise at each of its samples (n) [its unit]; see `position_noise`.

    An encoder of coarse steps is quiet at rest, and a line's own error is as fast as the motion: told in pieces, with
    lines between their middles. No sample may be missing.
    """
    pieces = len(series) // PIECE
    if pieces < 2:
        return np.full(len(series), position_noise(series))
    cut = series[: pieces * PIECE].reshape(pieces, PIECE)
    sizes = np.min(
        [np.median(np.abs(np.diff(cut, n=order)), axis=1) / _median_of_noise(order) for order in ORDERS], axis=0
    )
    middles = (np.arange(pieces) + 0.5) * PIECE
    return np.asarray(np.interp(np.arange(len(series)), middles, sizes))


def find_jumps(series: NDArray[np.float64], longest: int) -> NDArray[np.bool_]:
    """Mark samples of a series (n), `longest` in a row at most, that jump away and come back.

    Either edge is JUMP times the change of the samples beside it, and a sample's usual change. Missing samples are
    NaN.
    """
    jumped = np.zeros(len(series), dtype=np.bool_)
    measured = np.flatnonzero(np.isfinite(series))
    values = series[measured]
    sizes = np.abs(np.diff(values))
    if longest < 1 or not np.any(sizes):
        return jumped
    still = np.full(BESIDE, np.median(sizes[sizes > 0.0]))
    beside = sliding_window_view(np.concatenate((still, sizes, still)), BESIDE).max(axis=1)
    edges = np.flatnonzero(sizes > JUMP * np.maximum(beside[: len(sizes)], still[0]))
    returns = np.flatnonzero(sizes > JUMP * np.maximum(beside[BESIDE + 1 :], still[0]))
    for edge in edges:
        near = returns[
            np.searchsorted(returns, edge, side="right") : np.searchsorted(returns, edge + longest, side="right")
        ]
        back = near[np.abs(values[near + 1] - values[edge]) < sizes[edge] / JUMP]
        if len(back):
            jumped[measured[edge + 1 : back[0] + 1]] = True
    return jumped


def _median_of_noise(order: int) -> float:
    """Median size of the differences of white noise of one standard deviation."""
    return MEDIAN_OF_NORMAL * math.sqrt(math.comb(2 * order, order))


def encoder_step(position: NDArray[np.float64]) -> float:
    """Step of the encoder that read a position (n) [its unit]; 0 where none shows. Missing samples are NaN.

    The smallest change but for one in a hundred, if the other small ones are multiples of it. Where an axis goes many
    steps a sample all the time, the smallest change of a change is it, if the changes are multiples of that.
    """
    changes = np.abs(np.diff(position))
    rounding = ROUNDING * float(np.nanmax(changes, initial=0.0))
    step, even, others = _find_multiples(changes, rounding)
    if step == 0.0:
        return 0.0
    if float(np.mean(others)) > OTHERS:
        counted = float(np.mean(even[others])) > EVEN and float(np.mean(even)) > EVEN
    else:
        # One step at a time: a motion of constant speed has changes of one size as well, but no pauses between them.
        moves = changes > 0.5 * step
        alone = ~moves[:-2] | ~moves[2:]
        counted = float(np.mean(alone[moves[1:-1]])) > ALONE if moves[1:-1].any() else False
    return step if counted else _find_step_at_speed(position, changes)


def _find_step_at_speed(position: NDArray[np.float64], changes: NDArray[np.float64]) -> float:
    """Step of an encoder of which every sample passes several, as of `encoder_step`."""
    again = np.abs(np.diff(position, n=2))
    again = again[np.isfinite(again)]
    if not len(again):
        return 0.0
    step, even, _ = _find_multiples(again, DIGITS * float(again.max()))
    if step == 0.0 or float(np.mean(even)) <= EVEN:
        return 0.0
    small = (again > 0.5 * step) & (again <= SMALL * step)
    step = float(np.sum(again[small]) / np.sum(np.round(again[small] / step)))
    # A motion of constant acceleration has changes that differ by multiples as well, but are none.
    counts = changes[(changes > 0.5 * step) & (changes < MANY * step)] / step
    counted = len(counts) > 0 and float(np.mean(np.abs(counts - np.round(counts)) < UNEVEN)) > EVEN
    return step if counted else 0.0


def _find_multiples(
    changes: NDArray[np.float64], rounding: float
) -> tuple[float, NDArray[np.bool_], NDArray[np.bool_]]:
    """The smallest of some changes but for one in a hundred; the small ones that are multiples, and other than one."""
    changes = changes[changes > rounding]
    if not len(changes):
        return 0.0, np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=np.bool_)
    step = float(np.quantile(changes, 0.01))
    small = changes <= SMALL * step  # of many steps the rounding of a file's digits adds up
    steps = changes[small] / step
    even = np.abs(steps - np.round(steps)) < UNEVEN
    return step, even, ~even | (np.round(steps) != 1.0)
