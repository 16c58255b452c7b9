"""Real numeric variables of a MAT file, version 7.3, which is HDF5, members of structs and struct arrays among them.

A struct is a group. The fields of a struct array are arrays of references, of one shape, to its elements' values.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_mhe.logfiles.hdf5 import hdf_variable
from sgms_mhe.logfiles.table import StoredArray

VALUES: Final = ("Data", "data", "values", "Values")
"""Fields of a channel that hold its samples, where a name and a unit may stand beside them."""
DEEPEST: Final = 16
"""Structs within structs."""
_MOST: Final = 100_000
"""Variables of a file: references may lead in a circle."""


def describe_values(found: dict[str, StoredArray], path: str, texts: Mapping[str, str]) -> dict[str, StoredArray]:
    """The members `found` of the struct `path`, its values with the label and the unit among its texts."""
    label = next((texts[key] for key in ("name", "label", "title") if texts.get(key)), "")
    for name in found.keys() & {f"{path}.{field}" for field in VALUES}:
        unit = texts.get("unit", texts.get("units", found[name].unit))
        found[name] = replace(found[name], label=label, unit=unit)
    return found


def hdf_variables(path: Path, h5py: Any) -> dict[str, StoredArray]:
    """The variables of a file by name; raises as h5py does, and ValueError, where it is damaged."""
    with h5py.File(path, "r") as content:
        return _Walk(path, h5py, content).members({key: content[key] for key in content if key[:1] != "#"}, "", 0)


@dataclass(frozen=True)
class _Walk:
    """The way through an open file."""

    path: Path
    h5py: Any
    content: Any

    def struct(self, group: Any, path: str, depth: int) -> dict[str, StoredArray]:
        """Members of a struct by their paths; of an array of structs those of path(1), path(2), ..."""
        if depth > DEEPEST:
            return {}
        fields = {key: group[key] for key in group}
        if not fields or not all(map(self._is_referring, fields.values())):
            return self.members(fields, path, depth)
        references = {key: np.ravel(node[()]) for key, node in fields.items()}
        count = min(map(len, references.values()))
        found: dict[str, StoredArray] = {}
        for k in range(count):
            part = {key: self.content[places[k]] for key, places in references.items() if places[k]}
            found |= self.members(part, path if count == 1 else f"{path}({k + 1})", depth)
            if len(found) > _MOST:
                raise ValueError(f"more than {_MOST} variables")
        return found

    def members(self, fields: Mapping[str, Any], path: str, depth: int) -> dict[str, StoredArray]:
        """Numeric members of one struct by their paths, its values with the label and the unit beside them."""
        found: dict[str, StoredArray] = {}
        texts: dict[str, str] = {}
        for field, node in fields.items():
            name = f"{path}.{field}" if path else field
            if isinstance(node, self.h5py.Group):
                found |= self.struct(node, name, depth + 1)
            elif "MATLAB_empty" in node.attrs or node.dtype.kind not in "fiub":
                continue
            elif _class(node) == "char":
                texts[field.casefold()] = "".join(map(chr, np.ravel(node[()]))).strip("\0 ")
            else:
                found[name] = _turn(hdf_variable(self.path, self.h5py, name, node, ()))
        return describe_values(found, path, texts)

    def _is_referring(self, node: Any) -> bool:
        """Return True for the field of a struct array; a cell array refers too, and says so."""
        is_data = isinstance(node, self.h5py.Dataset)
        return is_data and self.h5py.check_ref_dtype(node.dtype) is not None and _class(node) != "cell"


def _turn(found: StoredArray) -> StoredArray:
    """A variable in MATLAB's shape."""
    return replace(found, shape=found.shape[::-1], read=lambda: found.read().T)


def _class(node: Any) -> str:
    value = node.attrs.get("MATLAB_class", b"")
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)
