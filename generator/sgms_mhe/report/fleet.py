"""The page over a fleet: what failed, which axis left its band, every number of every axis over its logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from markupsafe import Markup

from sgms_mhe import __version__
from sgms_mhe.machine import OF_KIND, Kind
from sgms_mhe.report.courses import Mark, drawn
from sgms_mhe.report.units import PrintedValue, quantity, split_name, use_units
from sgms_mhe.report.words import base_words, capital, relative_change

SHOWN_OPEN: Final = 8
"""Axes whose plots are not folded away, where none has left its band."""
_VERDICTS: Final = {
    "explained": "named",
    "adequate": "named",
    "good": "named",
    "sgms": "",
    "switching": "",
    "failed": "bad",
}
"""Class of a verdict's badge; any other is open."""


@dataclass(frozen=True)
class FleetLog:
    """A row of the table as the page shows it.

    Attributes:
        name, axis, date, machine: as the table has them; date empty where it is not known.
        verdict, summary: of its result; empty where it failed.
        failure: why it failed; empty where it did not.
        link: to the row's own report or file, relative to the page; empty: none.
        notes: on the record.
    """

    name: str
    axis: str
    date: str
    machine: str
    verdict: str
    summary: str
    failure: str
    link: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class FleetPoint:
    """A number in one log, with the band that it is held against (None: none).

    Attributes:
        log: name.
        time: when the log was taken, in any unit; None: not known.
        when: the same in words.
        value, std: of the number.
        band: its ends.
        band_of: `own` (earlier logs of the axis), `fleet` (other axes), or empty.
        count: of the logs that the band is made of.
        left: whether the number left it.
    """

    log: str
    time: float | None
    when: str
    value: float
    std: float
    band: tuple[float, float] | None
    band_of: Literal["own", "fleet", ""]
    count: int
    left: bool


@dataclass(frozen=True)
class FleetTrend:
    """A steady move: its change over `days`, with standard deviation, from a straight line through `count` logs."""

    change: float
    std: float
    days: float
    count: int


@dataclass(frozen=True)
class FleetCourse:
    """A number of an axis over its logs, the earliest first.

    `nominal` is NaN where a machine file has none, `trend` None where it does not move steadily.
    """

    axis: str
    machine: str
    kind: Kind
    name: str
    nominal: float
    points: tuple[FleetPoint, ...]
    trend: FleetTrend | None = None

    @property
    def newest(self) -> FleetPoint:
        """The last point."""
        return self.points[-1]

    @property
    def left(self) -> bool:
        """Return True if it stands out: a log left its band, or it moves steadily."""
        return self.trend is not None or any(point.left for point in self.points)

    def words(self) -> str:
        """Return the number in words."""
        label, _, own = self.name.rpartition(".")
        with use_units(OF_KIND[self.kind]):
            words = split_name(own)[0]
        return f"{label.replace('_', ' ')}: {words}" if label else capital(base_words(own))

    def written(self, value: float, std: float = float("nan")) -> PrintedValue:
        """A value of it with its unit."""
        with use_units(OF_KIND[self.kind]):
            return quantity(self.name.rpartition(".")[2], value, std)


def fleet_content(verb: str, table: str, logs: Sequence[FleetLog], courses: Sequence[FleetCourse]) -> dict[str, Any]:
    """Everything that the template asks for, but for data, style and script."""
    failed = [log for log in logs if log.failure]
    left = [course for course in courses if course.left]
    judged = sum(point.band is not None for course in courses for point in course.points)
    axes = list(dict.fromkeys(log.axis for log in logs))
    gone = list(dict.fromkeys(course.axis for course in left))
    return {
        "machine": f"fleet {verb}",
        "description": "",
        "source": table,
        "badge": _badge(len(failed), len(gone)),
        "headline": _headline(len(logs), len(failed), gone),
        "limits": None,
        "verb": verb,
        "tiles": _tiles(logs, failed, axes, gone, judged, len(left)),
        "failed": failed,
        "left": [departure for course in left for departure in _departures(course)],
        "axes": _axes(courses, gone),
        "strips": _strips(courses),
        "logs": [{"log": log, "badge": _VERDICTS.get(log.verdict, "open")} for log in logs],
        "about": [
            ("Table", table),
            ("Numbers", "value and interval of two standard deviations, as the log determines it"),
            ("Band", "where 99 % of the logs of an unchanged axis lie: of the axis's own first logs (three to five "
             "of them, by date), else of the newest logs of the other axes of its machine (five or more)"),
            ("Left", "the interval lies outside of the band as a whole"),
            ("Moves steadily", "a straight line over time (five dated logs or more) whose slope is beyond doubt and "
             "whose ends lie further apart than the intervals reach"),
            ("sgms-mhe", __version__),
        ],
    }  # fmt: skip


def _badge(failed: int, gone: int) -> dict[str, str]:
    if failed:
        return {"style": "failed", "sign": "!", "name": f"{failed} failed"}
    if gone:
        return {"style": "undecided", "sign": "?", "name": f"{gone} {'axis stands' if gone == 1 else 'axes stand'} out"}
    return {"style": "certain", "sign": "✓", "name": "all done, nothing stands out"}


