"""Series of samples: means and sums over them, and shifts of them in time."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.sparse import csc_array

from sgms_mhe.support.arrays import Array, Index, Mask


def row_means(series: Array, factor: int) -> Array:
    """Means over `factor` samples each, (n, ...) to (n // factor, ...); samples that fill no row are left out.

    Of one sample each they are the series itself.
    """
    if factor == 1:
        return series
    m = len(series) // factor
    rows = series[: m * factor].reshape(m, factor, *series.shape[1:])
    # numpy's own mean takes five times as long over a short axis.
    return np.asarray(np.einsum("ij...->i...", rows) / factor)


def find_runs(mask: Mask) -> list[tuple[int, int]]:
    """(first, after the last) of every run of true entries (n)."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def bin_sums(series: Array, weight: Array, index: Index, count: int) -> Array:
    """Sums over the rows of each bin of weight (m) times series (m, k): (count, k); `index`: each row's bin (m).

    A product with a sparse matrix: all series at once, where `bincount` goes through the rows for each.
    """
    m = len(index)
    return np.asarray(csc_array((weight, index, np.arange(m + 1)), shape=(count, m)) @ series)


@dataclass(frozen=True)
class Shift:
    """A delay of all samples: each is made of four, and beyond the ends the last one goes on (Lagrange).

    Lines would lose half of a signal near half the rate, which looks like a resonance.

    Attributes:
        first: the first of the four, from the sample on.
        weights: of the four.
        slopes: derivatives of these in the delay [1/s].
    """

    first: int
    weights: tuple[float, ...]
    slopes: tuple[float, ...]

    @classmethod
    def of(cls, delay: float, rate: float) -> Self:
        """By a delay [s], below zero to earlier ones, of samples at a rate [Hz]."""
        back = -delay * rate
        whole = math.floor(back)
        u = back - whole  # the place between the second and the third
        weights = (
            -u * (u - 1.0) * (u - 2.0) / 6.0,
            (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
            -(u + 1.0) * u * (u - 2.0) / 2.0,
            (u + 1.0) * u * (u - 1.0) / 6.0,
        )
        by_place = (
            -(3.0 * u**2 - 6.0 * u + 2.0) / 6.0,
            (3.0 * u**2 - 4.0 * u - 1.0) / 2.0,
            -(3.0 * u**2 - 2.0 * u - 2.0) / 2.0,
            (3.0 * u**2 - 1.0) / 6.0,
        )
        return cls(whole - 1, weights, tuple(-slope * rate for slope in by_place))

    def of_series(self, series: Array) -> Array:
        """A series (n) or (n, k) later."""
        return self._sum(series, self.weights)

    def slope_of(self, series: Array) -> Array:
        """Its derivative in the delay [1/s]."""
        return self._sum(series, self.slopes)

    def _sum(self, series: Array, by: tuple[float, ...]) -> Array:
        before, after = max(0, -self.first), max(0, self.first + len(by) - 1)
        padded = np.pad(series, [(before, after), *[(0, 0)] * (series.ndim - 1)], mode="edge")
        start, n = self.first + before, len(series)
        # A model that has run away stays without a number, which its fit refuses.
        with np.errstate(invalid="ignore"):
            return np.asarray(sum(weight * padded[start + k : start + k + n] for k, weight in enumerate(by)))
