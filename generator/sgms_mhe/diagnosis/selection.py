"""Which causes: forward selection over refits, backward pruning, rivals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from sgms_mhe.diagnosis.criteria import Criteria
from sgms_mhe.diagnosis.groups import Group
from sgms_mhe.diagnosis.laws import Laws, fit_law, starting_unknown
from sgms_mhe.diagnosis.reduction import necessary, pruned
from sgms_mhe.diagnosis.result import Score
from sgms_mhe.diagnosis.rivals import Contest, Rejected, Rival, cause_significance, find_rivals
from sgms_mhe.diagnosis.rounds import search_round
from sgms_mhe.diagnosis.subject import Fit


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
    """Add effects one after the other, from the machine with all its own numbers refitted."""
    laws, current = fit_law(starting_unknown(laws), (), criteria)
    scores: tuple[Score, ...] = ()
    seen: frozenset[str] = frozenset()
    for number in range(1, criteria.thresholds.rounds + 1):
        if criteria.excess(current) < criteria.material:  # what is left could not make any cause matter
            break
        criteria.course.search(number)
        found = search_round(laws.chosen, current, number, seen, criteria)
        scores, seen = scores + found.scores, seen | found.seen
        if found.fit is None:
            break
        extras = pruned(laws.chosen, found.fit, criteria, least=1).extras
        laws, current = fit_law(laws, extras, criteria)
    # What is left unexplained is no measure for the machine's numbers, but no finer one than that is possible.
    told = criteria.thresholds.left * criteria.excess(current)
    return Searched(laws, current, replace(criteria, material=max(criteria.material, told)), scores, seen)


def select_causes(searched: Searched) -> Selection:
    """Of what was found, and of the machine's numbers, as little as explains the record; and what would do as well."""
    subject, criteria = searched.laws.chosen, searched.criteria
    refitted, fit = necessary(subject, searched.fit, criteria)
    contest = Contest(None, (), {})
    for number in range(1, criteria.thresholds.rival_rounds + 1):
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
