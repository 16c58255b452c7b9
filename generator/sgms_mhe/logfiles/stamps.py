"""Time stamps in a text: ISO 8601 with and without a zone, dates day or month first, times of day."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from typing import Final

import numpy as np

from sgms_mhe.logfiles.decimals import is_missing
from sgms_mhe.logfiles.table import Array

_CLOCK: Final = (
    r"(?P<h>\d{1,2}):(?P<min>\d{2}):(?P<s>\d{2})(?:[.,](?P<frac>\d{1,12}))?(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_ZONE: Final = r"(?:\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2}))?"
_FORMS: Final = (
    (
        "ISO 8601",
        re.compile(rf"(?P<y>\d{{4}})(?P<mark>[-/.])(?P<a>\d{{1,2}})[-/.](?P<b>\d{{1,2}})[T\s]\s*{_CLOCK}{_ZONE}"),
    ),
    (
        "date and time",
        re.compile(rf"(?P<a>\d{{1,2}})(?P<mark>[-/.])(?P<b>\d{{1,2}})[-/.](?P<y>\d{{4}})[T,\s]\s*{_CLOCK}{_ZONE}"),
    ),
    ("time of day", re.compile(_CLOCK)),
)
_DAY: Final = 86400


def stamp_form(token: str) -> str | None:
    """What kind of time stamp a field is, or None."""
    return next((name for name, form in _FORMS if form.fullmatch(token)), None) if ":" in token else None


def seconds_of_stamps(tokens: Sequence[str], order: str | None) -> Array:
    """Seconds since the first time stamp (n,), NaN where a field is empty; a time of day goes on over midnight.

    Raises ValueError, with (index, what is allowed), for a field that is no stamp of the first one's form, and for
    dates that are several and whose order nothing tells.
    """
    first = next((token for token in tokens if not is_missing(token)), "")
    name = stamp_form(first)
    if name is None:
        raise ValueError(0, "a time stamp")
    form = dict(_FORMS)[name]
    matches = [None if is_missing(token) else form.fullmatch(token) for token in tokens]
    for k, (match, token) in enumerate(zip(matches, tokens, strict=True)):
        if match is None and not is_missing(token):
            raise ValueError(k, f"a time stamp like the first, {first}")
    dates = [None if match is None else match.groupdict() for match in matches]
    order = "ymd" if name == _FORMS[0][0] else order or _date_order(dates)
    days: dict[tuple[str, str, str], int] = {}
    nanoseconds: list[int | None] = []
    for k, parts in enumerate(dates):
        try:
            nanoseconds.append(None if parts is None else _nanoseconds(parts, order, days))
        except ValueError as error:
            raise ValueError(k, str(error)) from None
    if order is None and len(days) > 1:
        allowed = 'day or month first? [log] of the machine file has dates = "dmy" or dates = "mdy"'
        raise ValueError(0, allowed)
    start = next(value for value in nanoseconds if value is not None)
    since = np.array([np.nan if value is None else (value - start) / 1e9 for value in nanoseconds])
    return since if days else _over_midnight(since)


def _date_order(dates: Sequence[dict[str, str | None] | None]) -> str | None:
    """Day or month first, as the numbers or the marks between them tell."""
    numbers = {(p["a"] or "", p["b"] or "", p["mark"]) for p in dates if p is not None and "mark" in p}
    if any(mark == "." or int(a) > 12 for a, _, mark in numbers):
        return "dmy"
    return "mdy" if any(int(b) > 12 for _, b, _ in numbers) else None


def _nanoseconds(parts: dict[str, str | None], order: str | None, days: dict[tuple[str, str, str], int]) -> int:
    """Nanoseconds of a stamp, since year 1 or midnight, in UTC where it states its zone; `days` remembers dates."""
    hour, minute, second = (int(parts[key] or 0) for key in ("h", "min", "s"))
    if hour > 23 or minute > 59 or second > 59:
        raise ValueError("a time of day up to 23:59:59")
    if parts["half"]:
        hour = hour % 12 + (12 if parts["half"] in "pP" else 0)
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


def _over_midnight(since: Array) -> Array:
    """Times of day that go on counting after midnight."""
    good = np.flatnonzero(np.isfinite(since))
    back = np.diff(since[good]) < -0.5 * _DAY
    since[good[1:]] += _DAY * np.cumsum(back)
    return since
