"""Arrays by the type of their numbers, for annotations; shapes stand in docstrings."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
AnyArray = NDArray[Any]

TINY: Final = float(np.finfo(np.float64).tiny)
"""Least normal number: keeps quotients of nothing finite."""
