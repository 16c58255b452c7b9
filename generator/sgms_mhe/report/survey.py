"""The page of a first look at an axis: a decision without reading, or the reason why there is none."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from sgms_mhe import __version__
from sgms_mhe.identification.survey import MAIN, Survey
from sgms_mhe.machine import Machine
from sgms_mhe.report.pieces import Row, tile
from sgms_mhe.report.units import SPACE, axis_units, plain, reading, stated
from sgms_mhe.report.words import SIGNS, capital, join_words, sentence, title
from sgms_mhe.support.statements import Rule, Statement, list_open

PLACES: Final = {"mass": 1, "inertia": 1, "friction": 3, "damping": 4}
"""Of their tiles."""

Columns = Mapping[str, Any]
"""Columns of a log, as `inspect` has them."""
About = Sequence[tuple[str, str]]
"""Subjects of a page, by names."""
ABOUT: Final = (
    ("Numbers", "least squares along the measured motion, intervals of two standard deviations"),
    ("Next", "identify searches for the law of friction, diagnose for causes of what is left"),
)


def survey_content(found: Survey, columns: Columns, command: str) -> dict[str, Any]:
    """Return the text of the page; `columns`: of the log as it was read; `command`: plans the next motion."""
    units, questions = found.units, list_open(found.statements)
    unsure = _name_unsure(found.statements)
    style = "undecided" if unsure else "limited" if questions else "certain"
    name = f"open: {join_words(unsure)}" if unsure else "determined, with limits" if questions else "determined"
    choices = [{"choice": sentence(s.sentence), **_split_move(s.next or "")} for s in questions]
    if any(choice["move"] for choice in choices):
        choices.append({"choice": "The next motion as a trajectory:", "move": "", "command": command})
    warnings = found.explored.records.warnings
    limits = {"title": "Open, and what to record next", "choices": choices, "others": warnings}
    return _page(columns, style, name, ABOUT) | {
        "headline": _headline(found.statements),
        "limits": limits if choices or warnings else None,
        "tiles": _tiles(found),
        "time_plots": [{"key": "over_time", "size": "", "aria": f"{capital(units.balance)} over time, and its fit"}],
        "speed_title": f"{capital(units.push)} less inertia over speed",
    }


def unread_content(reason: str, columns: Columns, machine: Machine | None, *, has_log: bool) -> dict[str, Any]:
    """Return the text of the page of a log to which nothing was fitted; `has_log`: its columns are drawn."""
    plots = [
        {"key": "log_force", "size": "", "aria": f"{capital(axis_units().push)} over time, as read from the log"},
        {"key": "log_position", "size": "low", "aria": "Position over time, as read from the log"},
    ]
    about = [] if machine is None else [("Machine file", f"{machine.name}, sha256 {machine.digest[:16]}")]
    return _page(columns, "failed", "no numbers", about, machine) | {
        "headline": "Nothing was fitted to this log.",
        "limits": {"title": "The reason, and the remedy", "choices": [], "others": [reason]},
        "tiles": [],
        "time_plots": plots if has_log else [],
        "speed_title": "",
    }


def _page(columns: Columns, style: str, name: str, about: About, machine: Machine | None = None) -> dict[str, Any]:
    """Return the common part of both pages."""
    cells = [
        {"name": c["name"] or "", "from": c["from"], "unit": c["unit"] or "not stated", "why": c.get("because") or ""}
        | {key: "–" if c[key] is None else plain(c[key]) for key in ("min", "max")}
        for c in columns.get("columns", ())
    ]
    return {
        "machine": "first look" if machine is None else machine.name,
        "description": "",
        "source": columns["file"],
        "badge": {"style": style, "sign": SIGNS[style], "name": name},
        "columns": cells,
        "notes": columns.get("notes", ()),
        "about": [*about, ("Computed by", f"sgms-mhe {__version__}")],
    }


def _split_move(move: str) -> dict[str, str]:
    """Return the next step on a question: a motion to record, or a command."""
    if move.startswith("sgms-mhe"):
        return {"move": "", "command": move}
    return {"move": move and f"Record {re.sub(r' .sgms-mhe plan[^)]*.', '', move)}.", "command": ""}


def _headline(statements: Sequence[Statement]) -> str:
    """Return the decision in a sentence."""
    parts = [
        f"{MAIN[s.about]} {stated(s)}" for s in statements if s.about in MAIN and (s.kind, s.sure) == ("number", "yes")
    ]
    unsure = _name_unsure(statements)
    return capital("; ".join([*parts, *([f"{join_words(unsure)} not determined"] if unsure else [])])) + "."


def _name_unsure(statements: Sequence[Statement]) -> list[str]:
    """Return the numbers that decide and are not determined, in words."""
    return [MAIN[s.about] for s in statements if s.kind == "number" and s.about in MAIN and s.sure != "yes"]


def _tiles(found: Survey) -> list[Row]:
    """Return sign, mass, constant force, friction, damping and noise; a dash where one is not determined."""
    units, tiles = found.units, {}
    for s in found.statements:
        shown, text = stated(s), s.text
        if s.kind == "number" and s.sure == "yes":
            text = "; ".join(filter(None, (shown.spread and f"± {shown.spread} {shown.unit}", text)))
        value = f"{shown.value} {shown.unit.replace(' ', SPACE)}" if s.sure == "yes" else "–"
        kind = "" if s.sure == "yes" else "before"
        if s.kind == "sign":
            tiles[0] = tile(f"Sign of the {units.push}", "right" if s.sure == "yes" else "open", s.next or "", kind)
        elif s.kind == "number" and s.about in MAIN:
            tiles[PLACES[MAIN[s.about]]] = tile(capital(MAIN[s.about]), value, text, kind)
        elif s.kind == "number" and "." in s.about and 2 not in tiles:
            value = "none" if s.rule is Rule.NO_FORCE else value
            tiles[2] = tile(
                "Gravity, other constant load", value, "; ".join((title(s.about.partition(".")[0]), text)), kind
            )
        elif s.rule is Rule.NOISE:
            step = reading(float(s.numbers["step"]), units.position) if s.numbers["step"] else "no size that shows"
            tiles[5] = tile(f"Noise of the {units.push}", value, f"of the position: steps of {step}")
    return [tiles[place] for place in sorted(tiles)]
