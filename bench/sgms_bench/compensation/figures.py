"""Figures of friction compensation: error around a reversal, the circle's contour, settling, parameters followed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sgms_bench.compensation.tracking import (
    EKF,
    METHODS,
    MHE,
    NONE,
    STATIC,
    TRUE,
    AxisRun,
    Scenario,
    TrackingComparison,
    contour_error,
    rests,
    reversals,
)
from sgms_bench.experiment.figures import open_axes
from sgms_mhe.evaluation.plots import save_figure

Array = NDArray[np.float64]

# Dark enough on white, apart for the colour-blind and in print: colour, line width, style.
STYLES: Final[dict[str, tuple[str, float, str]]] = {
    NONE: ("0.55", 1.6, "-"),
    STATIC: ("#b8860b", 1.2, "--"),
    EKF: ("#d95f02", 1.8, "-"),
    MHE: ("#0b5394", 1.0, "-"),
    TRUE: ("black", 0.9, ":"),
}
BEFORE_S, AFTER_S = 0.03, 0.12
SETTLING_S = 0.08
FORMATS = ("png", "svg")


def write_figures(comparison: TrackingComparison, out_dir: Path) -> tuple[Path, ...]:
    """Draw what the comparison's scenarios allow, and write each figure as PNG and SVG; returns the files."""
    drawn = {"reversal": reversal_figure(comparison), "parameters": parameter_figure(comparison)}
    if "circle" in comparison.scenarios:
        drawn["circle"] = circle_figure(comparison)
    if "step_and_settle" in comparison.scenarios:
        drawn["settling"] = settling_figure(comparison)
    written = []
    for name, figure in drawn.items():
        for suffix in FORMATS:
            written.append(out_dir / f"{name}.{suffix}")
            save_figure(written[-1], figure)
    return tuple(written)


def reversal_figure(comparison: TrackingComparison) -> Figure:
    """Tracking error, and friction against what is fed forward, around the reversal after the middle of each run."""
    names = list(comparison.scenarios)
    figure = Figure(figsize=(0.8 + 3.3 * len(names), 5.4), layout="constrained")
    axes = figure.subplots(2, len(names), squeeze=False, sharex="col")
    for name, (errors, forces) in zip(names, axes.T, strict=True):
        runs = {method: comparison.runs[name, method][0] for method in METHODS}
        part, time = _around_middle_reversal(runs[NONE])
        forces.plot(time, runs[MHE].friction_N[part], color="0.8", linewidth=5.0, label="plant's friction")
        for method in METHODS:
            _draw(errors, method, time, 1e9 * runs[method].error_m[part])
            if method in (STATIC, EKF, MHE):
                _draw(forces, method, time, runs[method].compensation_N[part])
        errors.set_title(name.replace("_", " "), loc="left")
        forces.set_xlabel("time after the reversal [ms]")
        forces.set_xlim(time[0], time[-1])
    axes[0, 0].set_ylabel(f"true - reference position [n{comparison.units.position}]")
    axes[1, 0].set_ylabel(f"{comparison.units.push} [{comparison.units.force}]")
    _legend(figure, [*axes[0, 0].get_legend_handles_labels()], axes[1, 0])
    open_axes(*axes.ravel())
    return figure


def circle_figure(comparison: TrackingComparison) -> Figure:
    """Contour error of the last lap over the angle, magnified: a ring without error is round."""
    shown = {method: _last_lap(*comparison.runs["circle", method]) for method in METHODS}
    largest = 1e9 * max(float(np.abs(error).max()) for _, error in shown.values())
    step = _round(0.8 * largest)
    zero, nano = 3.0 * step, f"n{comparison.units.position}"
    figure = Figure(figsize=(8.6, 4.9), layout="constrained")
    left, right = figure.subplots(1, 2, subplot_kw={"projection": "polar"})
    for axis, methods in ((left, (NONE, STATIC, MHE)), (right, (EKF, MHE, TRUE))):
        near = 1e9 * max(float(np.abs(shown[method][1]).max()) for method in methods)
        tick, ring = (step, zero) if axis is left else (_round(0.8 * near), 3.0 * _round(0.8 * near))
        for method in methods:
            angle, error = shown[method]
            _draw(axis, method, angle, ring + 1e9 * error)
        axis.set_ylim(0.0, ring + 2.0 * tick)
        axis.set_yticks(
            [ring - tick, ring, ring + tick], [f"-{tick:g} {nano}", "0", f"+{tick:g} {nano}"], fontsize="x-small"
        )
        axis.set_rlabel_position(22.5)
        axis.set_xticks(np.arange(8) * np.pi / 4, [f"{45 * k}°" for k in range(8)], fontsize="x-small")
        axis.grid(color="0.85", linewidth=0.6)
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
    left.set_title("contour error", fontsize="medium")
    right.set_title("contour error, magnified", fontsize="medium")
    return figure


