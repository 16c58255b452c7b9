"""Figures of the paper's experiment: 3 (hysteresis), 6 (signals), 7 (friction), 8 (stiffness)."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sgms_bench.records import EstimatorOutcome, Record
from sgms_mhe.configuration import override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion

Array = NDArray[np.float64]

# Apart for the colour-blind, and in print without colour.
TRUE, MEASURED, MHE, EKF = "black", "0.72", "#0b5394", "#d95f02"
ELEMENTS = ("#0b5394", "#d95f02", "#1b7837", "#7b3294")

# The paper's figure 3; f_S = 3 N is f_C (1 + beta).
FIGURE_3 = {
    "stiffness": [10e6, 5e6, 2.5e6, 1.25e6],
    "fraction": [0.1, 0.2, 0.3, 0.4],
    "micro_viscous": [0.0, 0.0, 0.0, 0.0],
    "viscous": 0.0,
    "coulomb": 2.0,
    "stribeck_ratio": 0.5,
    "stribeck_velocity": 1e-6,
}
# Loops nested into each other; the last ones close them from the inside out.
REVERSALS_M = (1e-6, -1e-6, 0.6e-6, -0.5e-6, 0.3e-6, -0.2e-6, 1e-6, -1e-6, 0.0)


def figure_3_machine(machine: Machine) -> Machine:
    """The machine with the friction parameters of the paper's figure 3."""
    return override_machine(machine, {"friction": FIGURE_3})


def hysteresis_figure(machine: Machine) -> Figure:
    """Friction over displacement for loops nested into each other: the law remembers every open reversal."""
    machine = figure_3_machine(machine)
    # Constant speed between the reversals: a stop on the way would be a step up the Stribeck curve.
    velocity = 4e-6
    motion = Motion(machine.sampling.rate)
    for target in REVERSALS_M:
        motion.move_to(target, velocity, 100.0 * velocity, 2e4 * velocity)
    path = motion.trajectory("hysteresis")
    run = simulate_axis(machine, path, AxisConfig(control="prescribed", encoder_resolution_m=0.0, force_noise_N=0.0))
    if run.truth is None:
        raise ValueError("the run was simulated without truth")
    position, friction = 1e6 * run.truth.position_m, run.truth.friction_N
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
    left.plot(path.time_s, position, color=MHE, linewidth=1.2)
    left.set_xlabel("time [s]")
    left.set_ylabel(f"displacement [µ{machine.plant.units.position}]")
    right.plot(position, friction, color=MHE, linewidth=1.2)
    right.set_xlabel(f"displacement [µ{machine.plant.units.position}]")
    right.set_ylabel(f"friction [{machine.plant.units.force}]")
    open_axes(left, right)
    return figure


