"""`diagnose`: from a log and a machine to a verdict."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.alignment import (
    align,
    compile_half_steps,
    find_chain_error,
    in_step,
    offset_notes,
    sampling_offset,
)
from sgms_mhe.diagnosis.causes import (
    Confirmed,
    base_parameters,
    confirm_causes,
    confirm_constant_causes,
    extended_machine,
    refit_numbers,
    restore_undetermined,
)
from sgms_mhe.diagnosis.criteria import Progress, ProgressReport, make_criteria, material_force, small_force
from sgms_mhe.diagnosis.final_fit import FinalFit, RecordResidual, fit_rivals, make_final_fit, split_rms
from sgms_mhe.diagnosis.fits import Fit, Subject, fit_model
from sgms_mhe.diagnosis.laws import list_compilations, make_laws
from sgms_mhe.diagnosis.models import FitError
from sgms_mhe.diagnosis.parametrisation import TIMING_MOST, ParameterGroup
from sgms_mhe.diagnosis.result import Diagnosis, Rms, Score, Traces, Verdict
from sgms_mhe.diagnosis.selection import Searched, drop_effects, search_causes, select_causes
from sgms_mhe.diagnosis.structure import force_over_speed, structure_map
from sgms_mhe.diagnosis.uncertainty import inertial_noise
from sgms_mhe.diagnosis.wording import choose_experiment, list_alternatives, summarise
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES
from sgms_mhe.model.effects import cause as cause_definition
from sgms_mhe.recordings.evidence import gain_interval, hides_friction, noise_floor
from sgms_mhe.recordings.excerpt import make_excerpt
from sgms_mhe.recordings.excitation import clock_note, find_steady_blocks, measure_excitation
from sgms_mhe.recordings.recording import Recording, add_encoder, prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.parallel import beside

Array = NDArray[np.float64]

EXCITED: Final = 0.05
"""Range of the simulated friction below which a record says nothing of it [f_C]: the axis hardly moves."""
ALLOWED_NOISE: Final = 0.5
"""RMS beyond noise that a complete explanation may leave; the largest of the three counts [noise floor]: the floor
itself is an estimate."""
ALLOWED_ENCODER: Final = 1.0
"""The same where the encoder's steps make most of the floor: where its lines are, and so how much of their noise passes
the low-passes, is known to a factor of 1.4."""
MOSTLY: Final = 0.5
"""Share of the power of a residual, or a floor, from which on it is said to be the encoder's noise."""
ALLOWED_SHARE: Final = 0.15
"""RMS beyond noise that a complete explanation may leave; the largest of the three counts [RMS beyond noise before]: 98
% of the power is explained."""
MOST_WITHOUT_CAUSES: Final = 3.0
"""RMS beyond noise that a machine without causes may leave, whatever the three before it say [noise floor]: what leaves
more is not adequate."""
SMEARED: Final = MOST_WITHOUT_CAUSES
"""RMS that the chain's low-passes change friction by, from which on a model's force passes them [noise floor]: what is
less is no reason to call a machine inadequate, and the motion before the chain has noise of its own."""
MOST_WITH_CAUSES: Final = 1.25
"""RMS beyond noise that named causes may leave, whatever the three of `unexplained` say [noise floor]: what leaves more
has not explained the record, however much it gained."""
LEAST_ALLOWED: Final = 0.012
"""RMS beyond noise that either may leave, however quiet the record; numbers beside effects only what is small [f_C]:
sampling, integration and a low cutoff leave as much of a log without noise."""
MOST_RESIDUAL: Final = 0.75
"""RMS beyond noise that may be left for causes to be listed that are constant over the record [RMS beyond noise
before]: measured axes have what no catalogue has; a quarter must go."""
CURVE_GAIN: Final = 0.5
"""RMS of what is left as a curve over speed, from which a curve is taken for another one, with CURVE_SHARE [gain that
matters]: curves over speed add up to nearly any other one, and what they miss of it is such a curve."""
CURVE_SHARE: Final = 0.3
"""The same over all that is left [RMS beyond noise]: where much else is left the map over speed shows some of that."""


