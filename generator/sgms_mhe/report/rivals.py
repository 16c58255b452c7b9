"""Open questions of a record, and the fit of each rival in its cause's place."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sgms_mhe.diagnosis import Alternative, Cause, Diagnosis, Limit, RivalFit
from sgms_mhe.model.effects import separating_moves
from sgms_mhe.report.pieces import bar_width, force_bars
from sgms_mhe.report.series import View, views
from sgms_mhe.report.units import force, quantity, split_name
from sgms_mhe.report.words import base_words, capital, cause_title, sentence, title


@dataclass(frozen=True, eq=False)
class InPlace:
    """A rival in its cause's place.

    Attributes:
        number: among the rivals, from 1.
        fit: of the rival.
        cause: whose place it takes.
        views: what is left with the cause (`before`) and with the rival (`after`).
    """

    number: int
    fit: RivalFit
    cause: Cause
    views: tuple[View, ...]

    @property
    def words(self) -> str:
        """Return the rival in words."""
        return title(self.fit.name)

    @property
    def cause_words(self) -> str:
        """Return the cause in words."""
        return cause_title(self.cause)

    def plot(self, key: str) -> str:
        """Name of one of its plots."""
        return f"rival_{self.number}_{key}"


def rivals_by_cause(d: Diagnosis) -> dict[str, list[Alternative]]:
    """Return the rivals of each named cause, by that cause's label."""
    labels = [c.label for c in d.causes]
    found: dict[str, list[Alternative]] = {}
    for a in d.alternatives:
        if a.rival and a.instead_of is not None and a.name not in labels:
            found.setdefault(a.instead_of, []).append(a)
    return {label: rivals for label, rivals in found.items() if label in labels}


def rivals_in_place(d: Diagnosis) -> tuple[InPlace, ...]:
    """Every rival with what it leaves, beside what its cause leaves."""
    causes = {cause.name: cause for cause in reversed(d.causes)}
    t = d.traces
    found: list[InPlace] = []
    for fit in d.rival_fits:
        if fit.instead_of in causes:
            both = replace(t, nominal_N=t.held_out_fit_N, held_out_fit_N=t.friction_N - fit.residual_N)
            found.append(InPlace(len(found) + 1, fit, causes[fit.instead_of], tuple(views(both))))
    return tuple(found)


def open_questions(d: Diagnosis) -> dict[str, Any] | None:
    """Return the open questions: choices between causes with the move that makes each, then all other limits."""
    rivals = rivals_by_cause(d)
    pairs = [(cause, rival) for cause in d.causes for rival in rivals.get(cause.label, ())]
    choices = [
        {
            "choice": f"{capital(title(cause.name))}, or {title(rival.name)}?",
            "move": sentence(next(iter(separating_moves(cause.name, rival.name)), rival.why_not)),
            "command": f"sgms-mhe plan {d.machine.name} --separate {cause.name} {rival.name} --out plan.csv"
            if cause.name != rival.name
            else "",
        }
        for cause, rival in pairs
    ]
    told = {(rival.instead_of, rival.name) for _, rival in pairs}
    others = [_words(limit) for limit in d.undecidable if limit.between not in told]
    if not choices and not others:
        return None
    return {"title": "What this record cannot decide", "choices": choices, "others": others}


def _words(limit: Limit) -> str:
    """Return a limit as a sentence, a number of the machine by its words."""
    if limit.number is None:
        return sentence(limit.words)
    return sentence(f"{capital(base_words(limit.number))}:{limit.words.partition(':')[2]}")


def rival_blocks(d: Diagnosis, rivals: Sequence[InPlace]) -> list[dict[str, Any]]:
    """Return the text on every rival, and which of its plots comes first."""
    parameters = {(a.name, a.instead_of): a.parameters for a in d.alternatives if a.rival}
    return [_block(d, rival, parameters.get((rival.fit.name, rival.fit.instead_of), {})) for rival in rivals]


def _block(d: Diagnosis, rival: InPlace, parameters: Mapping[str, float]) -> dict[str, Any]:
    left = (d.rms.held_out_after, rival.fit.held_out_rms_N)
    most = max((v for v in (*left, d.noise_floor_N) if math.isfinite(v)), default=0.0)
    drawn = sorted((view for view in rival.views if len(view.centres)), key=_apart, reverse=True)
    plots = [{"key": rival.plot(view.key), "title": f"What is left over {view.title}"} for view in drawn]
    return {
        "title": capital(rival.words),
        "name": rival.fit.name,
        "instead_of": rival.cause_words,
        "parameters": [
            {"words": split_name(key)[0], "value": str(quantity(key, value))} for key, value in parameters.items()
        ],
        "rows": force_bars([(f"With {rival.cause_words}", "a", left[0]), (f"With {rival.words}", "r", left[1])], most),
        "floor_at": bar_width(d.noise_floor_N, most),
        "differ": _difference(d, rival),
        "residual": rival.plot("residual"),
        "first": plots[:1],
        "rest": plots[1:],
    }


def _difference(d: Diagnosis, rival: InPlace) -> str:
    """How far apart the two simulations are along this record."""
    apart = (rival.fit.residual_N - d.traces.residual_after)[d.traces.used]
    if not len(apart):
        return ""
    rms, most = math.sqrt(float(np.mean(apart**2))), float(np.abs(apart).max())
    return (
        f"Along this record the two simulations are {force(rms)} RMS apart, at most {force(most)}; the noise of the "
        f"measurement is {force(d.noise_floor_N)}. Too little of the record tells them apart to be certain."
    )


def _apart(view: View) -> float:
    """How differently the two residuals depend on a coordinate; lines of a spectrum come last."""
    apart = view.mean_after - view.mean_before
    return -1.0 if view.key == "frequency" else math.sqrt(float(np.mean(apart**2)))
