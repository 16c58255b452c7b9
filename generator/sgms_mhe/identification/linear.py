"""Linear least squares with some coefficients at least 0: a convex problem, so that no start decides its solution."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RIDGE: Final = 1e-8
"""Of the diagonal of normal equations: columns that are the same to so many digits share what they explain."""
TINY: Final = 1e-300


def solve_bounded(gram: Array, moment: Array, positive: Mask, information: Array) -> Array:
    """Minimise |y - X b|^2 + sum_j information_j b_j^2 with b_j >= 0 where positive.

    Free coefficients are eliminated by the triangular factor of the normal equations, in which they come first; what is
    left is nonnegative least squares.

    Args:
        gram: X'X (p, p).
        moment: X'y (p).
        positive: which coefficients are at least 0 (p).
        information: of the prior (p).

    Returns:
        b (p); 0 where a column is.
    """
    diagonal = np.diag(gram)
    scale = np.where(diagonal > TINY, 1.0 / np.sqrt(np.maximum(diagonal, TINY)), 0.0)
    order = np.argsort(positive, kind="stable")
    free = int((~positive).sum())
    A = (gram * np.outer(scale, scale))[np.ix_(order, order)]
    A = A + np.diag((information * scale**2)[order] + RIDGE + (scale[order] == 0.0))
    R = np.linalg.cholesky(A).T
    q = solve_triangular(R, (moment * scale)[order], trans="T")
    result = np.empty(len(moment))
    rest = nnls(R[free:, free:], q[free:])[0] if free < len(q) else q[free:]
    result[free:] = rest
    if free:
        result[:free] = solve_triangular(R[:free, :free], q[:free] - R[:free, free:] @ rest)
    coefficients = np.empty(len(moment))
    coefficients[order] = result
    return np.asarray(coefficients * scale)
