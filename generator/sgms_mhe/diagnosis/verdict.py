"""From logs and a machine to a verdict."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from sgms_mhe.configuration import drop_disturbance
from sgms_mhe.diagnosis.alignment import compile_half_steps, find_chain_error, in_step, offset_notes, sampling_offset
from sgms_mhe.diagnosis.beginning import (
    ROUGH,
    RecordStart,
    begin_from_record,
    compare_numbers,
    distance,
    identify_start,
    list_refuted,
    mean_speed,
    plain_friction,
    refute_by_causes,
)
from sgms_mhe.diagnosis.causes import name_cause
from sgms_mhe.diagnosis.combinations import KnownCombination, find_combinations
from sgms_mhe.diagnosis.criteria import ProgressReport, make_criteria
from sgms_mhe.diagnosis.final_fit import FinalFit, RecordResidual, fit_rivals, make_final_fit, split_rms
from sgms_mhe.diagnosis.fits import Fit, Subject, fit_model
from sgms_mhe.diagnosis.harmonics import list_smoothed
from sgms_mhe.diagnosis.judgement import MOST_WITHOUT_CAUSES, Judged, allowed_excess, judge
from sgms_mhe.diagnosis.laws import SHARPER, make_laws, subtract_effects
from sgms_mhe.diagnosis.learned_machine import learn_beside
from sgms_mhe.diagnosis.models import FitError
from sgms_mhe.diagnosis.numbers import base_parameters, extended_machine
from sgms_mhe.diagnosis.parametrisation import TIMING_MOST
from sgms_mhe.diagnosis.parts import Rms, Score
from sgms_mhe.diagnosis.preparation import Prepared, prepare_logs
from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.diagnosis.selection import Searched, drop_effects, search_causes, select_causes
from sgms_mhe.diagnosis.structure import structure_map
from sgms_mhe.diagnosis.traces import Traces
from sgms_mhe.diagnosis.uncertainty import FLOOR_SURE, MOSTLY, inertial_noise
from sgms_mhe.diagnosis.wording import list_alternatives
from sgms_mhe.machine import Machine
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.evidence import gain_interval, noise_floor
from sgms_mhe.recordings.excitation import clock_note, find_steady_blocks, measure_excitation
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.parallel import beside

EXCITED: Final = 0.05
"""Range of the simulated friction below which a record says nothing of it [f_C]: the axis hardly moves."""
SMEARED: Final = MOST_WITHOUT_CAUSES
"""RMS that the chain's low-passes change friction by, from which on a model's force passes them [noise floor]: what is
less is no reason to call a machine inadequate, and the motion before the chain has noise of its own."""


def diagnose_logs(
    machine: Machine,
    logs: Sequence[Log],
    held_out_s: Sequence[tuple[float, float]] | None,
    told: ProgressReport,
    *,
    is_rough: bool = True,
) -> Diagnosis:
    """Find the errors of a machine's model along logs of its axis as one record.

    Args:
        machine: the axis as it is believed to be.
        logs: one or several; numbers of each are free in it.
        held_out_s: as of `diagnose`, of the first log.
        told: of each step.
        is_rough: whether the file's numbers may be far from the record's.

    Raises:
        InputError: a log does not fit the machine, or has too few usable samples.
        FitError: a model is not finite along the record.
    """
    request = _Request(prepare_logs(drop_disturbance(machine), logs, held_out_s), logs, held_out_s, told)
    recording, begun = request.file.recording, None
    if is_rough and _is_excited(recording, request.file.nominal):
        identified = told.report_identification
        begun = begin_from_record(recording, request.file.nominal, identified, has_force=request.has_force)
    return _diagnose_begun(request, begun)


@dataclass(frozen=True, eq=False)
class _Request:
    """Inputs of a diagnosis.

    Attributes:
        file: the log along the machine of the file.
        logs: as they were read.
        held_out_s: as of `diagnose`.
        told: of each step.
    """

    file: Prepared
    logs: Sequence[Log]
    held_out_s: Sequence[tuple[float, float]] | None
    told: ProgressReport

    @property
    def has_force(self) -> bool:
        """Return True if a log has the force, not friction alone."""
        return not all(log.is_friction_alone for log in self.logs)


def _diagnose_begun(request: _Request, begun: RecordStart | None) -> Diagnosis:
    """Diagnose from the record's numbers where there are any; from the file's where no model of those is finite."""
    if begun is not None:
        try:
            found, without = _diagnose_aligned(request, begun)
            return _diagnose_again(request, begun, found, without)
        except FitError as error:
            log_decision("beginning", "file stays: a model of the record's numbers is not finite", reason=str(error))
    return _diagnose_aligned(request, None)[0]


def _diagnose_again(request: _Request, begun: RecordStart, found: Diagnosis, without: Recording) -> Diagnosis:
    """Diagnose anew from a start identified with the causes still in the record.

    Args:
        request: logs, held-out segments and progress.
        begun: the record's numbers.
        found: the diagnosis from these.
        without: the record without its causes.

    Returns:
        A diagnosis from the file where its numbers hold beside the causes, or leave less than the record's with all
        that was found, unless it alone is unexplained; the better one of two where numbers identified without them
        leave less; else `found`.
    """
    leaves_more = found.rms.held_out_after > found.rms.held_out_before
    if not found.is_rough or leaves_more:
        again = _diagnose_aligned(request, None)[0]
        lost = again.verdict == "unexplained" != found.verdict
        log_decision(
            "beginning",
            "the file's numbers hold beside the causes, or leave less: diagnosed from them",
            explains_less=lost,
            leaves_more=leaves_more,
        )
        return found if lost else again
    if not found.causes or found.rms.held_out_after < FLOOR_SURE * found.noise_floor_N:
        return found
    identified, machine = request.told.report_identification, request.file.machine
    anew = identify_start(without, machine, begun.mass, identified, has_force=request.has_force)
    if anew is None:
        return found
    again, _ = _diagnose_aligned(request, anew)
    log_decision(
        "beginning",
        "numbers identified without the causes, where they leave less",
        residual_N=found.rms.held_out_after,
        residual_again_N=again.rms.held_out_after,
    )
    sharper = again.is_rough and again.rms.held_out_after < SHARPER * found.rms.held_out_after
    return again if sharper else found


def _diagnose_aligned(request: _Request, begun: RecordStart | None) -> tuple[Diagnosis, Recording]:
    """The diagnosis of a log with its force in step with its position, and the record without its causes.

    `begun`: the record's numbers, to begin from these; None: from the file's.
    """
    machine, offset = request.file.machine, 0.0
    most = TIMING_MOST * machine.sampling.step
    prepared = request.file if begun is None else prepare_logs(begun.machine, request.logs, request.held_out_s)
    found, without = _diagnose_log(prepared, request, begun)
    while (more := sampling_offset(found)) and abs(offset + more) <= most:
        offset += more
        log_decision("record", "force put in step with position, and diagnosed again", offset_s=offset, most_s=most)
        late = prepare_logs(prepared.machine, [in_step(log, offset) for log in request.logs], request.held_out_s)
        found, without = _diagnose_log(late, request, begun)
    return replace(found, offset_s=offset, warnings=(*offset_notes(machine, offset), *found.warnings)), without


def _diagnose_log(prepared: Prepared, request: _Request, begun: RecordStart | None) -> tuple[Diagnosis, Recording]:
    """The diagnosis of a log as it is, and the record without its causes.

    Args:
        prepared: the log along the machine to begin from.
        request: logs, held-out segments and progress.
        begun: the record's numbers, where these are the beginning.
    """
    file, source, progress = request.file, request.logs[0].source, request.told
    machine, record, recording, nominal = prepared.machine, prepared.record, prepared.recording, prepared.nominal
    if not _is_excited(recording, nominal):
        if recording is not record:
            # A long rest may hold all pieces; a whole record costs no more than this one run.
            recording, nominal = record, fit_model(Subject.of(machine, record), (), refitted=())
        return _report_standstill(file.machine, source, recording, nominal), recording
    progress.report_base()
    floor = noise_floor(recording, nominal.residual)
    smear = recording.rms(find_chain_error(Subject.of(machine, recording), nominal))
    whole = replace(record, is_smeared=smear > SMEARED * floor)
    record, recording = whole, whole if recording is record else replace(recording, is_smeared=whole.is_smeared)
    one_speed = find_steady_blocks(record) is not None
    measured = measure_excitation(record.signals, machine)
    criteria = make_criteria(machine, floor, measured, progress, one_speed=one_speed, several=record.of_log is not None)
    log_decision(
        "record",
        "noise floor, gain that matters, and effects that the motion can show",
        source=source,
        samples=len(record.signals),
        residual_rows=int(record.used.sum()),
        noise_floor_N=floor,
        material_N=criteria.material,
        one_speed=one_speed,
        motion=dict(measured),
        excited=criteria.excited,
        warnings=record.warnings,
    )
    searched = search_causes(make_laws(machine, recording, floor, is_open=begun is not None), criteria)
    left_out = searched.left_out
    try:
        final, judged = _judge_search(record, nominal, searched, progress)
    except FitError:
        # A gap that opens again and again has no finite derivatives, wherever a fit of it would begin.
        left_out += tuple(dict.fromkeys(effect.name for effect in searched.fit.effects))
        if not searched.fit.effects:
            raise
        final, judged = _judge_search(record, nominal, drop_effects(searched), progress)
    if begun is not None:
        final = replace(final, nominal_residual=file.residual_along(record, final.subject.alignment.sampled))
    without = subtract_effects(final.subject.whole, judged.found.selection.fit)
    return _diagnosis(file.machine, source, final, judged, begun, left_out), without


def _judge_search(
    record: Recording, nominal: Fit, searched: Searched, progress: ProgressReport
) -> tuple[FinalFit, Judged]:
    """Judge the result of a search: select, fit to the end, confirm."""
    # What was found is mostly what is selected, and final next.
    selection = beside(
        partial(select_causes, searched), [partial(compile_half_steps, searched.laws.chosen.whole, searched.fit)]
    )
    final = make_final_fit(record, nominal, searched.laws, selection)
    progress.report_judgement()
    return final, judge(final)


def _is_excited(recording: Recording, nominal: Fit) -> bool:
    """Return True if the axis moved enough for its friction to show: it changes, or every element slips."""
    simulated = (recording.friction - nominal.residual)[recording.used]
    changes = float(np.ptp(simulated)) >= EXCITED * recording.machine.friction.coulomb
    return changes or recording.extents.travel > scales_of(recording.machine).deflection


def _diagnosis(
    machine: Machine,
    source: str,
    final: FinalFit,
    judged: Judged,
    begun: RecordStart | None,
    left_out: Sequence[str] = (),
) -> Diagnosis:
    """The verdict with everything that a report needs.

    Args:
        machine: of the file.
        source: of the log.
        final: fit of the selection.
        judged: the verdict.
        begun: the record's numbers, where these were the beginning; else None.
        left_out: effects that looked good, but have no model here.
    """
    record, causes, selection = final.record, judged.found.causes, judged.found.selection
    named = bool(causes) or begun is not None
    numbers = () if begun is None else compare_numbers(machine, begun, final, selection.fit)
    nominal, start = final.nominal_residual, final.residual_of(final.start)
    # Where nothing is named: the machine's numbers, with the transition that fits; of a rough file the record's.
    unseen = final.residual_of(judged.found.blind if named else judged.plain)
    extended_left = final.residual_of(selection.fit)
    floor = final.floor if final.along is None else final.find_floor(extended_left)
    learned = learn_beside(record, extended_left, unseen, floor)
    verdict = judged.verdict if learned is None else "unexplained"  # what can be predicted is not noise
    rms_before, held_before = split_rms(nominal, record)
    rms_after, held_after = split_rms(unseen, record)
    extended, changes = extended_machine(record.machine, final, selection, causes, machine) if named else (None, None)
    held = record.held_out
    encoder = _force_of_noise(final) if verdict in ("unexplained", "adequate") else 0.0
    hidden_by = min(encoder, held_after) if encoder**2 > MOSTLY * held_after**2 else 0.0
    return Diagnosis(
        machine=machine,
        source=source,
        verdict=verdict,
        causes=causes,
        alternatives=list_alternatives(selection, machine.plant.units),
        rms=Rms(rms_before, rms_after, held_before, held_after),
        noise_floor_N=floor,
        gain_interval_N=gain_interval(nominal.loss[held], unseen.loss[held], unseen.rows[held])
        if named
        else (0.0, 0.0),
        base=base_parameters(final, judged.free if named else final.start, machine),
        scores=selection.scores if named or verdict != "unexplained" else _unname_scores(selection.scores),
        structure_before=structure_map(record, nominal.residual, final.encoder),
        structure_after=structure_map(record, extended_left.residual if named else start.residual, final.encoder),
        traces=_traces(record, nominal, extended_left if named else nominal, unseen),
        extended=extended,
        changes=changes,
        law=final.subject.machine.friction.law,
        excited=True,
        warnings=(
            *final.recording.warnings,
            *_law_notes(final, judged.plain),
            *_estimation_notes(machine, extended),
            *(
                f"{name}: it looked good, but its model is not finite along this record: left out"
                for name in left_out
                if name not in {cause.name for cause in causes}
            ),
        ),
        rival_fits=fit_rivals(final, selection),
        undecided=(*clock_note(record), *list_smoothed(record, causes)),
        encoder_noise_N=hidden_by,
        plain=plain_friction(record),
        refuted=refute_by_causes(causes) if begun is None else list_refuted(numbers),
        is_rough=begun is not None and distance(numbers, mean_speed(record)) > ROUGH,
        combinations=_combine_causes(final, judged),
        learned=learned,
    )


def _combine_causes(final: FinalFit, judged: Judged) -> tuple[KnownCombination, ...]:
    """Return the determined combinations of collinear causes on the record, every number of the machine free."""
    selection = judged.found.selection
    if len(judged.found.causes) < 2:
        return ()
    labels = {cause.label for cause in judged.found.causes}
    groups = [(group, name_cause(selection.fit, group)) for group in selection.causes]
    free = fit_model(final.subject, selection.fit.effects, warm=selection.fit)
    known = [(group, label) for group, label in groups if label in labels]
    return find_combinations(final.subject, free, final.other, known)


def _force_of_noise(final: FinalFit) -> float:
    """RMS of the force the encoder's steps, or its noise in the acceleration, leave where nothing was fitted [N].

    The larger one.
    """
    record = final.record
    rows = record.used & record.rows_held_out()
    forces = [force for force in (final.encoder, inertial_noise(record)) if force is not None]
    return max(float(np.sqrt(np.mean(force[rows] ** 2))) for force in forces) if rows.any() else 0.0


def _law_notes(final: FinalFit, plain: Fit) -> tuple[str, ...]:
    """Return the remarks on an axis that obeys another law than its machine file states."""
    if not final.alternative:
        return ()
    unit, law = final.record.machine.plant.units.force, final.subject.machine.friction.law
    how = "at once" if law == "switching" else "smoothly"
    return (f"elements slip {how}: [friction] law = {law} alone leaves {plain.rms:.3g} {unit}",)


def _estimation_notes(machine: Machine, extended: Machine | None) -> tuple[str, ...]:
    """Return the remarks on parameters the machine estimates and the extended one cannot."""
    estimated = machine.estimator.parameters if extended is None else extended.estimator.parameters
    return tuple(
        f"{name}: 0 in the extended machine, which does not estimate it: there is no scale for it"
        for name in machine.estimator.parameters
        if name not in estimated
    )


def _unname_scores(scores: Sequence[Score]) -> tuple[Score, ...]:
    return tuple(replace(s, outcome="redundant") if s.outcome == "named" else s for s in scores)


def _traces(recording: Recording, nominal: RecordResidual, extended: RecordResidual, blind: RecordResidual) -> Traces:
    measured = recording.reduce(recording.signals.friction)
    return Traces(
        time_s=recording.time if recording.of_log is None else np.arange(len(recording.time)) / recording.rate,
        position_m=recording.position,
        velocity_m_s=recording.velocity,
        acceleration_m_s2=recording.acceleration,
        force_N=recording.force,
        friction_N=measured,
        nominal_N=measured - nominal.residual,
        extended_N=measured - extended.residual,
        held_out_fit_N=measured - blind.residual,
        used=recording.used,
        held_out=recording.rows_held_out(),
        block=recording.block,
        rate=recording.rate,
    )


def _report_standstill(machine: Machine, source: str, recording: Recording, nominal: Fit) -> Diagnosis:
    rms, held = split_rms(nominal, recording)
    maps = structure_map(recording, nominal.residual)
    floor = noise_floor(recording, nominal.residual)
    excess = math.sqrt(max(0.0, nominal.rms**2 - floor**2))
    return Diagnosis(
        machine=machine,
        source=source,
        verdict="adequate" if excess < allowed_excess(machine, floor) else "unexplained",
        rms=Rms(rms, rms, held, held),
        noise_floor_N=floor,
        structure_before=maps,
        structure_after=maps,
        traces=_traces(recording, *3 * (RecordResidual.of(nominal),)),
        law=machine.friction.law,
        excited=False,
        warnings=(*recording.warnings, "no excitation: the axis hardly moves"),
    )
