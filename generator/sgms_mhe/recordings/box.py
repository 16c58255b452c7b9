"""Quadratic model of a sum of squares, minimised exactly over a box."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

Array = NDArray[np.float64]


def solve_box(A: Array, g: Array, lower: Array, upper: Array) -> Array:
    """Return argmin s'As/2 - g's subject to lower <= s <= upper.

    Where the free minimum leaves the box, it is bounded least squares of the Cholesky factor, |R s - R^-T g|^2, by
    the active-set method of Stark and Parker (1995). Clipping to the box instead can promise a negative gain.

    Args:
        A: symmetric, positive definite (n, n).
        g: (n).
        lower, upper: ends of the box (n), lower <= 0 <= upper, infinite where there is none.

    Returns:
        s (n).

    Raises:
        numpy.linalg.LinAlgError: A is not positive definite.
    """
    scale = 1.0 / np.sqrt(np.diag(A))
    R = np.linalg.cholesky(A * np.outer(scale, scale)).T
    q = solve_triangular(R, g * scale, trans="T")
    free = scale * solve_triangular(R, q)
    if np.all((free >= lower) & (free <= upper)):
        return np.asarray(free)
    moves = np.flatnonzero(upper > lower)
    s = lower.copy()
    if len(moves):
        fixed = np.where(upper > lower, 0.0, lower) / scale
        box = lower[moves] / scale[moves], upper[moves] / scale[moves]
        found = lsq_linear(R[:, moves], q - R @ fixed, box, method="bvls", tol=1e-12, max_iter=20 * len(moves))
        inside = np.clip(scale[moves] * found.x, lower[moves], upper[moves])
        s[moves] = np.select([found.active_mask < 0, found.active_mask > 0], [lower[moves], upper[moves]], inside)
    return s
