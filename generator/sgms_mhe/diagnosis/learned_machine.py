"""A residual learned beside the causes: the machine with it, and the gain on other records."""

from dataclasses import replace

import numpy as np

from sgms_mhe.configuration import step_every_sample
from sgms_mhe.diagnosis.alignment import in_step
from sgms_mhe.diagnosis.criteria import material_force, small_force
from sgms_mhe.diagnosis.extension import add_tables
from sgms_mhe.diagnosis.final_fit import RecordResidual
from sgms_mhe.diagnosis.fits import Fit
from sgms_mhe.diagnosis.learned import Learned, LearnedRecord
from sgms_mhe.diagnosis.learner import learn_residual
from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.model.building import logged_share
from sgms_mhe.recordings.recording import Recording, prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.decisions import log_decision


def learn_beside(record: Recording, full: RecordResidual, blind: RecordResidual, floor: float) -> Learned | None:
    """Learn parts of a residual as large as a cause; `blind`: of the fit without held-out blocks; `floor` [N]."""
    material = _least_gain(record.machine, floor)
    return learn_residual(record, full.residual, blind.residual, floor=floor, material=material)


def _least_gain(machine: Machine, floor: float) -> float:
    """Return the RMS gain from which a learned force matters, that of a cause [N]; `floor`: noise [N]."""
    return max(material_force(machine, floor), small_force(machine))


def adopt_tables(found: Diagnosis, log: Log) -> Diagnosis:
    """Return a diagnosis whose extended machine has the learned tables beside the causes.

    It has them where, run along the record as its file has it, its residual is smaller by a material amount, and where
    they lose on no other record; the record's residual is then that of this machine.
    """
    learned = found.learned
    if learned is None or any(record.is_worse for record in learned.records):
        return found
    base = found.extended or found.machine
    share = logged_share(base)
    extended, changes = add_tables(found.machine, base, found.changes, [term.entry(share) for term in learned.terms])
    record = prepare(base, in_step(log, found.offset_s) if found.offset_s else log)
    before, after = (_simulate(axis, record) for axis in (base, extended))
    least = _least_gain(base, found.noise_floor_N)
    log_decision(
        "learner",
        "the extended machine has the tables where, run along the record, it leaves less by what matters",
        before_N=before,
        after_N=after,
        least_gain_N=least,
    )
    if not before**2 - after**2 > least**2:
        return found
    traces = found.traces
    force = learned.along(np.nan_to_num(traces.position_m), np.nan_to_num(traces.velocity_m_s), 1.0 / traces.rate)
    traces = replace(
        traces, extended_N=traces.extended_N + force, held_out_fit_N=traces.held_out_fit_N + learned.unseen
    )
    left = traces.friction_N - traces.held_out_fit_N
    on_seen, on_held_out = (
        float(np.sqrt(np.mean(left[traces.used & rows] ** 2))) for rows in (~traces.held_out, traces.held_out)
    )
    others = (replace(r, held_out_after=own.after) for r, own in zip(found.records[1:], learned.records, strict=False))
    return replace(
        found,
        learned=replace(learned, in_file=True),
        extended=extended,
        changes=changes,
        traces=traces,
        rms=replace(found.rms, after=on_seen, held_out_after=on_held_out),
        records=(*found.records[:1], *others) if learned.records else found.records,
    )


def _simulate(machine: Machine, record: Recording) -> float:
    """Return the RMS of measured minus simulated friction of a machine as its file has it [N]."""
    simulated = CompiledModel(step_every_sample(machine)).predict(record.signals)
    return record.rms(record.friction - record.reduce(simulated))


def judge_learned(learned: Learned, recording: Recording, fit: Fit, name: str, plain: float) -> LearnedRecord:
    """Judge learned tables on another record of the axis.

    Args:
        learned: on the first record.
        recording: the other one, in line with the machine without the tables.
        fit: of this record's own numbers, without its held-out blocks.
        name: of its log.
        plain: residual of Coulomb and viscous friction there [N].
    """
    held_out = recording.rows_held_out()
    position, velocity = np.nan_to_num(recording.position), np.nan_to_num(recording.velocity)
    left = fit.residual - learned.along(position, velocity, 1.0 / recording.rate)
    # To first order: what belongs to the record is fitted anew beside the tables.
    columns, seen = fit.jacobian[:, fit.interior], recording.used & ~held_out
    left = left - columns @ np.linalg.lstsq(columns[seen], left[seen], rcond=None)[0]
    before, after = (float(np.sqrt(np.mean(rows[held_out] ** 2))) for rows in (fit.residual, left))
    return LearnedRecord(name, before, after, plain)
