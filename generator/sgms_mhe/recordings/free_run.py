"""Free run: motion a machine makes of a logged force or a command alone, and how long it stays near the real one.

The simulated axis (`plant/`) runs from the first samples of every stretch without a gap. Before such a start it follows
the measured motion, so that elements, lags and clocks are those of the record.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

from sgms_mhe.machine import OF_KIND, Kind, Machine
from sgms_mhe.plant.axis_config import MAX_SUBSTEPS, AxisConfig
from sgms_mhe.plant.native import HiddenEffect, NativeAxis
from sgms_mhe.recordings.series import find_runs
from sgms_mhe.signals.chain import readings
from sgms_mhe.signals.drive import command_of, switched_on
from sgms_mhe.signals.logs import Log, check_rate
from sgms_mhe.signals.noise import encoder_step, position_noise
from sgms_mhe.support.arrays import Array, Index
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.notebooks import Presentation, Shown, labelled_axes

FIRST: Final = 20
"""Samples that a start is estimated from, and that are not compared."""
LONGEST_STEP_S: Final = 1e-4
COMMANDED_STEP_S: Final = 1e-3
"""Longest step of an axis whose loop and gear are slow: a smart servo's."""
STEPS_PER_RADIAN: Final = 10.0
"""Of the fastest oscillation: its period is then right to 0.04 %."""
SHOTS: Final = 20
ROWS_HZ: Final = 100.0
TOLERANCE: Final = 0.01
"""Error of a horizon over the range of the record's positions."""
SMALLEST: Final = 1e-9
"""Noise over that range, at least: a simulated position has no other."""

_NONE: Final[Mapping[str, float]] = MappingProxyType({})


@dataclass(frozen=True)
class ShotStart:
    """State that a shot starts from: position [m], velocity [m/s], strain added to that of the motion."""

    sample: int
    position: float
    velocity: float
    strain: float = 0.0


@dataclass(frozen=True)
class MotionHorizon:
    """Longest time after a start up to which the RMS error over all starts stays within a bound.

    Attributes:
        seconds: that time; `reached`: whether the error is beyond the bound after it, or the record allows no more.
        error: the bound [m].
        starts: how many, spread evenly.
    """

    seconds: float
    reached: bool
    error: float
    starts: int


@dataclass(frozen=True, repr=False)
class FreeRun(Shown):
    """Motion from the measured force alone; arrays (n), of a rotary axis angles [rad].

    time [s]; measured position [m], NaN where it is missing; simulated position [m], NaN in a gap and where the model
    ran away; `compared` samples, none of the first of a start. drift: slope of the error over the
    time since its start [m/s]. `source` names the log.
    """

    time_s: Array
    position_m: Array
    simulated_position_m: Array
    compared: NDArray[np.bool_]
    starts: tuple[ShotStart, ...]
    drift_m_s: float
    horizon: MotionHorizon
    source: str
    kind: Kind = "linear"

    @property
    def error(self) -> Array:
        """Simulated minus measured position of the compared samples [m]; infinite where the model ran away."""
        error = (self.simulated_position_m - self.position_m)[self.compared]
        return np.where(np.isfinite(error), error, math.inf)

    @property
    def rms(self) -> float:
        """RMS of the error [m]."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def columns(self) -> dict[str, Array]:
        """Columns (n) of the prediction's file, as this kind of axis names them."""
        names = ("position_m", "simulated_position_m")
        return {OF_KIND[self.kind].named(name): getattr(self, name) for name in names}

    def plot(self, axes: Any | None = None) -> Any:
        """Draw position measured and simulated over time; return the matplotlib axes, those given or new ones."""
        axes = labelled_axes(axes, "time [s]", f"position [{OF_KIND[self.kind].position}]")
        axes.plot(self.time_s, self.position_m, linewidth=1.0, color="0.6", label="measured")
        axes.plot(self.time_s, self.simulated_position_m, linewidth=1.0, label="free run")
        axes.legend()
        return axes

    def describe(self) -> str:
        """Return error, drift and horizon in words."""
        unit, horizon = OF_KIND[self.kind].position, self.horizon
        again = f", started anew behind {len(self.starts) - 1} gaps" if len(self.starts) > 1 else ""
        least = "" if horizon.reached else "at least "
        return (
            f"free run: {self.rms:.4g} {unit} rms, drift {self.drift_m_s:.3g} {unit}/s{again}; within "
            f"{horizon.error:.3g} {unit} rms for {least}{horizon.seconds:.3g} s after {horizon.starts} starts"
        )

    def _shown(self) -> Presentation:
        return f"{self.source or 'log'}: {self.describe()}", (), ()

    def to_json(self) -> dict[str, Any]:
        """Plain data; numbers in `unit`; None where the model ran away."""
        mae, rms = float(np.mean(np.abs(self.error))), self.rms
        return {
            "mae": mae if math.isfinite(mae) else None,
            "rms": rms if math.isfinite(rms) else None,
            "unit": OF_KIND[self.kind].position,
            "skipped": len(self.compared) - int(self.compared.sum()),
            "starts_s": [float(self.time_s[start.sample]) for start in self.starts],
            "drift_per_s": self.drift_m_s if math.isfinite(self.drift_m_s) else None,
            "horizon": vars(self.horizon),
        }


