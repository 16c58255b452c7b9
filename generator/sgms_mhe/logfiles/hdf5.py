"""HDF5, by h5py."""

from pathlib import Path
from typing import Any

from sgms_mhe.logfiles.table import StoredArray, Table, real, refuse_damage, table_of_arrays
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.libraries import optional_library

_WHOLE = "a whole HDF5 file, its columns arrays of real numbers"


def read_hdf5(path: Path) -> Table:
    """The table of every array below the file's root, groups as paths with dots. A unit is an attribute `unit(s)`.

    Raises InputError for a damaged file and where h5py is absent, OSError as open does.
    """
    h5py = optional_library("h5py", "hdf5", "HDF5", path)
    found: dict[str, StoredArray] = {}

    def note(place: str, node: Any) -> None:
        if not isinstance(node, h5py.Dataset) or place.startswith("#"):
            return
        name = place.strip("/").replace("/", ".")
        for member in node.dtype.names or ():
            found[f"{name}.{member}"] = hdf_variable(path, h5py, f"{name}.{member}", node, member)
        if node.dtype.kind in "fiub":
            found[name] = hdf_variable(path, h5py, name, node, ())

    with refuse_damage(path, _WHOLE), h5py.File(path, "r") as content:
        content.visititems(note)
    return table_of_arrays(path, "HDF5", _WHOLE, found)


def hdf_variable(path: Path, h5py: Any, name: str, node: Any, part: str | tuple[()]) -> StoredArray:
    """The array at a node of an open file, or the member `part` of its elements, which have no unit."""
    place = node.name

    def read() -> Array:
        with h5py.File(path, "r") as content:
            return real(path, name, content[place][part])

    return StoredArray(node.shape, read, unit="" if part else stated_unit(node))


def stated_unit(node: Any) -> str:
    """The unit in an array's attributes, `unit(s)`; empty where there is none."""
    value = next((node.attrs[key] for key in ("unit", "units", "Unit", "Units") if key in node.attrs), "")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