def diagnose(
    machine: Machine,
    log: Log,
    *,
    progress: Progress | None = None,
    held_out_s: Sequence[tuple[float, float]] | None = None,
) -> Diagnosis:
    """Say what a machine's model gets wrong along a log, and why.

    Args:
        machine: the axis as it is believed to be.
        log: what was measured.
        progress: called with each step and the share of the work before it.
        held_out_s: intervals since the log's start [s] that no fit behind a reported gain may see; None: a third of the
            record, in blocks.

    Raises:
        InputError: the log does not fit the machine, has too few usable samples, or a model of it is not finite.
    """
    started = time.monotonic()
    told = ProgressReport(progress or (lambda step, share: None))
    most, offset = TIMING_MOST * machine.sampling.step, 0.0
    try:
        found = _diagnose_log(machine, log, held_out_s, told)
        while (more := sampling_offset(found)) and abs(offset + more) <= most:
            offset += more
            log_decision("record", "force put in step with position, and diagnosed again", offset_s=offset, most_s=most)
            found = _diagnose_log(machine, in_step(log, offset), held_out_s, told)
    except FitError as error:
        raise InputError(log.source or "log", "simulated friction", None, f"finite, but {error}") from None
    warnings = (*offset_notes(machine, offset), *found.warnings)
    return replace(found, warnings=warnings, seconds=time.monotonic() - started)


def _diagnose_log(
    machine: Machine, log: Log, held_out_s: Sequence[tuple[float, float]] | None, progress: ProgressReport
) -> Diagnosis:
    """The diagnosis of a log as it is."""
    progress.report_start()
    record = prepare(machine, log, held_out_s)
    record = beside(partial(add_encoder, record, log), list_compilations(machine, make_excerpt(record)))
    recording = make_excerpt(record)
    nominal = fit_model(Subject.of(machine, recording), (), refitted=())
    if not _is_excited(recording, nominal):
        if recording is not record:
            # A long rest may hold all pieces; a whole record costs no more than this one run.
            recording, nominal = record, fit_model(Subject.of(machine, record), (), refitted=())
        return _report_standstill(machine, log, recording, nominal)
    progress.report_base()
    floor = noise_floor(recording, nominal.residual)
    smear = recording.rms(find_chain_error(Subject.of(machine, recording), nominal))
    whole = replace(record, is_smeared=smear > SMEARED * floor)
    record, recording = whole, whole if recording is record else replace(recording, is_smeared=whole.is_smeared)
    one_speed = find_steady_blocks(record) is not None
    measured = measure_excitation(record.signals, machine)
    criteria = make_criteria(machine, floor, measured, progress, one_speed=one_speed)
    log_decision(
        "record",
        "noise floor, gain that matters, and effects that the motion can show",
        source=log.source,
        samples=len(log),
        residual_rows=int(record.used.sum()),
        noise_floor_N=floor,
        material_N=criteria.material,
        one_speed=one_speed,
        motion=dict(measured),
        excited=criteria.excited,
        warnings=record.warnings,
    )
    searched = search_causes(make_laws(machine, recording, floor), criteria)
    left_out: tuple[str, ...] = ()
    try:
        final, judged = _judge_search(record, nominal, searched, progress)
    except FitError:
        # A gap that opens again and again has no finite derivatives, wherever a fit of it would begin.
        left_out = tuple(dict.fromkeys(effect.name for effect in searched.fit.effects))
        if not left_out:
            raise
        final, judged = _judge_search(record, nominal, drop_effects(searched), progress)
    return _diagnosis(machine, log, final, judged, left_out)


def _judge_search(
    record: Recording, nominal: Fit, searched: Searched, progress: ProgressReport
) -> tuple[FinalFit, _Judged]:
    """Judge the result of a search: select, fit to the end, confirm."""
    # What was found is mostly what is selected, and final next.
    selection = beside(
        partial(select_causes, searched), [partial(compile_half_steps, searched.laws.chosen.whole, searched.fit)]
    )
    final = make_final_fit(record, nominal, searched.laws, selection)
    progress.report_judgement()
    return final, _judge(final)


def _is_excited(recording: Recording, nominal: Fit) -> bool:
    """Return True if the axis moved enough for its friction to show."""
    simulated = (recording.friction - nominal.residual)[recording.used]
    machine = recording.machine
    return not float(np.ptp(simulated)) < EXCITED * machine.friction.coulomb


