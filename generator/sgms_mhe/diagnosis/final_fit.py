"""Final fit of a selection: at the full rate of the record, to the end; and the residuals of the whole record."""

import math
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np

from sgms_mhe.diagnosis.alignment import align, find_encoder_force, find_residual
from sgms_mhe.diagnosis.candidates import edge_rows
from sgms_mhe.diagnosis.fits import Fit, Subject, fit_model
from sgms_mhe.diagnosis.laws import ALIGNMENTS, Laws
from sgms_mhe.diagnosis.models import FitError
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, drop_effect, drop_group
from sgms_mhe.diagnosis.parts import RivalFit
from sgms_mhe.diagnosis.rivals import Selection
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.model.effects.search import Step
from sgms_mhe.recordings.evidence import RecordLoss, noise_floor
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array, Mask

ALLOWED_ENCODER: Final = 1.0
"""RMS beyond noise that a complete explanation may leave where the encoder's steps make most of the floor [noise
floor]: where its lines are, and so how much of their noise passes the low-passes, is known to a factor of 1.4."""


@dataclass(frozen=True, eq=False)
class RecordResidual(RecordLoss):
    """Residual of a record a fit may have seen parts of."""

    @classmethod
    def of(cls, fit: Fit) -> Self:
        """Return that of the record that was fitted."""
        return cls(residual=fit.residual, loss=fit.loss, rows=fit.rows)

    @classmethod
    def along(cls, whole: Subject, fit: Fit, sampled: Array) -> Self:
        """Return that of a whole record, parts of which were fitted; see `find_residual`."""
        residual, recording = find_residual(whole, fit, sampled), whole.recording
        rows = recording.sum_blocks(np.ones(len(residual)))
        return cls(residual=residual, loss=recording.sum_blocks(residual**2), rows=rows)


def split_rms(fit: Fit | RecordResidual, recording: Recording) -> tuple[float, float]:
    """RMS [N] on blocks the fit behind the gains sees, and on the held-out ones."""

    def value(blocks: Mask) -> float:
        rows = float(fit.rows[blocks].sum())
        return math.sqrt(float(fit.loss[blocks].sum()) / rows) if rows > 0 else math.nan

    return value(~recording.held_out), value(recording.held_out)


@dataclass(frozen=True, eq=False)
class FinalFit:
    """A record with the causes that were selected, ready to be judged.

    Attributes:
        record: all of it.
        subject: machine with the transition that fits, in line with the selection; on pieces of a long record.
        other: the same under the other law; None: there is none.
        alternative: whether the law that fits is not the machine file's.
        selection: with numbers that can be reported.
        nominal: the machine as it is, with its own transition.
        nominal_residual: of that over the whole record.
        start: all of the machine's numbers refitted, no effect added.
        floor: noise of the measured friction [N].
        encoder: force the encoder's steps leave in the whole record's residual (m) [N]; None: they do not show.
        along: the machine along the whole record, where the fits are to pieces of it.
        known: residuals over the whole record, by the fit's identity.
    """

    record: Recording
    subject: Subject
    other: Subject | None
    alternative: bool
    selection: Selection
    nominal: Fit
    nominal_residual: RecordResidual
    start: Fit
    floor: float
    encoder: Array | None
    along: Subject | None
    known: dict[int, tuple[Fit, RecordResidual]] = field(default_factory=dict, repr=False)

    @property
    def recording(self) -> Recording:
        """Return the record of the fits."""
        return self.subject.recording

    @property
    def seen(self) -> Mask:
        """Rows (m) that the fit behind the reported gains sees."""
        return self.recording.used & ~self.recording.rows_held_out()

    def residual_of(self, fit: Fit) -> RecordResidual:
        """Return the residual of the whole record."""
        if self.along is None:
            return RecordResidual.of(fit)
        if id(fit) not in self.known:
            self.known[id(fit)] = fit, RecordResidual.along(self.along, fit, self.subject.alignment.sampled)
        return self.known[id(fit)][1]

    def excess(self, fit: Fit) -> float:
        """RMS beyond noise [N]; of a record fitted in pieces, that of the pieces or of the whole, whichever is more."""
        beyond = fit.cross_rms**2 - self.floor**2
        if self.along is not None:
            left = self.residual_of(fit)
            beyond = max(beyond, left.rms**2 - self.find_floor(left) ** 2)
        return math.sqrt(max(0.0, beyond))

    @property
    def encoder_friction(self) -> float:
        """RMS of the friction the encoder's steps may leave [N]: numbers of the machine imitate it."""
        inertial = self.record.steps_inertia
        if self.encoder is None or inertial is None:
            return 0.0
        return math.hypot(1.0, ALLOWED_ENCODER) * self.record.rms(self.encoder - inertial)

    def find_floor(self, left: RecordResidual) -> float:
        """Return the noise floor of the whole record [N], from its residual."""
        return noise_floor(self.record, left.residual, self.encoder)


