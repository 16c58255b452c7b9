"""Friction compensation in closed loop: with nothing, static feed-forward, EKF and MHE, on a plant that is off.

The plant is the simulated axis under the switching Maxwell-slip law. Its friction is not the machine file's: level,
stiffness and damping start 30 % off and drift by 25 % of their value during the run. The emitted C runs in the loop,
sample by sample; what it returns adds to the position controller's force. The circle's second axis is off the other way
round and has an instance of its own.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.compensation.figures import write_figures
from sgms_bench.compensation.loop import LoopCompensation, LoopedEstimator
from sgms_bench.compensation.tracking import (
    EKF,
    METHODS,
    MHE,
    NONE,
    STATIC,
    TRUE,
    AxisRun,
    Measures,
    Scenario,
    TrackingComparison,
    TrackingTruth,
    measure,
    measure_contour,
)
from sgms_mhe.configuration import override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig, Controller
from sgms_mhe.plant.simulation import linear_drift, simulate_axis
from sgms_mhe.plant.trajectories import Trajectory, circle, make_trajectory
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import write_text
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
Effects = Sequence[tuple[str, Mapping[str, float]]]

DURATION_S: Final = 12.0
OFF: Final = 0.3
DRIFT: Final = 0.25
CURRENT_LOOP_Hz: Final = 1000.0
SCENARIOS: Final = ("paper", "step_and_settle", "circle")
STATIC_SMOOTHING: Final = 10.0
"""Of static feed-forward's sign, over v_s: of 0, 1, 3 and 10 the one that serves it best."""


def truth_of(machine: Machine, off: float = OFF, drift: float = DRIFT) -> TrackingTruth:
    """Levels and damping too high and rising, stiffness too low and falling."""
    signs = {"coulomb": 1.0, "viscous": 1.0, "stiffness": -1.0}
    if machine.friction.viscous == 0.0:
        del signs["viscous"]
    return TrackingTruth({k: 1.0 + s * off for k, s in signs.items()}, {k: s * drift for k, s in signs.items()})


def make_scenario(machine: Machine, name: str, duration_s: float, truth: TrackingTruth) -> Scenario:
    """A scenario of whole periods that together last at least `duration_s`.

    Raises:
        InputError: no scenario of that name.
    """
    rate, max_velocity = machine.sampling.rate, machine.sampling.max_velocity
    if name not in SCENARIOS:
        raise InputError("compensate", "trajectory", name, f"one of {', '.join(SCENARIOS)}")
    if name == "circle":
        velocity = min(0.02, 0.5 * max_velocity)
        lap = 2.0 * math.pi * 5e-3 / velocity
        x, y = circle(rate, velocity=velocity, laps=max(1, math.ceil(duration_s / lap)))
        return Scenario(name, ((x, truth), (y, truth.mirror())))
    period = make_trajectory(name, rate, max_velocity=max_velocity)
    whole = math.ceil(duration_s / period.duration_s - 1e-9) * period.duration_s
    return Scenario(name, ((period.repeat(whole), truth),))


def actuation_delay(machine: Machine) -> float:
    """Mean time from a sample until the force that answers it acts in the simulated loop [s]: hold, current loop."""
    return 0.5 * machine.sampling.step + 1.0 / (2.0 * math.pi * CURRENT_LOOP_Hz)


def axis_config(machine: Machine, seed: int) -> AxisConfig:
    """The simulated axis: switching law, encoder of 1 nm, current loop, PID with inertia feed-forward in time."""
    bandwidth = min(80.0, machine.sampling.rate / 40.0)
    controller = Controller.pid(machine.plant.moved, bandwidth, feedforward_lead_s=actuation_delay(machine))
    return AxisConfig(law="maxwell_slip", controller=controller, current_loop_Hz=CURRENT_LOOP_Hz, seed=seed)


