"""Weights of the estimator from a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from sgms_mhe.api.inputs import LOGGER, LogSource, Note, Step, load, recorded_log
from sgms_mhe.evaluation.tuning import Tuned
from sgms_mhe.evaluation.tuning import tune as tune_weights
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.output_error import check_objective
from sgms_mhe.support.options import Option


def tune(
    machine: str | Path | Machine,
    log: LogSource,
    *,
    objective: Annotated[Literal["force", "motion", "both"], Option()] = "force",
    note: Note | None = None,
    progress: Step | None = None,
) -> Tuned:
    """Find the noise weights and the horizon under which a log is likeliest.

    Args:
        machine: file, name, or loaded.
        log: file, Log, DataFrame or arrays by name.
        objective: force: innovations are likeliest; motion: the errors of a motion predicted over the horizon,
            their second integral; both: both.
        note: called with each sentence on how the log was read; None: they are `LogWarning`s.
        progress: called with each step; None: the logger `sgms_mhe.progress` is.

    Returns:
        The trials, and `changes()`, the content of a machine file that extends the machine.

    Raises:
        InputError: machine or log; too few updates in motion.
    """
    check_objective("tune", objective)
    axis = load(machine)
    return tune_weights(axis, recorded_log(log, axis, driven=True, note=note), progress or LOGGER.info, objective)
