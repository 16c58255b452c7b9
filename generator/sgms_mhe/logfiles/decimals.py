"""Numbers in a text: their form, decimal mark and value."""

import re
from typing import Final, Literal

Mark = Literal[".", ","]

MISSING: Final = frozenset(
    ("", "-", "--", "---", "nan", "na", "n/a", "#n/a", "null", "none", "nil", "missing", "1.#qnan", "-1.#ind", "-nan")
)
"""How a missing sample is written, in lower case."""

_EXPONENT: Final = r"(?:[eEdD][+-]?\d+)?"
_SPACED: Final = re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:[ '’]\d{{3}})+(?:[.,]\d*)?{_EXPONENT}", re.ASCII)
"""Groups of three digits whose mark is no decimal mark."""
_INFINITE: Final = re.compile(r"[+-]?inf(?:inity)?", re.IGNORECASE)
_QUICK: Final = re.compile(r"-?\d+\.?\d*(?:[eE][+-]?\d+)?", re.ASCII)
_COULD_BE_GROUPS: Final = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)
_MINUS: Final = "\N{MINUS SIGN}"
_NUMBERS: Final = {
    mark: re.compile(
        rf"[+-]?(?:\d+[{mark}]?\d*|[{mark}]\d+|\d{{1,3}}(?:[{other}]\d{{3}})+(?:[{mark}]\d*)?){_EXPONENT}", re.ASCII
    )
    for mark, other in (".,", ",.")
}
"""Numbers by their decimal mark, with groups of three digits by the other or without."""


def is_missing(token: str) -> bool:
    """Return True if a field stands for a missing sample."""
    return token.lower() in MISSING


def _plain(token: str) -> str:
    """A field without marks but the decimal one: groups of thousands by spaces or apostrophes, a typeset minus."""
    if token.isascii() and " " not in token and "'" not in token:
        return token
    token = token.replace(_MINUS, "-")
    return re.sub(r"[\s'’]", "", token) if _SPACED.fullmatch(re.sub(r"\s", " ", token)) else token


def is_number(token: str) -> bool:
    """Return True if a field is a number by one of the decimal marks."""
    token = _plain(token)
    return any(form.fullmatch(token) for form in (*_NUMBERS.values(), _INFINITE))


def value_of(token: str, mark: Mark) -> float:
    """A field's value by a decimal mark; groups of three digits are those of the other. ValueError for no number."""
    if mark == "." and _QUICK.fullmatch(token):
        return float(token)
    if is_missing(token):
        return float("nan")
    token = _plain(token)
    if _INFINITE.fullmatch(token):
        return float(token)
    if not _NUMBERS[mark].fullmatch(token):
        raise ValueError(f"{token!r} is no number")
    plain = token.replace("," if mark == "." else ".", "").replace(mark, ".")
    return float(plain.replace("d", "e").replace("D", "e"))


def told_by(token: str) -> Mark | Literal["either"] | None:
    """The decimal mark a field tells; `either` for 1,234, which may be both; None where it tells nothing.

    A comma with other than three digits behind it, with a zero or nothing before it, or with an exponent, is a decimal
    mark, and so is one after groups by points. A point is one by the same rules; commas that occur twice or stand
    before a point are groups. 1.234 alone tells nothing: where nothing else is told, a point is the decimal mark.
    """
    if not ("," in token or "." in token) or not is_number(token):
        return None
    token = _plain(token)
    last = max(token.rfind(","), token.rfind("."))
    mark: Mark = "," if token[last] == "," else "."
    other: Mark = "." if mark == "," else ","
    if token.count(mark) > 1:
        return other
    if other not in token and _COULD_BE_GROUPS.fullmatch(token):
        return "either" if mark == "," else None
    return mark
