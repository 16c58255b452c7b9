"""A report's words: names of causes, sizes and changes, lists and sentences."""

import math
from collections.abc import Sequence
from typing import Final

from sgms_mhe.diagnosis import Cause
from sgms_mhe.model.effects import BASE_CAUSES, base_number, cause, cause_names
from sgms_mhe.report.units import force, force_suffix, percent, quantity

SIGNS: Final = {"certain": "✓", "limited": "✓", "undecided": "?", "failed": "!", "nothing": "–"}
"""Signs of a badge by its style, how far a result holds; only what is `certain` is green."""
LEAST_CHANGE: Final = 5e-4
"""Of a change: less is zero at the digits that it is written with."""


def title(name: str, *, own: bool = False) -> str:
    """Return the name of a cause in words; `own`: an effect the machine file has already."""
    words = cause(name).summary if name in cause_names() else name.replace("_", " ")
    return f"{words}: another value than the machine file's" if own else words


def cause_title(c: Cause) -> str:
    """Return the name of a named cause in words."""
    return title(c.name, own=bool(c.nominal) and c.name not in BASE_CAUSES)


def cause_text(c: Cause) -> str:
    """A cause in words, with its leading number where it is an effect."""
    key = next(iter(c.parameters), None)
    if key is None or c.nominal or c.name in BASE_CAUSES:
        return cause_title(c)
    return f"{title(c.name)} ({quantity(key, c.parameters[key], c.std.get(key, math.nan))})"


def base_words(name: str) -> str:
    """A base parameter's name in words."""
    number = base_number(name)
    if number is None:
        return name.replace("_", " ")
    # The stem of an array is the cause that means all of its elements.
    return f"{number.words} of element {number.element(name) + 1}" if number.is_element(name) else number.words


def relative_change(before: float, after: float) -> str:
    """A change in percent, with its sign."""
    if not (math.isfinite(before) and math.isfinite(after)) or before == 0.0:
        return "–"
    change = after / before - 1.0
    if abs(change) < LEAST_CHANGE:
        return percent(0.0)
    return ("+" if change >= 0.0 else "−") + percent(abs(change))


def between(low: float, high: float) -> str:
    """An interval of forces, or torques."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return "not known"
    return f"{force(low).removesuffix(force_suffix())} to {force(high)}"


def join_words(parts: Sequence[str]) -> str:
    """A list within a sentence."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def capital(text: str) -> str:
    """The text with a capital first."""
    return text[:1].upper() + text[1:]


def sentence(text: str) -> str:
    """The text as a sentence; names at its beginning stay as they are written."""
    text = text.strip()
    first = text.partition(" ")[0].rstrip(",:;")
    if first not in cause_names() and "_" not in first:  # names stay as they are written
        text = capital(text)
    return text if text.endswith((".", "!", "?", ":")) else text + "."
