"""Time stamps in a text: ISO 8601 with and without a zone, dates day or month first, times of day, durations."""

import math
import re
from collections.abc import Iterable, Sequence
from datetime import date
from typing import Final

import numpy as np

from sgms_mhe.logfiles.decimals import is_missing
from sgms_mhe.support.arrays import Array

_CLOCK: Final = (
    r"(?P<h>\d{1,2}):(?P<min>\d{2}):(?P<s>\d{2})(?:(?:[.,]|:(?=\d{3}(?!\d)))(?P<frac>\d{1,12}))?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_ZONE: Final = r"(?:\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2}))?"
_FORMS: Final = {
    "ISO 8601": re.compile(
        rf"(?P<y>\d{{4}})(?P<mark>[-/.])(?P<a>\d{{1,2}})[-/.](?P<b>\d{{1,2}})[T\s]\s*{_CLOCK}{_ZONE}"
    ),
    "date and time": re.compile(
        rf"(?P<a>\d{{1,2}})(?P<mark>[-/.])(?P<b>\d{{1,2}})[-/.](?P<y>\d{{4}})[T,\s]\s*{_CLOCK}{_ZONE}"
    ),
    "time of day": re.compile(_CLOCK),
    "minutes and seconds": re.compile(r"(?P<min>\d{1,2}):(?P<s>\d{2})[.,](?P<frac>\d{1,12})"),
    "duration": re.compile(r"(?P<span>[+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)\s?(?P<unit>(?:sec|s|ms|us|min|hr|h))"),
}
_SPANS: Final = {"sec": 1e9, "s": 1e9, "ms": 1e6, "us": 1e3, "min": 60e9, "hr": 3600e9, "h": 3600e9}
"""Nanoseconds of the unit behind a duration, as MATLAB writes it."""
_LAST: Final = frozenset(unit[-1] for unit in _SPANS)
_DAY: Final = 86400
_PERIODS: Final = {"time of day": _DAY, "minutes and seconds": 3600}
"""Seconds after which stamps start over."""


def is_clock(token: str) -> bool:
    """Return True if a field is a time stamp and no duration, as keys above a table have one too."""
    return stamp_form(token) not in (None, "duration")


def stamp_form(token: str) -> str | None:
    """Return the kind of time stamp of a field, or None."""
    if ":" in token or token[-1:] in _LAST:
        return next((name for name, form in _FORMS.items() if form.fullmatch(token)), None)
    return None


class Stamps:
    """A column of time stamps, read at once or piece after piece.

    Args:
        order: of dates with slashes, as [log] states it; None: by their numbers.
    """

    def __init__(self, order: str | None) -> None:
        self._stated = order
        self._form = ""
        self._first = ""
        self._dates: set[tuple[str, str, str]] = set()
        self._order: str | None = None
        self._days: dict[tuple[str, str, str], int] = {}
        self._last = math.nan
        self._turns = 0

    def seconds(self, tokens: Sequence[str]) -> Array:
        """Seconds since the first time stamp of all (n,), NaN where a field is empty.

        A time of day goes on over midnight. Raises ValueError, with (index, allowed form), for a field that is no
        stamp of the first one's form, and for dates that are several and whose order nothing tells.
        """
        found = self._parts(tokens)
        if not self._first:
            return np.full(len(tokens), np.nan)
        self._dates |= {(p["a"] or "", p["b"] or "", p["mark"] or "") for p in found if p is not None and "mark" in p}
        order = "ymd" if self._form == "ISO 8601" else self._stated or _date_order(self._dates)
        if order != self._order:
            self._order, self._days = order, {}
        nanoseconds: list[int | None] = []
        for k, parts in enumerate(found):
            try:
                nanoseconds.append(None if parts is None else _nanoseconds(parts, order, self._days))
            except ValueError as error:
                raise ValueError(k, str(error)) from None
        if order is None and len(self._days) > 1:
            allowed = 'day or month first? [log] (machine file, --log) has dates = "dmy" or dates = "mdy"'
            raise ValueError(0, allowed)
        start = _nanoseconds(_split(self._first, self._form) or {}, order, self._days)
        since = np.array([np.nan if value is None else (value - start) / 1e9 for value in nanoseconds])
        return self._go_on(since, _PERIODS[self._form]) if self._form in _PERIODS else since

    def _parts(self, tokens: Sequence[str]) -> list[dict[str, str | None] | None]:
        """Each stamp in its parts, None where a field is empty."""
        if not self._first:
            k, first = next(((k, t) for k, t in enumerate(tokens) if not is_missing(t)), (0, ""))
            if not first:
                return [None] * len(tokens)
            self._form = stamp_form(first) or ""
            if not self._form:
                raise ValueError(k, "a time stamp")
            self._first = first
        found = [_split(token, self._form) for token in tokens]
        for k, token in enumerate(tokens):
            if found[k] is None and not is_missing(token):
                raise ValueError(k, f"a time stamp like the first, {self._first}")
        return found

    def _go_on(self, since: Array, period: float) -> Array:
        """Times that go on counting after midnight, or the full hour."""
        good = np.flatnonzero(np.isfinite(since))
        if len(good):
            back = np.diff(since[good], prepend=self._last) < -0.5 * period
            self._last = float(since[good[-1]])
            turns = self._turns + np.cumsum(back)
            self._turns = int(turns[-1])
            since[good] += period * turns
        return since


def _split(token: str, form: str) -> dict[str, str | None] | None:
    match = _FORMS[form].fullmatch(token)
    return None if match is None else match.groupdict()


def _date_order(dates: Iterable[tuple[str, str, str]]) -> str | None:
    """Day or month first, as the numbers of dates or the marks between them tell."""
    if any(mark == "." or int(a) > 12 for a, _, mark in dates):
        return "dmy"
    return "mdy" if any(int(b) > 12 for _, b, _ in dates) else None


def _nanoseconds(parts: dict[str, str | None], order: str | None, days: dict[tuple[str, str, str], int]) -> int:
    """Nanoseconds of a stamp, since year 1 or midnight, in UTC where it states its zone; `days` remembers dates."""
    if span := parts.get("span"):
        return round(float(span.replace(",", ".")) * _SPANS[parts["unit"] or "s"])
    hour, minute, second = (int(parts.get(key) or 0) for key in ("h", "min", "s"))
    if hour > 23 or minute > 59 or second > 59:
        raise ValueError("a time of day up to 23:59:59")
    if half := parts.get("half"):
        hour = hour % 12 + (12 if half in "pP" else 0)
    day = 0
    if year := parts.get("y"):
        key = (year, parts["a"] or "", parts["b"] or "")
        if key not in days:
            first, second_of_date = int(key[1]), int(key[2])
            month, of_month = (second_of_date, first) if order in ("dmy", None) else (first, second_of_date)
            try:
                days[key] = date(int(year), month, of_month).toordinal()
            except ValueError:
                raise ValueError("a date of the calendar") from None
        day = days[key]
    zone = parts.get("zone") or "Z"
    ahead = (int(zone[1:3]) * 60 + int(zone[-2:])) * (-60 if zone[0] == "-" else 60) if zone[0] in "+-" else 0
    fraction = int((parts["frac"] or "0").ljust(12, "0")) // 1000
    return (day * _DAY + hour * 3600 + minute * 60 + second - ahead) * 10**9 + fraction
