"""Rows: means over samples of a series; and their sums over bins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

Array = NDArray[np.float64]


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


def bin_sums(series: Array, weight: Array, index: NDArray[np.int64], count: int) -> Array:
    """Sums over the rows of each bin of weight (m) times series (m, k): (count, k); `index`: each row's bin (m).

    A product with a sparse matrix: all series at once, where `bincount` goes through the rows for each.
    """
    m = len(index)
    return np.asarray(csc_array((weight, index, np.arange(m + 1)), shape=(count, m)) @ series)
