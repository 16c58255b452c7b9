"""Choice of the friction law: elements that go over smoothly or that switch, beside the causes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Self

import numpy as np

from sgms_mhe.configuration import switch_law
from sgms_mhe.diagnosis.alignment import align, decimate
from sgms_mhe.diagnosis.candidates import stiffness_start, stribeck_start
from sgms_mhe.diagnosis.criteria import EQUAL_T, Criteria
from sgms_mhe.diagnosis.fits import Fit, Subject, fit_model
from sgms_mhe.diagnosis.models import FitError
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, least_smooth_distance, machine_groups
from sgms_mhe.identification.search import element_numbers
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.recordings.evidence import difference_statistic
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.parallel import beside, run_parallel

SHARPER: Final = 0.97
"""RMS below which the law is taken that is not the machine file's [RMS left by the other]: of a smaller difference the
machine file is right."""
DECIDED: Final = 0.8
"""RMS below which a law is the axis's, and the other is not tried again [RMS left by the other]: no effect turns so
much round."""
DECIDED_RESIDUAL: Final = 2.0
"""RMS beyond noise up to which a law is decided [gain that matters]: with more left something large is still missing.
"""
ALIGNMENTS: Final = 2
"""Alignments of a model at a selection, each with a fit [1]: to the second order."""


def subtract_effects(subject: Subject, fit: Fit) -> Recording:
    """Return the record without the force of a fit's effects.

    Raises:
        FitError: its model is not finite along the record.
    """
    if not fit.effects:
        return subject.recording
    at, friction = subject, subject.friction(fit)
    if not np.all(np.isfinite(friction)):  # it was fitted at the full rate, then
        at, friction = subject.whole, subject.whole.friction(fit)
    alone = at.model(())
    theta = at.start(alone, (), fit)
    effects = friction - alone.run(at.recording, theta, derivatives=False)[0]
    if not np.all(np.isfinite(effects)):
        raise FitError("the model is not finite with the numbers that it was fitted with")
    return replace(subject.recording, friction=subject.recording.friction - effects)


def convex_start(subject: Subject, fit: Fit) -> dict[str, float]:
    """Numbers of the machine to start from, by column [SI]: of the friction a fit's effects do not explain.

    Neither the machine file's numbers nor where the fit stopped matter. Nothing where there is no friction, or none
    can be told from the effects'.
    """
    columns = {column.name for column in subject.model(()).columns}
    try:
        found = element_numbers(subtract_effects(subject, fit), subject.noise)
    except FitError:
        return {}
    return {name: value for name, value in found.items() if name in columns}


@dataclass(frozen=True, eq=False)
class Laws:
    """The same axis and record under both laws.

    Attributes:
        own: that of the machine file.
        alternative: the other one; None where it is no model of the record, or an effect of the file's does not stand
            with it.
        taken: whether the alternative one fits better.
        decided: whether the one that is not taken is out of the question, whatever effect is added.
        apart: RMS of their difference when both were fitted last [N]; inf: never.
    """

    own: Subject
    alternative: Subject | None
    taken: bool = False
    decided: bool = False
    apart: float = math.inf

    @property
    def chosen(self) -> Subject:
        """The one that is taken."""
        return self.alternative if self.taken and self.alternative is not None else self.own

    @property
    def other(self) -> Subject | None:
        """The one that is not."""
        return self.own if self.taken else self.alternative

    @property
    def doubt(self) -> float:
        """RMS of a force that might yet be the difference of the laws [N]."""
        return 0.0 if self.alternative is None or self.decided else self.apart

    def replace_chosen(self, subject: Subject) -> Self:
        """The same with another subject in the place of the chosen one."""
        return replace(self, alternative=subject) if self.taken else replace(self, own=subject)


def make_laws(machine: Machine, recording: Recording, floor: float, *, is_open: bool = False) -> Laws:
    """A machine along a record under both laws, thinned for the search.

    Args:
        machine: with the numbers to begin from.
        recording: of the log.
        floor: its noise [N].
        is_open: whether these are the record's own.
    """
    thin = [replace(one, is_open=is_open) for one in _thinned(machine, recording, floor)]
    own, *others = run_parallel([partial(_align_nominal, subject) for subject in thin])
    if own is None:
        raise FitError("the model is not finite with the machine's own numbers")
    return Laws(own, others[0] if others else None)


def list_compilations(machine: Machine, recording: Recording) -> list[Callable[[], object]]:
    """Return the functions that compile every model of `make_laws`, to be done beside other work."""
    return [partial(one.model, ()) for thin in _thinned(machine, recording, 1.0) for one in (thin.whole, thin)]


def _thinned(machine: Machine, recording: Recording, floor: float) -> list[Subject]:
    """The machine along a record, under its own law and the other one if there is one; `floor`: its noise [N]."""
    alternative = other_law(machine)
    axes = [machine] if alternative is None else [machine, alternative]
    return [decimate(replace(Subject.of(axis, recording), noise=floor)) for axis in axes]


def other_law(machine: Machine) -> Machine | None:
    """Return the machine with the other law, if it has one; smooth elements that differ between two samples."""
    return switch_law(machine, least_smooth_distance(machine))


def _align_nominal(subject: Subject) -> Subject | None:
    """The subject in line with the machine's own numbers; None where that is no model of the record."""
    try:
        return align(subject, fit_model(subject, (), refitted=()))
    except FitError:
        return None


