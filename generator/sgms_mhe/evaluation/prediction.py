"""The model alone along a measured motion: friction it says against friction that was measured."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.signal import decimate

from sgms_mhe.configuration import step_every_sample
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import OF_KIND, Kind, Machine
from sgms_mhe.recordings.free_run import FreeRun
from sgms_mhe.recordings.series import find_runs
from sgms_mhe.signals.chain import Signals, signals_of_record
from sgms_mhe.signals.logs import Log, align_velocity, write_columns
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.libraries import data_frame
from sgms_mhe.support.notebooks import Presentation, Shown, labelled_axes

MOST_DECIMATION: Final = 100
_FILTER_LENGTH: Final = 10  # rows behind the decimation: a stretch that is shorter says nothing there


@dataclass(frozen=True, repr=False)
class PredictedFriction(Shown):
    """Friction at the samples of a log, without any estimation; arrays (n).

    time [s]; measured [N], NaN where it is no measurement; friction [N] of the model at the machine file's parameters,
    which starts with all elements relaxed; drive force [N] behind the same filters; `source` names the log. Of a
    rotary axis torques [N m]; `kind` says which it is. `motion`: from force or command alone, where asked for;
    of a log without a force it is all, and frictions are NaN.
    """

    time_s: Array
    friction_measured_N: Array
    friction_N: Array
    force_N: Array
    source: str
    kind: Kind = "linear"
    motion: FreeRun | None = None

    @property
    def columns(self) -> dict[str, Array]:
        """Columns (n) of the prediction's file, as this kind of axis names them."""
        names = ("time_s", "friction_measured_N", "friction_N")
        friction = {OF_KIND[self.kind].named(name): getattr(self, name) for name in names[: 1 if self.is_motion else 3]}
        return friction if self.motion is None else friction | self.motion.columns

    @property
    def is_motion(self) -> bool:
        """Return True if no force was recorded: there is no friction to compare."""
        return bool(np.isnan(self.force_N).all())

    def to_frame(self) -> Any:
        """A pandas.DataFrame with the columns of the prediction's file, a row per sample."""
        return data_frame(self.columns)

    def plot(self, axes: Any | None = None) -> Any:
        """Draw friction measured and simulated over time; return the matplotlib axes, those given or new ones."""
        axes = labelled_axes(axes, "time [s]", OF_KIND[self.kind].balance)
        axes.plot(self.time_s, self.friction_measured_N, linewidth=0.6, color="0.6", label="measured")
        axes.plot(self.time_s, self.friction_N, linewidth=1.0, label="simulated")
        axes.legend()
        return axes

    def _shown(self) -> Presentation:
        if self.motion is not None and self.is_motion:
            return self.motion._shown()
        rest = self.friction_measured_N - self.friction_N
        rms, unit = float(np.sqrt(np.nanmean(rest**2))), OF_KIND[self.kind].force
        size = float(np.nanstd(self.friction_measured_N))
        title = f"{self.source or 'log'}: measured minus simulated friction {rms:.4g} {unit} rms, of {size:.4g} {unit}"
        return title, (), ()


@dataclass(frozen=True)
class ForceError:
    """Residual of the drive force, over `rows` compared rows of a log; all RMS [N].

    Measured minus simulated friction is also measured minus simulated drive force: both hold the same mass times
    acceleration. `relative` to the drive force it is the number by which inverse dynamic models are judged.
    """

    rows: int
    residual_rms_N: float
    friction_rms_N: float
    force_rms_N: float

    @property
    def relative(self) -> float:
        """RMS of the residual over RMS of the drive force."""
        return self.residual_rms_N / self.force_rms_N if self.force_rms_N > 0.0 else math.nan


def predict_log(machine: Machine, log: Log, motion: FreeRun | None = None) -> PredictedFriction:
    """Run the model along a log; `motion`: that it makes, all that there is of a log without a force.

    Raises:
        InputError: no sample of the log is a valid measurement of friction.
    """
    if log.is_commanded:
        if motion is None:
            raise InputError(
                log.source, "column " + log.units.named("force_N"), None, "a force; without one --free-run"
            )
        return PredictedFriction(log.time_s, log.force_N, log.force_N, log.force_N, log.source, log.kind, motion)
    signals = signals_of_record(align_velocity(log), machine)
    return replace(predict_signals(machine, signals, log.source), motion=motion)


def predict_signals(machine: Machine, signals: Signals, source: str = "log") -> PredictedFriction:
    """Run the model along aligned signals; `source` names them in messages."""
    if not signals.valid.any():
        allowed = "a row that is valid: the filters settle first, and after every missing sample"
        raise InputError(source, "rows", len(signals), allowed)
    friction = CompiledModel(step_every_sample(machine)).predict(signals)
    measured = np.where(signals.valid, signals.friction, np.nan)
    return PredictedFriction(signals.time, measured, friction, signals.force, source, machine.plant.kind)


def force_error(
    prediction: PredictedFriction, *, start_s: float = 0.0, end_s: float = math.inf, factor: int = 1
) -> ForceError:
    """Compare measured and simulated force over the valid samples.

    Args:
        prediction: along a whole log.
        start_s, end_s: seconds since the log's first sample; the model runs through all of it.
        factor: compare every `factor`-th sample behind an anti-aliasing filter without delay (0.8 of the new Nyquist
            frequency), applied apart to each stretch without a gap.

    Raises:
        InputError: nothing is left to compare.
    """
    if not 1 <= factor <= MOST_DECIMATION:
        raise InputError("comparison", "decimation", factor, f"an integer from 1 to {MOST_DECIMATION}")
    since = prediction.time_s - prediction.time_s[0]
    difference = prediction.friction_measured_N - prediction.friction_N
    counted = np.isfinite(difference) & (since >= start_s) & (since <= end_s)
    columns = np.column_stack((difference, prediction.friction_measured_N, prediction.force_N))
    least = 1 if factor == 1 else _FILTER_LENGTH * factor
    stretches = [columns[a:b] for a, b in find_runs(counted) if b - a >= least]
    if not stretches:
        part = f"rows from {start_s:g} to {min(end_s, float(since[-1])):g} s"
        allowed = f"{least} valid rows without a gap (the filters settle first, and after every missing sample)"
        raise InputError(prediction.source, part, int(counted.sum()), allowed)
    if factor > 1:
        # Of odd order: the usual even one has a gain below 1 at frequency zero.
        stretches = [decimate(stretch, factor, n=7, axis=0, zero_phase=True) for stretch in stretches]
    rows = np.concatenate(stretches)
    residual, friction, force = np.sqrt(np.mean(rows**2, axis=0)).tolist()
    return ForceError(len(rows), residual, friction, force)


def write_prediction(path: str | Path, prediction: PredictedFriction) -> None:
    """Write a prediction's columns as CSV, atomically."""
    write_columns(path, prediction.columns)
