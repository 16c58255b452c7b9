"""Open questions of a record, and the fit of each rival in its cause's place."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sgms_mhe.diagnosis import Cause, Diagnosis, RivalFit
from sgms_mhe.report.pieces import bar_width, force_bars
from sgms_mhe.report.series import View, views
from sgms_mhe.report.units import quantity, split_name
from sgms_mhe.report.words import base_words, capital, cause_title, sentence, title
from sgms_mhe.support.statements import Rule, Statement, list_open


@dataclass(frozen=True, eq=False)
class InPlace:
    """A rival in its cause's place.

    Attributes:
        number: among the rivals, from 1.
        fit: of the rival.
        cause: whose place it takes.
        views: residual with the cause (`before`) and with the rival (`after`).
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


def rivals_in_place(d: Diagnosis) -> tuple[InPlace, ...]:
    """Every rival with its residual, beside that of its cause."""
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
    found = list_open(d.statements)
    if not found:
        return None
    return {
        "title": "What this record cannot decide",
        "choices": [_choice(s, d.machine.name) for s in found if s.kind == "choice"],
        "others": [_sentence(s) for s in found if s.kind != "choice"],
    }


def _choice(s: Statement, machine: str) -> dict[str, str]:
    named, rival = str(s.numbers["named"]), str(s.numbers["rival"])
    return {
        "choice": f"{capital(title(named))}, or {title(rival)}?",
        "move": sentence(s.next or s.sentence),
        "command": f"sgms-mhe plan {machine} --separate {named} {rival} --out plan.csv" if named != rival else "",
    }


def _sentence(s: Statement) -> str:
    """Return a statement's sentence, a number of the machine by its words."""
    if s.rule is not Rule.UNSEEN:
        return sentence(s.sentence)
    return sentence(capital(s.sentence.replace(s.about, base_words(s.about), 1)))


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
        "residual": rival.plot("residual"),
        "first": plots[:1],
        "rest": plots[1:],
    }


def _apart(view: View) -> float:
    """How differently the two residuals depend on a coordinate; lines of a spectrum come last."""
    apart = view.mean_after - view.mean_before
    return -1.0 if view.key == "frequency" else math.sqrt(float(np.mean(apart**2)))
