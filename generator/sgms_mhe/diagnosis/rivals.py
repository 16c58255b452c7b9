"""Every other candidate in each cause's place: those that fit as well on this record, and better."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from sgms_mhe.diagnosis.candidates import search
from sgms_mhe.diagnosis.criteria import (
    CLOSE,
    EQUAL_EXCESS,
    PROMISING,
    SAME_FORCE,
    SMALL_SHARE,
    Criteria,
    Ranked,
    drop_duplicates,
    is_ruled_out,
    linear_gain,
    list_addable,
    make_effect,
    rank_proposals,
)
from sgms_mhe.diagnosis.fits import Fit, Subject, try_fit
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, ParameterGroup, drop_effect, drop_group, machine_groups
from sgms_mhe.diagnosis.parts import Score
from sgms_mhe.diagnosis.proposals import Proposal
from sgms_mhe.diagnosis.uncertainty import explains_noise
from sgms_mhe.model.effects import EFFECT_NAMES, cause, effect_definition
from sgms_mhe.recordings.evidence import EQUAL_T, difference_statistic, gain_force, score_test
from sgms_mhe.recordings.excitation import find_steady_blocks
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.parallel import run_parallel, workers

Judgement = Literal["better", "rival", "worse", "untried"]


@dataclass(frozen=True, eq=False)
class Rival:
    """A candidate that fits as well as a cause: `fit` has its `group` in the cause's place."""

    group: ParameterGroup
    instead_of: str
    fit: Fit
    excess_N: float


@dataclass(frozen=True)
class Rejected:
    """A candidate that lost: in place of `instead_of` it leaves `excess_N` more [N]."""

    instead_of: str
    excess_N: float


@dataclass(frozen=True, eq=False)
class Contest:
    """Contest of the causes of a fit with the rest of the catalogue.

    Attributes:
        better: a fit with a better candidate in a cause's place; the rest then says nothing.
        rivals: candidates that fit as well.
        rejected: the others, by name.
    """

    better: Fit | None
    rivals: tuple[Rival, ...]
    rejected: Mapping[str, Rejected]


@dataclass(frozen=True, eq=False)
class _RivalPlace:
    """A cause's place among the others.

    Attributes:
        group: of the cause.
        fit: with the cause.
        without: without it.
        effects: effects under test that stay, as they are beside it.
        refitted: groups of the machine's own numbers that stay free without it.
        gain: RMS of the force it explains [N].
        ranked: candidates for it, the most promising first.
    """

    group: ParameterGroup
    fit: Fit
    without: Fit
    effects: tuple[CandidateEffect, ...]
    refitted: tuple[ParameterGroup, ...]
    gain: float
    ranked: tuple[Ranked, ...]

    @property
    def cause(self) -> str:
        """Whose place it is."""
        return self.group.cause


@dataclass(frozen=True, eq=False)
class _JudgedRival:
    """A candidate in a cause's place; `fit` where it was tried."""

    name: str
    judgement: Judgement
    excess: float
    group: ParameterGroup | None = None
    fit: Fit | None = None


def find_rivals(
    subject: Subject,
    fit: Fit,
    refitted: tuple[ParameterGroup, ...],
    seen: Collection[str],
    criteria: Criteria,
    number: int,
) -> Contest:
    """Put every other candidate in the place of each cause of a fit.

    `seen`: effects that ever looked good; `number`: of the round, from 1.
    """
    rivals: list[Rival] = []
    rejected: dict[str, Rejected] = {}
    groups = (*(() if subject.is_open else refitted), *fit.candidate_groups)
    make_place = partial(_place, subject, fit, refitted, seen=seen, criteria=criteria)
    for k, place in enumerate(_list_ahead(make_place, groups)):
        if place is None:
            continue
        comparing = partial(criteria.progress.report_rivals, number, k / len(groups), place.cause)
        for judged in _contest(subject, place, criteria, comparing):
            if judged.judgement == "better":
                return Contest(judged.fit, (), {})
            if judged.judgement == "rival" and judged.fit is not None:
                own = judged.group or judged.fit.candidate_groups[-1]
                rivals.append(Rival(own, place.cause, judged.fit, judged.excess))
            elif judged.judgement == "worse" or judged.name not in rejected:
                rejected[judged.name] = Rejected(place.cause, judged.excess)
    return Contest(None, tuple(rivals), rejected)


def _list_ahead(
    make_place: Callable[[ParameterGroup], _RivalPlace | None], groups: Sequence[ParameterGroup]
) -> Iterator[_RivalPlace | None]:
    """Return the places of causes in their order, as many made at a time as there are cores: most may not be needed."""
    ahead = workers()
    for first in range(0, len(groups), ahead):
        yield from run_parallel([partial(make_place, group) for group in groups[first : first + ahead]])


