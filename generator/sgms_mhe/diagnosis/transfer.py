"""Causes of one record fitted to and judged on several records of the same axis.

Numbers of a record are fitted in each: a constant offset, the Coulomb level and the damping, which temperature
changes, and, unless the axis is homed, the origin of its position. All else that was found is common to the records.
Each record in turn is held out of the fit of that, and the others' result is judged there.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from sgms_mhe.diagnosis.alignment import in_step
from sgms_mhe.diagnosis.beginning import plain_friction
from sgms_mhe.diagnosis.criteria import material_force
from sgms_mhe.diagnosis.final_fit import split_rms
from sgms_mhe.diagnosis.fits import Fit, Subject
from sgms_mhe.diagnosis.joint_fit import JointFit, Member
from sgms_mhe.diagnosis.joint_numbers import adopt_numbers, drop_causes, find_common, find_contradicted, theta_without
from sgms_mhe.diagnosis.laws import SHARPER, other_law
from sgms_mhe.diagnosis.learned import LearnedRecord
from sgms_mhe.diagnosis.learned_machine import judge_learned
from sgms_mhe.diagnosis.origin import A_PERIOD, find_pitches, find_reach, search_origin
from sgms_mhe.diagnosis.other_record import JudgedRecord, Origin, TransferredCause
from sgms_mhe.diagnosis.own_numbers import is_of_record
from sgms_mhe.diagnosis.parts import Cause
from sgms_mhe.diagnosis.preparation import prepare_log
from sgms_mhe.diagnosis.record_fit import RecordFit, shift_position
from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.evidence import gain_force, gain_interval, noise_floor
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.decisions import log_decision

Intervals = Sequence[tuple[float, float]]

ORIGIN_STEPS: Final = 16 * A_PERIOD
"""Steps of the derivative in an origin per period of the shortest sine, or per travel where nothing repeats [1]."""


def judge_on_records(
    found: Diagnosis,
    log: Log,
    others: Sequence[Log],
    report: Callable[[str], None],
    held_out_s: Intervals | None = None,
    *,
    together: bool = False,
) -> Diagnosis:
    """Return a diagnosis with its numbers fitted to several records, and its causes judged on each by the others.

    Args:
        found: of the first record, or of all of them.
        log: that record.
        others: logs of the same axis.
        report: called with each record's name.
        held_out_s: as of `diagnose`, of the first record.
        together: whether the diagnosis is of all records.

    Raises:
        InputError: a log that does not fit the machine.
        FitError: a model that is not finite along one.
    """
    records: list[_AxisRecord] = []
    for one in (log, *others):
        report(one.source or "another record")
        aligned = in_step(one, found.offset_s) if found.offset_s else one
        records.append(_AxisRecord.along(found, aligned, bool(records), None if records else held_out_s))
    asked = records if together else records[1:]
    judged = [
        record.judge(found, found.causes, _follow_others(found, records, record, found.causes, together))
        for record in asked
    ]
    others_say = [record for record, _ in judged]
    own = [together and is_of_record(cause.name, records[0].recording) for cause in found.causes]
    causes = tuple(
        replace(cause, transfers=None if alone else _holds(cause, others_say, together))
        for cause, alone in zip(found.causes, own, strict=True)
    )
    log_decision(
        "records",
        "a cause transfers where its force, by the other records, gains on one that shows it, and loses on none",
        together=together,
        records=[record.name for record, _ in judged],
        causes={cause.label: cause.transfers for cause in causes},
        gains_N={
            cause.label: [t.gain_interval_N for r, _ in judged for t in r.causes if t.label == cause.label]
            for cause in causes
        },
    )
    learned = found.learned
    if learned is not None and not together:  # no record is another one where it was learned from all
        learned = replace(learned, records=tuple(with_it for _, with_it in judged if with_it is not None))
    found = replace(found, causes=causes, learned=learned)
    shared = tuple(cause for cause in causes if cause.transfers is not False)
    if not together:
        judged.insert(0, records[0].judge(found, shared, _follow_others(found, records, records[0], shared)))
    kept = [record for record, _ in judged]
    if len(shared) < len(causes):
        for i in range(1, len(records)):
            after = drop_causes(_follow_others(found, records, records[i], shared, together), causes, shared)
            fit = after.fit(after.theta, after.free(), after.seen)
            kept[i] = replace(kept[i], common_after=split_rms(fit, after.subject.recording)[1])
    found = replace(found, records=tuple(kept))
    return found if found.extended is None else _fit_together(found, found.extended, records, shared)


def predicts_better(found: Diagnosis, other: Diagnosis) -> bool:
    """Return True if the first of two diagnoses leaves clearly less of further records, each by the others' numbers.

    Or as little, with one answer where the other has several.
    """
    left, before = (sum(record.common_after**2 for record in one.records[1:]) for one in (found, other))
    decides = other.verdict == "ambiguous" and found.verdict == "explained"
    return left < (SHARPER**-2 if decides else SHARPER**2) * before


def leaves_something(found: Diagnosis) -> bool:
    """Return True if a first record's numbers leave a material force of the joined records, or several answers."""
    left = [found.rms.held_out_after, *(record.common_after for record in found.records[1:])]
    floors = [record.noise_floor_N for record in found.records]
    beyond = float(np.mean(np.square(left)) - np.mean(np.square(floors)))
    matters = material_force(found.machine, float(np.sqrt(np.mean(np.square(floors)))))
    return found.verdict == "ambiguous" or beyond > matters**2


