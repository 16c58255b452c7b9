"""Numbers in JSON, which has no NaN and no infinity."""

import math
from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any


def finite(content: Any) -> Any:
    """The content with plain floats, numpy's among them, and None for those that are not finite."""
    if isinstance(content, Mapping):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    if isinstance(content, Real) and not isinstance(content, Integral):
        return float(content) if math.isfinite(content) else None
    return content
