"""Judgement of a final fit: causes that hold, and the verdict they allow."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

from sgms_mhe.diagnosis.alignment import align
from sgms_mhe.diagnosis.causes import (
    Confirmed,
    confirm_causes,
    find_nameless,
    keep_predictive,
    refit_numbers,
    restore_undetermined,
)
from sgms_mhe.diagnosis.criteria import SMALL_SHARE, material_force, small_force
from sgms_mhe.diagnosis.final_fit import ALLOWED_ENCODER, FinalFit
from sgms_mhe.diagnosis.fits import Fit, fit_model
from sgms_mhe.diagnosis.parametrisation import ParameterGroup, machine_groups
from sgms_mhe.diagnosis.parts import Cause, StandsFor
from sgms_mhe.diagnosis.result import Verdict
from sgms_mhe.diagnosis.structure import leaves_curve
from sgms_mhe.diagnosis.uncertainty import MOSTLY
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.model.effects import cause as cause_definition
from sgms_mhe.recordings.evidence import hides_friction
from sgms_mhe.support.decisions import log_decision

ALLOWED_NOISE: Final = 0.5
"""RMS beyond noise that a complete explanation may leave; the largest of the three counts [noise floor]: the floor
itself is an estimate."""
MOST_WITHOUT_CAUSES: Final = 3.0
"""RMS beyond noise that a machine without causes may leave, whatever the three before it say [noise floor]: what leaves
more is not adequate."""
MOST_WITH_CAUSES: Final = 1.25
"""RMS beyond noise that named causes may leave, whatever the three of `unexplained` say [noise floor]: what leaves more
has not explained the record, however much it gained."""
LEAST_ALLOWED: Final = 0.012
"""RMS beyond noise that either may leave, however quiet the record; numbers beside effects only what is small [f_C]:
sampling, integration and a low cutoff leave as much of a log without noise."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A verdict and its evidence.

    Attributes:
        verdict: the word.
        found: causes that are named.
        plain: the machine as it is, with the transition that fits.
        free: all of the machine's numbers refitted, beside the causes that were confirmed first.
    """

    verdict: Verdict
    found: Confirmed
    plain: Fit
    free: Fit


def judge(final: FinalFit) -> Judged:
    """Confirm the causes, and say whether they explain the record."""
    found = confirm_causes(final, final.selection)
    groups = machine_groups(final.subject.machine) if final.subject.is_open else ()
    plain = fit_model(final.subject, (), refitted=groups, warm=found.selection.fit if groups else None)
    # The base numbers' own small errors are no structure that asks for a name.
    free = fit_model(final.subject, found.selection.fit.effects, warm=found.selection.fit)
    best = min(found.selection.fit, free, key=final.excess)
    before, after = final.excess(plain), final.excess(best)
    judged = found.selection.causes
    allowed = allowed_excess(final.record.machine, final.floor, judged, before, _encoder_rms(final))
    curve = after < allowed and any(_may_substitute(group.cause) for group in judged) and _leaves_curve(final, best)
    verdict: Verdict
    unnamed: Collection[str] = ()
    if not found.selection.causes:
        # As it is, and not with other numbers: what these explain and no cause does is not adequate.
        found = _without_causes(final, found, plain)
        plain = found.selection.fit
        before = final.excess(plain)
    if not judged and before < allowed:
        verdict = "adequate"
    elif judged and after < allowed and not curve:
        verdict = "ambiguous" if found.selection.rivals else "explained"
        if final.alternative:
            found = refit_numbers(final, found, explained=True)
    else:
        verdict = "unexplained"
        # Something is left; but causes that are the same everywhere in the record are none the less real.
        predictive = keep_predictive(final, final.selection)
        if predictive.causes:
            found = predictive
            unnamed = find_nameless(final, found) if judged else {cause.label for cause in found.causes}
        elif judged:
            found = _without_causes(final, predictive, plain)
            plain = found.selection.fit
    if found.causes:
        found = restore_undetermined(final, found)
        over_speed = None
        if verdict == "unexplained" and _leaves_curve(final, found.selection.fit):
            over_speed = _may_substitute
        elif any(_is_any_curve(c.name) for c in found.causes):
            over_speed = _is_part_of_curve
        found = _mark_rivals(found, over_speed, unnamed)
    log_decision(
        "verdict",
        "residual beyond noise is within what a complete explanation may leave, and no curve over speed is left",
        confirmed=[group.name for group in judged],
        noise_floor_N=final.floor,
        beyond_noise_before_N=before,
        beyond_noise_after_N=after,
        allowed_N=allowed,
        leaves_curve_over_speed=curve,
        rivals=[rival.group.cause for rival in found.selection.rivals],
        law_of_the_file=not final.alternative,
        outcome=verdict,
        named=[cause.label for cause in found.causes],
    )
    return Judged(verdict, found, plain, free)


def _without_causes(final: FinalFit, found: Confirmed, plain: Fit) -> Confirmed:
    """Return the machine as it is, in line with itself: the record was with a fit that may have other numbers.

    Where its numbers are the record's, they are fitted.
    """
    groups = machine_groups(final.subject.machine) if final.subject.is_open else ()
    subject = align(final.subject, plain, anew=True)
    fit = fit_model(subject, (), refitted=groups, warm=plain)
    blind = fit_model(subject, (), refitted=groups, warm=fit, rows=final.seen) if groups else fit
    selection = replace(found.selection, fit=fit, refitted=groups, unnamed=groups, rivals=())
    return Confirmed(selection, blind, ())


def _mark_rivals(found: Confirmed, over_speed: Callable[[str], bool] | None, unnamed: Collection[str]) -> Confirmed:
    """Return the causes, with those marked that are `unnamed` or may be a part of a curve over speed."""

    def find_part(cause: Cause) -> StandsFor:
        if over_speed is not None and over_speed(cause.name):
            return "curve over speed"
        return "what has no name" if cause.label in unnamed else ""

    return replace(found, causes=tuple(replace(cause, stands_for=find_part(cause)) for cause in found.causes))


def _may_substitute(name: str) -> bool:
    """Return True if a cause beside a residual curve over speed may be a part of it: a machine's number, a curve."""
    return name in BASE_CAUSES or cause_definition(name).over_speed


