"""Which causes: forward selection over refits, backward pruning, rivals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from sgms_mhe.diagnosis.criteria import Criteria
from sgms_mhe.diagnosis.descent import FitError
from sgms_mhe.diagnosis.fitting import fit_model
from sgms_mhe.diagnosis.groups import Group
from sgms_mhe.diagnosis.laws import SHARPER, Laws, fit_chosen, fit_law, is_driven, starting_unknown
from sgms_mhe.diagnosis.reduction import necessary, pruned
from sgms_mhe.diagnosis.result import Score
from sgms_mhe.diagnosis.rivals import Contest, Rejected, Rival, cause_significance, find_rivals
from sgms_mhe.diagnosis.rounds import search_round
from sgms_mhe.diagnosis.subject import Fit
from sgms_mhe.recordings.evidence import gain_force

END_SHARE: Final = 0.2
"""RMS gain that matters once the search has ended, at least [RMS beyond noise]: a smaller one is not told from that."""
RIVAL_STEPS: Final = 3
"""Times that a better candidate takes a cause's place, at most [1]: two that are better in turns would never end."""


@dataclass(frozen=True, eq=False)
class Searched:
    """Where the forward search ended.

    Attributes:
        laws: the transitions, with the one that fits.
        fit: effects found, all of the machine's numbers refitted.
        criteria: what matters from now on.
        scores: of all rounds.
        seen: effects that ever looked good.
    """

    laws: Laws
    fit: Fit
    criteria: Criteria
    scores: tuple[Score, ...]
    seen: frozenset[str]


@dataclass(frozen=True, eq=False)
class Selection:
    """What was selected.

    Attributes:
        fit: effects and the machine's numbers that are wrong; all other numbers as in the machine file.
        refitted: groups of the machine's own numbers that are free.
        scores: of all rounds.
        rivals: of the causes.
        rejected: candidates that were put in a cause's place and lost.
        p_values: of each cause.
        unnamed: those of `refitted` that are no cause: free because something else is left, not because they are wrong.
        inconstant: names of candidates that are no cause because their size changes over the record.
        free: where the forward search ended, all of the machine's numbers refitted.
    """

    fit: Fit
    refitted: tuple[Group, ...]
    scores: tuple[Score, ...]
    rivals: tuple[Rival, ...]
    rejected: Mapping[str, Rejected]
    p_values: Mapping[Group, float]
    free: Fit
    unnamed: tuple[Group, ...] = ()
    inconstant: tuple[str, ...] = ()

    @property
    def causes(self) -> tuple[Group, ...]:
        """Groups that are named: the machine's own, then effects under test."""
        own = tuple(group for group in self.refitted if group not in self.unnamed)
        return own + self.fit.extra_groups


def search_causes(laws: Laws, criteria: Criteria) -> Searched:
    """Add effects one after the other, from the machine with all its own numbers refitted.

    Amid the search fits keep to the law that is taken, and both are compared before an effect is added that explains no
    more than they differ by: it might be that difference. And once nothing more is found; where the comparison changes
    something, the search goes on.
    """
    laws, current = fit_law(starting_unknown(laws), (), criteria)
    scores: tuple[Score, ...] = ()
    seen: frozenset[str] = frozenset()
    number, compared, ended = 0, True, False
    while True:
        excess = criteria.excess(current)
        # Where less is left than matters, no cause could.
        ended = ended or number == criteria.table.rounds or excess < criteria.material
        if not ended and (compared or excess > laws.doubt):
            number += 1
            criteria.course.search(number)
            found = search_round(laws.chosen, current, number, seen, criteria)
            seen |= found.seen
            ended = found.fit is None
            if compared or found.fit is None or _gain(current, found.fit) > laws.doubt:
                scores += found.scores
                if found.fit is not None:
                    known = pruned(laws.chosen, found.fit, criteria, least=1)
                    laws, current = fit_chosen(laws, known.extras, criteria, known=known)
                    compared = False
                    continue
        if compared:
            break
        before, taken = current, laws.taken
        laws, current = fit_law(laws, current.extras, criteria, known=current)
        compared = True
        if laws.taken != taken or current.rms < SHARPER * before.rms:
            ended = False
    # What is left unexplained is no measure for the machine's numbers, but no finer one than that is possible.
    told = END_SHARE * criteria.excess(current)
    criteria = replace(criteria, material=max(criteria.material, told))
    return _by_simpler_law(Searched(laws, current, criteria, scores, seen))


def _by_simpler_law(searched: Searched) -> Searched:
    """What was found, under the other law where the record decides for none and fewer causes explain as much there.

    A cause may be the difference of the laws.
    """
    laws, criteria = searched.laws, searched.criteria
    if laws.other is None or laws.decided or is_driven(searched.fit.extras):
        return searched
    causes, fit = necessary(laws.chosen, searched.fit, criteria)
    count = len(causes) + len(fit.extras)
    if count == 0:
        return searched
    try:
        found = fit_model(laws.other, searched.fit.extras, warm=searched.fit)
    except FitError:
        return searched
    causes, other = necessary(laws.other, found, criteria)
    if len(causes) + len(other.extras) < count and criteria.costs_nothing(fit, other):
        return replace(searched, laws=replace(laws, taken=not laws.taken), fit=found)
    return searched


def without_effects(searched: Searched) -> Searched:
    """The same with none of the effects that were found."""
    laws, fit = fit_law(searched.laws, (), searched.criteria)
    return replace(searched, laws=laws, fit=fit)


def _gain(before: Fit, after: Fit) -> float:
    """RMS of the force that a fit explains and the one before it did not, on unseen folds [N]."""
    return gain_force(before.cross, after.cross, before.rows)


def select_causes(searched: Searched) -> Selection:
    """Of what was found, and of the machine's numbers, as little as explains the record; and what would do as well."""
    subject, criteria = searched.laws.chosen, searched.criteria
    refitted, fit = necessary(subject, searched.fit, criteria)
    contest = Contest(None, (), {})
    for number in range(1, RIVAL_STEPS + 1):
        criteria.course.rivals(number, 0.0, "", ())
        contest = find_rivals(subject, fit, refitted, searched.seen, criteria, number)
        if contest.better is None:
            break
        refitted, fit = necessary(subject, contest.better, criteria)
    groups = (*refitted, *fit.extra_groups)
    return Selection(
        fit=fit,
        refitted=refitted,
        scores=searched.scores,
        rivals=contest.rivals,
        rejected=contest.rejected,
        p_values={group: cause_significance(subject, fit, group) for group in groups},
        free=searched.fit,
    )
