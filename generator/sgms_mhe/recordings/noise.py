"""Noise of a residual that holds more than noise, and its colour behind the signal chain."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.special import chdtr, chdtri

from sgms_mhe.machine import Machine
from sgms_mhe.recordings.lines import Lines
from sgms_mhe.signals.chain import lowpass_coefficients
from sgms_mhe.support.arrays import Array

SMOOTH_ORDER: Final = 2  # of the polynomial that is smooth over a piece
QUIETEST: Final = 0.1  # of the pieces: those that hold nothing but noise, if any do
LIKELY: Final = 0.95  # of pieces of noise have less variance than one that is left out
ROUNDS: Final = 100
SAME: Final = 1e-4  # relative change of the variance at which it has settled
LONGEST: Final = 1000  # pieces that lines are told from: those in the middle
MEMORY: Final = 12.0  # periods of the cutoff after which the low-passes' response is over


@dataclass(frozen=True, eq=False)
class Colour:
    """Residual of a polynomial through segments of noise of variance 1 behind the chain.

    Attributes:
        basis: orthonormal, of the polynomial (width, order + 1).
        left: variance per row that is left, of noise of the force and of the encoder (2).
        next: covariance of neighbouring rows that is left, over the rows of a piece (2).
        freedom: of the chi-squared distribution that comes nearest to a piece's variance.
    """

    basis: Array
    left: Array
    next: Array
    freedom: float


def find_colour(machine: Machine, factor: int, width: int, *, is_filtered: bool) -> Colour:
    """Return the colour of rows that are means over `factor` samples, in segments of `width` rows.

    `is_filtered`: whether they have passed the chain's low-passes.
    """
    coefficients = lowpass_coefficients(machine) if is_filtered else (1.0, 0.0, 0.0, 0.0, 0.0)
    return _colour(coefficients, machine.sampling.velocity_cutoff / machine.sampling.rate, factor, width)


@lru_cache(maxsize=32)
def _colour(coefficients: tuple[float, ...], cutoff: float, factor: int, width: int) -> Colour:
    b, a = coefficients[:3], (1.0, *coefficients[3:])
    impulse = np.zeros(math.ceil(MEMORY / cutoff) + (width + 1) * factor)
    impulse[factor] = 1.0
    force = lfilter(b, a, lfilter(b, a, impulse))
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), SMOOTH_ORDER + 1))[0]
    project = np.eye(width) - basis @ basis.T
    left, following, freedom = [], [], []
    # Friction is force less mass times acceleration, the second difference of position behind the same low-passes.
    for response in (force, np.diff(force, 2)):
        rows = np.convolve(response, np.full(factor, 1.0 / factor))
        lags = np.array([float(rows[: len(rows) - k * factor] @ rows[k * factor :]) for k in range(width)])
        rest = project @ toeplitz(lags / lags[0]) @ project
        left.append(float(np.trace(rest)) / width)
        following.append(float(np.trace(rest, offset=1)) / width)
        freedom.append(float(np.trace(rest)) ** 2 / float(np.sum(rest * rest)))
    return Colour(basis, np.array(left), np.array(following), min(freedom))


def quiet_variance(pieces: Array, colour: Colour, coordinates: tuple[Array, ...] = ()) -> tuple[float, float]:
    """Variance of the noise in pieces (k, width) some of which hold more than a polynomial and noise.

    Begins with the quietest pieces and takes in all others that noise of the variance so far would make: a push, a
    reversal a model gets wrong, leaves its piece out, however many of them there are. The polynomial's share
    of the noise is estimated from the correlation of neighbouring rows: the chain makes the force's noise slow, the
    encoder's, twice differentiated, fast.

    Args:
        pieces: rows of the residual.
        colour: of the noise.
        coordinates: of the rows (k, width) each, along which a force may come again.

    Returns:
        That of all, and that of the background: without lines of the spectra over the coordinates.
    """
    rest = pieces - pieces @ colour.basis @ colour.basis.T
    whole = _measure_quiet(rest, colour)
    first = max(0, (len(rest) - LONGEST) // 2)
    part = slice(first, first + LONGEST)
    return whole, whole * _background_share(rest[part], colour, tuple(at[part] for at in coordinates))


def _background_share(rest: Array, colour: Colour, coordinates: tuple[Array, ...]) -> float:
    """Share of the noise in a polynomial's residual (k, width) without lines."""
    whole = least = _measure_quiet(rest, colour)
    lines, left = Lines(coordinates, colour.basis), rest
    while (found := lines.add_line(rest, left)) is not None:
        left = found
        least = min(least, _measure_quiet(left, colour))
    return least / whole if whole > 0.0 else 1.0


def _measure_quiet(rest: Array, colour: Colour) -> float:
    """Variance of the noise in the pieces of a polynomial's residual (k, width) that noise alone would make."""
    power = np.mean(rest**2, axis=1)
    likely, quietest = chdtri(colour.freedom, 1.0 - np.array([LIKELY, QUIETEST])).tolist()
    most = likely / colour.freedom
    share = float(chdtr(colour.freedom + 2.0, likely)) / LIKELY  # of the mean, below that
    mean = float(np.quantile(power, QUIETEST) / quietest * colour.freedom)
    quiet = power <= most * mean
    for _ in range(ROUNDS):
        if not quiet.any():
            break
        before, mean = mean, float(power[quiet].mean()) / share
        quiet = power <= most * mean
        if abs(mean - before) <= SAME * before:
            break
    if not quiet.any():
        return mean / float(colour.left[0])
    products = np.sum(rest[quiet, 1:] * rest[quiet, :-1], axis=1)
    return _solve_both(mean, float(np.mean(products)) / rest.shape[1] / share, colour)


def _solve_both(mean: float, following: float, colour: Colour) -> float:
    """Variance of the force's and the encoder's noise together, that leave so much on rows and between neighbours."""
    force, encoder = np.linalg.solve(np.vstack((colour.left, colour.next)), [mean, following])
    if encoder <= 0.0:
        return mean / float(colour.left[0])
    if force <= 0.0:
        return mean / float(colour.left[1])
    return float(force + encoder)
