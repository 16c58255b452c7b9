"""Where a number of an axis is expected, and whether a log's leaves that band.

From the axis's own earlier logs, where it has enough of them: the band of its first ones, which does not move with the
later ones. Otherwise from the fleet: the newest logs of the other axes of the same machine, by median and median
deviation, which a few bad ones do not move.

Both are prediction intervals: with centre c and spread s over n values, c +- t s sqrt(1 + 1/n), t of the Student
distribution with n - 1 degrees of freedom at `LEVEL`. s is no less than the standard deviations that the logs state.

Wear that was there from the first log widens the band it should leave. So the course over time is judged as well: a
straight line through it, whose slope is beyond doubt and whose ends lie further apart than the logs' intervals reach.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Final, Literal

import numpy as np
from scipy.stats import t as student

from sgms_mhe.api.fleet.table import Row
from sgms_mhe.api.fleet.work import FleetNumber, Result
from sgms_mhe.report import Band, FleetCourse, FleetPoint, NumberTrend
from sgms_mhe.support.numbers import SIGMAS

LEVEL: Final = 0.99
"""Share of the logs of an unchanged axis that lie within a band."""
FIRST: Final = 5
"""Logs that an axis's own band is made of, at most."""
LEAST_OWN: Final = 3
LEAST_TREND: Final = 5
LEAST_FLEET: Final = 5
DAY_S: Final = 86_400.0
_TO_DEVIATION: Final = 1.4826
"""Standard deviation over median absolute deviation, of a Gaussian."""


def courses(results: Sequence[tuple[Row, Result]]) -> tuple[FleetCourse, ...]:
    """Every number of every axis over its logs, the earliest first, in the table's order of axes.

    Logs without a date stand last, in the table's order.
    """
    numbers: dict[tuple[str, str, str], list[tuple[Row, Result, FleetNumber]]] = {}
    for row, result in results:
        for number in result.numbers:
            numbers.setdefault((_compared_with(row), row.axis, number.name), []).append((row, result, number))
    for own in numbers.values():
        own.sort(key=lambda found: _order(found[0]))
    series = []
    for key, own in numbers.items():
        points = tuple(
            FleetPoint(
                log=row.name,
                time=None if row.date is None else row.date.timestamp(),
                when=row.when,
                value=number.value,
                std=number.std,
                band=_band(key, k, numbers),
                row=row.number,
            )
            for k, (row, _, number) in enumerate(own)
        )
        _, last, newest = own[-1]
        _, axis, name = key
        series.append(FleetCourse(axis, last.machine, last.kind, name, newest.nominal, points, _trend(points)))
    return tuple(series)


def _trend(points: Sequence[FleetPoint]) -> NumberTrend | None:
    """How steadily a number moves; None: it does not, or there are too few dated logs to say."""
    dated = [point for point in points if point.time is not None]
    times = np.array([point.time for point in dated], dtype=float)
    if len(times) < LEAST_TREND or np.ptp(times) == 0.0:
        return None
    days = (times - times[0]) / DAY_S
    values = np.array([point.value for point in dated])
    stated = _rms([point.std for point in dated])
    centred = days - days.mean()
    slope = float(centred @ values / (centred @ centred))
    residual = values - values.mean() - slope * centred
    scatter = max(math.sqrt(float(residual @ residual) / (len(days) - 2)), stated)
    span = float(days[-1])
    change, std = slope * span, scatter * span / math.sqrt(float(centred @ centred))
    sure = abs(change) > float(student.ppf(0.5 + 0.5 * LEVEL, len(days) - 2)) * std
    return NumberTrend(change, std, span, len(days)) if sure and abs(change) > 2.0 * SIGMAS * stated else None


def _compared_with(row: Row) -> str:
    """Axes of one machine file are compared with each other; those that name none, with their own past alone."""
    return row.machine or f"axis {row.axis}"


def _order(row: Row) -> tuple[bool, datetime | int]:
    return (row.date is None, row.number if row.date is None else row.date)


def _band(
    key: tuple[str, str, str],
    index: int,
    ordered: Mapping[tuple[str, str, str], Sequence[tuple[Row, Result, FleetNumber]]],
) -> Band | None:
    found = ordered[key]
    if found[index][0].date is not None:
        first = [number for row, _, number in found[:index] if row.date is not None][:FIRST]
        if len(first) >= LEAST_OWN:
            values = np.array([number.value for number in first])
            return _interval(first, float(values.mean()), float(values.std(ddof=1)), "own")
    others = [
        rows[-1][2]
        for (machine, axis, name), rows in ordered.items()
        if (machine, name) == (key[0], key[2]) and axis != key[1]
    ]
    if len(others) < LEAST_FLEET:
        return None
    values = np.array([number.value for number in others])
    centre = float(np.median(values))
    return _interval(others, centre, _TO_DEVIATION * float(np.median(np.abs(values - centre))), "fleet")


def _interval(numbers: Sequence[FleetNumber], centre: float, spread: float, origin: Literal["own", "fleet"]) -> Band:
    count = len(numbers)
    stated = _rms([number.std for number in numbers])
    quantile = float(student.ppf(0.5 + 0.5 * LEVEL, count - 1))
    reach = quantile * max(spread, stated) * math.sqrt(1.0 + 1.0 / count)
    return Band(centre - reach, centre + reach, origin, count)


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))
