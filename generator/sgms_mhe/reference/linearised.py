"""What an integrator returns: intervals and outputs, with their sensitivities."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Outputs(NamedTuple):
    """Outputs and their sensitivities: y [N] (n,), C (n, n_x), D (n, n_p)."""

    y: Array
    C: Array
    D: Array


class Linearised(NamedTuple):
    """n intervals and their sensitivities to the node state where they start and to theta.

    Attributes:
        x1: where they end (n, n_x).
        A: its sensitivity to the node state (n, n_x, n_x).
        B: its sensitivity to theta (n, n_x, n_p).
        inner: outputs at the R - 1 readings inside of each: y (n, R - 1), C (n, R - 1, n_x), D (n, R - 1, n_p).
    """

    x1: Array
    A: Array
    B: Array
    inner: Outputs