def _holds(cause: Cause, records: Sequence[JudgedRecord], together: bool) -> bool | None:
    """Return True if a cause holds on records by the numbers of the others, False if not; None: too few show it.

    Of the first record it holds where one of the further ones confirms and none refutes it. Of all records together it
    may be weak on each: it gains on all of them as one, and none refutes it; a cause one alone shows says nothing
    of the others.
    """
    shown = [t for record in records for t in record.causes if t.label == cause.label and t.is_shown]
    gain = sum(math.copysign(t.gain_N**2, t.gain_N) for t in shown)
    confirmed = gain > 0.0 if together else any(t.gain_interval_N[0] > 0.0 for t in shown)
    if shown and (not confirmed or any(t.gain_interval_N[1] < 0.0 for t in shown)):
        return False
    return True if len(shown) > int(together) else None


@dataclass(frozen=True, eq=False)
class _AxisRecord:
    """A record along the extended machine of a diagnosis, counted from the origin it tells.

    Attributes:
        name: source of its log.
        fit: the extended machine along it, in line with that.
        file: along the machine of the file.
        counted_from: position that is 0 now [m].
        origin: by the record; None: not asked.
    """

    name: str
    fit: RecordFit
    file: Recording
    counted_from: float
    origin: Origin | None

    @classmethod
    def along(cls, found: Diagnosis, log: Log, is_further: bool, held_out_s: Intervals | None) -> "_AxisRecord":
        """Return a log along the extended machine; `held_out_s`: as of `diagnose`.

        Places count from the origin of the first record, which a further one (`is_further`) has to tell.
        """
        extended = found.extended or found.machine
        recording = prepare_log(extended, log, held_out_s)
        file = recording if found.extended is None else prepare_log(found.machine, log, held_out_s)
        origin = _find_origin(found, recording, log) if is_further else None
        counted_from = origin.candidates_m[0] if origin is not None and origin.candidates_m else 0.0
        recording, file = (shift_position(one, -counted_from) for one in (recording, file))
        fit = RecordFit.of(Subject.of(extended, recording)).align()
        return cls(log.source or "log", fit, file, counted_from, origin)

    @property
    def recording(self) -> Recording:
        """The record, in line with the extended machine."""
        return self.fit.subject.recording

    @property
    def origin_step(self) -> float:
        """Step of the derivative in its origin [m]; 0 where that is known, or the record tells nothing of it."""
        if self.origin is None or not self.origin.candidates_m:
            return 0.0
        travel = float(np.ptp(self.recording.position[self.recording.used]))
        return min(find_pitches(self.fit.subject.machine), default=travel) / ORIGIN_STEPS

    def judge(
        self, found: Diagnosis, causes: Sequence[Cause], after: RecordFit
    ) -> tuple[JudgedRecord, LearnedRecord | None]:
        """Judge causes, the extended machine and learned tables; `after`: the record by the others' numbers."""
        fit, recording = after.fit(after.theta, after.free(), after.seen), after.subject.recording
        floor, plain, with_it = noise_floor(recording, fit.residual), plain_friction(self.file), None
        before = RecordFit.of(Subject.of(found.machine, self.file)).align()
        if found.learned is not None:
            with_it = judge_learned(found.learned, recording, fit, self.name, plain.held_out)
        record = JudgedRecord(
            name=self.name,
            held_out_before=split_rms(before.fit(before.theta, before.free(), before.seen), self.file)[1],
            held_out_after=split_rms(fit, recording)[1],
            plain=plain.held_out,
            force=plain.force,
            noise_floor_N=floor,
            origin_m=-self.counted_from,
            origin=self.origin,
            common_after=split_rms(fit, recording)[1],
            own=self.fit.name_numbers(fit),
            causes=tuple(_judge_cause(after, fit, cause, floor, found) for cause in causes),
        )
        return record, with_it


