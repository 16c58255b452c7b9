"""From a log to named causes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from sgms_mhe.api.inputs import LOGGER, LogSource, Note, list_sources, load, recorded_log
from sgms_mhe.diagnosis import Diagnosis
from sgms_mhe.diagnosis import diagnose as diagnose_log
from sgms_mhe.diagnosis.criteria import Progress
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.output_error import check_objective
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.notebooks import read_only
from sgms_mhe.support.options import Option


def diagnose(
    machine: str | Path | Machine,
    log: LogSource | Sequence[LogSource],
    *,
    held_out_s: Annotated[Sequence[tuple[float, float]] | None, Option("FROM TO", 0.0, 1e8)] = None,
    objective: Annotated[Literal["force", "motion", "both"], Option()] = "force",
    note: Note | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find the errors of a machine's simulation along a log, name the causes, and measure the gain of naming them.

    Args:
        machine: file, name, or loaded: the axis as it is believed to be.
        log: measurements as file, Log or DataFrame. Of several, records of one axis, the first is diagnosed,
            and all as one where that leaves something; the numbers are fitted to all, each is judged by the others.
        held_out_s: intervals since the log's start [s] that no fit behind a reported gain sees; None: a third of the
            record, in blocks.
        objective: norm of the extended machine's numbers. force: all of them; motion: Coulomb level, damping and sizes
            of effects once more, to the motion the force alone makes; both: each error over its noise.
        note: called with each sentence on how the log was read; None: they are `LogWarning`s.
        progress: called with each step and the share of the work before it; None: the logger `sgms_mhe.progress` is.

    Returns:
        Verdict, causes with parameters and deviations, rivals, questions left open by the record, the extended machine.

    Raises:
        InputError: machine or log; an ImplausibleError where the log's sign, scale or unit cannot be meant.
    """
    check_objective("diagnose", objective)
    axis = load(machine)
    sources = list_sources(log)
    if not sources:
        raise InputError("diagnose", "log", [], "at least one")
    first, *others = (recorded_log(source, axis, note=note) for source in sources)
    found = diagnose_log(
        axis, first, others=others, progress=progress or _tell, held_out_s=held_out_s, objective=objective
    )
    return read_only(found)


def _tell(step: str, share: float) -> None:
    LOGGER.info("%s (%.0f %%)", step, 100.0 * share)
