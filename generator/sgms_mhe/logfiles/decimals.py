"""Numbers in a text: what is one, what its decimal mark is, and its value."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

Mark = Literal[".", ","]

MISSING: Final = frozenset(
    ("", "-", "--", "---", "nan", "na", "n/a", "#n/a", "null", "none", "nil", "missing", "1.#qnan", "-1.#ind", "-nan")
)
"""How a missing sample is written, in lower case."""

_EXPONENT: Final = r"(?:[eEdD][+-]?\d+)?"
_PLAIN: Final = re.compile(rf"[+-]?(?:\d+[.,]?\d*|[.,]\d+){_EXPONENT}", re.ASCII)
_GROUPED: Final = re.compile(rf"[+-]?\d{{1,3}}(?:(?:,\d{{3}})+(?:\.\d*)?|(?:\.\d{{3}})+(?:,\d*)?){_EXPONENT}", re.ASCII)
_INFINITE: Final = re.compile(r"[+-]?inf(?:inity)?", re.IGNORECASE)
_COULD_BE_GROUPS: Final = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)
_WITHOUT_GROUPS: Final = {
    ".": re.compile(rf"[+-]?(?:\d+\.?\d*|\.\d+){_EXPONENT}", re.ASCII),
    ",": re.compile(rf"[+-]?(?:\d+,?\d*|,\d+){_EXPONENT}", re.ASCII),
}
_WITH_GROUPS: Final = {
    ".": re.compile(rf"[+-]?\d{{1,3}}(?:,\d{{3}})+(?:\.\d*)?{_EXPONENT}", re.ASCII),
    ",": re.compile(rf"[+-]?\d{{1,3}}(?:\.\d{{3}})+(?:,\d*)?{_EXPONENT}", re.ASCII),
}


def is_missing(token: str) -> bool:
    """Whether a field says that there is no sample."""
    return token.lower() in MISSING


def is_number(token: str) -> bool:
    """Whether a field is a number by one of the decimal marks."""
    return bool(_PLAIN.fullmatch(token) or _GROUPED.fullmatch(token) or _INFINITE.fullmatch(token))


def value_of(token: str, mark: Mark) -> float:
    """A field's value by a decimal mark; groups of three digits are those of the other. ValueError for no number."""
    if is_missing(token):
        return float("nan")
    if _INFINITE.fullmatch(token):
        return float(token)
    other = "," if mark == "." else "."
    if _WITHOUT_GROUPS[mark].fullmatch(token):
        plain = token
    elif _WITH_GROUPS[mark].fullmatch(token):
        plain = token.replace(other, "")
    else:
        raise ValueError(f"{token!r} is no number")
    return float(plain.replace(mark, ".").replace("d", "e").replace("D", "e"))


@dataclass(frozen=True)
class MarkEvidence:
    """Fields that tell the decimal mark, the first of each kind; None where there is none.

    Attributes:
        comma: whose comma can only be a decimal mark.
        point: whose point can only be a decimal mark, or whose commas can only be groups.
        either: whose comma may be both.
    """

    comma: str | None = None
    point: str | None = None
    either: str | None = None

    @property
    def mark(self) -> Mark | None:
        """The decimal mark; None where the fields contradict each other or do not tell."""
        if self.comma is not None:
            return None if self.point is not None else ","
        return None if self.point is None and self.either is not None else "."


def evidence(tokens: Iterable[str]) -> MarkEvidence:
    """What the numbers among fields say of the decimal mark.

    A comma with other than three digits behind it, with a zero or nothing before it, or with an exponent, is a decimal
    mark, and so is one after groups by points. A point is one by the same rules, and commas that occur twice or stand
    before a point are groups. 1,234 may be both.
    """
    found: dict[str, str] = {}
    for token in tokens:
        if not ("," in token or "." in token) or not is_number(token):
            continue
        last = max(token.rfind(","), token.rfind("."))
        mark, other = token[last], "." if token[last] == "," else ","
        repeated = token.count(mark) > 1
        if repeated or (_COULD_BE_GROUPS.fullmatch(token) and other not in token):
            # Groups by this mark would make the other one the decimal mark; by one alone nothing is told.
            kind = ("point" if mark == "," else "comma") if repeated else ("either" if mark == "," else "")
        else:
            kind = "comma" if mark == "," else "point"
        if kind:
            found.setdefault(kind, token)
    return MarkEvidence(**found)
