"""The page over a run of an estimator along a log, while it goes on and after it."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from sgms_mhe import __version__
from sgms_mhe.evaluation.watching import WORDS, RunSummary, flags_of, status_words
from sgms_mhe.recordings.series import find_runs
from sgms_mhe.report.pieces import tile
from sgms_mhe.report.plots import line, uniform
from sgms_mhe.report.units import axis_units, force, plain, quantity, scaled_unit, split_name
from sgms_mhe.report.words import base_words, capital, relative_change
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.numbers import SIGMAS

RELOAD_S: Final = 2
"""Between two readings of the page while the run goes on [s]."""
SHOWN_FAULTS: Final = 20
"""Rows of faults on the page."""
WIDEST: Final = 4.0
"""Bounds over the newest ones that are drawn."""
_SIGNS: Final = {"certain": "✓", "undecided": "?", "failed": "!"}
_OPEN: Final = ("doubt", "overrun", "missing", "speed")
"""Flags with which an estimate is to be taken with care."""


@dataclass(frozen=True)
class Watched:
    """A run as its page shows it.

    Attributes:
        course: summary of the updates; one at the least.
        source: the log, as its user calls it.
        ended: why it ended; empty while it goes on.
        remarks: sentences on the log.
    """

    course: RunSummary
    source: str
    ended: str
    remarks: tuple[str, ...] = ()


def seconds(time: float) -> str:
    """A moment or a while."""
    return "–" if not math.isfinite(time) else f"{time:.2f} s"


def watch_content(watched: Watched) -> dict[str, Any]:
    """Return the text of the page."""
    course, machine = watched.course, watched.course.machine
    found = course.summary()
    status = 0 if course.latest is None else int(course.latest.status[0])
    length = found["end_s"] - found["start_s"]
    return {
        "machine": machine.name,
        "description": machine.description,
        "source": watched.source,
        "badge": _badge(watched, status),
        "headline": f"{'At the end' if watched.ended else 'Live'}: {status_words(status)}.",
        "summary": f"{found['updates']} updates over {seconds(length)} of the log, {found['samples']} samples"
        + (f"; ended: {watched.ended}." if watched.ended else "."),
        "limits": {"title": "Mind this about the log", "choices": [], "others": list(watched.remarks)}
        if watched.remarks
        else None,
        "reload_s": 0 if watched.ended else RELOAD_S,
        "tiles": _tiles(course, found),
        "parameters": _parameters(course),
        "recent_plots": [
            {"key": "friction", "size": "", "aria": "Friction measured and estimated, newest updates"},
            {"key": "innovation", "size": "low", "aria": "Innovation, newest updates"},
        ],
        "run_plots": [{"key": "test_ratio", "size": "low", "aria": "Test ratio over the run"}],
        "every": "one update" if course.trend.every == 1 else f"{course.trend.every} updates",
        "states": [
            {"words": capital(WORDS[name]), "updates": count, "time": seconds(found["status_s"][name])}
            for name in WORDS
            if (count := found["status"][name])
        ],
        "faults": [
            {
                "words": capital(WORDS[episode.fault]),
                "start": seconds(episode.start_s),
                "end": seconds(episode.end_s),
                "updates": episode.updates,
            }
            for episode in course.episodes[:SHOWN_FAULTS]
        ],
        "more_faults": f"The first {SHOWN_FAULTS} of {course.faults}." if course.faults > SHOWN_FAULTS else "",
        "about": [
            ("Log", watched.source),
            ("Machine file", f"{machine.name}, sha256 {machine.digest[:16]}"),
            ("Estimator", f"the generated C, an update every {1e3 * course.interval_s:g} ms"),
            ("Computed by", f"sgms-mhe {__version__}"),
        ],
    }


def watch_plots(course: RunSummary) -> dict[str, Any]:
    """Return the data of the page's plots, by their names."""
    unit = axis_units().force
    recent = _spread(course.recent)
    newest = uniform(float(recent[0, 0]), course.interval_s) | {"group": "recent"}
    drawn: dict[str, Any] = {
        "friction": newest
        | {
            "yLabel": axis_units().balance,
            "zero": True,
            "series": [line("measured", recent[:, 1], "before", 4.5), line("estimated", recent[:, 2], "after", 1.6)],
        },
        "innovation": newest
        | {"yLabel": f"innovation [{unit}]", "zero": True, "series": [line("innovation", recent[:, 3], "before", 1.0)]},
    }
    points, step, n_p = _spread(course.trend.points), course.trend.every * course.interval_s, len(course.names)
    whole = uniform(course.first_s + step - course.interval_s, step)
    ratio = np.where(points[:, 2 * n_p] > 0.0, points[:, 2 * n_p], np.nan)
    drawn["test_ratio"] = whole | {
        "unit": "",
        "yLabel": "test ratio",
        "yLog": True,
        "series": [line("test ratio", ratio, "before", 1.2)],
        "shaded": [
            (whole["start"] + step * (a - 1), whole["start"] + step * (b - 1))
            for a, b in find_runs(points[:, -1] > 0.0)
        ],
        "shadedName": "in doubt",
    }
    for k, name in enumerate(course.names):
        nominal = float(course.nominal[k])
        factor, shown = scaled_unit(nominal, split_name(name)[1])
        value, reach = points[:, k] / factor, SIGMAS * points[:, n_p + k] / factor
        if course.latest is not None:
            # Bounds of the beginning, as wide as the prior's, would leave no room for anything else.
            reach[reach > WIDEST * SIGMAS * course.latest.std[0, k] / factor] = np.nan
        drawn[f"parameter_{k}"] = whole | {
            "unit": shown,
            "yLabel": f"[{shown}]" if shown else "",
            "series": [
                line("estimate", value, "after", 1.8),
                line("+ 2 sigma", value + reach, "after", 1.0, [3, 3]),
                line("− 2 sigma", value - reach, "after", 1.0, [3, 3]),
                line("machine file", np.full(len(value), nominal / factor), "before", 1.2, [7, 4]),
            ],
        }
    return drawn


