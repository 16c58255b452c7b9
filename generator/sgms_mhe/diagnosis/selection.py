"""Forward selection over refits, backward reduction, rivals: from a machine along a record to its causes."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from sgms_mhe.diagnosis.alignment import find_encoder_force
from sgms_mhe.diagnosis.candidates import search
from sgms_mhe.diagnosis.criteria import (
    CLOSE,
    GAIN_SHARE,
    PROMISING,
    SAME_FORCE,
    Criteria,
    Ranked,
    drop_duplicates,
    is_ruled_out,
    list_addable,
    make_effect,
    raise_floor,
    rank_proposals,
)
from sgms_mhe.diagnosis.curves import fit_curve
from sgms_mhe.diagnosis.fits import EffectsError, Fit, Subject, fit_model, try_fit
from sgms_mhe.diagnosis.laws import SHARPER, Laws, fit_chosen, fit_law, start_unknown_numbers
from sgms_mhe.diagnosis.parts import Outcome, Score
from sgms_mhe.diagnosis.reduction import keep_necessary, prune_effects
from sgms_mhe.diagnosis.rivals import Contest, Selection, cause_significance, find_rivals
from sgms_mhe.diagnosis.uncertainty import explains_noise
from sgms_mhe.model.effects import cause, effect_definition
from sgms_mhe.recordings.evidence import EQUAL_T, difference_statistic, noise_floor
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.parallel import run_parallel

RIVAL_STEPS: Final = 3
"""Times that a better candidate takes a cause's place, at most [1]: two that are better in turns would never end."""


@dataclass(frozen=True, eq=False)
class SelectionStep:
    """Step of the forward selection.

    Attributes:
        fit: with the effect that is added; None: none is.
        scores: of every candidate.
        seen: names of those that looked good.
    """

    fit: Fit | None
    scores: tuple[Score, ...]
    seen: frozenset[str]


def search_step(
    subject: Subject, current: Fit, number: int, seen: Collection[str], criteria: Criteria
) -> SelectionStep:
    """Search, refit the best, choose the one to add to the current fit; `seen`: earlier good ones."""
    names = list_addable(subject.machine, current.effects, criteria)
    candidates = _candidates(subject, current, names, seen, criteria)
    significant = [
        r for r in candidates if r.proposal.feasible and r.proposal.p_value * len(names) < criteria.table.significance
    ]
    least = PROMISING * criteria.enough(current)
    strong = sorted((r for r in significant if r.gain > least), key=lambda r: -r.gain)
    fits = _refits(subject, current, _shortlist(strong, criteria), number, criteria)
    chosen = _choose(subject, current, fits, criteria)
    scores = []
    for ranked in candidates:
        p = ranked.proposal
        outcome: Outcome
        if p.name == chosen:
            outcome = "named"
        elif ranked in strong:
            outcome = "redundant"
        elif ranked in significant:
            outcome = "too small"
        else:
            outcome = "not significant"
        refit = fits[p.name].gain_over(current) if p.name in fits else math.nan
        p_value = min(1.0, p.p_value * len(names))
        scores.append(Score(p.name, number, p_value, max(0.0, ranked.gain), refit, dict(p.parameters), outcome))
    log_decision(
        "search",
        "effect that explains most of those significant and large enough, refitted",
        step=number,
        effects=[effect.name for effect in current.effects],
        beyond_noise_N=criteria.excess(current),
        significance=criteria.table.significance,
        least_gain_N=criteria.enough(current),
        candidates=[
            {"name": s.name, "p_value": s.p_value, "gain_N": s.gain_N, "refit_gain_N": s.refit_gain_N,
             "outcome": s.outcome, "starts": s.parameters}
            for s in sorted(scores, key=lambda s: -s.gain_N)
        ],
        added=chosen,
    )  # fmt: skip
    return SelectionStep(
        fit=None if chosen is None else fits[chosen],
        scores=tuple(scores),
        seen=frozenset(r.proposal.name for r in strong),
    )