def settling_figure(comparison: TrackingComparison) -> Figure:
    """Size of the error after the end of a move: median over all moves, and the largest."""
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axis = figure.subplots()
    for method in METHODS:
        run = comparison.runs["step_and_settle", method][0]
        rate = run.trajectory.rate
        count = min(round(SETTLING_S * rate), *(end - first for first, end in rests(run.trajectory)))
        errors = 1e9 * np.abs([run.error_m[first : first + count] for first, _ in rests(run.trajectory)])
        time: Array = 1e3 * np.arange(count, dtype=np.float64) / rate
        _draw(axis, method, time, np.maximum(np.median(errors, axis=0), 0.1))
        axis.plot(time, np.maximum(errors.max(axis=0), 0.1), color=STYLES[method][0], linewidth=0.5)
    axis.set_yscale("log")
    axis.set_ylim(bottom=0.1)
    axis.set_xlim(0.0, time[-1])
    axis.set_xlabel("time after the end of the move [ms]")
    axis.set_ylabel(f"|true - reference position| [n{comparison.units.position}]")
    axis.set_title("median over the moves; thin: the largest", loc="left", fontsize="medium")
    axis.legend(loc="upper right", frameon=False)
    open_axes(axis)
    return figure


def parameter_figure(comparison: TrackingComparison) -> Figure:
    """Draw the estimates of the estimators in the loop, and the truth."""
    scenario = comparison.scenarios[list(comparison.scenarios)[-1]]
    runs = {method: comparison.runs[scenario.name, method][0] for method in (EKF, MHE)}
    estimates = {method: run.estimates for method, run in runs.items() if run.estimates is not None}
    names = next(iter(estimates.values())).parameter_names
    figure = Figure(figsize=(7.2, 0.8 + 1.15 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for k, (name, axis) in enumerate(zip(names, axes, strict=True)):
        nominal = comparison.nominal[name]
        for method, found in estimates.items():
            _draw(axis, method, found.time_s, found.parameters[:, k] / nominal)
        time = estimates[MHE].time_s
        axis.plot(time, _true_over_nominal(scenario, name, time), label="true", **_line(TRUE))
        axis.set_ylabel(f"{name.replace('_', ' ')}\n/ nominal", fontsize="small")
    axes[0].set_title(f"{scenario.name.replace('_', ' ')}, first axis", loc="left", fontsize="medium")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    open_axes(*axes)
    return figure


def _true_over_nominal(scenario: Scenario, name: str, time: Array) -> Array:
    trajectory, truth = scenario.axes[0]
    group = next((g for g in truth.scale if name == g or name.startswith(f"{g}_")), None)
    if group is None:
        return np.ones_like(time)
    return np.asarray(truth.scale[group] * (1.0 + truth.drift[group] * np.minimum(time / trajectory.duration_s, 1.0)))


def _around_middle_reversal(run: AxisRun) -> tuple[slice, Array]:
    """Samples around the first reversal in the second half, and their time after it [ms]."""
    turns, rate, n = reversals(run.trajectory), run.trajectory.rate, len(run.error_m)
    late = turns[turns >= n // 2]
    turn = int(late[0] if len(late) else turns[-1])
    part = slice(max(0, turn - round(BEFORE_S * rate)), min(n, turn + round(AFTER_S * rate)))
    return part, 1e3 * (np.arange(part.start, part.stop, dtype=np.float64) - turn) / rate


def _last_lap(x: AxisRun, y: AxisRun) -> tuple[Array, Array]:
    """Angle [rad] and contour error [m] of the last whole turn."""
    error = contour_error(x, y)
    px, py = x.trajectory.position_m, y.trajectory.position_m
    angle = np.unwrap(np.arctan2(py - 0.5 * (py.max() + py.min()), px - 0.5 * (px.max() + px.min())))
    lap = angle >= angle[-1] - 2.0 * np.pi
    return angle[lap], error[lap]


def _line(method: str) -> dict[str, Any]:
    colour, width, style = STYLES[method]
    return {"color": colour, "linewidth": width, "linestyle": style}


def _draw(axis: Any, method: str, x: Array, y: Array) -> None:
    axis.plot(x, y, label=method, **_line(method))


def _round(value: float) -> float:
    """A round number not above a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(k for k in (1.0, 2.0, 5.0) if k * power <= value))


def _legend(figure: Figure, entries: Sequence[Any], forces: Any) -> None:
    handles, labels = entries
    more, texts = forces.get_legend_handles_labels()
    known = dict(zip([*labels, *texts], [*handles, *more], strict=True))
    figure.legend(known.values(), known.keys(), loc="outside upper center", ncols=len(known), frameon=False)