def make_final_fit(record: Recording, nominal: Fit, laws: Laws, selection: Selection) -> FinalFit:
    """The selection fitted at the full rate until its numbers can be reported.

    Args:
        record: the whole record.
        nominal: the machine as it is, fitted to the excerpt.
        laws: of the excerpt, with the transition that fits.
        selection: its causes.
    """
    subject = laws.chosen.with_final_steps()
    # A long record is fitted in pieces; what is left is measured along all of it.
    in_pieces = len(subject.whole.recording.signals) < len(record.signals)
    along = Subject.of(subject.whole.machine, record) if in_pieces else None
    fit = selection.fit
    for _ in range(ALIGNMENTS):
        subject = align(subject, fit, anew=True)
        effects = tuple(_time_step(subject, along, fit, effect) for effect in fit.effects)
        fit = fit_model(subject, effects, refitted=selection.refitted, warm=fit)
    encoder = find_encoder_force(subject.whole, fit)
    floor = noise_floor(subject.recording, fit.residual, encoder)
    subject = replace(subject, noise=floor, encoder=encoder)
    # The machine as it is keeps the transition of its file.
    nominal_residual = RecordResidual.along(Subject.of(record.machine, record), nominal, subject.alignment.sampled)
    return FinalFit(
        record=record,
        subject=subject,
        other=laws.other,
        alternative=laws.taken,
        selection=replace(selection, fit=fit),
        nominal=nominal,
        nominal_residual=nominal_residual,
        start=fit_model(subject, ()),
        floor=floor,
        encoder=encoder if along is None else find_encoder_force(along, fit),
        along=along,
    )


def _time_step(subject: Subject, along: Subject | None, fit: Fit, effect: CandidateEffect) -> CandidateEffect:
    """A step at the instant the whole record says, its size given; `along`: that record, where pieces are fitted.

    The segments only bound it between two of them; and a search may have put it where something was not known yet.
    """
    kind = effect_definition(effect.name).search
    if not isinstance(kind, Step):
        return effect
    size, instant, whole = effect.parameters[kind.size], effect.parameters[kind.time], subject.whole
    if along is None:
        recording, left = whole.recording, whole.recording.friction - whole.friction(fit)
        inside = _away_from_edges(recording)
    else:
        recording, left = along.recording, find_residual(along, fit, subject.alignment.sampled)
        inside = _between_fitted(recording, whole.recording, instant)
    without = left + np.where(recording.time > instant, size, 0.0)
    rest, time = without[inside], recording.time[inside]
    if len(rest) < 2 or not np.all(np.isfinite(rest)):
        return effect
    last = int(np.argmin(np.cumsum(rest**2 - (rest - size) ** 2)))  # before the step
    at = float(time[min(last + 1, len(time) - 1)])
    return replace(effect, parameters={**effect.parameters, kind.time: at - 0.5 / recording.rate})


def _away_from_edges(recording: Recording) -> Mask:
    """Used rows (m) that a step may be at."""
    inside = recording.used.copy()
    rows = np.flatnonzero(inside)
    edge = edge_rows(len(rows))
    inside[rows[:edge]] = inside[rows[len(rows) - edge :]] = False
    return inside


def _between_fitted(whole: Recording, fitted: Recording, instant: float) -> Mask:
    """Used rows of a whole record (m) between the two fitted ones that an instant is between."""
    inside = whole.used.copy()
    time = fitted.time[fitted.used]
    seen = np.searchsorted(time, instant)
    if seen > 0:
        inside &= whole.time >= time[seen - 1]
    if seen < len(time):
        inside &= whole.time <= time[seen]
    return inside


def fit_rivals(final: FinalFit, selection: Selection) -> tuple[RivalFit, ...]:
    """Return the fit of each rival in its cause's place, all else of the selection beside it.

    The fits do not see the held-out blocks, as those behind the causes' gains do not. A rival without a finite model at
    the full rate has none.
    """
    found = []
    for rival in selection.rivals:
        place = next((group for group in selection.causes if group.cause == rival.instead_of), None)
        if place is None:
            continue
        effects = drop_effect(selection.fit.effects, place)
        refitted = drop_group(selection.refitted, place)
        if rival.group.is_candidate:
            effects += (rival.fit.effects[rival.group.index],)
        else:
            refitted = (*drop_group(refitted, rival.group), rival.group)
        try:
            fit = fit_model(final.subject, effects, refitted=refitted, warm=rival.fit, rows=final.seen)
        except FitError:
            continue
        left = final.residual_of(fit)
        seen, held_out = split_rms(left, final.record)
        found.append(RivalFit(rival.group.cause, rival.instead_of, seen, held_out, left.residual))
    return tuple(found)
