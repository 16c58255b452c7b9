"""Figures of estimates, drawn without a display and without global state.

matplotlib is imported when a figure is made: nothing that is computed or emitted needs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sgms_mhe.machine import OF_KIND
from sgms_mhe.model import FreeParameter
from sgms_mhe.model.effects import base_number
from sgms_mhe.recordings.series import find_runs
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.status import FLAGS, REFUSED, has_measurement, select_flags
from sgms_mhe.support.files import atomic_write
from sgms_mhe.support.libraries import optional_library
from sgms_mhe.support.numbers import SIGMAS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Dark enough on white, and apart for the colour-blind.
MEASURED, ESTIMATED, BAND, NOMINAL = "0.6", "#0b5394", "#9fc5e8", "#b45f06"
WIDTH_IN = 9.0


def friction_figure(estimates: Estimates, title: str) -> Figure:
    """Friction measured and estimated, their difference, and the status of every update."""
    figure, units = blank_figure(6.6), OF_KIND[estimates.kind]
    unit = units.force
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(4, 2, 1.6))
    counted = has_measurement(estimates.status)
    taken = np.where(counted, estimates.friction_measured_N, np.nan)
    axes[0].plot(estimates.time_s, taken, color=MEASURED, linewidth=1.6, label="measured")
    axes[0].plot(estimates.time_s, estimates.friction_N, color=ESTIMATED, linewidth=0.9, label="estimated")
    axes[0].set_ylabel(units.balance)
    _head(axes[0], title, columns=2)
    difference = taken - estimates.friction_N
    axes[1].plot(estimates.time_s, difference, color=ESTIMATED, linewidth=0.7)
    axes[1].axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
    axes[1].set_ylabel(f"measured -\nestimated [{unit}]")
    if np.isfinite(difference).any():
        rms = float(np.sqrt(np.nanmean(difference**2)))
        axes[1].text(0.99, 0.95, f"rms {rms:.3g} {unit}", transform=axes[1].transAxes, ha="right", va="top")
    _draw_status(axes[2], estimates)
    axes[2].set_xlabel("time [s]")
    return figure


def parameter_figure(estimates: Estimates, parameters: Sequence[FreeParameter], title: str) -> Figure:
    """Every estimated parameter with its band of two standard deviations and its nominal value."""
    figure = blank_figure(1.2 + 1.9 * len(parameters))
    axes = figure.subplots(len(parameters), 1, sharex=True, squeeze=False)[:, 0]
    units = OF_KIND[estimates.kind]
    for axis, parameter, value, std in zip(axes, parameters, estimates.parameters.T, estimates.std.T, strict=True):
        low, high = value - SIGMAS * std, value + SIGMAS * std
        axis.fill_between(estimates.time_s, low, high, color=BAND, linewidth=0, label="$\\pm 2\\sigma$")
        axis.plot(estimates.time_s, value, color=ESTIMATED, linewidth=1.2, label="estimate")
        axis.axhline(parameter.nominal, color=NOMINAL, linewidth=1.0, linestyle="--", label="nominal")
        # An effect's parameter has its unit in its name.
        number = base_number(parameter.name)
        unit = "" if number is None else f"\n[{units.unit(number.name + number.suffix) or 1}]"
        axis.set_ylabel(units.named(parameter.column).replace(".", "\n") + unit)
    _head(axes[0], title, columns=3)
    axes[-1].set_xlabel("time [s]")
    return figure


def save_figure(path: Path, figure: Figure) -> None:
    """Write a figure as PNG, or SVG where the path says so, atomically; the same figure gives the same bytes."""
    _drawing("matplotlib.backends.backend_agg").FigureCanvasAgg(figure)
    is_svg = path.suffix == ".svg"
    metadata = {"Date": None, "Creator": None} if is_svg else {"Software": None}
    with atomic_write(path) as stream, _drawing("matplotlib").rc_context({"svg.hashsalt": "sgms-mhe"}):
        figure.savefig(stream, format="svg" if is_svg else "png", dpi=150, metadata=metadata)


def blank_figure(height_in: float) -> Figure:
    """Return a figure without axes. Raises InputError where matplotlib is not installed."""
    figure: Figure = _drawing("matplotlib.figure").Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    return figure


def _drawing(module: str) -> Any:
    return optional_library(module, "plot", "a figure")


def _head(axis: Any, title: str, *, columns: int) -> None:
    """Title to the left, legend to the right of it, above the data and not on them."""
    axis.set_title(title, loc="left")
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, frameon=False, borderaxespad=0.2)


def _draw_status(axis: Any, estimates: Estimates) -> None:
    """One row per flag, a bar wherever it is set; every flag has its place, so that figures compare."""
    step = float(np.median(np.diff(estimates.time_s))) if len(estimates) > 1 else 1.0
    names = [*FLAGS, REFUSED]
    for row, (name, mask) in enumerate(select_flags(estimates.status).items()):
        spans = [(estimates.time_s[a] - step, (b - a) * step) for a, b in find_runs(mask)]
        axis.broken_barh(spans, (row - 0.4, 0.8), color="#cc0000" if name == REFUSED else "0.35")
    axis.set_yticks(range(len(names)), names, fontsize="x-small")
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_ylabel("status")
    axis.grid(axis="y", color="0.92")
    axis.set_axisbelow(True)