def _find_origin(found: Diagnosis, recording: Recording, log: Log) -> Origin | None:
    """Return another record's origin; None where the axis is homed."""
    extended = found.extended or found.machine
    if extended.log is not None and extended.log.homed:
        return None
    known, own = found.traces.position_m[found.traces.used], recording.position[recording.used]
    least, most = float(own.min() - known.max()), float(own.max() - known.min())
    middle, reach = 0.5 * (least + most), 0.5 * min(most - least, find_reach(extended))
    origin = search_origin(extended, log, middle - reach, middle + reach)
    log_decision("records", "origin of a record's position", record=log.source, **origin.to_json())
    return origin


def _follow_others(
    found: Diagnosis,
    records: Sequence[_AxisRecord],
    held_out: _AxisRecord,
    causes: Sequence[Cause],
    together: bool = False,
) -> RecordFit:
    """Return a record with the numbers of the extended machine by all others, its position counted as they say.

    By the first alone they are those of its own diagnosis, unless that is of all records (`together`). Without causes
    that are not among those given.
    """
    others, fit = [record for record in records if record is not held_out], held_out.fit
    if others == [records[0]] and not together:
        return fit
    common, own = find_common(found, fit, causes), fit.free()
    joint = JointFit(_list_members(found, others, causes), common, own)
    fit = replace(fit, theta=joint.numbers(joint.descend()))
    step = max(record.origin_step for record in records)
    origin = float(JointFit((Member(fit, step),), np.zeros_like(common), own).descend().origins[0])
    recording = shift_position(fit.subject.recording, -origin)
    return replace(fit, subject=replace(fit.subject, recording=recording))


def _list_members(found: Diagnosis, records: Sequence[_AxisRecord], causes: Sequence[Cause]) -> tuple[Member, ...]:
    """Return the records of a joint fit, the first one's origin known, without causes that are not among those given.

    Each starts at its own numbers: from those of another record a step far beyond them takes the common ones with it.
    """
    fits = [drop_causes(record.fit, found.causes, causes) for record in records]
    starts = [replace(fit, theta=fit.fit(fit.theta, fit.free()).theta) for fit in fits]
    steps = [0.0, *(record.origin_step for record in records[1:])]
    return tuple(Member(*one) for one in zip(starts, steps, strict=True))


def _fit_together(
    found: Diagnosis, extended: Machine, records: Sequence[_AxisRecord], shared: Sequence[Cause]
) -> Diagnosis:
    """Return a diagnosis with the numbers of all of its records; a cause of the first one alone stays that."""
    first, own = records[0].fit, records[0].fit.free()
    joint = JointFit(_list_members(found, records, shared), find_common(found, first, shared), own)
    at = joint.descend()
    alternative = other_law(extended)
    others = [None if alternative is None else Subject.of(alternative, record.recording) for record in records]
    covariance = joint.errors(at, others)
    floor = max(record.noise_floor_N for record in found.records)
    differing = joint.find_differing(at, covariance, material_force(found.machine, floor))
    differing &= find_contradicted(found.machine, joint, at)
    log_decision(
        "records",
        "numbers of all records together",
        common=int(joint.common.sum()),
        of_each_record=int(own.sum()),
        differing=[column.name for column, differs in zip(first.model.columns, differing, strict=True) if differs],
        residual_N=[fit.rms for fit in joint.fits(at)],
        origins_m=at.origins.tolist(),
    )
    return adopt_numbers(found, extended, joint, at, covariance, differing, shared)


def _judge_cause(after: RecordFit, fit: Fit, cause: Cause, floor: float, found: Diagnosis) -> TransferredCause:
    """Return the gain of one cause on the held-out blocks of a record, by the numbers of the others."""
    recording, held = after.subject.recording, after.subject.recording.held_out
    free = after.free(cause.name)
    with_cause = fit if np.array_equal(free, fit.free) else after.fit(after.theta, free, after.seen)
    without = after.fit(theta_without(after, cause), free, after.seen)
    force = recording.rms(with_cause.residual - without.residual)
    gain = gain_interval(without.loss[held], with_cause.loss[held], fit.rows[held])
    return TransferredCause(
        label=cause.label,
        gain_N=gain_force(without.loss[held], with_cause.loss[held], fit.rows[held]),
        gain_interval_N=gain,
        is_shown=force > material_force(found.machine, floor),
    )
