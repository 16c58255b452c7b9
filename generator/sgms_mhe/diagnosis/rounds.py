"""One round of the forward search: every effect searched, the best refitted, the best of these added."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.candidates import search
from sgms_mhe.diagnosis.criteria import Criteria, addable
from sgms_mhe.diagnosis.descent import FitError
from sgms_mhe.diagnosis.fitting import fit_model
from sgms_mhe.diagnosis.groups import Extra, Group
from sgms_mhe.diagnosis.noise_response import explains_noise
from sgms_mhe.diagnosis.proposals import Proposal
from sgms_mhe.diagnosis.result import Outcome, Score
from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.model.effects import cause, effect_definition
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.evidence import cross_loss, difference_statistic, gain_force, nuisance
from sgms_mhe.recordings.repetition import in_step
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.parallel import in_parallel

Array = NDArray[np.float64]

PROMISING: Final = 0.8
"""Linear gain from which a candidate is refitted, if it is close too [gain to be added]: a refit finds more."""
CLOSE: Final = 0.55
"""Linear gain from which a candidate is refitted, if it is promising too [best linear gain]: a refit changes the order.
"""
CLEAR: Final = 0.8
"""Linear gain from which a candidate is refitted whose force is linear in its sizes [best linear gain]: its linear gain
says all of it."""
SAME_FORCE: Final = 0.985
"""Correlation from which two candidates make one force [1]: the one with fewer numbers is refitted."""
EQUAL_GAIN: Final = 0.97
"""Gain from which refitted candidates are equals [best gain]: the one that leaves the machine's numbers alone is added.
"""
EQUAL_T: Final = 2.5
"""T over blocks up to which two fits are equally good [1]: two-sided one percent."""


@dataclass(frozen=True, eq=False)
class Ranked:
    """A proposal and the RMS of the force that it explains by cross-validation, to first order [N].

    `group`: numbers of the machine that it is; None: an effect.
    """

    gain: float
    proposal: Proposal
    group: Group | None = None


@dataclass(frozen=True, eq=False)
class Round:
    """What a round found.

    Attributes:
        fit: with the effect that is added; None: none is.
        scores: of every candidate.
        seen: names of those that looked good.
    """

    fit: Fit | None
    scores: tuple[Score, ...]
    seen: frozenset[str]


def search_round(subject: Subject, current: Fit, number: int, seen: Collection[str], criteria: Criteria) -> Round:
    """Search, refit the best, choose the one to add to the current fit; `seen`: what looked good before."""
    names = addable(subject.machine, current.extras, criteria)
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
        refit = gain_force(current.cross, fits[p.name].cross, current.rows) if p.name in fits else math.nan
        p_value = min(1.0, p.p_value * len(names))
        scores.append(Score(p.name, number, p_value, max(0.0, ranked.gain), refit, dict(p.parameters), outcome))
    log_decision(
        "search",
        "effect that explains most of those significant and large enough, refitted",
        step=number,
        effects=[extra.name for extra in current.extras],
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
    return Round(
        fit=None if chosen is None else fits[chosen],
        scores=tuple(scores),
        seen=frozenset(r.proposal.name for r in strong),
    )


def _refits(
    subject: Subject, current: Fit, shortlist: Sequence[Ranked], number: int, criteria: Criteria
) -> dict[str, Fit]:
    """Fits with each candidate of a shortlist, where it can be fitted.

    What takes the elements' motion from them costs a hundred times the others: only where these leave it a chance.
    """
    cheap = [r for r in shortlist if not effect_definition(r.proposal.name).drives_elements]
    fits: dict[str, Fit] = {}
    for stage in (cheap, [r for r in shortlist if r not in cheap]):
        best = max((gain_force(current.cross, fit.cross, fit.rows) for fit in fits.values()), default=0.0)
        proposals = [r.proposal for r in stage if r.gain > CLEAR * best]
        if proposals:
            criteria.course.refits(number, [p.name for p in proposals])
        tried = in_parallel(
            [partial(attempted_fit, subject, (*current.extras, p.extra), warm=current) for p in proposals]
        )
        fits |= {p.name: fit for p, fit in zip(proposals, tried, strict=True) if fit is not None}
    return fits


def _candidates(
    subject: Subject, current: Fit, names: Sequence[str], seen: Collection[str], criteria: Criteria
) -> list[Ranked]:
    """The best proposal of every effect that is searched."""
    free = nuisance(current.slopes[subject.recording.used][:, current.loose])

    def ranked(wanted: Sequence[str]) -> list[Ranked]:
        return with_gains(subject, current, search(subject, current, wanted, free))

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
    kept = distinct(near, SAME_FORCE)[: criteria.table.refits]
    return [r for r in kept if r.gain > CLEAR * kept[0].gain or not effect_definition(r.proposal.name).linear]


def attempted_fit(
    subject: Subject, extras: Sequence[Extra], *, refitted: Sequence[Group] | None = None, warm: Fit | None = None
) -> Fit | None:
    """A fit, or None where the model is not finite from its start on."""
    try:
        return fit_model(subject, extras, refitted=refitted, warm=warm)
    except FitError:
        return None


def is_ruled_out(fit: Fit, name: str, subject: Subject) -> bool:
    """Whether the effect that was added last has turned into a simpler one, or into one that no such axis has."""
    if not fit.extras or fit.extras[-1].name != name:
        return False
    parameters = fit.extras[-1].parameters
    definition = effect_definition(name)
    if not definition.possible(parameters, scales_of(subject.machine)):
        return True
    if definition.sine is not None and definition.sine.coordinate == "time":
        frequency = np.array([parameters[definition.sine.period]])
        if in_step(subject.recording, frequency).any():
            return True
    return cause(name).simpler.reached(parameters, subject.recording.extents)


def _choose(subject: Subject, current: Fit, fits: Mapping[str, Fit], criteria: Criteria) -> str | None:
    """The candidate to add: the best by cross-validation; among equals the one that leaves other numbers alone."""
    gains = {name: gain_force(current.cross, fit.cross, fit.rows) for name, fit in fits.items()}
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
        or gains[name] > EQUAL_GAIN * gains[best]
    ]
    if len(equal) == 1:
        return best
    alone = {name: fit_model(subject, fits[name].extras, refitted=()) for name in equal}
    return min(alone, key=lambda name: float(alone[name].cross.sum()))


def with_gains(subject: Subject, current: Fit, proposals: Sequence[Proposal]) -> list[Ranked]:
    """Proposals with what they explain by cross-validation, in their order."""
    gains = in_parallel([partial(linear_gain, subject, current, proposal) for proposal in proposals])
    return [Ranked(gain, proposal) for gain, proposal in zip(gains, proposals, strict=True)]


def linear_gain(subject: Subject, current: Fit, proposal: Proposal) -> float:
    """RMS of the force that a proposal explains by cross-validation, to first order [N]."""
    recording = subject.recording
    # Columns are projected on used rows: the other parameters follow by themselves.
    full = np.zeros((len(recording.time), proposal.columns.shape[1]))
    full[recording.used] = proposal.columns
    shift = np.zeros(len(recording.time))
    shift[recording.used] = proposal.columns @ proposal.coefficients
    prior = 1e-9 * np.maximum(np.sum(full**2, axis=0), 1e-300)
    after = cross_loss(recording, full, current.residual - shift, prior)
    return gain_force(current.loss, after, current.rows)


def distinct(ranked: Sequence[Ranked], same_force: float) -> list[Ranked]:
    """Without proposals that make the same force as another one with fewer numbers."""
    forces = [r.proposal.columns @ r.proposal.coefficients for r in ranked]
    numbers = [len(r.proposal.parameters) or r.proposal.columns.shape[1] for r in ranked]

    def same(x: Array, y: Array) -> bool:
        return float(x @ y) > same_force * math.sqrt(float(x @ x) * float(y @ y))

    return [
        candidate
        for candidate, force, count in zip(ranked, forces, numbers, strict=True)
        if not any(other < count and same(at, force) for at, other in zip(forces, numbers, strict=True))
    ]
