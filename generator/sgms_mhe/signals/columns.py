"""This package's own CSV: named columns, commas, numbers by shortest round-trip."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write


def write_columns(path: str | Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write named columns (n,) as CSV, atomically; floats by shortest round-trip, integers as integers."""
    block = 65536
    with atomic_write(path) as stream:
        stream.write((",".join(columns) + "\n").encode())
        length = len(next(iter(columns.values())))
        for start in range(0, length, block):
            parts = (map(repr, values[start : start + block].tolist()) for values in columns.values())
            stream.write("".join(",".join(row) + "\n" for row in zip(*parts, strict=True)).encode())


def read_columns(path: str | Path) -> dict[str, NDArray[np.float64]]:
    """Read the columns (n,) of a file that write_columns wrote. Raises InputError for any other file."""
    try:
        with Path(path).open(encoding="utf-8") as stream:
            names = stream.readline().rstrip("\n").split(",")
            values = np.loadtxt(stream, delimiter=",", comments=None, ndmin=2)
    except OSError as error:
        raise InputError(path, "file", None, f"a readable file ({error.strerror or error})") from None
    except ValueError as error:
        raise InputError(path, "file", None, f"a CSV file of numbers as this package writes it ({error})") from None
    if values.shape[1] != len(names):
        raise InputError(path, "line 1", len(names), f"as many names as the rows have numbers, {values.shape[1]}")
    return dict(zip(names, np.ascontiguousarray(values.T), strict=True))
