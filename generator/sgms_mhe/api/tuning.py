"""Weights of the estimator from a log."""

from __future__ import annotations

from pathlib import Path

from sgms_mhe.api.inputs import LOGGER, LogSource, Note, Step, load, recorded_log
from sgms_mhe.evaluation.tuning import Tuned
from sgms_mhe.evaluation.tuning import tune as tune_weights
from sgms_mhe.machine import Machine


def tune(
    machine: str | Path | Machine, log: LogSource, *, note: Note | None = None, progress: Step | None = None
) -> Tuned:
    """Find the noise weights and the horizon under which a log is likeliest.

    Args:
        machine: file, name, or loaded.
        log: file, Log, DataFrame or arrays by name.
        note: called with each sentence on how the log was read; None: they are `LogWarning`s.
        progress: called with each step; None: the logger `sgms_mhe.progress` is.

    Returns:
        What was tried, and `changes()`, the content of a machine file that extends the machine.

    Raises:
        InputError: machine or log; too few updates in motion.
    """
    axis = load(machine)
    return tune_weights(axis, recorded_log(log, axis, note=note), progress or LOGGER.info)
