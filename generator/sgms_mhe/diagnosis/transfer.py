"""Causes of one record judged on other records of the same axis.

What belongs to a record is fitted in each: a constant offset, the Coulomb level and the damping, which temperature
changes, and, unless the axis is homed, the origin of its position. All else is the extended machine's as it stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.alignment import align, decimate, in_step
from sgms_mhe.diagnosis.beginning import plain_friction
from sgms_mhe.diagnosis.criteria import material_force
from sgms_mhe.diagnosis.final_fit import split_rms
from sgms_mhe.diagnosis.fits import FINAL_STEP, ITERATIONS, Fit, Subject
from sgms_mhe.diagnosis.learned import LearnedRecord
from sgms_mhe.diagnosis.learned_machine import judge_learned
from sgms_mhe.diagnosis.models import CompiledFit, LeastSquares, Prior
from sgms_mhe.diagnosis.other_record import OtherRecord, TransferredCause
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, JacobianColumn, ParameterGroup
from sgms_mhe.diagnosis.result import Cause, Diagnosis
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition, reported_name
from sgms_mhe.model.effects import cause as cause_definition
from sgms_mhe.recordings.evidence import find_nuisance, gain_force, gain_interval, noise_floor
from sgms_mhe.recordings.excerpt import make_excerpt
from sgms_mhe.recordings.recording import Recording, Runs, add_encoder, prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.parallel import run_parallel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SHIFTS_A_SINE: Final = 8
"""Origins tried per period of the shortest sine [1]: the nearest one leaves 4 % of its power."""
SHIFTS_A_SPAN: Final = 64
"""Origins tried over the range of positions where nothing repeats [1]."""
MOST_SHIFTS: Final = 800
"""Origins tried, at most [1]: a run of the model each."""
FINER: Final = 8
"""Times that the best origin is refined, each to half of the distance [1]."""
FORCE_OF_PLACE: Final = 1e-9
"""Change of friction by another origin, from which on it depends on the place [Coulomb level]."""
LENGTH: Final = "_m"
"""End of the name of a period in position."""


@dataclass(frozen=True, eq=False)
class _Transfer:
    """A machine along another record, its own numbers fixed, and what belongs to the record free.

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
    def of(cls, subject: Subject) -> _Transfer:
        """The machine of a subject, beside it the effects that belong to a record and that it has not."""
        own = {effect.name for effect in subject.machine.effects}
        names = [name for name in EFFECT_NAMES if effect_definition(name).of_record and name not in own]
        effects = tuple(CandidateEffect(name, {}) for name in names)
        model = subject.model(effects)
        theta = np.array([c.theta(c.none) if c.group.is_candidate else c.machine_theta for c in model.columns])
        return cls(subject, model, theta, effects)

    def free(self, fixed: str = "") -> Mask:
        """Numbers that belong to the record (n_p), but those of a cause under judgement."""
        return np.array(
            [cause_definition(c.group.cause).of_record and c.group.cause != fixed for c in self.model.columns],
            dtype=np.bool_,
        )

    def fit(self, theta: Array, free: Mask, rows: Mask | None = None) -> Fit:
        """Fit what is free, from theta (n_p) on, to rows (m); None: all used ones.

        Raises:
            FitError: the model is not finite.
        """
        recording = self.subject.recording
        seen = recording.used if rows is None else rows
        none = np.zeros(int(free.sum()))
        problem = LeastSquares(self.model, recording, seen, free, Prior(none, none, none))
        found = problem.descend(theta, ITERATIONS, FINAL_STEP)
        loss = recording.sum_blocks(found.residual**2)
        return Fit(
            model=self.model,
            effects=tuple(
                CandidateEffect(e.name, {c.name: c.si(t) for c, t in self._numbers(found.theta, i)})
                for i, e in enumerate(self.effects)
            ),
            theta=found.theta,
            free=free,
            interior=free,
            residual=found.residual,
            jacobian=found.jacobian,
            loss=loss,
            cross=loss,
            rows=recording.sum_blocks(np.ones(len(recording.time))),
        )

    def _numbers(self, theta: Array, index: int) -> list[tuple[JacobianColumn, float]]:
        group = ParameterGroup.candidate(self.effects[index].name, index)
        return [(c, t) for c, t in zip(self.model.columns, theta.tolist(), strict=True) if c.group == group]

    def align(self) -> _Transfer:
        """The same with its record in line with the model."""
        fit = self.fit(self.theta, self.free())
        return replace(self, subject=align(self.subject, fit))

    @property
    def seen(self) -> Mask:
        """Rows (m) that the fit behind a reported gain sees."""
        recording = self.subject.recording
        return recording.used & ~recording.rows_held_out()


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
    recording, origin = _record(extended, log), 0.0
    if extended.log is None or not extended.log.homed:
        origin = _find_origin(Subject.of(extended, recording), found)
    recording = shift_position(recording, origin)
    after = _Transfer.of(Subject.of(extended, recording)).align()
    fit = after.fit(after.theta, after.free(), after.seen)
    floor = noise_floor(after.subject.recording, fit.residual)
    plain = plain_friction(recording)
    file = shift_position(_record(found.machine, log), origin)
    before = _Transfer.of(Subject.of(found.machine, file)).align()
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
        origin_m=origin,
        causes=tuple(_judge_cause(after, fit, cause, floor, found) for cause in found.causes),
    )
    return record, with_it