def run_axis(
    machine: Machine,
    estimator: LoopedEstimator,
    trajectory: Trajectory,
    truth: TrackingTruth,
    method: str,
    *,
    config: AxisConfig,
    set_point: bool = True,
    hidden: Effects = (),
) -> AxisRun:
    """Follow a trajectory with one compensation.

    Args:
        machine: the file that the estimator knows.
        estimator: in the loop.
        trajectory: to follow.
        truth: how the axis differs from the file.
        method: compensation.
        config: of the simulated axis.
        set_point: whether the drive tells the estimator where it is going.
        hidden: effects that the axis has and the file has not.
    """
    n = len(trajectory.position_m)
    drift = {name: linear_drift(relative, trajectory.duration_s) for name, relative in truth.drift.items()}
    plant: dict[str, Any] = {"scale": truth.scale, "drift": drift, "hidden_effects": hidden}
    velocity, acceleration = set_point_ahead(trajectory, machine.compensation.delay)
    loop: LoopCompensation | None = None
    if method in (EKF, MHE):
        told = {"velocity": velocity, "acceleration": acceleration} if set_point else {}
        loop = LoopCompensation(estimator, n, **told)
    elif method == STATIC:
        friction = machine.friction
        smooth = np.tanh(velocity / (STATIC_SMOOTHING * friction.stribeck_velocity))
        loop = LoopCompensation(estimator, n, force=friction.coulomb * smooth + friction.viscous * velocity)
    elif method == TRUE:
        loop = LoopCompensation(estimator, n, force=_true_friction(machine, trajectory, plant))
    run = simulate_axis(machine, trajectory, config, compensation=loop.native if loop else None, **plant)
    if run.truth is None:
        raise ValueError("the run was simulated without truth")
    return AxisRun(
        trajectory,
        run.truth.position_m - trajectory.position_m,
        np.zeros(n) if loop is None else loop.force_N,
        run.truth.friction_N + run.truth.effect_force_N,
        loop.estimates(run.log) if loop is not None and method in (EKF, MHE) else None,
    )


def set_point_ahead(trajectory: Trajectory, delay_s: float) -> tuple[Array, Array]:
    """Mean velocity of the reference from each sample over the delay (n) [m/s], its acceleration at the end (n)."""
    delay = max(delay_s, 1.0 / trajectory.rate)
    time, position = trajectory.time_s, trajectory.position_m
    velocity = (np.interp(time + delay, time, position) - position) / delay
    return velocity, np.interp(time + delay_s, time, trajectory.acceleration_m_s2)


def _true_friction(machine: Machine, trajectory: Trajectory, plant: Mapping[str, Any]) -> Array:
    """The plant's friction along the reference at the instants when the force that answers each sample acts (n) [N]."""
    config = AxisConfig("maxwell_slip", "prescribed", encoder_resolution_m=0.0, force_noise_N=0.0)
    truth = simulate_axis(machine, trajectory, config, **plant).truth
    if truth is None:
        raise ValueError("the run was simulated without truth")
    total = truth.friction_N + truth.effect_force_N
    return np.interp(truth.time_s + actuation_delay(machine), truth.time_s, total)


# --- the comparison -----------------------------------------------------------------------------------------------


