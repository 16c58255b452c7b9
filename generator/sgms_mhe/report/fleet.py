"""The page over a fleet: failures, axes outside of their band, every number of every axis over its logs."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from markupsafe import Markup

from sgms_mhe import __version__
from sgms_mhe.diagnosis.result import Standing
from sgms_mhe.machine import OF_KIND, Kind
from sgms_mhe.model.effects import reported_name
from sgms_mhe.report.courses import Mark, drawn
from sgms_mhe.report.pieces import tile
from sgms_mhe.report.units import PrintedValue, quantity, split_name, use_units
from sgms_mhe.report.words import SIGNS, base_words, capital
from sgms_mhe.support.numbers import SIGMAS
from sgms_mhe.support.statements import Rule, Statement

LEAST_LIFE: Final = 5
"""Dated logs from which on a number is judged over all of them."""
SHOWN_OPEN: Final = 8
"""Axes whose plots are not folded away, where none has left its band."""
_ORIGINS: Final = {"own": "own first logs", "fleet": "other axes"}
_STYLES: Final[Mapping[Standing, str]] = {
    "certain": "named",
    "limited": "",
    "undecided": "open",
    "failed": "open",
    "nothing": "open",
}
"""Class of a row's badge by how far its result holds."""


@dataclass(frozen=True)
class FleetLog:
    """A row of the table as the page shows it.

    Attributes:
        name, axis, date, machine: as the table has them; date empty where it is not known.
        verdict, standing, summary: of its result; a log that failed has none.
        failure: why it failed; empty where it did not.
        link: to the row's own report or file, relative to the page; empty: none.
        notes: on the record.
    """

    name: str
    axis: str
    date: str
    machine: str
    verdict: str
    standing: Standing
    summary: str
    failure: str
    link: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Band:
    """Where a number is expected, from `count` earlier logs of the axis (`own`) or other axes (`fleet`)."""

    low: float
    high: float
    origin: Literal["own", "fleet"]
    count: int


@dataclass(frozen=True)
class FleetPoint:
    """A number in one log, with the band it is compared with (None: none).

    Attributes:
        log: name.
        time: when the log was taken, in any unit; None: not known.
        when: the same in words.
        value, std: of the number.
        row: of the table, by its number.
    """

    log: str
    time: float | None
    when: str
    value: float
    std: float
    band: Band | None
    row: int = 0

    @property
    def left(self) -> bool:
        """Return True if its interval lies outside of the band as a whole."""
        reach = SIGMAS * self.std
        return self.band is not None and not (
            self.value - reach <= self.band.high and self.value + reach >= self.band.low
        )


@dataclass(frozen=True)
class NumberTrend:
    """A steady move: its change over `days`, with standard deviation, from a straight line through `count` logs."""

    change: float
    std: float
    days: float
    count: int


@dataclass(frozen=True)
class NumberChange:
    """A lasting change: the first log after it and its date in words, and by how much, with standard deviation."""

    log: str
    when: str
    change: float
    std: float


@dataclass(frozen=True)
class FleetCourse:
    """A number of an axis over its logs, the earliest first.

    `nominal` is NaN where a machine file has none, `trend` None where it does not move steadily; `changes` by time.
    """

    axis: str
    machine: str
    kind: Kind
    name: str
    nominal: float
    points: tuple[FleetPoint, ...]
    trend: NumberTrend | None = None
    changes: tuple[NumberChange, ...] = ()

    @property
    def newest(self) -> FleetPoint:
        """The last point."""
        return self.points[-1]

    @property
    def left(self) -> bool:
        """Return True if it stands out: a log left its band, it moves steadily, or it has changed."""
        return bool(self.trend is not None or self.changes or any(point.left for point in self.points))

    @property
    def is_judged(self) -> bool:
        """Return True if a log is compared with a band."""
        return any(point.band is not None for point in self.points)

    @property
    def unit(self) -> str:
        """Return its unit."""
        return OF_KIND[self.kind].unit(reported_name(self.name))

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
    gone = list(dict.fromkeys(course.axis for course in courses if course.left))
    statements = state_fleet(logs, courses)
    doubts = describe_doubts(statements)
    axes = {log.axis for log in logs if not log.failure}
    new = len(axes - {course.axis for course in courses if course.is_judged})
    unjudged = f"{new} of {len(axes)} axes not judged yet" if new else ""
    return {
        "machine": f"fleet {verb}",
        "description": "",
        "source": table,
        "badge": _badge(logs, failed, gone, doubts, unjudged),
        "headline": _headline(len(logs), len(failed), gone, doubts, unjudged, none=new == len(axes)),
        "limits": None,
        "verb": verb,
        "tiles": _tiles(logs, courses, gone, doubts),
        "failed": failed,
        "left": [capital(s.sentence) for s in statements if s.kind in ("band", "trend", "change")],
        "axes": _axes(courses, gone),
        "strips": _strips(courses),
        "logs": [{"log": log, "badge": _STYLES[log.standing]} for log in logs],
        "about": [
            ("Table", table),
            ("Numbers", "value and interval of two standard deviations, as the log determines it"),
            ("Band", "where 99 % of the logs of an unchanged axis lie: of the axis's own first logs (three to five "
             "of them, by date), else of the newest logs of the other axes of its machine (five or more)"),
            ("Left", "the interval lies outside of the band as a whole"),
            ("Moves steadily", "a straight line over time (five dated logs or more) whose slope is beyond doubt and "
             "whose ends lie further apart than the intervals reach"),
            ("Changed", "the means of the logs before and after differ (five dated logs or more); an unchanged number "
             "is called so with a chance of at most 1 % over all of its logs"),
            ("sgms-mhe", __version__),
        ],
    }  # fmt: skip


