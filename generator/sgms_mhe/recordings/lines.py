"""Lines of a spectrum: a force that comes again in time, or in place, is no noise."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from sgms_mhe.support.arrays import Array

NEIGHBOURS: Final = 64  # frequencies whose median is the background of each
BEYOND_CHANCE: Final = 9.0
"""Power of a line beyond that of the largest of as many frequencies of noise [background]: e^-9 by chance. The
background is that of the neighbours, or of white noise of the same power, whichever is more."""
MOST_LINES: Final = 16
ROUGH: Final = 0.05
"""Largest part of a coordinate beside the polynomial in a segment [period of a line]: at rest a position is noise, and
the force of its acceleration goes with it."""
SOLVABLE: Final = 1e-10  # of the largest diagonal entry, added to all


@dataclass
class Lines:
    """Sines along coordinates of segments, found one after the other in a polynomial's residual of these.

    Attributes:
        coordinates: instants [s] and positions [m], say, of the rows (k, width) each.
        basis: of the polynomial taken out of every segment, orthonormal (width, order + 1).
        found: coordinate's number and cycles per unit of it, of each line.
        waves: cosine and sine of each (2, k, width).
    """

    coordinates: tuple[Array, ...]
    basis: Array
    found: list[tuple[int, float]] = field(default_factory=list)
    waves: list[Array] = field(default_factory=list)

    def add_line(self, rest: Array, left: Array) -> Array | None:
        """Find the strongest line that is left, and fit all lines anew.

        Segments count the less the more is left in them: a push, a reversal is no line.

        Args:
            rest: residual of the polynomial (k, width).
            left: that, without the lines found before.

        Returns:
            The residual of polynomial and lines (k, width); None where there is no further line.
        """
        power = np.mean(left**2, axis=1, keepdims=True)
        usual = float(np.median(power))
        if len(self.found) == MOST_LINES or usual == 0.0:
            return None
        weight = np.sqrt(usual / np.maximum(power, usual))
        lines = [_find_strongest((weight * left).ravel(), at.ravel(), self._finest(at)) for at in self.coordinates]
        strongest, frequency, which = max(((*line, k) for k, line in enumerate(lines)), default=(0.0, 0.0, 0))
        if strongest == 0.0:
            return None
        self.found.append((which, frequency))
        self.waves.append(self._wave(which, frequency))
        weights, seen = np.repeat(weight, rest.shape[1]), (weight * rest).ravel()
        # A step of Gauss and Newton in all frequencies.
        columns = weights * self._project(self.waves)
        sizes = _solve(columns, seen)
        slopes = [
            self._turns(which) * (sine * wave[0] - cosine * wave[1])
            for (which, _), wave, cosine, sine in zip(self.found, self.waves, sizes[0::2], sizes[1::2], strict=True)
        ]
        moves = _solve(np.concatenate((columns, weights * self._project(slopes))), seen)[len(sizes) :]
        self.found = [self._moved(line, float(move)) for line, move in zip(self.found, moves, strict=True)]
        self.waves = [self._wave(*line) for line in self.found]
        columns = self._project(self.waves)
        return np.asarray(rest - (_solve(weights * columns, seen) @ columns).reshape(rest.shape))

    def _finest(self, coordinate: Array) -> float:
        """Cycles per unit of a coordinate (k, width) that a line may have, at most."""
        rough = coordinate - coordinate @ self.basis @ self.basis.T
        return ROUGH / max(math.sqrt(float(np.median(np.mean(rough**2, axis=1)))), 1e-300)

    def _moved(self, line: tuple[int, float], move: float) -> tuple[int, float]:
        """A line at another frequency, no more than half the distance of two."""
        most = 0.5 / float(np.ptp(self.coordinates[line[0]]))
        return line[0], line[1] + min(max(move, -most), most)

    def _turns(self, which: int) -> Array:
        """A coordinate from its middle on, times 2 pi (k, width)."""
        at = self.coordinates[which]
        return np.asarray(2.0 * math.pi * (at - 0.5 * (float(at.min()) + float(at.max()))))

    def _wave(self, which: int, frequency: float) -> Array:
        """Cosine and sine of a line (2, k, width)."""
        angle = frequency * self._turns(which)
        return np.stack((np.cos(angle), np.sin(angle)))

    def _project(self, series: Sequence[Array]) -> Array:
        """Return series (..., k, width), the polynomial taken out of each, one behind the other (series, rows)."""
        stacked = np.stack(series)
        stacked -= stacked @ self.basis @ self.basis.T
        return stacked.reshape(-1, self.coordinates[0].size)


def _solve(X: Array, y: Array) -> Array:
    """Least squares of series (p, rows) that may be alike."""
    scale = np.sqrt(np.einsum("ij,ij->i", X, X)) + 1e-300
    gram = X @ X.T / np.outer(scale, scale)
    return np.asarray(np.linalg.solve(gram + SOLVABLE * np.eye(len(X)), X @ y / scale) / scale)


def _find_strongest(series: Array, coordinate: Array, finest: float) -> tuple[float, float]:
    """Return the power and the frequency of the strongest line of a series (n); 0 where none stands above the noise.

    Of no more cycles than `finest` per unit of the coordinate (n), and than half the rows over its extent.
    """
    count, start, span = len(series), float(coordinate.min()), float(np.ptp(coordinate))
    if span <= 0.0 or count < NEIGHBOURS:
        return 0.0, 0.0
    # Sums over twice as many cells as cycles, and twice as many frequencies as are independent.
    cell = np.minimum(2 * count - 1, ((coordinate - start) * (2 * count / span)).astype(np.int64))
    sums = np.bincount(cell, weights=series, minlength=2 * count)
    power = np.abs(np.fft.rfft(sums, 4 * count)[1 : count + 1]) ** 2
    power = power[: len(power) // NEIGHBOURS * NEIGHBOURS].reshape(-1, NEIGHBOURS)
    # Of noise the power is distributed exponentially about its mean.
    background = np.maximum(np.median(power, axis=1) / math.log(2.0), float(series @ series))
    frequency = 0.5 * np.arange(1, power.size + 1).reshape(power.shape) / span
    high = (power > (math.log(count) + BEYOND_CHANCE) * background[:, None]) & (frequency <= finest)
    if not high.any():
        return 0.0, 0.0
    strongest = int(np.argmax(np.where(high, power, 0.0)))
    return float(power.ravel()[strongest]), float(frequency.ravel()[strongest])