@dataclass(frozen=True, eq=False)
class _Judged:
    """A verdict and what it rests on.

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


def _judge(final: FinalFit) -> _Judged:
    """Confirm the causes, and say whether they explain the record."""
    found = confirm_causes(final, final.selection)
    plain = final.fit((), refitted=())
    # The base numbers' own small errors are no structure that asks for a name.
    free = final.fit(found.selection.fit.effects, warm=found.selection.fit)
    best = min(found.selection.fit, free, key=final.excess)
    before, after = final.excess(plain), final.excess(best)
    judged = found.selection.causes
    allowed = _allowed_excess(final.record.machine, final.floor, judged, before, _encoder_rms(final))
    curve = after < allowed and any(_may_stand_in(group.cause) for group in judged) and _leaves_curve(final, best)
    verdict: Verdict
    if not found.selection.causes:
        # As it is, and not with other numbers: what these explain and no cause does is not adequate.
        plain = _align_plain(final, plain)
        before = final.excess(plain)
        verdict = "adequate" if before < allowed else "unexplained"
    elif after < allowed and not curve:
        verdict = "ambiguous" if found.selection.rivals else "explained"
        if final.alternative:
            found = refit_numbers(final, found, constant=False)
    else:
        verdict = "unexplained"
        # Something is left; but causes that are the same everywhere in the record are none the less real.
        found = confirm_constant_causes(final, final.selection)
        # What refitted numbers explain that are no cause is no merit of the causes.
        before = final.excess(final.fit((), refitted=found.selection.unnamed))
        kept = final.excess(found.selection.fit)
        certain = bool(found.causes) and kept < MOST_RESIDUAL * before
        log_decision(
            "verdict",
            "causes of an unexplained record are listed where they leave clearly less",
            causes=[cause.label for cause in found.causes],
            residual_beyond_noise_N=kept,
            allowed_N=MOST_RESIDUAL * before,
            listed=certain,
        )
        if not certain:
            plain = _align_plain(final, plain)
            found = Confirmed(replace(found.selection, fit=plain, refitted=(), rivals=()), plain, ())
    if found.causes:
        found = restore_undetermined(final, found)
        if verdict == "unexplained" and _leaves_curve(final, found.selection.fit):
            found = replace(found, causes=tuple(replace(c, stands_in=_may_stand_in(c.name)) for c in found.causes))
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
    return _Judged(verdict, found, plain, free)


def _align_plain(final: FinalFit, plain: Fit) -> Fit:
    """Return the machine as it is, in line with itself: the record was with a fit that may have other numbers."""
    return fit_model(align(final.subject, plain, anew=True), (), refitted=())


def _may_stand_in(name: str) -> bool:
    """Return True if a cause beside a residual curve over speed may be a part of it: a machine's number, a curve."""
    return name in BASE_CAUSES or cause_definition(name).over_speed


def _leaves_curve(final: FinalFit, fit: Fit) -> bool:
    """Return True if a good part of the residual is a curve over speed, and it matters."""
    material = material_force(final.record.machine, final.floor)
    left = final.residual_of(fit)
    curve = force_over_speed(final.record, left.residual)
    beyond = math.sqrt(max(0.0, left.rms**2 - final.floor**2))
    return curve > max(CURVE_GAIN * material, CURVE_SHARE * beyond)


def _encoder_rms(final: FinalFit) -> float:
    """RMS of the force that the encoder's steps leave in a record that can be judged all the same [N]; else 0."""
    encoder, record = final.encoder, final.record
    return 0.0 if encoder is None or hides_friction(record, encoder) else record.rms(encoder)


def _allowed_excess(
    machine: Machine,
    floor: float,
    causes: Sequence[ParameterGroup] = (),
    before: float = 0.0,
    encoder: float = 0.0,
) -> float:
    """RMS beyond noise [N] that a complete explanation may leave.

    `before`: without its causes; `encoder`: what the encoder's steps leave, where they are in the floor.

    A wrong number beside effects may stand for a part of what they leave: then that is no more than what is small.
    """
    level = machine.friction.coulomb
    noise = floor * (ALLOWED_ENCODER if encoder**2 > MOSTLY * floor**2 else ALLOWED_NOISE)
    wanted = max(machine.diagnosis.unexplained * level, noise, ALLOWED_SHARE * before)
    most = MOST_WITH_CAUSES if causes else MOST_WITHOUT_CAUSES
    mixed = len({group.is_candidate for group in causes}) > 1
    least = small_force(machine) if mixed else LEAST_ALLOWED * level
    return min(wanted, max(most * floor, least))