def _place(
    subject: Subject,
    fit: Fit,
    refitted: tuple[ParameterGroup, ...],
    group: ParameterGroup,
    *,
    seen: Collection[str],
    criteria: Criteria,
) -> _RivalPlace | None:
    """The place of a cause and who might take it; None where it explains nothing, or no model is finite without it."""
    effects, base = drop_effect(fit.effects, group), drop_group(refitted, group)
    without = try_fit(subject, effects, refitted=base, warm=fit)
    if without is None or (gain := fit.gain_over(without)) <= 0.0:
        return None
    found = (*_effects(subject, without, group.cause, seen, criteria), *_machine_numbers(subject, without, refitted))
    ranked = tuple(sorted(found, key=lambda r: -r.gain))
    return _RivalPlace(group, fit, without, effects, base, gain, ranked)


def _contest(
    subject: Subject, place: _RivalPlace, criteria: Criteria, comparing: Callable[[Sequence[str]], None]
) -> Iterator[_JudgedRival]:
    """Judge all candidates for a place, the most promising first; `comparing` is told which are tried."""
    ranked = place.ranked
    kept = drop_duplicates(ranked, SAME_FORCE)[: criteria.table.refits]
    if criteria.one_speed:
        kept += [r for r in ranked if r not in kept and criteria.has_same_clock(place.cause, _name(r))]
    others = [r for r in ranked if _name(r) != place.cause]
    tried = [r for r in others if r in kept and not r.gain < _promising(place.cause, _name(r)) * place.gain]
    if tried:
        comparing([_name(r) for r in tried])
    trials = iter(run_parallel([partial(_trial, subject, place, r) for r in tried]))
    for candidate in others:
        name = _name(candidate)
        if candidate not in tried:
            left = math.sqrt(max(0.0, place.gain**2 - max(candidate.gain, 0.0) ** 2))
            yield _JudgedRival(name, "untried", left)
        elif (trial := next(trials)) is not None:
            judgement, excess = _judge(subject, place, name, trial, criteria)
            yield _JudgedRival(name, judgement, excess, candidate.group, trial)


def _promising(named: str, other: str) -> float:
    """Share of a cause's gain from which on a candidate's linear one makes a refit worth its while."""
    alike = other in cause(named).confused_with or named in cause(other).confused_with
    return CLOSE if alike else PROMISING


def _name(candidate: Ranked) -> str:
    return candidate.group.cause if candidate.group else candidate.proposal.name


def _trial(subject: Subject, place: _RivalPlace, candidate: Ranked) -> Fit | None:
    """The fit with a candidate in the place; None where it is no model of the record."""
    effects = place.effects if candidate.group else (*place.effects, make_effect(candidate.proposal))
    base = (*place.refitted, candidate.group) if candidate.group else place.refitted
    return try_fit(subject, effects, refitted=base, warm=place.without)


def _effects(
    subject: Subject, without: Fit, instead_of: str, seen: Collection[str], criteria: Criteria
) -> list[Ranked]:
    """Effects in a cause's place; costly ones only if they ever looked good or are known to be confused with it."""
    free = without.find_nuisance(subject.recording.used)
    names = [
        name
        for name in list_addable(subject.machine, without.effects, criteria, instead_of=instead_of)
        if name != instead_of
        and (not effect_definition(name).costly or name in seen or instead_of in cause(name).confused_with)
    ]
    return rank_proposals(subject, without, [p for p in search(subject, without, names, free) if p.feasible])


def _machine_numbers(subject: Subject, without: Fit, refitted: tuple[ParameterGroup, ...]) -> list[Ranked]:
    """The machine's own numbers that are not refitted yet, in a cause's place."""
    recording = subject.recording
    jacobian = without.jacobian[recording.used]
    free = without.find_nuisance(recording.used)
    found = []
    for group in machine_groups(subject.machine):
        if group in refitted:
            continue
        Z = free.project(jacobian[:, [i for i, c in enumerate(without.model.columns) if c.group == group]])
        p, size = score_test(recording, Z, free.project(without.residual[recording.used]))
        proposal = Proposal(group.cause, {}, Z, size, 0.0, 1.0, p, True)
        found.append(Ranked(linear_gain(subject, without, proposal), proposal, group))
    return found


def _judge(subject: Subject, place: _RivalPlace, name: str, trial: Fit, criteria: Criteria) -> tuple[Judgement, float]:
    """A refitted candidate against the cause whose place it took, and the RMS it leaves more [N]."""
    judgement, excess = _compare(subject, place, name, trial, criteria)
    log_decision(
        "rivals",
        "candidate refitted in a cause's place",
        candidate=name,
        instead_of=place.cause,
        leaves_more_N=excess,
        t=difference_statistic(place.fit.cross, trial.cross),
        gain_of_cause_N=place.gain,
        material_N=criteria.material,
        outcome=judgement,
    )
    if judgement != "worse" and name in EFFECT_NAMES:
        gain = trial.gain_over(place.without)
        if explains_noise(subject, trial, gain):
            log_decision("rivals", "a candidate that explains noise alone is none", candidate=name, gain_N=gain)
            return "worse", max(0.0, excess)
    return judgement, excess


