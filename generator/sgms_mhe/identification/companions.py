"""Choice of the effects that stand beside the elements, by the gain on held-out samples."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from sgms_mhe.identification.fits import AxisFit, RecordView, fit_axis
from sgms_mhe.identification.record_numbers import fit_record_terms
from sgms_mhe.identification.records import ElementMotion
from sgms_mhe.identification.search import CHOICE_ITERATIONS, Views, align, fit_aligned, is_better
from sgms_mhe.identification.terms import (
    LAW_AND_SAMPLING,
    LEVEL_OF_RECORD,
    OF_RECORD,
    KnownFriction,
    Term,
    effect_parameters,
    is_friction,
    is_level,
    is_within_limits,
    level_terms,
    place_curve,
    transmitted_force,
)
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition, separating_moves
from sgms_mhe.model.effects.search import Harmonic
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.decisions import log_decision


def add_companions(
    views: Views, whole: AxisFit, base: Sequence[Term], companions: Sequence[Term], excited: Collection[str]
) -> tuple[AxisFit, dict[str, tuple[str, ...]]]:
    """Return the fit with the effects that it gains by, the best first; of two that gain alike that of fewer sizes.

    An effect of more sizes that has the best one as a limit, and would show itself in the motion, is no rival where it
    gains no more.

    Every one begins from the shape of the fit with all of them: elements that had to stand for gravity are none to
    begin from. An effect the motion does not excite counts beside a simpler one that it does: over a short way it
    may be either.

    Returns:
        The fit, and by the names of effects in it those that explain the records as well, or that the motion does not
        tell from it.
    """
    # The motion excites an effect where it excites one of its simpler limits.
    left = [t for t in companions if not {t.name, *effect_definition(t.name).simpler.causes}.isdisjoint(excited)]
    left += fit_record_terms(views, whole)
    machine = views.fine.rows.machine
    lined, base = align(views, whole), [term for term in base if term.name not in OF_RECORD]
    fit = fit_axis(lined, base, whole.shape, iterations=CHOICE_ITERATIONS)
    rivals: dict[str, tuple[str, ...]] = {}
    source = whole
    while True:
        level = [term for term in fit_level_terms(views.fine.rows, source) if term.name in excited]
        level = [term for term in level if not fit.place(term.name).stop]
        level = list(best_trials(lined, fit, level))
        tried = {
            term.name: fit_axis(lined, (*fit.terms, term), whole.shape, iterations=CHOICE_ITERATIONS)
            for term in sorted((*left, *level), key=lambda term: term.columns.shape[1])
        }
        better = [name for name, other in tried.items() if is_better(other, fit) and is_possible(machine, other)]
        bends = {name: bend(lined, tried[name]) for name in better}
        better = [name for name in better if bends[name] <= 1.0]
        log_decision(
            "companions",
            "effect beside the elements that leaves clearly less on unseen rows",
            residual_N=fit.cross_rms,
            residual_with_N={name: other.cross_rms for name, other in tried.items()},
            gains=better,
        )
        if not better:
            break
        best = better[0]
        for name in better[1:]:
            if is_better(tried[name], tried[best]):
                best = name
        fit = source = _drop_replaced(lined, tried[best], best)
        left = [term for term in left if term.name != best]
        if best in OF_RECORD:
            continue
        rivals[best] = tuple(
            other
            for other in better
            if other not in (best, *OF_RECORD)
            and separating_moves(best, other)
            and not is_better(fit, tried[other])
            and not (
                other in excited
                and best in effect_definition(other).simpler.causes
                and len(tried[other].coefficients) > len(tried[best].coefficients)
            )
        )
        if effect_definition(best).elastic and bends[best] > 0.0:
            rivals[best] += _ripples(best)
        if best not in excited:
            limits = [name for name in effect_definition(best).simpler.causes if name in tried]
            rivals[best] = (min(limits, key=lambda name: tried[name].cross_rms),) if limits else rivals[best]
    return fit_aligned(views, fit.terms, fit.shape, rounds=1), {a: b for a, b in rivals.items() if b}


def bend(view: RecordView, fit: AxisFit) -> float:
    """Return the deviation of a force over the place from a straight line, over the size of a fit's spring.

    0 where there is no spring, or the place shows nothing but a straight line. Beyond 1 the spring is a part of it.
    """
    springs = [term for term in fit.terms if term.name not in LAW_AND_SAMPLING and effect_definition(term.name).elastic]
    if not springs:
        return 0.0
    curve = place_curve(view.rows)
    bent = fit_axis(view, (*fit.terms, curve), fit.shape, iterations=0)
    spring, beside = (
        float(np.std(np.sum([term.columns @ bent.coefficient(term.name) for term in terms], axis=0)[view.rows.used]))
        for terms in (springs, [curve])
    )
    return beside / max(spring, np.finfo(float).tiny) if is_better(bent, fit) else 0.0


def _drop_replaced(view: RecordView, fit: AxisFit, newest: str) -> AxisFit:
    """The fit without the effects that leave no less beside the newest: they stood for it."""
    for term in fit.terms:
        if term.name in (newest, *LAW_AND_SAMPLING):
            continue
        terms = [other for other in fit.terms if other is not term]
        without = fit_axis(view, terms, fit.shape, iterations=CHOICE_ITERATIONS)
        if not is_better(fit, without):
            fit = without
    return fit


def _ripples(name: str) -> tuple[str, ...]:
    """The sines over the position an effect is confused with."""
    searches = {other: effect_definition(other).search for other in effect_definition(name).confused_with}
    return tuple(
        other for other, search in searches.items() if isinstance(search, Harmonic) and search.coordinate == "position"
    )


def is_possible(machine: Machine, fit: AxisFit) -> bool:
    """Return True if a machine file may state every effect of a fit, and an axis of its friction can have it.

    Else it stands for something else: it would drive the axis, say.
    """
    scales = replace(scales_of(machine), coulomb=fit.coulomb, damping=float(fit.coefficient("viscous").sum()))
    found = [(term, fit.coefficient(term.name)) for term in fit.terms if term.name not in LAW_AND_SAMPLING]
    return all(
        is_within_limits(term, sizes) and effect_definition(term.name).possible(effect_parameters(term, sizes), scales)
        for term, sizes in found
    )


def fit_level_terms(rows: Recording, fit: AxisFit, sliding: Array | None = None) -> tuple[Term, ...]:
    """Return the effects of the level of a fit, with all trials of their nonlinear parameters.

    `sliding`: as of `level_terms`; None: the fit's.
    """
    moved = rows.machine.plant.moved + float(fit.coefficient("mass").sum())
    beside = sum(fit.jacobian[:, fit.place(t.name)] @ fit.coefficient(t.name) for t in fit.terms if is_friction(t))
    elements = fit.elements @ fit.levels
    return level_terms(
        rows,
        transmitted_force(rows, fit.terms, fit.coefficients),
        fit.sliding(rows.velocity) if sliding is None else sliding,
        fit.shape.rise,
        KnownFriction(elements + beside, elements, moved),
    )


def spread_level_terms(rows: Recording, fit: AxisFit, terms: Sequence[Term]) -> tuple[Term, ...]:
    """Return terms, those of the level with their columns of all trials along a fit: a gear of several meshes, say."""
    trials, spread = fit_level_terms(rows, fit), []
    for term in terms:
        own = [trial.columns[:, : term.columns.shape[1]] for trial in trials if trial.name == term.name]
        spread.append(replace(term, columns=np.column_stack(own or [term.columns])))
    return tuple(spread)


def carry_load(view: RecordView, fit: AxisFit) -> RecordView:
    """Return the records whose elements carry the level added by a fit's load: they break away later by as much."""
    terms = [term for term in fit.terms if is_level(term) and term.positive]
    if not terms or not fit.coulomb > 0.0:
        return view
    slipping = renew_columns(terms, fit_level_terms(view.rows, fit, np.ones(len(view.rows.time))))
    added = sum(np.abs(term.columns) @ fit.coefficient(term.name) for term in slipping)
    ends = np.cumsum([motion.rows for motion in view.motions])
    loads = np.split(np.asarray(added) / fit.coulomb, ends[:-1])

    def carry(motions: Sequence[ElementMotion]) -> tuple[ElementMotion, ...]:
        return tuple(motion.carry(load) for motion, load in zip(motions, loads, strict=True))

    return replace(
        view,
        motions=carry(view.motions),
        misread=tuple(map(carry, view.misread)),
        thinned=tuple(map(carry, view.thinned)),
    )


def renew_columns(terms: Sequence[Term], renewed: Sequence[Term]) -> tuple[Term, ...]:
    """Return terms, those of the level and of its records with the columns they have among the renewed ones."""
    found = {(term.name, *term.given.values()): term.columns for term in renewed}
    return tuple(
        replace(term, columns=found[term.name, *term.given.values()][:, : term.columns.shape[1]])
        if is_level(term) or term.name == LEVEL_OF_RECORD
        else term
        for term in terms
    )


def best_trials(view: RecordView, fit: AxisFit, trials: Sequence[Term]) -> tuple[Term, ...]:
    """Of the trials of each effect the first, and beside it the one that explains most where it explains more."""
    found: dict[str, list[Term]] = {}
    for term in trials:
        found.setdefault(term.name, []).append(term)
    best: list[Term] = []
    for terms in found.values():
        looks = [fit_axis(view, (*fit.terms, term), fit.shape, iterations=0) for term in terms]
        most = min(range(len(terms)), key=lambda k: looks[k].cross_rms)
        best += [terms[0]] if not is_better(looks[most], looks[0]) else [terms[most]]
    return tuple(best)