def state_fleet(logs: Sequence[FleetLog], courses: Sequence[FleetCourse]) -> tuple[Statement, ...]:
    """Return the statements on every log, on numbers that left their band, and on those that move steadily."""
    found = []
    for log in logs:
        rule = Rule.FAILED if log.failure else Rule.DOUBTFUL if _STYLES[log.standing] == "open" else Rule.DONE
        found.append(Statement(rule, log.name, numbers={"verdict": log.verdict, "reason": log.failure}))
    for course in courses:
        about = f"{course.axis}, {course.name}"
        told = course.trend is not None or course.changes  # of which it is a part
        for p in (point for point in course.points if point.left and not told):
            if (band := p.band) is not None:
                ends: dict[str, float | str] = {"low": band.low, "high": band.high, "of": _ORIGINS[band.origin]}
                at, ends["count"] = f"{about}, {p.log}", band.count
                found.append(Statement.of_number(Rule.OUTSIDE, at, p.value, p.std, course.unit, **ends))
        if (trend := course.trend) is not None:
            move = Statement.of_number(Rule.MOVES, about, trend.change, trend.std, course.unit, days=trend.days)
            found.append(move)
        found += [
            Statement.of_number(Rule.CHANGED, about, c.change, c.std, course.unit, log=c.log, when=c.when)
            for c in course.changes
        ]
    return tuple(found)


def describe_doubts(statements: Sequence[Statement]) -> str:
    """Return the words on logs whose result does not hold: `4 of 6 logs open: 3 doubt, 1 late`; empty: all hold."""
    rows = [s for s in statements if s.kind == "row"]
    counts = Counter(str(s.numbers["verdict"]) for s in rows if s.rule is Rule.DOUBTFUL)
    each = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return f"{counts.total()} of {len(rows)} logs open: {each}" if counts else ""


def _badge(
    logs: Sequence[FleetLog], failed: Sequence[FleetLog], gone: Sequence[str], doubts: str, unjudged: str
) -> dict[str, str]:
    style, name = "certain", "all done, nothing stands out"
    if failed:
        style, name = "failed", f"{len(failed)} failed"
    elif gone:
        style, name = "undecided", f"{len(gone)} {'axis stands' if len(gone) == 1 else 'axes stand'} out"
    elif doubts or unjudged:
        style, name = "undecided", doubts.partition(":")[0] or unjudged
    elif any(log.standing == "limited" for log in logs):
        style, name = "limited", "all done, with limits"
    return {"style": style, "sign": SIGNS[style], "name": name}


def _headline(logs: int, failed: int, gone: Sequence[str], doubts: str, unjudged: str, *, none: bool) -> str:
    done = f"{logs - failed} of {logs} logs done" if failed else f"All {logs} logs done"
    shown = ", ".join(gone[:3]) + (f" and {len(gone) - 3} more" if len(gone) > 3 else "")
    out = f"{shown} {'stands' if len(gone) == 1 else 'stand'} out" if gone else "" if none else "no axis stands out"
    return "; ".join(part for part in (done, doubts, out, unjudged) if part)


def _tiles(
    logs: Sequence[FleetLog], courses: Sequence[FleetCourse], gone: Sequence[str], doubts: str
) -> list[dict[str, str]]:
    failed, axes = [log for log in logs if log.failure], {log.axis for log in logs}
    left, judged = sum(c.left for c in courses), sum(p.band is not None for c in courses for p in c.points)
    lives = sum(sum(p.time is not None for p in c.points) >= LEAST_LIFE for c in courses)
    count, _, each = doubts.partition(" of ")
    chance = f"about {0.01 * judged:.1g} of them outside by chance" if judged else "too few logs or axes for bands"
    reasons = "each with its reason below" if failed else "every row has its result"
    out = f"with {left} numbers" if gone else "no number left its band or changed" if judged else "none was judged"
    return [
        tile("Logs", f"{len(logs)}", f"of {len(axes)} axes"),
        tile("Failed", f"{len(failed)}", reasons, "bad" if failed else ""),
        tile("Open", count or "0", each.partition(": ")[2] or "every result holds", "before" if doubts else ""),
        tile("Axes that stand out", f"{len(gone)}", out, "before" if gone else ""),
        tile("Numbers judged over their life", f"{lives}", f"about {0.01 * lives:.1g} changes by chance"),
        tile("Values compared with a band", f"{judged}", chance),
    ]


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
    band = "none yet" if newest.band is None else _ORIGINS[newest.band.origin]
    breaks = [k for k, point in enumerate(course.points) if point.log in {change.log for change in course.changes}]
    says = [f"changed by {course.written(c.change, c.std)} from {c.when} on" for c in course.changes]
    if (trend := course.trend) is not None:
        says.append(f"moved by {course.written(trend.change, trend.std)} over {trend.days:.0f} days")
    return {
        "words": course.words(),
        "value": str(course.written(newest.value, newest.std)),
        "left": course.left,
        "says": "; ".join([*says, f"band of the newest: {band}"]),
        "svg": Markup(drawn(marks, ends, course.nominal, _writer(course), line, breaks)),
    }


def _writer(course: FleetCourse) -> Callable[[float], str]:
    return lambda value: str(course.written(value))


def _mark(course: FleetCourse, point: FleetPoint, at: float, name: str = "") -> Mark:
    said = f"{name or point.when or point.log}: {course.written(point.value, point.std)}"
    band = None if point.band is None else (point.band.low, point.band.high)
    return Mark(at, point.value, point.std, band, point.left, said, name)


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