def _diagnosis(machine: Machine, log: Log, final: FinalFit, judged: _Judged, left_out: Sequence[str] = ()) -> Diagnosis:
    """The verdict with everything that a report needs; `left_out`: effects that looked good, but have no model here."""
    record, verdict, causes = final.record, judged.verdict, judged.found.causes
    selection = judged.found.selection
    named = bool(causes)
    nominal, start = final.nominal_residual, final.residual_of(final.start)
    # Where nothing is named: the machine's numbers, with the transition that fits.
    unseen = final.residual_of(judged.found.blind if named else judged.plain)
    extended_left = final.residual_of(selection.fit)
    rms_before, held_before = split_rms(nominal, record)
    rms_after, held_after = split_rms(unseen, record)
    extended, changes = extended_machine(machine, final, selection, causes) if named else (None, None)
    held = record.held_out
    alternatives = list_alternatives(selection, machine.plant.units)
    rivals = [alternative for alternative in alternatives if alternative.rival]
    encoder = _force_of_noise(final) if verdict in ("unexplained", "adequate") else 0.0
    hidden_by = min(encoder, held_after) if encoder**2 > MOSTLY * held_after**2 else 0.0
    return Diagnosis(
        machine=machine,
        source=log.source,
        verdict=verdict,
        summary=summarise(verdict, causes, rivals, held_before, held_after, machine.plant.units, hidden_by),
        causes=causes,
        alternatives=alternatives,
        separating_experiment=choose_experiment(verdict, causes, rivals, hidden_by),
        rms=Rms(rms_before, rms_after, held_before, held_after),
        noise_floor_N=final.floor if final.along is None else final.find_floor(extended_left),
        gain_interval_N=gain_interval(nominal.loss[held], unseen.loss[held], unseen.rows[held])
        if named
        else (0.0, 0.0),
        base=base_parameters(final, judged.free if named else final.start),
        scores=selection.scores if named or verdict != "unexplained" else _unname_scores(selection.scores),
        structure_before=structure_map(record, nominal.residual, final.encoder),
        structure_after=structure_map(record, extended_left.residual if named else start.residual, final.encoder),
        traces=_traces(record, nominal, start, extended_left if named else nominal, unseen),
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
        seconds=0.0,
        rival_fits=fit_rivals(final, selection),
        undecided=clock_note(record),
        encoder_noise_N=hidden_by,
    )


def _force_of_noise(final: FinalFit) -> float:
    """RMS of the force that the encoder's steps, or its noise in the acceleration, leave where nothing was fitted [N].

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
    """Return the remarks on parameters that the machine estimates and the extended one cannot."""
    estimated = machine.estimator.parameters if extended is None else extended.estimator.parameters
    return tuple(
        f"{name}: 0 in the extended machine, which does not estimate it: there is no scale for it"
        for name in machine.estimator.parameters
        if name not in estimated
    )


def _unname_scores(scores: Sequence[Score]) -> tuple[Score, ...]:
    return tuple(replace(s, outcome="redundant") if s.outcome == "named" else s for s in scores)


def _traces(
    recording: Recording,
    nominal: RecordResidual,
    start: RecordResidual,
    extended: RecordResidual,
    blind: RecordResidual,
) -> Traces:
    measured = recording.reduce(recording.signals.friction)
    return Traces(
        time_s=recording.time,
        position_m=recording.position,
        velocity_m_s=recording.velocity,
        acceleration_m_s2=recording.acceleration,
        force_N=recording.force,
        friction_N=measured,
        nominal_N=measured - nominal.residual,
        refitted_N=measured - start.residual,
        extended_N=measured - extended.residual,
        held_out_fit_N=measured - blind.residual,
        used=recording.used,
        held_out=recording.rows_held_out(),
        block=recording.block,
        rate=recording.rate,
    )


def _report_standstill(machine: Machine, log: Log, recording: Recording, nominal: Fit) -> Diagnosis:
    rms, held = split_rms(nominal, recording)
    maps = structure_map(recording, nominal.residual)
    floor = noise_floor(recording, nominal.residual)
    excess = math.sqrt(max(0.0, nominal.rms**2 - floor**2))
    return Diagnosis(
        machine=machine,
        source=log.source,
        verdict="adequate" if excess < _allowed_excess(machine, floor) else "unexplained",
        summary="There is no excitation in this record: the axis hardly moves, so nothing can be said about friction.",
        causes=(),
        alternatives=(),
        separating_experiment="record a motion: strokes in both directions at several speeds, with reversals and rests",
        rms=Rms(rms, rms, held, held),
        noise_floor_N=floor,
        gain_interval_N=(0.0, 0.0),
        base=(),
        scores=(),
        structure_before=maps,
        structure_after=maps,
        traces=_traces(recording, *4 * (RecordResidual.of(nominal),)),
        extended=None,
        changes=None,
        law=machine.friction.law,
        excited=False,
        warnings=(*recording.warnings, "no excitation: the axis hardly moves"),
        seconds=0.0,
    )