def compare_compensations(
    machine: Machine,
    names: Sequence[str] = SCENARIOS,
    *,
    duration_s: float = DURATION_S,
    window_m: float = 50e-9,
    seed: int = 0,
    set_point: bool = True,
    hidden: Effects = (),
    out_dir: Path | None = None,
    progress: Progress | None = None,
) -> TrackingComparison:
    """Run every scenario with every compensation.

    Args:
        machine: its nominal friction is what static feed-forward and the estimators start from.
        names: scenarios.
        duration_s: least length of a run; parameters drift over all of it.
        window_m: within which the axis counts as settled.
        seed: of the plant's noise; each axis has its own.
        set_point: whether the drive tells the estimator its set-point ahead.
        hidden: effects that the axis has and the machine file has not.
        out_dir: folder that receives figures, compensation.txt and compensation.json.
        progress: called with (runs done, runs in all).
    """
    truth = truth_of(machine)
    scenarios = {name: make_scenario(machine, name, duration_s, truth) for name in dict.fromkeys(names)}
    machines = {kind: override_machine(machine, {"estimator": {"kind": kind.lower()}}) for kind in (EKF, MHE)}
    estimators = {kind: LoopedEstimator(settings) for kind, settings in machines.items()}
    runs: dict[tuple[str, str], tuple[AxisRun, ...]] = {}
    done, total = 0, len(METHODS) * sum(len(scenario.axes) for scenario in scenarios.values())
    for scenario in scenarios.values():
        for method in METHODS:
            axes = []
            for index, (trajectory, true) in enumerate(scenario.axes):
                estimator = estimators.get(method, estimators[EKF])
                config = axis_config(machine, seed + index)
                told: dict[str, Any] = {"config": config, "set_point": set_point, "hidden": hidden}
                axes.append(run_axis(machine, estimator, trajectory, true, method, **told))
                done += 1
                if progress is not None:
                    progress(done, total)
            runs[scenario.name, method] = tuple(axes)
    measures: dict[tuple[str, str], Measures] = {}
    for (name, method), axes_run in runs.items():
        if len(axes_run) == 1:
            measures[name, method] = measure(axes_run[0], window_m)
            continue
        for letter, run in zip("xy", axes_run, strict=True):
            measures[f"{name}, {letter}", method] = measure(run, window_m)
        measures[f"{name}, contour", method] = measure_contour(*axes_run)
    nominal = {p.column: p.nominal for p in estimators[MHE].model.parameters}
    table = _table(machine, measures, truth, window_m, set_point)
    comparison = TrackingComparison(table, runs, measures, scenarios, nominal, machine.plant.units)
    return comparison if out_dir is None else _written(comparison, out_dir)


ERRORS: Final = ("RMS", "peak", "worst")
"""Columns of errors."""


def _table(
    machine: Machine,
    measures: Mapping[tuple[str, str], Measures],
    truth: TrackingTruth,
    window_m: float,
    set_point: bool,
) -> CsvTable:
    nano = f"n{machine.plant.units.position}"
    formats = {"trajectory": "", "compensation": ""} | dict.fromkeys((f"{name} [{nano}]" for name in ERRORS), ".1f")
    formats |= {"of none": ".1%", "of static": ".1%", "settling [ms]": ".1f", "longest [ms]": ".1f"}
    rows: list[dict[str, Any]] = []
    for row in dict.fromkeys(name for name, _ in measures):
        for method in METHODS:
            found = measures[row, method]
            entry: dict[str, Any] = {"trajectory": row, "compensation": method, f"RMS [{nano}]": 1e9 * found.rms_m}
            if len(found.peaks_m):
                entry |= {f"peak [{nano}]": 1e9 * found.peak_m, f"worst [{nano}]": 1e9 * found.worst_m}
                entry["of none"] = found.peak_m / measures[row, NONE].peak_m
                entry["of static"] = found.peak_m / measures[row, STATIC].peak_m
            if len(found.settling_s):
                entry["settling [ms]"] = 1e3 * float(found.settling_s.mean())
                entry["longest [ms]"] = 1e3 * float(found.settling_s.max())
            rows.append(entry)
    true = ", ".join(f"{name} {scale:g}" for name, scale in truth.scale.items())
    change = ", ".join(f"{name} {relative:+.0%}" for name, relative in truth.drift.items())
    notes = (
        f"true over nominal at the start: {true}; change until the end: {change}; circle's y: the other way round",
        "peak: largest error after a reversal, mean over the reversals; worst: the largest of them",
        f"settling: from the end of a move until the error stays within {1e9 * window_m:g} {nano}, mean and longest",
        "true friction: the plant's own along the reference, ahead of the loop's delay: what no observer beats",
        f"loop: answers {1e6 * actuation_delay(machine):.0f} us after a sample, [compensation] delay "
        f"{1e6 * machine.compensation.delay:.0f} us; set-point ahead {'known' if set_point else 'not known'}",
    )
    return CsvTable(f"{machine.name}: friction compensation in closed loop", formats, rows, notes)


def _written(comparison: TrackingComparison, out_dir: Path) -> TrackingComparison:
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(out_dir, "output folder", None, f"a folder that can be made ({error.strerror})") from None
    written = write_figures(comparison, out_dir)
    write_text(out_dir / "compensation.txt", f"{comparison.table}\n")
    write_text(out_dir / "compensation.json", json.dumps(comparison.table.as_dict(), indent=2) + "\n")
    return replace(comparison, figures=written)