def start_unknown_numbers(laws: Laws) -> Laws:
    """The laws with fits that start from the record's estimates of numbers missing in the machine file.

    A file without a Stribeck effect says nothing about its velocity.
    """
    subject = laws.own
    unknown = {
        cause.name
        for cause in BASE_CAUSES.values()
        if cause.start_search is not None and any(getattr(subject.machine.friction, n) == 0.0 for n in cause.frees)
    }
    if not unknown:
        return laws
    groups = tuple(g for g in machine_groups(subject.machine) if g.kind != "base" or g.cause not in unknown)
    fit = fit_model(subject, (), refitted=groups)
    free = fit.find_nuisance(subject.recording.used)
    found = stribeck_start(subject.recording, fit, free)
    alternative = laws.alternative and laws.alternative.start_from({**laws.alternative.starts, **found})
    return replace(laws, own=subject.start_from({**subject.starts, **found}), alternative=alternative)


def fit_law(
    laws: Laws, effects: Sequence[CandidateEffect], criteria: Criteria, *, known: Fit | None = None
) -> tuple[Laws, Fit]:
    """Fit under the law that fits better, and keep to it from now on.

    Both are tried, so that the difference is not taken for an effect, nor an effect for it; each with its own thinned
    model brought into line, or the error of thinning would decide on the new effect; each also from numbers that the
    record alone gives. But where an effect takes the elements' motion from them, one run costs a hundred others and
    the laws hardly differ: the law and the start stay as without it. `known`: as of `fit_chosen`.
    """
    if is_driven(effects):
        return fit_chosen(laws, effects, criteria, known=known)
    if laws.alternative is None or laws.decided:
        laws, fit = fit_chosen(laws, effects, criteria, known=known)
        subject, fit = _restart(laws.chosen, fit, criteria)
        return laws.replace_chosen(subject), fit
    both = (laws.own, laws.alternative)
    # What runs next, at the full rate, is compiled beside.
    own, alternative = beside(
        partial(run_parallel, [partial(_start_stiff, subject, effects, criteria) for subject in both]),
        [partial(subject.whole.model, effects) for subject in both],
    )
    fit = _fit_or_known(own, effects, known)
    if fit is known:
        return laws, fit
    own, fit = align_fit(own, fit)

    def fit_other() -> tuple[Subject, Fit | None]:
        subject, found = _fit_alternative(alternative, fit)
        return (subject, found) if found is None else _restart(subject, found, criteria)

    def fit_own() -> tuple[Subject, Fit | None]:
        return _restart(own, fit, criteria)

    (own, better), (alternative, other) = run_parallel([fit_own, fit_other])
    fit = better or fit
    if other is None:
        return replace(laws, own=own, alternative=alternative, taken=False, apart=0.0), fit
    # Both have as many numbers: what they leave of the rows they saw is a fair comparison, and a sharper one than what
    # they predict of others, where elements that switch are rough.
    ratio = other.rms / fit.rms

    def leaves_little(one: Fit) -> bool:
        return criteria.excess(one) < DECIDED_RESIDUAL * criteria.material

    surer = leaves_little(other) and difference_statistic(other.loss, fit.loss) > EQUAL_T
    taken = ratio < SHARPER or surer
    better = other if taken else fit
    decided = not DECIDED < ratio < 1.0 / DECIDED and leaves_little(better)
    apart = float(np.std((other.residual - fit.residual)[own.recording.used]))
    log_decision(
        "law",
        "law that leaves clearly less, else the file's",
        effects=[effect.name for effect in effects],
        file=own.machine.friction.law,
        residual_N=fit.rms,
        residual_other_N=other.rms,
        ratio=ratio,
        taken_below=SHARPER,
        surely_less=surer,
        other_taken=taken,
        decided=decided,
        apart_N=apart,
    )
    return Laws(own, alternative, taken, decided, apart), better


