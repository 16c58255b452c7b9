"""Causes of one record judged on other records of the same axis.

What belongs to a record is fitted in each: a constant offset, the Coulomb level and the damping, which temperature
changes, and, unless the axis is homed, the origin of its position. All else is the extended machine's as it stands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.alignment import in_step
from sgms_mhe.diagnosis.beginning import plain_friction
from sgms_mhe.diagnosis.criteria import material_force
from sgms_mhe.diagnosis.final_fit import split_rms
from sgms_mhe.diagnosis.fits import Fit, Subject
from sgms_mhe.diagnosis.learned import LearnedRecord
from sgms_mhe.diagnosis.learned_machine import judge_learned
from sgms_mhe.diagnosis.origin import find_reach, search_origin
from sgms_mhe.diagnosis.other_record import OtherRecord, TransferredCause
from sgms_mhe.diagnosis.record_fit import RecordFit, shift_position
from sgms_mhe.diagnosis.result import Cause, Diagnosis
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition, reported_name
from sgms_mhe.recordings.evidence import gain_force, gain_interval, noise_floor
from sgms_mhe.recordings.excerpt import make_excerpt
from sgms_mhe.recordings.recording import Recording, add_encoder, prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.decisions import log_decision

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def judge_on_records(found: Diagnosis, others: Sequence[Log], report: Callable[[str], None]) -> Diagnosis:
    """Return a diagnosis with its causes and its extended machine judged on other records.

    Args:
        found: of the first record.
        others: logs of the same axis.
        report: called with each record's name.

    Raises:
        InputError: a log that does not fit the machine.
        FitError: a model that is not finite along one.
    """
    judged = []
    for log in others:
        report(log.source or "another record")
        judged.append(_judge_on(found, in_step(log, found.offset_s) if found.offset_s else log))
    records = tuple(record for record, _ in judged)
    learned = found.learned
    if learned is not None:
        learned = replace(learned, records=tuple(with_it for _, with_it in judged if with_it is not None))
    causes = tuple(replace(cause, transfers=_transfers(cause, records)) for cause in found.causes)
    log_decision(
        "records",
        "a cause transfers where its force, as it stands, gains on every other record that shows it",
        records=[record.name for record in records],
        causes={cause.label: cause.transfers for cause in causes},
        gains_N={
            cause.label: [t.gain_interval_N for r in records for t in r.causes if t.label == cause.label]
            for cause in causes
        },
    )
    return replace(found, causes=causes, records=records, learned=learned)


def _transfers(cause: Cause, records: Sequence[OtherRecord]) -> bool | None:
    """Return True if a cause holds on the other records, False if not on one; None: none of them shows it."""
    shown = [t for record in records for t in record.causes if t.label == cause.label and t.is_shown]
    return all(t.gain_interval_N[0] > 0.0 for t in shown) if shown else None


def _judge_on(found: Diagnosis, log: Log) -> tuple[OtherRecord, LearnedRecord | None]:
    """Judge the causes of a diagnosis, its extended machine and what it learned, on one other record."""
    extended = found.extended or found.machine
    recording, origin, counted_from = _record(extended, log), None, 0.0
    if extended.log is None or not extended.log.homed:
        known, own = found.traces.position_m[found.traces.used], recording.position[recording.used]
        least, most = float(own.min() - known.max()), float(own.max() - known.min())
        middle, reach = 0.5 * (least + most), 0.5 * min(most - least, find_reach(extended))
        origin = search_origin(extended, log, middle - reach, middle + reach)
        log_decision("records", "origin of a record's position", record=log.source, **origin.to_json())
        counted_from = origin.candidates_m[0] if origin.candidates_m else 0.0
    recording = shift_position(recording, -counted_from)
    after = RecordFit.of(Subject.of(extended, recording)).align()
    fit = after.fit(after.theta, after.free(), after.seen)
    floor = noise_floor(after.subject.recording, fit.residual)
    plain = plain_friction(recording)
    file = shift_position(_record(found.machine, log), -counted_from)
    before = RecordFit.of(Subject.of(found.machine, file)).align()
    name = log.source or "log"
    with_it = None
    if found.learned is not None:
        with_it = judge_learned(found.learned, after.subject.recording, fit, name, plain.held_out)
    record = OtherRecord(
        name=name,
        held_out_before=split_rms(before.fit(before.theta, before.free(), before.seen), file)[1],
        held_out_after=split_rms(fit, recording)[1],
        plain=plain.held_out,
        force=plain.force,
        noise_floor_N=floor,
        origin_m=-counted_from,
        origin=origin,
        causes=tuple(_judge_cause(after, fit, cause, floor, found) for cause in found.causes),
    )
    return record, with_it


def _record(machine: Machine, log: Log) -> Recording:
    """Return a log along a machine, of a long one the segments that models are fitted to."""
    return make_excerpt(add_encoder(prepare(machine, log), log))


def _theta_without(after: RecordFit, cause: Cause) -> Array:
    """Return the numbers (n_p) of a machine without one of its causes: the file's, or of an effect sizes of none."""
    theta = after.theta.copy()
    for i, column in enumerate(after.model.columns):
        group = column.group
        if group.is_candidate or (group.label or group.cause) != cause.label:
            continue
        reported = reported_name(column.name) if group.kind == "base" else column.name
        if cause.nominal:
            theta[i] = column.theta(cause.nominal[reported])
        elif effect_definition(group.cause).parameter(column.name).is_size:
            theta[i] = column.theta(column.none)
    return theta


def _judge_cause(after: RecordFit, fit: Fit, cause: Cause, floor: float, found: Diagnosis) -> TransferredCause:
    """Return the gain of one cause on the held-out blocks of another record, its numbers as they stand."""
    recording, held = after.subject.recording, after.subject.recording.held_out
    free = after.free(cause.name)
    with_cause = fit if np.array_equal(free, fit.free) else after.fit(after.theta, free, after.seen)
    without = after.fit(_theta_without(after, cause), free, after.seen)
    force = recording.rms(with_cause.residual - without.residual)
    gain = gain_interval(without.loss[held], with_cause.loss[held], fit.rows[held])
    return TransferredCause(
        label=cause.label,
        gain_N=gain_force(without.loss[held], with_cause.loss[held], fit.rows[held]),
        gain_interval_N=gain,
        is_shown=force > material_force(found.machine, floor),
    )