def signals_figure(record: Record) -> Figure:
    """The trajectory and the signals the estimator works on."""
    signals, units = record.signals, record.run.log.units
    figure = Figure(figsize=(7.2, 6.2), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    thin = slice(None, None, 10)
    time = signals.time[thin]
    valid = np.where(signals.valid, 1.0, np.nan)[thin]
    for axis, values, label in zip(
        axes,
        (
            1e3 * signals.position[thin],
            1e3 * signals.velocity[thin],
            signals.force[thin],
            signals.friction[thin] * valid,
        ),
        (
            f"position\n[m{units.position}]",
            f"velocity\n[m{units.velocity}]",
            f"drive {units.push}\n[{units.force}]",
            f"friction,\nmeasured [{units.force}]",
        ),
        strict=True,
    ):
        axis.plot(time, values, color=MHE, linewidth=0.8)
        axis.set_ylabel(label)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(time[0], time[-1])
    figure.align_ylabels(axes)
    open_axes(*axes)
    return figure


def friction_figure(record: Record, mhe: EstimatorOutcome, ekf: EstimatorOutcome) -> Figure:
    """Friction measured, true and estimated; two seconds of it closer; the errors."""
    figure = Figure(figsize=(7.2, 7.0), layout="constrained")
    whole, near, errors = figure.subplots(3, 1, height_ratios=(1.0, 1.25, 1.0))
    time = mhe.estimates.time_s
    measured = mhe.estimates.friction_measured_N
    lines = (
        (measured, "measured", MEASURED, 4.0, "-"),
        (record.friction, "true", TRUE, 2.4, "-"),
        (ekf.estimates.friction_N, "EKF", EKF, 1.6, "-"),
        (mhe.estimates.friction_N, "MHE", MHE, 1.2, "--"),
    )
    for axis in (whole, near):
        for values, label, colour, width, style in lines:
            axis.plot(time, values, color=colour, linewidth=width, linestyle=style, label=label)
        axis.set_ylabel(f"friction [{record.run.log.units.force}]")
    whole.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, borderaxespad=0.2)
    whole.set_xlim(time[0], time[-1])
    start, end = _busiest(time, record.friction, 2.0)
    near.set_xlim(start, end)
    inside = record.friction[(time >= start) & (time <= end)]
    margin = 0.08 * float(np.ptp(inside))
    near.set_ylim(float(inside.min()) - margin, float(inside.max()) + margin)
    whole.axvspan(start, end, color="0.93", zorder=0)
    for outcome, colour, width in ((ekf, EKF, 1.8), (mhe, MHE, 0.6)):
        error = outcome.estimates.friction_N - record.friction
        errors.plot(time, 1e3 * error, color=colour, linewidth=width)
    shown = np.concatenate([o.estimates.friction_N - record.friction for o in (mhe, ekf)])
    limit = 1e3 * float(np.quantile(np.abs(shown), 0.998)) * 1.3
    errors.set_ylim(-limit, limit)
    errors.set_xlim(time[0], time[-1])
    errors.set_ylabel("estimate - true\n[mN]")
    errors.set_xlabel("time [s]")
    figure.align_ylabels([whole, near, errors])
    open_axes(whole, near, errors)
    return figure


def stiffness_figure(record: Record, mhe: EstimatorOutcome, ekf: EstimatorOutcome, title: str) -> Figure:
    """Stiffness over its nominal value with +-2 sigma, MHE and EKF, and the truth."""
    count = len(record.theta)
    figure = Figure(figsize=(7.2, 1.2 + 1.55 * count), layout="constrained")
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    time = mhe.estimates.time_s
    for k, axis in enumerate(axes):
        theta, std = mhe.theta[:, k], mhe.std[:, k]
        axis.fill_between(
            time, theta - 2 * std, theta + 2 * std, color=MHE, alpha=0.18, linewidth=0, label=r"MHE $\pm 2\sigma$"
        )
        axis.plot(time, ekf.theta[:, k], color=EKF, linewidth=2.0, label="EKF")
        axis.plot(time, theta, color=MHE, linewidth=1.0, label="MHE")
        axis.axhline(record.theta[k], color=TRUE, linewidth=0.9, linestyle="--", label="true")
        shown = np.concatenate([theta, ekf.theta[:, k], record.theta[k : k + 1]])
        low, high = np.quantile(shown, (0.002, 0.998))
        margin = max(0.6 * (high - low), 2.2 * float(np.median(std)))
        axis.set_ylim(min(low, record.theta[k]) - margin, max(high, record.theta[k]) + margin)
        axis.set_ylabel(rf"$\kappa_{{{k + 1}}}\,/\,\kappa_{{{k + 1},\mathrm{{nom}}}}$")
    axes[0].set_title(title, loc="left", fontsize="medium")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, borderaxespad=0.2)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(time[0], time[-1])
    figure.align_ylabels(axes)
    open_axes(*axes)
    return figure


def _busiest(time: Array, friction: Array, width_s: float) -> tuple[float, float]:
    """The stretch of `width_s` in which friction changes most."""
    step = float(np.median(np.diff(time)))
    count = max(1, min(len(time) - 1, round(width_s / step)))
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(friction)))])
    first = int(np.argmax(travelled[count:] - travelled[:-count]))
    return float(time[first]), float(time[first + count])


def open_axes(*axes: Any) -> None:
    """Draw axes without their upper and right spines, on a faint grid."""
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="0.93", linewidth=0.6)
        axis.set_axisbelow(True)
