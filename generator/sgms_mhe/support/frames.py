"""Series as a pandas.DataFrame, for people who work in Python."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from numpy.typing import NDArray


def data_frame(columns: Mapping[str, NDArray[Any]]) -> Any:
    """A pandas.DataFrame of these columns (n,), in their order.

    pandas is imported here and not before: nothing that is computed or emitted hangs on it.
    """
    return import_module("pandas").DataFrame(dict(columns))
