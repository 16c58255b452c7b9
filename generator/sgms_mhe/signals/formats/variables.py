"""What every reader of a file returns, and how it refuses a damaged one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]
Choose = Callable[[Sequence[str]], Iterable[str]]
"""Which of the variables found in a file are wanted."""


@dataclass(frozen=True)
class Variables:
    """The wanted variables of a file (n,), and how to tell a user where row i (from 0) stands in it."""

    by_name: Mapping[str, Array]
    row: Callable[[int], str]


def damaged(path: Path, allowed: str, error: Exception) -> InputError:
    """The error of a file that its reader stumbles over."""
    return InputError(path, "file", None, f"{allowed} ({type(error).__name__}: {error})")


def array_row(index: int) -> str:
    """Where a row stands in a file of arrays."""
    return f"row {index + 1}"


def vector(path: Path, name: str, value: Any) -> Array:
    """A variable as a column (n,). Raises InputError for what is no vector of real numbers."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiub" or array.size != max(array.shape, default=0):
        found = f"{array.dtype} array of shape {array.shape}"
        raise InputError(path, f"variable {name}", found, "a vector of real numbers, one per row")
    return array.reshape(-1).astype(np.float64)
