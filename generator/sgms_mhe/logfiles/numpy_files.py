"""NumPy's files: archives (.npz), and single arrays (.npy), structured or a matrix of one row or column a signal."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sgms_mhe.logfiles.table import StoredArray, Table, real, refuse_damage, seconds, table_of_arrays
from sgms_mhe.support.arrays import Array

_WHOLE = "a whole NPZ archive, or NPY file, of numeric arrays"


def read_numpy(path: Path) -> Table:
    """The table of an archive or of an array. Raises InputError for a damaged file, OSError as open does."""
    with path.open("rb") as stream, refuse_damage(path, _WHOLE):
        content = np.load(stream, allow_pickle=False)
        if isinstance(content, np.ndarray):
            return _array_table(path, content)
        found = {name: StoredArray(_shape(content, name), partial(_read, path, name)) for name in content.files}
    return table_of_arrays(path, "NPZ", _WHOLE, found)


def _read(path: Path, name: str) -> Array:
    with np.load(path, allow_pickle=False) as archive:
        return _values(path, name, archive[name])


def _shape(archive: Any, name: str) -> tuple[int, ...]:
    """Shape of an array of an archive, by its own header, without its values."""
    with archive.zip.open(f"{name}.npy" if f"{name}.npy" in archive.zip.namelist() else name) as stream:
        version = np.lib.format.read_magic(stream)
        reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        return tuple(reader(stream)[0])


def _array_table(path: Path, array: Any) -> Table:
    names = array.dtype.names
    if names:
        found = {name: StoredArray(array.shape, partial(_values, path, name, array[name])) for name in names}
        return table_of_arrays(path, "NPY, structured", _WHOLE, found)
    if array.ndim != 2:
        raise ValueError(f"shape {array.shape}, no matrix of at least three signals, time, position and force")
    found = {ARRAY: StoredArray(array.shape, partial(real, path, ARRAY, array))}
    return table_of_arrays(path, "NPY", _WHOLE, found)


ARRAY = "array"
"""Name of the matrix in a file that names nothing."""


def _values(path: Path, name: str, value: Any) -> Array:
    array = np.asarray(value)
    return seconds(array) if array.dtype.kind == "M" and array.ndim == 1 else real(path, name, array)