class FreeRunRecord:
    """A log as free runs take it: its stretches without a gap, and the motion the axis follows before a start.

    `start_s`, `end_s` [s since the log's first sample] say which part is run through.

    Attributes:
        stretches: first sample and that after the last, of each.
        position: measured (n) [m]; NaN where it is missing.
        extent: range of the positions [m].

    Raises:
        InputError: no force was logged; no stretch is long enough to compare anything; nothing moves.
    """

    def __init__(self, machine: Machine, log: Log, start_s: float = 0.0, end_s: float = math.inf) -> None:
        check_rate(log, machine)
        if log.is_friction_alone or log.payload:
            said = f"a log with the {log.units.push} that moves the axis, and no mass beside it"
            raise InputError(log.source or "log", "free run", log.units.named("friction_N"), said)
        log = readings(log)
        command, self._on = command_of(log, machine), switched_on(log)
        self.log, self.position, self._is_commanded = log, log.position_m, command is not None
        good = np.isfinite(log.position_m) & (np.isfinite(log.force_N) | self._is_commanded)
        since = log.time_s - log.time_s[0]
        chosen = good & (since >= start_s) & (since <= end_s)
        self.stretches = [(a, b) for a, b in find_runs(chosen) if b - a > 2 * FIRST]
        if not self.stretches:
            allowed = f"more than {2 * FIRST} in a row with position and {log.units.push}"
            raise InputError(log.source or "log", "samples", int(chosen.sum()), allowed)
        self._is_fresh = ~np.concatenate(([False], good[:-1]))
        k = np.arange(len(log))
        filled = np.interp(k, k[good], log.position_m[good])
        self._sos = butter(2, machine.sampling.velocity_cutoff, fs=log.rate, output="sos")
        self._followed = np.ascontiguousarray(sosfiltfilt(self._sos, filled))
        self._driving = np.ascontiguousarray(np.interp(k, k[good], log.force_N[good])) if command is None else command
        self.extent = float(np.ptp(log.position_m[good]))
        if self.extent == 0.0:
            raise InputError(log.source or "log", log.units.named("position_m"), "the same throughout", "a motion")
        step = machine.sampling.position_step or encoder_step(log.position_m)
        self.noise = max(position_noise(log.position_m), step / math.sqrt(12.0), SMALLEST * self.extent)

    def axis(
        self, machine: Machine, parameters: Mapping[str, float] = _NONE, hidden: Sequence[HiddenEffect] = ()
    ) -> NativeAxis:
        """Return a machine's axis, at rest at the first sample, with these true numbers and effects it hides."""
        config = _config(machine, self.log.rate, self._is_commanded)
        sampling = machine.sampling.model_copy(update={"rate": self.log.rate})
        axis = NativeAxis(replace(machine, sampling=sampling), config, hidden)
        axis.enable(self._on)
        for name, value in parameters.items():
            axis.replace(name, value)
        axis.place(float(self._followed[0]))
        return axis

    def run(
        self, axis: NativeAxis, shots: Sequence[tuple[int, int]], starts: Sequence[ShotStart] = ()
    ) -> tuple[list[Array], list[ShotStart]]:
        """Run an axis freely through shots (first sample, that after the last), in the order of time.

        `starts` of an earlier run are taken over; without them each is estimated from its first samples.
        """
        here, runs, taken = 0, [], []
        for i, (first, end) in enumerate(shots):
            axis.follow(self._followed, self._driving, here, first)
            here = first
            start = starts[i] if starts else self._estimate(axis, first)
            runs.append(axis.run_free(self._driving, first, end, start.position, start.velocity, start.strain))
            taken.append(start)
        return runs, taken

    def rows(self, shots: Sequence[tuple[int, int]]) -> list[tuple[int, int, int]]:
        """Return shots with the step between samples a fit compares."""
        return [(a, b, max(1, round(self.log.rate / ROWS_HZ))) for a, b in shots]

    def force_residual(self, axis: NativeAxis) -> Array:
        """Return force by the model minus measured force along the measured motion (n), low-passed [N]."""
        acceleration = axis.follow(self._followed, self._driving, 0, len(self._driving))
        moved = np.pad(np.diff(self._followed, 2), 1, mode="edge") * self.log.rate**2
        before = 0.5 * (moved + np.concatenate((moved[:1], moved[:-1])))
        return axis.number("mass") * np.asarray(before - sosfiltfilt(self._sos, acceleration))

    def _estimate(self, axis: NativeAxis, first: int) -> ShotStart:
        """Return the start that fits its first samples best; strains only where no motion before them tells them.

        Least squares in position, velocity and strain, of which a standard deviation of 1 is known before.
        """
        measured, span = self.position[first : first + FIRST], FIRST / self.log.rate
        slope, level = np.polyfit(np.arange(FIRST) / self.log.rate, measured, 1)
        near = 1e-3 * self.extent
        scale = np.array([near, near / span, float(self._is_fresh[first])])
        guess = np.array([level, slope, 0.0])

        def residual(x: Array) -> Array:
            moved = axis.run_free(self._driving, first, first + FIRST, *(guess + scale * x).tolist())
            return np.append(np.nan_to_num((moved - measured) / self.noise, nan=1e9), x[2])

        found = least_squares(residual, np.zeros(3), bounds=([-np.inf, -np.inf, -1.0], [np.inf, np.inf, 1.0]))
        return ShotStart(first, *(guess + scale * found.x).tolist())


