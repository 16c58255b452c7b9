"""HDF5, by h5py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sgms_mhe.logfiles.table import Array, Column, Table, array_row, damage_error, real
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.libraries import optional_library

_WHOLE = "a whole HDF5 file, its columns arrays of real numbers"


def read_hdf5(path: Path) -> Table:
    """The table of every array below the file's root, groups as paths with dots. A unit is an attribute `unit(s)`.

    Raises InputError for a damaged file and where h5py is absent, OSError as open does.
    """
    h5py = optional_library("h5py", "hdf5", "HDF5", path)
    with path.open("rb"):
        pass  # a file that cannot be opened is told from one that is no HDF5
    found: dict[str, tuple[str, Column]] = {}

    def note(name: str, node: Any) -> None:
        if not isinstance(node, h5py.Dataset) or name.startswith("#"):
            return
        if node.dtype.names:
            for member in node.dtype.names:
                column = f"{_dot_name(name)}.{member}"
                found[column] = (name, Column(column, column, shape=node.shape))
        elif node.dtype.kind in "fiub":
            column = _dot_name(name)
            found[column] = (name, Column(column, column, stated_unit(node), node.shape))

    try:
        with h5py.File(path, "r") as content:
            content.visititems(note)
    except Exception as error:  # the readers of a damaged file stumble in many ways
        raise damage_error(path, _WHOLE, error) from None

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        try:
            with h5py.File(path, "r") as content:
                values = {}
                for name in names:
                    node = content[found[name][0]]
                    value = node[name.rsplit(".", 1)[1]] if node.dtype.names else node[()]
                    values[name] = real(path, name, value)
                return values
        except InputError:
            raise
        except Exception as error:
            raise damage_error(path, _WHOLE, error) from None

    return Table("HDF5", tuple(column for _, column in found.values()), read, array_row)


def _dot_name(name: str) -> str:
    return name.strip("/").replace("/", ".")


def stated_unit(node: Any) -> str:
    """The unit in an array's attributes, `unit(s)`; empty where there is none."""
    value = next((node.attrs[key] for key in ("unit", "units", "Unit", "Units") if key in node.attrs), "")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
