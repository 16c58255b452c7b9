"""Libraries that come with an extra of this package: imported where they are needed, and not before."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sgms_mhe.support.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray


def optional_library(module: str, extra: str, purpose: str, source: str | Path = "sgms-mhe") -> Any:
    """Import a module of a library that is no dependency of this package.

    Args:
        module: its full name.
        extra: that brings the library.
        purpose: that the library is needed for, as in "HDF5".
        source: file or option that asked for it.

    Raises:
        InputError: it is not installed; the message says how to install it.
    """
    try:
        return import_module(module)
    except ImportError:
        allowed = f"not installed, {purpose} needs it: pip install 'sgms-mhe[{extra}]'"
        raise InputError(source, "library", module.partition(".")[0], allowed) from None


def data_frame(columns: Mapping[str, NDArray[Any]]) -> Any:
    """Return a pandas.DataFrame of columns (n,), in their order. Raises InputError where pandas is not installed."""
    return optional_library("pandas", "frames", "to_frame()").DataFrame(dict(columns))
