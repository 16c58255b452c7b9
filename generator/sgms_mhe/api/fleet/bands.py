"""Where a number of an axis is expected, and whether a log's leaves that band.

From the axis's own earlier logs, where it has enough of them: the band of its first ones, which does not move with the
later ones. Otherwise from the fleet: the newest logs of the other axes of the same machine, by median and median
deviation, which a few bad ones do not move.

Both are prediction intervals: with centre c and spread s over n values, c +- t s sqrt(1 + 1/n), t of the Student
distribution with n - 1 degrees of freedom at `LEVEL`. s is no less than the standard deviations that the logs state.

Wear that was there from the first log widens the band it should leave. So all logs of an axis are judged together as
well: by a straight line, whose slope is beyond doubt and whose ends lie further apart than the logs' intervals reach;
and by steps of the mean, found by Student statistics of stretches against the rest (Levin and Kline 1985, Olshen 2004),
the limit by Bonferroni over all stretches. Of line and steps the one with the lesser information criterion counts.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np
from scipy.stats import t as student

from sgms_mhe.api.fleet.table import Row
from sgms_mhe.api.fleet.work import FleetNumber, Result
from sgms_mhe.report import Band, FleetCourse, FleetPoint, NumberChange, NumberTrend
from sgms_mhe.report.fleet import LEAST_LIFE
from sgms_mhe.support.arrays import TINY, Array
from sgms_mhe.support.numbers import SIGMAS

LEVEL: Final = 0.99
"""Share of the logs of an unchanged axis that lie within a band."""
FIRST: Final = 5
"""Logs that an axis's own band is made of, at most."""
ALARM: Final = 0.01
"""Chance that a number without a change is called changed, over all of its logs."""
LEAST_SIDE: Final = 2
"""Logs on either side of a change: one alone is for its band to judge."""
LEAST_OWN: Final = 3
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
            # Axes of one machine file are compared with each other; those that name none, with their own past alone.
            compared_with = row.machine or f"axis {row.axis}"
            numbers.setdefault((compared_with, row.axis, number.name), []).append((row, result, number))
    for own in numbers.values():
        own.sort(key=lambda found: (found[0].date is None, found[0].date or found[0].number))
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
        course = FleetCourse(axis, last.machine, last.kind, name, newest.nominal, points, *_judge_life(points))
        series.append(course)
    return tuple(series)


def _judge_life(points: Sequence[FleetPoint]) -> tuple[NumberTrend | None, tuple[NumberChange, ...]]:
    """How steadily a number moves over its dated logs, or where it changes; neither: it does not, or few logs tell."""
    dated = [point for point in points if point.time is not None]
    times, values = (np.array([getattr(point, name) for point in dated], dtype=float) for name in ("time", "value"))
    if len(times) < LEAST_LIFE or np.ptp(times) == 0.0:
        return None, ()
    days, count = (times - times[0]) / DAY_S, len(times)
    stated = _rms([point.std for point in dated])
    centred = days - days.mean()
    slope = float(centred @ values / (centred @ centred))
    residual = values - values.mean() - slope * centred
    loss = float(residual @ residual)
    scatter = max(math.sqrt(loss / (count - 2)), stated)
    span = float(days[-1])
    change, std = slope * span, scatter * span / math.sqrt(float(centred @ centred))
    sure = abs(change) > float(student.ppf(0.5 + 0.5 * LEVEL, count - 2)) * std
    moves = sure and abs(change) > 2.0 * SIGMAS * stated
    cuts = find_steps(values, stated)
    parts = np.split(values, cuts)
    losses = (loss, float(sum(np.sum((part - part.mean()) ** 2) for part in parts)))
    line, level = (  # Bayesian information criteria
        count * math.log(max(left / count, stated**2, TINY)) + parameters * math.log(count)
        for left, parameters in zip(losses, (2, 2 * len(cuts) + 1), strict=True)
    )
    if moves and (not cuts or line <= level):
        return NumberTrend(change, std, span, count), ()
    scatter = max(math.sqrt(losses[1] / (count - len(parts))), stated)
    return None, tuple(
        NumberChange(
            dated[k].log,
            dated[k].when,
            float(after.mean() - before.mean()),
            scatter * math.sqrt(1.0 / len(before) + 1.0 / len(after)),
        )
        for k, before, after in zip(cuts, parts, parts[1:], strict=False)
    )


def find_steps(values: Array, stated: float) -> list[int]:
    """Return the places of the first values after each step of the mean of a series.

    The mean of a stretch is compared with that of all other values, over all stretches: one that goes on to the end is
    a step, another one a step and its return. Each part is searched again. A series without any step has one with a
    chance of `ALARM` at the most.

    Args:
        values: in the order of time (n).
        stated: standard deviation a value has at least.
    """
    count = len(values)
    if count < LEAST_LIFE:
        return []
    inner = range(LEAST_SIDE, count - LEAST_SIDE + 1)
    start, end = np.array([(i, j) for i in inner for j in (*inner, count) if j - i >= LEAST_SIDE]).T
    sums, size = np.concatenate(([0.0], np.cumsum(values))), end - start
    own = sums[end] - sums[start]
    change, share = own / size - (sums[-1] - own) / (count - size), size * (count - size) / count
    left = np.maximum(np.sum((values - values.mean()) ** 2) - share * change**2, 0.0)
    statistic = np.abs(change) * np.sqrt(share) / np.maximum(np.maximum(np.sqrt(left / (count - 2)), stated), TINY)
    best = int(np.argmax(statistic))
    if statistic[best] <= float(student.ppf(1.0 - 0.5 * ALARM / len(size), count - 2)):
        return []
    cuts = [int(place) for place in (start[best], end[best]) if place < count]
    parts = zip([0, *cuts], np.split(values, cuts), strict=True)
    return sorted([*cuts, *(first + k for first, part in parts for k in find_steps(part, stated))])


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