def _compare(
    subject: Subject, place: _RivalPlace, name: str, trial: Fit, criteria: Criteria
) -> tuple[Judgement, float]:
    """The same by the residuals of both."""
    material = criteria.material
    has_same_clock = criteria.has_same_clock(place.cause, name)
    steady = find_steady_blocks(subject.recording) if has_same_clock else None
    if steady is not None:
        t, gain = difference_statistic(place.fit.cross, trial.cross), place.fit.gain_over(trial)
        if _is_clear(t, gain, criteria):
            # The start and the stop do not tell the two apart, but a model has to run through them.
            return "better", gain
    told = np.ones(subject.recording.blocks, dtype=np.bool_) if steady is None else steady
    excess = gain_force(trial.cross[told], place.fit.cross[told], place.fit.rows[told])
    t = difference_statistic(place.fit.cross[told], trial.cross[told])
    unseen = has_same_clock or (name in EFFECT_NAMES and name not in criteria.excited)
    if is_ruled_out(trial, name, subject):
        return "worse", max(0.0, excess)
    as_good = excess < EQUAL_EXCESS * material
    if as_good and unseen:
        return "rival", excess  # however well it fits: the record does not hold what would show it
    clearly = _is_clear(t, excess, criteria)
    simpler = name in cause(place.cause).simpler.causes and excess < material
    if simpler and t > EQUAL_T and excess > EQUAL_EXCESS * material:
        return "rival", excess  # something more is there for sure, but not enough to matter
    if clearly or simpler:
        return "better", excess
    hardly = excess > -EQUAL_EXCESS * material or t > -EQUAL_T
    if place.cause in cause(name).simpler.causes and hardly:
        return "worse", max(0.0, excess)  # more numbers and no better: it only imitates
    # The start and the stop pull at the numbers of what is told by them alone.
    same = has_same_clock or t < EQUAL_T or excess < CLOSE * material
    if as_good or (excess < SMALL_SHARE * place.gain and same):
        return "rival", excess
    return "worse", excess


def _is_clear(t: float, excess: float, criteria: Criteria) -> bool:
    return t < -EQUAL_T and excess < -EQUAL_EXCESS * criteria.material


def cause_significance(subject: Subject, fit: Fit, group: ParameterGroup) -> float:
    """Score test of a group's parameters at a fit (Wald form)."""
    recording, columns = subject.recording, fit.model.columns
    inside = np.array([c.group == group for c in columns]) & fit.free
    X = fit.jacobian[recording.used]
    free = fit.find_nuisance(recording.used, inside)
    Z = free.project(X[:, inside])
    # Distance of the sizes from those that they have without the cause; a lag's too, whose force is no multiple of it.
    if group.is_candidate:
        own = effect_definition(group.cause)
        sizes = np.array([c.group == group and own.parameter(c.name).is_size for c in columns])
        none = np.array([c.theta(c.none) if c.group == group else 0.0 for c in columns])
        shift = np.where(sizes, fit.theta - none, 0.0)[inside]
    else:
        shift = (fit.theta - np.array([c.machine_theta for c in columns]))[inside]
    p, _ = score_test(recording, Z, free.project(fit.residual[recording.used]) + Z @ shift)
    return p


@dataclass(frozen=True, eq=False)
class Selection:
    """Selected causes.

    Attributes:
        fit: effects and the machine's numbers that are wrong; all other numbers as in the machine file.
        refitted: groups of the machine's own numbers that are free.
        scores: of all rounds.
        rivals: of the causes.
        rejected: candidates put in a cause's place and lost.
        p_values: of each cause.
        unnamed: those of `refitted` that are no cause: free because something else is left, not because they are wrong.
        inconstant: names of candidates that are no cause because their size changes over the record.
        free: where the forward search ended, all of the machine's numbers refitted.
    """

    fit: Fit
    refitted: tuple[ParameterGroup, ...]
    scores: tuple[Score, ...]
    rivals: tuple[Rival, ...]
    rejected: Mapping[str, Rejected]
    p_values: Mapping[ParameterGroup, float]
    free: Fit
    unnamed: tuple[ParameterGroup, ...] = ()
    inconstant: tuple[str, ...] = ()

    @property
    def causes(self) -> tuple[ParameterGroup, ...]:
        """Groups that are named: the machine's own, then effects under test."""
        own = tuple(group for group in self.refitted if group not in self.unnamed)
        return own + self.fit.candidate_groups
