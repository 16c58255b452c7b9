"""Numbers with intervals, as every table, page, comment and message writes them."""

import math
from typing import Final

SIGMAS: Final = 2.0
"""Standard deviations on either side of a number, wherever a reader sees `+-`, and that a number differs from none by:
95 %. Columns of data have one."""


def interval(value: float, std: float, digits: int = 2) -> str:
    """A number with two standard deviations, `4.012 +- 0.015`; alone where it has none (NaN or 0)."""
    if not math.isfinite(std) or std <= 0.0:
        return f"{value:.6g}"
    wide = SIGMAS * std
    place = digits - 1 - math.floor(math.log10(wide))
    if abs(value) < 1e4 and 0 <= place <= 6:
        return f"{value:.{place}f} +- {wide:.{place}f}"
    return f"{value:.{_significant(value, wide)}g} +- {wide:.{digits}g}"


def round_number(value: float, std: float) -> float:
    """A value with as many digits as its deviation has meaning, two more for safety; at most twelve."""
    if value == 0.0 or not math.isfinite(std) or std <= 0.0:
        return float(f"{value:.12g}")
    return float(f"{value:.{min(12, _significant(value, std) + 1)}g}")


def _significant(value: float, std: float) -> int:
    """Digits of a value down to the second one of its deviation."""
    if value == 0.0:
        return 2
    return max(3, math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 2)