def _config(machine: Machine, rate: float, commanded: bool) -> AxisConfig:
    """Return an axis that force or command drive, sensors without errors, in steps that resolve its oscillations."""
    numbers = [(name, x) for effect in machine.effects for name, x in effect.parameters.items() if isinstance(x, float)]
    stiffness = sum(machine.friction.stiffness) + sum(abs(x) for name, x in numbers if name.endswith("_N_m"))
    resonances = [2.0 * math.pi * x for name, x in numbers if name.endswith("_Hz")]
    fastest = max((math.sqrt(stiffness / machine.plant.moved), *resonances))
    longest = COMMANDED_STEP_S if commanded else LONGEST_STEP_S
    steps = math.ceil(max(1.0 / longest, STEPS_PER_RADIAN * fastest) / rate - 1e-9)
    return AxisConfig(
        control="command" if commanded else "logged",
        current_loop_Hz=math.inf,
        encoder_resolution_m=0.0,
        force_noise_N=0.0,
        substeps=min(steps, MAX_SUBSTEPS),
    )


def run_freely(
    machine: Machine, log: Log, *, start_s: float = 0.0, end_s: float = math.inf, tolerance_m: float | None = None
) -> FreeRun:
    """Run a machine by the force in a log alone, or by the command its drive takes, anew after every gap.

    Args:
        machine: with all its effects.
        log: at the machine's rate.
        start_s, end_s: the part that is run through [s since the log's first sample].
        tolerance_m: error of the horizon [m]; None: 1 % of the range of the positions.

    Raises:
        InputError: a log without a force or a command for this drive, or without a stretch long enough; an effect that
            the plant does not know.
    """
    record = FreeRunRecord(machine, log, start_s, end_s)
    simulated, since, starts = _run_stretches(machine, record)
    compared = since >= FIRST
    error = (simulated - record.position)[compared]
    drift = float(np.polyfit(since[compared] / log.rate, error, 1)[0]) if np.isfinite(error).all() else math.nan
    horizon = _find_horizon(machine, record, TOLERANCE * record.extent if tolerance_m is None else tolerance_m)
    return FreeRun(
        log.time_s, record.position, simulated, compared, tuple(starts), drift, horizon, log.source, log.kind
    )


def measure_free_run(machine: Machine, log: Log) -> float:
    """Return `FreeRun.rms` alone [m]; NaN where the log allows no free run, or the model runs away."""
    try:
        record = FreeRunRecord(machine, log)
    except InputError:
        return math.nan
    simulated, since, _ = _run_stretches(machine, record)
    return float(np.sqrt(np.mean((simulated - record.position)[since >= FIRST] ** 2)))


def _run_stretches(machine: Machine, record: FreeRunRecord) -> tuple[Array, Index, list[ShotStart]]:
    """Run freely through all stretches: positions (n) [m], samples since each start (n), -1 outside, and the starts."""
    n = len(record.position)
    simulated, since = np.full(n, math.nan), np.full(n, -1)
    runs, starts = record.run(record.axis(machine), record.stretches)
    for (first, end), positions in zip(record.stretches, runs, strict=True):
        simulated[first:end], since[first:end] = positions, np.arange(end - first)
    return simulated, since, starts


def spread_shots(record: FreeRunRecord, length: int, count: int) -> list[tuple[int, int]]:
    """Return shots of a length [samples], at most so many, that start evenly over all places where one fits."""
    places = np.concatenate([np.arange(a, b - length + 1) for a, b in record.stretches])
    chosen = np.unique(np.linspace(0, len(places) - 1, count).round().astype(int))
    return [(int(a), int(a) + length) for a in places[chosen]]


def _find_horizon(machine: Machine, record: FreeRunRecord, tolerance: float) -> MotionHorizon:
    """Shoot over half of the longest stretch, from starts spread over the record."""
    length = max(b - a for a, b in record.stretches) // 2
    shots = spread_shots(record, length, SHOTS)
    runs, _ = record.run(record.axis(machine), shots)
    errors = np.array([run - record.position[a:b] for run, (a, b) in zip(runs, shots, strict=True)])
    beyond = ~(np.sqrt(np.mean(errors**2, axis=0)) <= tolerance)
    reached = bool(beyond.any())
    samples = int(np.argmax(beyond)) if reached else length
    return MotionHorizon(samples / record.log.rate, reached, tolerance, len(shots))