def _headline(logs: int, failed: int, gone: Sequence[str]) -> str:
    done = f"{logs - failed} of {logs} logs done" if failed else f"All {logs} logs done"
    if not gone:
        return f"{done}; no axis stands out"
    shown = ", ".join(gone[:3]) + (f" and {len(gone) - 3} more" if len(gone) > 3 else "")
    return f"{done}; {shown} {'stands' if len(gone) == 1 else 'stand'} out"


def _tiles(
    logs: Sequence[FleetLog],
    failed: Sequence[FleetLog],
    axes: Sequence[str],
    gone: Sequence[str],
    judged: int,
    left: int,
) -> list[dict[str, str]]:
    by_chance = 0.01 * judged
    return [
        {"label": "Logs", "value": f"{len(logs)}", "kind": "", "note": f"of {len(axes)} axes"},
        {
            "label": "Failed",
            "value": f"{len(failed)}",
            "kind": "bad" if failed else "",
            "note": "each with its reason below" if failed else "every row has its result",
        },
        {
            "label": "Axes that stand out",
            "value": f"{len(gone)}",
            "kind": "before" if gone else "",
            "note": f"with {left} numbers" if gone else "all in band, none moves",
        },
        {
            "label": "Numbers held against a band",
            "value": f"{judged}",
            "kind": "",
            "note": f"about {by_chance:.1g} of them outside by chance" if judged else "too few logs or axes for bands",
        },
    ]


def _departures(course: FleetCourse) -> list[dict[str, str]]:
    """The newest log that left its band, with how many did; and a steady move."""
    out = [point for point in course.points if point.left]
    found = [_departure(course, out[-1], len(out))] if out else []
    if course.trend is not None:
        t, newest = course.trend, course.newest
        before = newest.value - t.change
        share = f", {relative_change(before, newest.value)}" if before > 0.0 else ""
        change = course.written(t.change, t.std)
        found.append(
            {
                "axis": course.axis,
                "words": course.words(),
                "value": str(course.written(newest.value, newest.std)),
                "when": newest.when,
                "why": f"moves steadily: {change}{share} over {t.days:.0f} days, {t.count} logs",
            }
        )
    return found


def _departure(course: FleetCourse, point: FleetPoint, times: int) -> dict[str, str]:
    low, high = point.band or (float("nan"), float("nan"))
    of = "its own first" if point.band_of == "own" else "the newest logs of the other"
    what = "logs" if point.band_of == "own" else "axes"
    side = "above" if point.value > high else "below"
    return {
        "axis": course.axis,
        "words": course.words(),
        "value": str(course.written(point.value, point.std)),
        "when": point.when or point.log,
        "why": f"{side} the band {course.written(low)} to {course.written(high)} of {of} {point.count} {what}"
        + (f"; {times} of its {len(course.points)} logs" if times > 1 else ""),
    }


def _axes(courses: Sequence[FleetCourse], gone: Sequence[str]) -> list[dict[str, Any]]:
    """Axes with a course over time, those that left a band first."""
    over_time = [course for course in courses if len(course.points) > 1]
    names = list(dict.fromkeys([*gone, *(course.axis for course in over_time)]))
    found: list[dict[str, Any]] = []
    for name in names:
        own = sorted((c for c in over_time if c.axis == name), key=lambda c: not c.left)
        if own:
            found.append(
                {
                    "name": name,
                    "left": name in gone,
                    "open": name in gone or (not gone and len(found) < SHOWN_OPEN),
                    "plots": [_plot(course) for course in own],
                }
            )
    return found


def _plot(course: FleetCourse) -> dict[str, Any]:
    times = [point.time for point in course.points]
    known = all(time is not None for time in times)
    marks = [_mark(course, p, float(k) if not known or p.time is None else p.time) for k, p in enumerate(course.points)]
    ends = (course.points[0].when, course.points[-1].when) if known else ("first", "last")
    line: Literal["", "course", "course moves"] = ("course moves" if course.trend else "course") if known else ""
    newest = course.newest
    band = {"own": "own first logs", "fleet": "other axes", "": "none yet"}[newest.band_of]
    return {
        "words": course.words(),
        "value": str(course.written(newest.value, newest.std)),
        "left": course.left,
        "band": band,
        "svg": Markup(drawn(marks, ends, course.nominal, _writer(course), line)),
    }


def _writer(course: FleetCourse) -> Callable[[float], str]:
    return lambda value: str(course.written(value))


def _mark(course: FleetCourse, point: FleetPoint, at: float, name: str = "") -> Mark:
    said = f"{name or point.when or point.log}: {course.written(point.value, point.std)}"
    return Mark(at, point.value, point.std, point.band, point.left, said, name)


def _strips(courses: Sequence[FleetCourse]) -> list[dict[str, Any]]:
    """Every number over the axes of one machine: the newest of each axis, where there are several."""
    groups: dict[tuple[str, str], list[FleetCourse]] = {}
    for course in courses:
        groups.setdefault((course.machine, course.name), []).append(course)
    strips = []
    for (machine, _), found in groups.items():
        if len(found) > 1:
            marks = [_mark(c, c.newest, float(k), c.axis) for k, c in enumerate(found)]
            ends = (found[0].axis, found[-1].axis)
            first = found[0]
            svg = drawn(marks, ends, first.nominal, _writer(first), "")
            strips.append({"words": first.words(), "machine": machine, "svg": Markup(svg), "count": len(found)})
    return strips
