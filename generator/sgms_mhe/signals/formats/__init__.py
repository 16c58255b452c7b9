"""Formats of log files, a module each: path and wanted variables in, their columns out."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from sgms_mhe.signals.formats.delimited import read_columns, read_delimited, write_columns
from sgms_mhe.signals.formats.mat import read_mat
from sgms_mhe.signals.formats.npz import read_npz
from sgms_mhe.signals.formats.variables import Choose, Variables

READERS: Final[Mapping[str, Callable[[Path, Choose], Variables]]] = MappingProxyType(
    {".csv": read_delimited, ".txt": read_delimited, ".npz": read_npz, ".mat": read_mat}
)
"""Reader of each format by the suffix of the file's name, in lower case."""

__all__ = ["READERS", "read_columns", "write_columns"]