def is_driven(effects: Sequence[CandidateEffect]) -> bool:
    """Return True if an effect changes the elements' motion."""
    return any(effect_definition(effect.name).drives_elements for effect in effects)


def fit_chosen(
    laws: Laws, effects: Sequence[CandidateEffect], criteria: Criteria, *, known: Fit | None = None
) -> tuple[Laws, Fit]:
    """Fit under the law that is taken.

    `known`: with these effects by this law. It stands where no fit from the machine's own numbers can begin: beside a
    gap they may be none that a model runs through.

    Raises:
        FitError: the model is not finite where its fit starts, and no fit is known.
    """
    subject = laws.chosen
    if not is_driven(effects):  # what runs next, at the full rate, is compiled beside
        subject = beside(partial(_start_stiff, subject, effects, criteria), [partial(subject.whole.model, effects)])
    fit = _fit_or_known(subject, effects, known)
    if fit is known:
        return laws, fit
    subject, fit = align_fit(subject, fit)
    return laws.replace_chosen(subject), fit


def _fit_or_known(subject: Subject, effects: Sequence[CandidateEffect], known: Fit | None) -> Fit:
    """The fit from the machine's own numbers, or the one that is known where none can begin there."""
    try:
        return fit_model(subject, effects)
    except FitError:
        if known is None:
            raise
        return known


def align_fit(subject: Subject, fit: Fit) -> tuple[Subject, Fit]:
    """The fit with everything at hand, the record brought into line with it.

    Not where no fit can begin at its own numbers: a state may be at the limit of its integration steps.
    """
    for _ in range(ALIGNMENTS):
        aligned = align(subject, fit)
        try:
            fit = fit_model(aligned, fit.effects, warm=fit)
        except FitError:
            break
        subject = aligned
    return subject, fit


def _start_stiff(subject: Subject, effects: Sequence[CandidateEffect], criteria: Criteria) -> Subject:
    """The subject with fits that start from the common factor on stiffnesses that leaves clearly less than the file's.

    Where elements turn round all the time the sum of squares is rough in their stiffness, and a fit that starts far
    from it stops short. With other effects it may be another one.
    """
    rough = {
        g.cause for g in machine_groups(subject.machine) if g.kind == "base" and BASE_CAUSES[g.cause].start_factors
    }
    numbers = [number for cause in rough for number in BASE_CAUSES[cause].numbers]
    kept = {key: value for key, value in subject.starts.items() if not any(number.holds(key) for number in numbers)}
    subject = subject.start_from(kept)
    return subject.start_from({**kept, **stiffness_start(subject, effects, criteria.material)})


def _restart(subject: Subject, fit: Fit, criteria: Criteria) -> tuple[Subject, Fit]:
    """The fit, or where it leaves something one from numbers no machine file has a say in, if that is better.

    A sum of squares of elements has more than one minimum, and the file's numbers decide which one a fit ends in.
    """
    if criteria.excess(fit) < criteria.material:
        return subject, fit
    starts = convex_start(subject, fit)
    if not starts:
        return subject, fit
    again = subject.start_from({**subject.starts, **starts})
    try:
        again, better = align_fit(again, fit_model(again, fit.effects))
    except FitError:
        return subject, fit
    return (again, better) if better.rms < SHARPER * fit.rms else (subject, fit)


def _fit_alternative(alternative: Subject, fit: Fit) -> tuple[Subject, Fit | None]:
    """The other law with the effects of a fit, in line; None where it cannot be fitted.

    The switching law's sum of squares is rough: from the machine's numbers and from the fit's.
    """
    found: Fit | None = None
    for _ in range(ALIGNMENTS):
        if found is not None:
            alternative = align(alternative, found)
        for warm in (None, found or fit):
            try:
                found = fit_model(alternative, fit.effects, warm=warm, again=warm is not None)
            except FitError:
                continue
    return (alternative, None) if found is None else align_fit(alternative, found)
