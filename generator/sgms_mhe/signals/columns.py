"""This package's own CSV: named columns, commas, numbers by shortest round-trip."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

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