def _refits(
    subject: Subject, current: Fit, shortlist: Sequence[Ranked], number: int, criteria: Criteria
) -> dict[str, Fit]:
    """Fits with each candidate of a shortlist, where it can be fitted.

    Candidates that change the elements' motion cost a hundred times the others: only where these leave it a chance.
    """
    cheap = [r for r in shortlist if not effect_definition(r.proposal.name).drives_elements]
    fits: dict[str, Fit] = {}
    for stage in (cheap, [r for r in shortlist if r not in cheap]):
        best = max((fit.gain_over(current) for fit in fits.values()), default=0.0)
        proposals = [r.proposal for r in stage if r.gain > PROMISING * best]
        if proposals:
            criteria.progress.report_refits(number, [p.name for p in proposals])
        tried = run_parallel(
            [partial(try_fit, subject, (*current.effects, make_effect(p)), warm=current) for p in proposals]
        )
        fits |= {p.name: fit for p, fit in zip(proposals, tried, strict=True) if fit is not None}
    return fits


def _candidates(
    subject: Subject, current: Fit, names: Sequence[str], seen: Collection[str], criteria: Criteria
) -> list[Ranked]:
    """The best proposal of every effect that is searched."""
    free = current.find_nuisance(subject.recording.used)

    def ranked(wanted: Sequence[str]) -> list[Ranked]:
        return rank_proposals(subject, current, search(subject, current, wanted, free))

    found = ranked([name for name in names if not effect_definition(name).costly])
    costly = _worth_a_search(current, found, seen, criteria)
    found += ranked([name for name in names if effect_definition(name).costly and name in costly])
    best: dict[str, Ranked] = {}
    for candidate in found:
        name = candidate.proposal.name
        if name not in best or candidate.gain > best[name].gain:
            best[name] = candidate
    return list(best.values())


def _worth_a_search(current: Fit, found: Sequence[Ranked], seen: Collection[str], criteria: Criteria) -> list[str]:
    """Effects whose search runs models: where the others leave something, or look like one of them."""
    costly = [name for name in criteria.excited if effect_definition(name).costly]
    best = max((r for r in found if r.proposal.feasible), key=lambda r: r.gain, default=None)
    if best is None:
        return costly
    left = math.sqrt(max(0.0, criteria.excess(current) ** 2 - max(0.0, best.gain) ** 2))
    return [
        name
        for name in costly
        if left > criteria.material or best.proposal.name in cause(name).confused_with or name in seen
    ]


def _shortlist(strong: Sequence[Ranked], criteria: Criteria) -> list[Ranked]:
    """Candidates, the best first, that a refit might put before the others."""
    if not strong:
        return []
    near = [r for r in strong if r.gain > CLOSE * strong[0].gain]
    kept = drop_duplicates(near, SAME_FORCE)[: criteria.table.refits]
    return [r for r in kept if r.gain > PROMISING * kept[0].gain or not effect_definition(r.proposal.name).linear]


def _choose(subject: Subject, current: Fit, fits: Mapping[str, Fit], criteria: Criteria) -> str | None:
    """The candidate to add: the best by cross-validation; among equals the one that leaves other numbers alone."""
    gains = {name: fit.gain_over(current) for name, fit in fits.items()}
    gains = {
        name: gain
        for name, gain in gains.items()
        if gain > criteria.enough(current)
        and not is_ruled_out(fits[name], name, subject)
        and not explains_noise(subject, fits[name], gain)
    }
    if not gains:
        return None
    best = max(gains, key=lambda name: gains[name])
    equal = [
        name
        for name in gains
        if name == best
        or difference_statistic(fits[best].cross, fits[name].cross) < EQUAL_T
        or gains[name] > SHARPER * gains[best]
    ]
    if len(equal) == 1:
        return best
    alone = fits if subject.is_open else {n: fit_model(subject, fits[n].effects, refitted=()) for n in equal}
    return min(equal, key=lambda name: float(alone[name].cross.sum()))


@dataclass(frozen=True, eq=False)
class Searched:
    """Result of the forward selection.

    Attributes:
        laws: the transitions, with the one that fits.
        fit: effects found, all of the machine's numbers refitted.
        criteria: from now on.
        scores: of all rounds.
        seen: effects that ever looked good.
        left_out: those of them whose model is not finite at the numbers it was fitted with.
    """

    laws: Laws
    fit: Fit
    criteria: Criteria
    scores: tuple[Score, ...]
    seen: frozenset[str]
    left_out: tuple[str, ...] = ()