def _spread(rows: Array) -> Array:
    """At least two rows, so that an axis has a length."""
    return rows if len(rows) > 1 else np.concatenate((rows, np.full((2 - len(rows), rows.shape[1]), np.nan)))


def _badge(watched: Watched, status: int) -> dict[str, str]:
    """Of a run that goes on the newest status, else the gravest one: green only where nothing is to be minded."""
    name = f"live: {flags_of(status)[0]}"
    style = "failed" if status < 0 else "undecided" if set(flags_of(status)) & set(_OPEN) else "certain"
    if watched.ended:
        count = watched.course.faults
        name = f"ended: {count or 'no'} {'fault' if count == 1 else 'faults'} seen"
        style = style if style == "failed" else "undecided" if count or watched.remarks else "certain"
    return {"name": name, "style": style, "sign": _SIGNS[style]}


def _tiles(course: RunSummary, found: dict[str, Any]) -> list[dict[str, str]]:
    last, greatest = course.latest, found["greatest_test_ratio"]
    if last is None:
        return []
    rms = found["residual_rms_N"]
    residual = "–" if rms is None else force(rms)
    measured = f"measured {force(float(last.friction_measured_N[0]))}"
    highest = f"greatest {plain(greatest['value'])} at {seconds(greatest['time_s'])}"
    missing = f"{found['missing_samples']} of {found['samples']} samples missing"
    return [
        tile("Time of the log", seconds(found["end_s"]), f"{found['updates']} updates"),
        tile("Friction, estimated", force(float(last.friction_N[0])), measured),
        tile("Test ratio", plain(float(last.test_ratio[0])), highest),
        tile("Measured minus estimated", residual, f"RMS over {found['measured']} updates"),
        tile("Faults seen", str(course.faults), missing),
    ]


def _parameters(course: RunSummary) -> list[dict[str, str]]:
    last = course.latest
    if last is None:
        return []
    rows = zip(course.names, course.nominal.tolist(), last.parameters[0].tolist(), last.std[0].tolist(), strict=True)
    return [
        {
            "words": capital(base_words(name)),
            "name": axis_units().named(name),
            "value": str(quantity(name, value, std)),
            "nominal": str(quantity(name, nominal)),
            "change": relative_change(nominal, value),
            "plot": f"parameter_{k}",
            "title": f"{capital(base_words(name))}: {quantity(name, value, std)}",
        }
        for k, (name, nominal, value, std) in enumerate(rows)
    ]
