"""An estimator over a log, as the controller would run it, the model alone along it, the origin of its places."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Final, Literal

from sgms_mhe.api.inputs import LogSource, Note, Progress, load, recorded_log
from sgms_mhe.configuration import carry_load, override_machine
from sgms_mhe.diagnosis import origin
from sgms_mhe.diagnosis.other_record import Origin
from sgms_mhe.evaluation.prediction import PredictedFriction, predict_log
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.free_run import run_freely
from sgms_mhe.reference import estimate_reference
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.notebooks import read_only
from sgms_mhe.support.options import Option

SOLVERS: Final = ("c", "reference", "ekf", "smoother")


def estimate(
    machine: str | Path | Machine,
    log: LogSource,
    *,
    solver: Annotated[Literal["c", "reference", "ekf", "smoother"], Option()] = "c",
    progress: Progress | None = None,
    note: Note | None = None,
) -> Estimates:
    """Estimate friction and parameters from a log as the controller would, one row per update.

    Args:
        machine: file, name, or loaded.
        log: file, Log or DataFrame; columns that replace the signal chain (velocity_m_s, ...) are used where they are.
        solver: one of c, the generated C, compiled here; reference, the Python solver it is judged by; ekf, the
            generated C of an extended Kalman filter; smoother, least squares over the whole record.
        progress: called with (updates done, updates in all).
        note: called with each sentence on how the log was read; None: they are `LogWarning`s.

    Returns:
        One row per update; `to_frame()` has the columns of the command's file.

    Raises:
        InputError: machine, solver or log; a log that ends before the first update.
        BuildError: the C compiler refused.
    """
    if solver not in SOLVERS:
        raise InputError("estimate", "solver", solver, f"one of {', '.join(SOLVERS)}")
    axis = load(machine)
    recorded = recorded_log(log, axis, driven=True, note=note)
    check_length(len(recorded), recorded.source, axis)
    if solver in ("c", "ekf"):
        chosen = override_machine(axis, {"estimator": {"kind": "ekf"}}) if solver == "ekf" else axis
        estimator = CompiledEstimator(chosen)
        if has_own_signals(recorded):
            return read_only(estimator.estimate(signals_from_log(recorded, axis), progress=progress))
        return read_only(estimator.estimate_log(recorded, mode="tick", progress=progress))
    kind: Literal["smoother"] | None = "smoother" if solver == "smoother" else None
    return read_only(estimate_reference(axis, signals_from_log(recorded, axis), kind, progress=progress))


def predict(
    machine: str | Path | Machine,
    log: LogSource,
    *,
    lowpass_Hz: Annotated[float | None, Option(least=1e-3, most=1e7)] = None,
    free_run: bool = False,
    note: Note | None = None,
) -> PredictedFriction:
    """Run a machine's model along the motion in a log, without estimation.

    Args:
        machine: file, name, or loaded.
        log: file, Log or DataFrame.
        lowpass_Hz: cutoff in place of the machine's velocity_cutoff [Hz].
        free_run: also run the model by the logged force, or command, alone: `motion` of the result.
        note: called with each sentence on how the log was read; None: they are `LogWarning`s.

    Returns:
        Measured and simulated friction at every sample (n) [N]; `to_frame()` has the columns of the command's file.

    Raises:
        InputError: machine or log; no sample is a valid measurement of friction.
        BuildError: the C compiler refused.
    """
    axis = load(machine)
    if lowpass_Hz is not None:
        axis = override_machine(axis, {"sampling": {"velocity_cutoff": lowpass_Hz}})
    recorded = recorded_log(log, axis, commanded=True, note=note)
    axis = carry_load(axis, recorded.run)
    return read_only(predict_log(axis, recorded, run_freely(axis, recorded) if free_run else None))


def find_origin(
    machine: str | Path | Machine, log: LogSource, *, within_m: float | None = None, note: Note | None = None
) -> Origin:
    """Find the position a machine's forces over place count from, along a first stretch of motion.

    After a power-up an axis that is not homed counts its positions from another place. The returned
    `position_m` is the argument of `NAME_set_origin`; a log with that subtracted from its positions is one of the homed
    axis. Offset, Coulomb level and damping of the log are its own. Not determined where the log tells nothing of the
    place, or several origins fit it as well.

    Args:
        machine: file, name, or loaded; with effects that read the place.
        log: file, Log or DataFrame.
        within_m: how far from position 0 the origin may be [m], of a rotary axis [rad]; None: anywhere, where the
            forces over place repeat.
        note: called with each sentence on how the log was read; None: they are `LogWarning`s.

    Raises:
        InputError: machine or log; no `within_m` where the forces over place do not repeat.
        BuildError: the C compiler refused.
    """
    if within_m is not None and not 0.0 < within_m < math.inf:
        raise InputError("find_origin", "within_m", within_m, "a number above 0")
    axis = load(machine)
    return origin.find_origin(axis, recorded_log(log, axis, note=note), within_m)


def has_own_signals(log: Log) -> bool:
    """Return True if a log brings a signal that is otherwise computed of position and force."""
    return any(column is not None for column in (log.velocity_m_s, log.acceleration_m_s2, log.friction_N))


def check_length(samples: int, source: str | Path, machine: Machine) -> None:
    """Refuse a log that ends before the first update.

    Raises:
        InputError: names the log, its rows and how many it takes.
    """
    least = machine.sampling.samples_per_update + 1
    if samples < least:
        raise InputError(source, "rows", samples, f"at least {least}, what one update of {machine.name} takes")
