"""How sharply elements slip: a property of the smoothed law, not of an axis, and found out beside the causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.alignment import aligned, thinned
from sgms_mhe.diagnosis.candidates import stiffness_start, stribeck_start
from sgms_mhe.diagnosis.criteria import Criteria
from sgms_mhe.diagnosis.descent import FitError
from sgms_mhe.diagnosis.evidence import nuisance
from sgms_mhe.diagnosis.fitting import fit_model
from sgms_mhe.diagnosis.groups import Extra, machine_groups
from sgms_mhe.diagnosis.recording import Recording
from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.machine import Machine, Thresholds
from sgms_mhe.model.effects import BASE_CAUSES
from sgms_mhe.support.parallel import in_parallel

Transition = Literal["machine", "sharp"]
"""From sticking to slipping: as the machine file's smoothing says, or almost at once."""


@dataclass(frozen=True, eq=False)
class Laws:
    """The same axis and record under the transitions that it may have.

    Attributes:
        smooth: that of the file.
        sharp: elements that slip almost at once; None where the file's do, be it that they switch, or where that is no
            model of the record.
        taken: which of them fits better.
        decided: whether the other one is out of the question, whatever effect is added.
    """

    smooth: Subject
    sharp: Subject | None
    taken: Transition = "machine"
    decided: bool = False

    @property
    def chosen(self) -> Subject:
        """The one that is taken."""
        return self.sharp if self.taken == "sharp" and self.sharp is not None else self.smooth

    @property
    def other(self) -> Subject | None:
        """The one that is not."""
        return self.smooth if self.taken == "sharp" else self.sharp

    def with_chosen(self, subject: Subject) -> Laws:
        """The same with another subject in the place of the chosen one."""
        return replace(self, sharp=subject) if self.taken == "sharp" else replace(self, smooth=subject)


def sharp_smoothing(thresholds: Thresholds) -> dict[str, float]:
    """`[friction] smoothing` of elements that slip almost at once."""
    return {"zeta": thresholds.sharp_zeta, "lambda": thresholds.sharp_lambda, "gamma": thresholds.sharp_gamma}


def laws_of(machine: Machine, recording: Recording, floor: float) -> Laws:
    """A machine along a record under both transitions, thinned for the search; `floor`: its noise [N]."""
    smoothing, own = sharp_smoothing(machine.diagnosis), machine.friction.smoothing
    axes = [machine]
    if own is not None and own.lambda_ < smoothing["lambda"]:
        axes.append(override_machine(machine, {"friction": {"smoothing": smoothing}}))
    thin = [thinned(replace(Subject.of(axis, recording), noise=floor)) for axis in axes]
    found = [subject for subject in in_parallel([partial(_in_line_as_it_is, s) for s in thin]) if subject is not None]
    return Laws(found[0], found[1] if len(found) > 1 else None)


def _in_line_as_it_is(subject: Subject) -> Subject | None:
    """The subject in line with the machine's own numbers; None where that is no model of the record."""
    try:
        return aligned(subject, fit_model(subject, (), refitted=()))
    except FitError:
        return None


def starting_unknown(laws: Laws) -> Laws:
    """The laws with fits that start from what the record shows of numbers that the machine file says nothing of.

    A file without a Stribeck effect says nothing about its velocity.
    """
    subject = laws.smooth
    unknown = {
        cause.name
        for cause in BASE_CAUSES.values()
        if cause.start_search is not None and any(getattr(subject.machine.friction, n) == 0.0 for n in cause.frees)
    }
    if not unknown:
        return laws
    groups = tuple(g for g in machine_groups(subject.machine) if g.kind != "base" or g.cause not in unknown)
    fit = fit_model(subject, (), refitted=groups)
    free = nuisance(fit.slopes[subject.recording.used][:, fit.loose])
    found = stribeck_start(subject.recording, fit, free)
    sharp = laws.sharp and laws.sharp.starting_from({**laws.sharp.starts, **found})
    return replace(laws, smooth=subject.starting_from({**subject.starts, **found}), sharp=sharp)


def fit_transition(laws: Laws, extras: Sequence[Extra], criteria: Criteria) -> tuple[Laws, Fit]:
    """Fit with the transition from sticking to slipping that fits better, from now on.

    Both are tried, after every effect again, so that the difference is not taken for an effect, nor an effect for it;
    each with its own thinned model brought into line, or what thinning does to the new effect would decide.
    """
    thresholds = criteria.thresholds
    if laws.sharp is None or laws.decided:
        subject = _starting_stiff(laws.chosen, extras, criteria)
        subject, fit = in_line(subject, fit_model(subject, extras))
        return laws.with_chosen(subject), fit
    smooth, sharp = in_parallel([partial(_starting_stiff, s, extras, criteria) for s in (laws.smooth, laws.sharp)])
    smooth, fit = in_line(smooth, fit_model(smooth, extras))
    sharp, other = _fit_sharp(sharp, fit)
    if other is None:
        return replace(laws, smooth=smooth, sharp=sharp, taken="machine"), fit
    ratio = other.cross_rms / fit.cross_rms
    taken: Transition = "sharp" if ratio < thresholds.sharper else "machine"
    better = other if taken == "sharp" else fit
    decided = (
        not thresholds.decided < ratio < 1.0 / thresholds.decided
        and criteria.excess(better) < thresholds.decided_left * criteria.material
    )
    return Laws(smooth, sharp, taken, decided), better


def in_line(subject: Subject, fit: Fit) -> tuple[Subject, Fit]:
    """The fit with everything at hand, the record brought into line with it."""
    for _ in range(subject.thresholds.alignments):
        subject = aligned(subject, fit)
        fit = fit_model(subject, fit.extras, warm=fit)
    return subject, fit


def _starting_stiff(subject: Subject, extras: Sequence[Extra], criteria: Criteria) -> Subject:
    """The subject with fits that start from the common factor on stiffnesses that leaves clearly less than the file's.

    Where elements turn round all the time the sum of squares is rough in their stiffness, and a fit that starts far
    from it stops short. With other effects it may be another one.
    """
    rough = {
        g.cause for g in machine_groups(subject.machine) if g.kind == "base" and BASE_CAUSES[g.cause].start_factors
    }
    numbers = [number for cause in rough for number in BASE_CAUSES[cause].numbers]
    kept = {key: value for key, value in subject.starts.items() if not any(number.holds(key) for number in numbers)}
    subject = subject.starting_from(kept)
    return subject.starting_from({**kept, **stiffness_start(subject, extras, criteria.material)})


def _fit_sharp(sharp: Subject, fit: Fit) -> tuple[Subject, Fit | None]:
    """The sharp transition with the effects of a fit, in line; None where it cannot be fitted.

    The switching law's sum of squares is rough: from the machine's numbers and from the smooth fit's.
    """
    found: Fit | None = None
    for _ in range(sharp.thresholds.alignments):
        if found is not None:
            sharp = aligned(sharp, found)
        for warm in (None, found or fit):
            try:
                found = fit_model(sharp, fit.extras, warm=warm, again=warm is not None)
            except FitError:
                continue
    return (sharp, None) if found is None else in_line(sharp, found)
