"""Backwards: effects, entries of their lists and numbers a selection can do without."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sgms_mhe.diagnosis.candidates import search
from sgms_mhe.diagnosis.criteria import Criteria, make_effect, small_force
from sgms_mhe.diagnosis.fits import Fit, Subject, fit_model, prior_information, try_fit
from sgms_mhe.diagnosis.maps import ENTRY_GAIN
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, ParameterGroup, drop_effect, drop_group, machine_groups
from sgms_mhe.model.effects import cause, effect_definition
from sgms_mhe.model.effects.search import Harmonic, Periodic
from sgms_mhe.recordings.evidence import cross_loss, gain_force
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.parallel import run_parallel

Groups = tuple[ParameterGroup, ...]


def join_map(subject: Subject, fit: Fit, criteria: Criteria) -> Fit:
    """The fit with one map in place of a map and the ripples beside it, where it has no more numbers and is as good.

    A search adds one effect after the other: of a map whose first sine is by far the strongest it adds one as a
    ripple, and the rest as a map of another period.
    """
    mapped = [e for e in fit.effects if isinstance(effect_definition(e.name).search, Periodic)]
    for one in mapped:
        simpler = cause(one.name).simpler.causes
        ripples = [
            e for e in fit.effects if e.name in simpler and isinstance(effect_definition(e.name).search, Harmonic)
        ]
        if not ripples:
            continue
        parts = [one, *ripples]
        others = tuple(effect for effect in fit.effects if effect not in parts)
        without = try_fit(subject, others, warm=fit)
        if without is None:
            continue
        used = subject.choose_rate(others).recording.used
        free = without.find_nuisance(used)
        numbers = sum(len(effect.parameters) for effect in parts)
        for whole in search(subject, without, [one.name], free):
            trial = try_fit(subject, (*others, make_effect(whole)), warm=without)
            if trial is None or len(whole.parameters) > numbers:
                continue
            if criteria.is_as_good(fit, trial):
                return trial
    return fit


def reduce_orders(effect: CandidateEffect) -> CandidateEffect:
    """The same force over its shortest period: all multiples of that are periods too."""
    definition = effect_definition(effect.name)
    kind = definition.search
    if not isinstance(kind, Periodic):
        return effect
    orders = {key: round(value) for key, value in effect.parameters.items() if kind.order.holds(key)}
    common = math.gcd(*orders.values())
    lower = {key: float(order // common) for key, order in orders.items()}
    period = effect.parameters[kind.sine.period] / common
    return replace(effect, parameters={**effect.parameters, **lower, kind.sine.period: period})


def prune_effects(
    subject: Subject, fit: Fit, criteria: Criteria, *, refitted: Sequence[ParameterGroup] | None = None, least: int = 0
) -> Fit:
    """The fit without effects the others have made superfluous; `least` effects stay.

    `refitted`: groups of the machine's own numbers that are free; None: all. An effect without which there is no model
    of the record is not superfluous.
    """
    while len(fit.effects) > least:
        fits = run_parallel(
            [
                partial(try_fit, subject, drop_effect(fit.effects, group), refitted=refitted, warm=fit)
                for group in fit.candidate_groups
            ]
        )
        trials = [trial for trial in fits if trial is not None]
        gains = [fit.gain_over(trial) for trial in trials]
        stays = not gains or min(gains) > criteria.material
        log_decision(
            "reduction",
            "effect without which no more is left than matters is superfluous",
            effects=[effect.name for effect in fit.effects],
            least_loss_N=min(gains, default=math.inf),
            material_N=criteria.material,
            left=[effect.name for effect in (fit if stays else trials[gains.index(min(gains))]).effects],
        )
        if stays:
            return fit
        fit = trials[gains.index(min(gains))]
    return fit


def find_wrong_numbers(subject: Subject, fit: Fit, criteria: Criteria) -> tuple[Groups, Fit]:
    """Return the machine's numbers that must differ from the file: the fewest groups without a material loss.

    All of them where the numbers are the record's. Not small ones: laws of friction and long steps are wrong by as
    much, where elements slip. Returns them, and the fit with only them free.
    """
    effects, material = fit.effects, max(criteria.material, small_force(subject.machine))
    everything = fit_model(subject, effects, warm=fit)
    if subject.is_open:
        return machine_groups(subject.machine), everything
    named: Groups = ()
    current = fit_model(subject, effects, refitted=(), warm=everything)
    while True:
        missing = everything.gain_over(current)
        rest = [group for group in machine_groups(subject.machine) if group not in named]
        if missing < material or not rest:
            break
        fits = run_parallel([partial(try_fit, subject, effects, refitted=(*named, g), warm=everything) for g in rest])
        trials = {group: trial for group, trial in zip(rest, fits, strict=True) if trial is not None}
        if not trials:
            break
        best = min(trials, key=lambda group: float(trials[group].cross.sum()))
        if trials[best].gain_over(current) < material:
            break
        named, current = (*named, best), trials[best]
    for group in named:  # an early one may have stood in for later ones
        if len(named) < 2:
            break
        without = drop_group(named, group)
        trial = try_fit(subject, effects, refitted=without, warm=current, again=True)
        if trial is not None and current.gain_over(trial) < material:
            named, current = without, trial
    log_decision(
        "reduction",
        "fewest numbers of the file that must differ",
        effects=[effect.name for effect in effects],
        material_N=material,
        residual_all_free_N=everything.cross_rms,
        residual_N=current.cross_rms,
        wrong=[group.name for group in named],
    )
    return named, current


def keep_necessary(subject: Subject, fit: Fit, criteria: Criteria) -> tuple[Groups, Fit]:
    """The wrong numbers, and the fit without effects that are superfluous beside those."""
    refitted, fit = find_wrong_numbers(subject, join_map(subject, fit, criteria), criteria)
    return refitted, shorten_lists(
        subject, prune_effects(subject, fit, criteria, refitted=refitted), criteria, refitted
    )


def shorten_lists(subject: Subject, fit: Fit, criteria: Criteria, refitted: Sequence[ParameterGroup]) -> Fit:
    """The fit without entries of lists that gain nothing on unseen folds, to first order; one entry stays.

    The rest of a map is stated over its shortest period.
    """
    gain = ENTRY_GAIN * criteria.material
    for group in fit.candidate_groups:
        definition = effect_definition(group.cause)
        if definition.any_curve:
            continue  # what lies between the others is not none without it
        entries = _entries(fit, group)
        dropped: list[int] = []
        cross = fit.cross
        while len(entries) - len(dropped) > 1:
            left = {i: _cross_without(subject, fit, group, (*dropped, i)) for i in entries if i not in dropped}
            weakest = min(left, key=lambda i: float(left[i].sum()))
            if gain_force(cross, left[weakest], fit.rows) < -gain:
                break
            dropped, cross = [*dropped, weakest], left[weakest]
        values = fit.effects[group.index].parameters
        names = [name for name in values if not any(name in entries[i] for i in dropped)]
        short = definition.lists({name: values[name] for name in names})
        least = reduce_orders(CandidateEffect(group.cause, definition.entries(short)))
        if least.parameters != values:
            effects = [least if i == group.index else effect for i, effect in enumerate(fit.effects)]
            fit = fit_model(subject, effects, refitted=refitted, warm=fit)
    return fit


def _entries(fit: Fit, group: ParameterGroup) -> dict[int, tuple[str, ...]]:
    """Names of an effect's numbers by the entry of its lists they are of; empty where it has none."""
    lists = [p for p in effect_definition(group.cause).parameters if p.array]
    values = fit.effects[group.index].parameters
    count = sum(lists[0].holds(name) for name in values) if lists else 0
    return {i: tuple(p.entry(i) for p in lists) for i in range(1, count + 1)}


def _cross_without(subject: Subject, fit: Fit, group: ParameterGroup, dropped: Sequence[int]) -> Array:
    """Losses (blocks) by cross-validation where some entries of an effect's lists are none."""
    entries = _entries(fit, group)
    names = {name for i in dropped for name in entries[i]}
    columns = fit.model.columns
    inside = np.array([c.group == group and c.name in names for c in columns])
    sizes = inside & np.array([c.proportional for c in columns])
    shift = (fit.theta - np.array([c.theta(c.none) for c in columns]))[sizes]
    kept = fit.interior & ~inside
    residual = fit.residual + fit.jacobian[:, sizes] @ shift
    prior = prior_information(subject, fit.model, kept)
    return cross_loss(subject.choose_rate(fit.effects).recording, fit.jacobian[:, kept], residual, prior)
