"""NumPy's files: archives (.npz), and single arrays (.npy), structured or a matrix of one row or column a signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sgms_mhe.logfiles.table import Array, Column, Table, array_row, damage_error, real, seconds
from sgms_mhe.support.errors import InputError

_WHOLE = "a whole NPZ archive, or NPY file, of numeric arrays"


def read_numpy(path: Path) -> Table:
    """The table of an archive or of an array. Raises InputError for a damaged file, OSError as open does."""
    with path.open("rb") as stream:
        try:
            content = np.load(stream, allow_pickle=False)
            if isinstance(content, np.ndarray):
                return _array_table(path, content)
            found = {name: _describe(content, name) for name in content.files}
        except Exception as error:  # the readers of a damaged file stumble in many ways
            raise damage_error(path, _WHOLE, error) from None

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        try:
            with np.load(path, allow_pickle=False) as archive:
                values = {name: archive[name] for name in names}
        except Exception as error:
            raise damage_error(path, _WHOLE, error) from None
        return {name: _values(path, name, value) for name, value in values.items()}

    return Table("NPZ", tuple(found.values()), read, array_row, stamped=frozenset())


def _describe(archive: Any, name: str) -> Column:
    """A column of an archive, its shape read from the array's own header without its values."""
    with archive.zip.open(f"{name}.npy" if f"{name}.npy" in archive.zip.namelist() else name) as stream:
        version = np.lib.format.read_magic(stream)
        reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape = reader(stream)[0]
    return Column(name, name, shape=shape)


def _array_table(path: Path, array: Any) -> Table:
    names = array.dtype.names
    if names:
        columns = tuple(Column(name, name, shape=array.shape) for name in names)
        return Table(
            "NPY, structured", columns, lambda wanted: {n: _values(path, n, array[n]) for n in wanted}, array_row
        )
    if array.ndim != 2:
        allowed = "a matrix of at least three signals, time, position and force"
        raise InputError(path, "array", f"shape {array.shape}", allowed)
    return Table(
        "NPY", (Column(ARRAY, ARRAY, shape=array.shape),), lambda _: {ARRAY: real(path, ARRAY, array)}, array_row
    )


ARRAY = "array"
"""Name of the matrix in a file that names nothing."""


def _values(path: Path, name: str, value: Any) -> Array:
    array = np.asarray(value)
    return seconds(array) if array.dtype.kind == "M" and array.ndim == 1 else real(path, name, array)