def search_causes(laws: Laws, criteria: Criteria) -> Searched:
    """Search the causes; again without an effect whose states are at the limit of the model's integration steps.

    Raises:
        FitError: the model is not finite without such effects either.
    """
    try:
        return _search(laws, criteria)
    except EffectsError as error:
        left_out = tuple(name for name in error.effects if effect_definition(name).states)
        if not left_out:
            raise
        log_decision("selection", "effects that have no model along this record are left out", effects=left_out)
        excited = tuple(name for name in criteria.excited if name not in left_out)
        found = search_causes(laws, replace(criteria, excited=excited))
        return replace(found, left_out=left_out + found.left_out)


def _search(laws: Laws, criteria: Criteria) -> Searched:
    """Add effects one after the other, from the machine with all its own numbers refitted.

    Amid the search fits keep to the law that is taken, and both are compared before an effect is added that explains no
    more than they differ by: it might be that difference. And once nothing more is found; where the comparison changes
    something, the search goes on.
    """
    laws, current = fit_law(start_unknown_numbers(laws), (), criteria)
    whole = laws.chosen.whole
    criteria = raise_floor(criteria, noise_floor(whole.recording, current.residual, find_encoder_force(whole, current)))
    scores: tuple[Score, ...] = ()
    seen: frozenset[str] = frozenset()
    number, compared, ended = 0, True, False
    while True:
        excess = criteria.excess(current)
        # Where less is left than matters, no cause could.
        ended = ended or number == criteria.table.rounds or excess < criteria.material
        if not ended and (compared or excess > laws.doubt):
            number += 1
            criteria.progress.report_search(number)
            found = search_step(laws.chosen, current, number, seen, criteria)
            seen |= found.seen
            ended = found.fit is None
            if compared or found.fit is None or found.fit.gain_over(current) > laws.doubt:
                scores += found.scores
                if found.fit is not None:
                    known = prune_effects(laws.chosen, found.fit, criteria, least=1)
                    laws, current = fit_chosen(laws, known.effects, criteria, known=known)
                    compared = False
                    continue
        if compared:
            curved = fit_curve(laws.chosen, current, criteria)
            if curved is None:
                break
            laws, current = fit_chosen(laws, curved.effects, criteria, known=curved)
            compared, ended = False, False
            continue
        before, taken = current, laws.taken
        laws, current = fit_law(laws, current.effects, criteria, known=current)
        compared = True
        if laws.taken != taken or current.rms < SHARPER * before.rms:
            ended = False
    # What is left unexplained is no measure for the machine's numbers, but no finer one than that is possible.
    told = GAIN_SHARE * criteria.excess(current)
    criteria = replace(criteria, material=max(criteria.material, told))
    return Searched(laws, current, criteria, scores, seen)


def drop_effects(searched: Searched) -> Searched:
    """The same with none of the effects that were found."""
    laws, fit = fit_law(searched.laws, (), searched.criteria)
    return replace(searched, laws=laws, fit=fit)


def select_causes(searched: Searched) -> Selection:
    """Select the fewest effects and numbers of the machine that explain the record, and find their rivals."""
    subject, criteria = searched.laws.chosen, searched.criteria
    refitted, fit = keep_necessary(subject, searched.fit, criteria)
    contest = Contest(None, (), {})
    for number in range(1, RIVAL_STEPS + 1):
        criteria.progress.report_rivals(number, 0.0, "", ())
        contest = find_rivals(subject, fit, refitted, searched.seen, criteria, number)
        if contest.better is None:
            break
        refitted, fit = keep_necessary(subject, contest.better, criteria)
    unnamed = refitted if subject.is_open else ()
    groups = (*(() if unnamed else refitted), *fit.candidate_groups)
    return Selection(
        fit=fit,
        refitted=refitted,
        scores=searched.scores,
        rivals=contest.rivals,
        rejected=contest.rejected,
        p_values={group: cause_significance(subject, fit, group) for group in groups},
        free=searched.fit,
        unnamed=unnamed,
    )