def _is_any_curve(name: str) -> bool:
    return name not in BASE_CAUSES and effect_definition(name).any_curve


def _is_part_of_curve(name: str) -> bool:
    """Return True if nothing tells a cause from a part of a curve of any shape named beside it."""
    return cause_definition(name).over_speed and not _is_any_curve(name)


def _leaves_curve(final: FinalFit, fit: Fit) -> bool:
    """Return True if a good part of the residual of a fit is a curve over speed, and it matters."""
    material = material_force(final.record.machine, final.floor)
    return leaves_curve(final.record, final.residual_of(fit).residual, final.floor, material, final.encoder)


def _encoder_rms(final: FinalFit) -> float:
    """RMS of the force the encoder's steps leave in a record that can be judged all the same [N]; else 0."""
    encoder, record = final.encoder, final.record
    return 0.0 if encoder is None or hides_friction(record, encoder) else record.rms(encoder)


def allowed_excess(
    machine: Machine, floor: float, causes: Sequence[ParameterGroup] = (), before: float = 0.0, encoder: float = 0.0
) -> float:
    """RMS beyond noise [N] that a complete explanation may leave.

    `before`: without its causes; `encoder`: residual of the encoder's steps, where they are in the floor.

    A wrong number beside effects may stand for a part of their residual: then only a small one is accepted.
    """
    level = machine.friction.coulomb
    noise = floor * (ALLOWED_ENCODER if encoder**2 > MOSTLY * floor**2 else ALLOWED_NOISE)
    wanted = max(machine.diagnosis.unexplained * level, noise, SMALL_SHARE * before)
    most = MOST_WITH_CAUSES if causes else MOST_WITHOUT_CAUSES
    mixed = len({group.is_candidate for group in causes}) > 1
    least = small_force(machine) if mixed else LEAST_ALLOWED * level
    return min(wanted, max(most * floor, least))
