"""What an integrator returns: intervals and outputs, with their sensitivities."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Linearised(NamedTuple):
    """Intervals and their sensitivities: x1 (n, n_x), A (n, n_x, n_x), B (n, n_x, n_p)."""

    x1: Array
    A: Array
    B: Array


class Outputs(NamedTuple):
    """Outputs and their sensitivities: y [N] (n,), C (n, n_x), D (n, n_p)."""

    y: Array
    C: Array
    D: Array