def _record(machine: Machine, log: Log) -> Recording:
    """Return a log along a machine, of a long one the segments that models are fitted to."""
    return make_excerpt(add_encoder(prepare(machine, log), log))


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
        misread=shift_column(recording.misread),
        runs=Runs(),
    )


def _find_origin(subject: Subject, found: Diagnosis) -> float:
    """Return what to add to a record's position [m] so that the forces over place of a machine fit; 0: as it is.

    The elements do not depend on the place, and what belongs to the record is fitted beside.
    """
    transfer = _Transfer.of(decimate(subject))
    recording, used = transfer.subject.recording, transfer.subject.recording.used
    here, jacobian = transfer.model.run(recording, transfer.theta)
    if jacobian is None or not np.all(np.isfinite(jacobian)):
        return 0.0
    free = find_nuisance(jacobian[used][:, transfer.free()])

    def run(shift: float) -> Array:
        return transfer.model.run(shift_position(recording, shift), transfer.theta, derivatives=False)[0]

    def left(shift: float) -> float:
        rest = free.project((recording.friction - run(shift))[used])
        return float(rest @ rest)

    def same(shift: float) -> bool:
        return float(np.max(np.abs(run(shift) - here))) < FORCE_OF_PLACE * subject.machine.friction.coulomb

    pitches = _pitches(subject.machine)
    known, own = found.traces.position_m[found.traces.used], recording.position[used]
    least, most = float(known.min() - own.max()), float(known.max() - own.min())
    step = min(pitches, default=SHIFTS_A_SINE * (most - least) / SHIFTS_A_SPAN) / SHIFTS_A_SINE
    if not step > 0.0 or (same(step) and same(math.pi * step)):
        return 0.0
    if pitches and same(max(pitches)):
        least, most = 0.0, max(pitches)
    middle, count = 0.5 * (least + most), min(MOST_SHIFTS, math.ceil((most - least) / step))
    tried = [0.0, *(middle + (k - 0.5 * count) * step for k in range(count + 1))]
    costs = run_parallel([partial(left, shift) for shift in tried])
    best, cost = min(zip(tried, costs, strict=True), key=lambda pair: pair[1])
    for _ in range(FINER):
        step *= 0.5
        best, cost = min([(best, cost), *((s, left(s)) for s in (best - step, best + step))], key=lambda pair: pair[1])
    gain = math.sqrt(max(0.0, costs[0] - cost) / len(own))
    log_decision("records", "origin of a record's position, where that gains what matters", origin_m=best, gain_N=gain)
    return best if gain > material_force(found.machine, found.noise_floor_N) else 0.0


def _pitches(machine: Machine) -> list[float]:
    """Periods of a machine's effects in position, and that of the shortest sine of each [m]."""
    found: list[float] = []
    for effect in machine.effects:
        definition = effect_definition(effect.name)
        numbers = definition.entries(effect.parameters)
        orders = [value for name, value in numbers.items() if definition.parameter(name).whole]
        for name, value in numbers.items():
            if definition.parameter(name).role == "period" and name.endswith(LENGTH):
                found += [value, value / max(orders, default=1.0)]
    return found


def _theta_without(after: _Transfer, cause: Cause) -> Array:
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


def _judge_cause(after: _Transfer, fit: Fit, cause: Cause, floor: float, found: Diagnosis) -> TransferredCause:
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
