"""Candidates in the order of their explained share, step by step."""

import math
from collections.abc import Collection, Sequence
from typing import Any, Final

from sgms_mhe.diagnosis import Score
from sgms_mhe.report.pieces import bar_width
from sgms_mhe.report.units import force, probability
from sgms_mhe.report.words import capital, title

NAMED: Final = "named"
LEAST: Final = 5e-4
"""Of a gain: less is zero at the digits that forces are written with."""


def ranked_scores(scores: Sequence[Score]) -> list[Score]:
    """Every candidate once: where it was named, otherwise in the first round it took part in; the best first."""
    best: dict[str, Score] = {}
    for score in sorted(scores, key=lambda s: s.round):
        if score.name not in best or (score.outcome == NAMED and best[score.name].outcome != NAMED):
            best[score.name] = score
    return sorted(best.values(), key=lambda s: (s.outcome != NAMED, -explained_force(s)))


def explained_force(score: Score) -> float:
    """Return the force a candidate explains [N RMS]: after a refit where there was one."""
    return next((gain for gain in (score.refit_gain_N, score.gain_N) if math.isfinite(gain)), 0.0)


def score_rows(scores: Sequence[Score], as_good: Collection[str]) -> list[dict[str, Any]]:
    """Rows of a table of candidates; `as_good`: names of those that fit as well as the named ones."""
    most = max((explained_force(s) for s in scores), default=0.0)
    return [
        {
            "title": capital(title(s.name)),
            "name": s.name,
            "gain": _amount(s.gain_N),
            "refit": _amount(s.refit_gain_N),
            "chance": probability(s.p_value),
            "outcome": "not ruled out" if s.name in as_good else s.outcome,
            "kind": "open" if s.name in as_good else s.outcome if s.outcome == NAMED else "other",
            "width": bar_width(explained_force(s), most),
        }
        for s in scores
    ]


def _amount(gain: float) -> str:
    """A gain; of one that would be written as zeros, that there is none."""
    return "none" if abs(gain) < LEAST else force(gain)
