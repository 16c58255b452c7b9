"""Sines that come again with a map belong to it, and a map is stated over the shortest of its periods."""

from __future__ import annotations

import math
from dataclasses import replace

from sgms_mhe.diagnosis.candidates import search
from sgms_mhe.diagnosis.criteria import Criteria
from sgms_mhe.diagnosis.groups import Extra
from sgms_mhe.diagnosis.rounds import attempted_fit
from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.model.effects import cause, effect_definition
from sgms_mhe.model.effects.search import Harmonic, Periodic
from sgms_mhe.recordings.evidence import nuisance


def joined(subject: Subject, fit: Fit, criteria: Criteria) -> Fit:
    """The fit with one map in place of a map and the ripples beside it, where it has no more numbers and is as good.

    A search adds one effect after the other: of a map whose first sine is by far the strongest it adds that one as a
    ripple, and what is left as a map of another period.
    """
    mapped = [e for e in fit.extras if isinstance(effect_definition(e.name).search, Periodic)]
    for one in mapped:
        simpler = cause(one.name).simpler.causes
        ripples = [
            e for e in fit.extras if e.name in simpler and isinstance(effect_definition(e.name).search, Harmonic)
        ]
        if not ripples:
            continue
        parts = [one, *ripples]
        others = tuple(extra for extra in fit.extras if extra not in parts)
        without = attempted_fit(subject, others, warm=fit)
        if without is None:
            continue
        used = subject.suited(others).recording.used
        free = nuisance(without.slopes[used][:, without.loose])
        numbers = sum(len(extra.parameters) for extra in parts)
        for whole in search(subject, without, [one.name], free):
            trial = attempted_fit(subject, (*others, whole.extra), warm=without)
            if trial is None or len(whole.parameters) > numbers:
                continue
            if criteria.costs_nothing(fit, trial):
                return trial
    return fit


def in_lowest_terms(extra: Extra) -> Extra:
    """The same force over its shortest period: all multiples of that are periods too."""
    definition = effect_definition(extra.name)
    kind = definition.search
    if not isinstance(kind, Periodic):
        return extra
    orders = {key: round(value) for key, value in extra.parameters.items() if kind.order.holds(key)}
    common = math.gcd(*orders.values())
    lower = {key: float(order // common) for key, order in orders.items()}
    period = extra.parameters[kind.sine.period] / common
    return replace(extra, parameters={**extra.parameters, **lower, kind.sine.period: period})
