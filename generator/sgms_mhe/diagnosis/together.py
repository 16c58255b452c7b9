"""`diagnose`: a log, or several of one axis, along a machine."""

import time
from collections.abc import Sequence
from dataclasses import replace

from sgms_mhe.diagnosis.alignment import in_step, offset_notes
from sgms_mhe.diagnosis.causes import has_size
from sgms_mhe.diagnosis.criteria import Progress, ProgressReport
from sgms_mhe.diagnosis.joint_numbers import refit_to_motion
from sgms_mhe.diagnosis.learned_machine import adopt_tables
from sgms_mhe.diagnosis.models import FitError
from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.diagnosis.transfer import judge_on_records, leaves_something, predicts_better
from sgms_mhe.diagnosis.verdict import diagnose_logs
from sgms_mhe.diagnosis.written_file import WrittenError
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.output_error import Objective
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.parallel import one_library_thread


@one_library_thread()
def diagnose(
    machine: Machine,
    log: Log,
    *,
    others: Sequence[Log] = (),
    progress: Progress | None = None,
    held_out_s: Sequence[tuple[float, float]] | None = None,
    objective: Objective = "force",
) -> Diagnosis:
    """Find the errors of a machine's model along a log, and their causes.

    Args:
        machine: the axis as it is believed to be.
        log: the measurements.
        others: further records of this axis: causes are sought on all where the first does not account for them, the
            numbers fitted to all, the causes judged on each.
        progress: called with each step and the share of the work before it.
        held_out_s: intervals since the log's start [s] that no fit behind a reported gain may see; None: a third of the
            record, in blocks.
        objective: norm of the last fit of the extended machine's numbers.

    Raises:
        InputError: the log does not fit the machine, has too few usable samples, or a model of it is not finite.
    """
    started = time.monotonic()
    told = ProgressReport(progress or (lambda step, share: None))
    try:
        told.report_start()
        found = diagnose_logs(machine, (log,), held_out_s, told)
        if others:
            found = judge_on_records(found, log, others, told.report_record, held_out_s)
            found = _diagnose_together(found, log, others, held_out_s, told)
        found = adopt_tables(found, log)
    except FitError as error:
        raise InputError(log.source or "log", "simulated friction", None, f"finite, but {error}") from None
    if objective != "force":
        told.report_motion()
        found = refit_to_motion(found, (log, *others), objective)
    written = tuple(WrittenError.measure(machine, found.extended, one) for one in (log, *others))
    return replace(found, written=written, seconds=time.monotonic() - started)


def _diagnose_together(
    found: Diagnosis,
    log: Log,
    others: Sequence[Log],
    held_out_s: Sequence[tuple[float, float]] | None,
    told: ProgressReport,
) -> Diagnosis:
    """Return the diagnosis of all records as one where they leave something and it predicts them better."""
    if not leaves_something(found):
        return found
    offset, moved = found.offset_s, []
    for one, record in zip((log, *others), found.records, strict=True):
        late = in_step(one, offset) if offset else one
        moved.append(replace(late, position_m=late.position_m + record.origin_m))
    try:
        together = diagnose_logs(found.machine, moved, held_out_s, told, is_rough=found.is_rough)
    except FitError:
        return found
    notes = (*offset_notes(found.machine, offset), *together.warnings)
    together = replace(together, offset_s=offset + together.offset_s, warnings=notes)
    together = judge_on_records(together, log, others, told.report_record, held_out_s, together=True)
    # Of a number that each record has of its own the mean may be the file's.
    kept = tuple(cause for cause in together.causes if has_size(cause))
    better = bool(kept) and predicts_better(together, found)
    log_decision(
        "records",
        "the diagnosis of all records as one stands where it predicts them better than that of the first",
        held_out_N=[record.held_out_after for record in found.records],
        held_out_together_N=[record.held_out_after for record in together.records],
        stands=better,
    )
    if not better:
        return found
    labels = {cause.label for cause in kept}
    alone = tuple(cause for cause in found.causes if cause.transfers is False and cause.label not in labels)
    return replace(together, causes=(*kept, *alone))
