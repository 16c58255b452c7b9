"""A machine along another record, its own numbers fixed, and the record's own numbers free."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sgms_mhe.diagnosis.alignment import align
from sgms_mhe.diagnosis.fits import FINAL_STEP, ITERATIONS, Fit, Subject, make_fit
from sgms_mhe.diagnosis.models import CompiledFit, LeastSquares, ModelPoint, Prior
from sgms_mhe.diagnosis.own_numbers import is_of_record
from sgms_mhe.diagnosis.parametrisation import CandidateEffect
from sgms_mhe.model.effects import EFFECT_NAMES, reported_name
from sgms_mhe.recordings.evidence import noise_floor
from sgms_mhe.recordings.recording import Recording, Runs
from sgms_mhe.support.arrays import Array, Mask


@dataclass(frozen=True, eq=False)
class RecordFit:
    """A machine along another record, its own numbers fixed, and the record's own numbers free.

    Attributes:
        subject: machine and record.
        model: every number of the machine a parameter, an offset beside it.
        theta: as the machine has them (n_p).
    """

    subject: Subject
    model: CompiledFit
    theta: Array
    effects: tuple[CandidateEffect, ...]

    @classmethod
    def of(cls, subject: Subject) -> Self:
        """The machine of a subject, beside it the effects that belong to a record and that it has not."""
        own = {effect.name for effect in subject.machine.effects}
        names = [name for name in EFFECT_NAMES if is_of_record(name, subject.recording) and name not in own]
        effects = tuple(CandidateEffect(name, {}) for name in names)
        model = subject.model(effects)
        theta = np.array([c.theta(c.none) if c.group.is_candidate else c.machine_theta for c in model.columns])
        return cls(subject, model, theta, effects)

    def free(self, fixed: str = "") -> Mask:
        """Numbers that belong to the record (n_p), but those of a cause under judgement."""
        recording = self.subject.recording
        return np.array(
            [is_of_record(c.group.cause, recording) and c.group.cause != fixed for c in self.model.columns],
            dtype=np.bool_,
        )

    def fit(self, theta: Array, free: Mask, rows: Mask | None = None) -> Fit:
        """Fit the free numbers, from theta (n_p) on, to rows (m); None: all used ones.

        Raises:
            FitError: the model is not finite.
        """
        recording = self.subject.recording
        seen = recording.used if rows is None else rows
        none = np.zeros(int(free.sum()))
        problem = LeastSquares(self.model, recording, seen, free, Prior(none, none, none))
        return self.make_fit(problem.descend(theta, ITERATIONS, FINAL_STEP), free)

    def make_fit(self, found: ModelPoint, free: Mask) -> Fit:
        """Return the fit that ended at a point, of the numbers that were free (n_p)."""
        return make_fit(self.model, self.effects, self.subject.recording, found, free, free)

    def name_numbers(self, fit: Fit) -> dict[str, float]:
        """Return the free numbers of a fit by name [SI], those of an effect with its label before them."""
        return {
            (f"{c.group.name}.{c.name}" if c.group.kind != "base" else reported_name(c.name)): c.si(theta)
            for c, theta, free in zip(self.model.columns, fit.theta.tolist(), fit.free.tolist(), strict=True)
            if free
        }

    def align(self) -> Self:
        """The same with its record in line with the model, and the noise its fit leaves."""
        fit = self.fit(self.theta, self.free())
        noise = noise_floor(self.subject.recording, fit.residual)
        return replace(self, subject=replace(align(self.subject, fit), noise=noise))

    @property
    def seen(self) -> Mask:
        """Rows (m) that the fit behind a reported gain sees."""
        recording = self.subject.recording
        return recording.used & ~recording.rows_held_out()


def shift_position(recording: Recording, shift: float) -> Recording:
    """Return the recording with its position counted from another origin [m]."""
    if shift == 0.0:
        return recording

    def shift_column(motion: Array | None) -> Array | None:
        return None if motion is None else motion + shift * np.eye(1, motion.shape[1])

    return replace(
        recording,
        signals=replace(recording.signals, position=recording.signals.position + shift),
        position=recording.position + shift,
        unfiltered=shift_column(recording.unfiltered),
        runs=Runs(),
    )
