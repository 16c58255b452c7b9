"""The figures of a report as pictures, for documents and slides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from sgms_mhe.diagnosis import Diagnosis
from sgms_mhe.evaluation.plots import WIDTH_IN, blank_figure
from sgms_mhe.recordings.series import find_runs
from sgms_mhe.report.estimator import EstimatorGain
from sgms_mhe.report.ranking import NAMED, ranked_scores
from sgms_mhe.report.series import View
from sgms_mhe.report.units import axis_units

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED, BEFORE, AFTER = "#374151", "#c2540a", "#0b6aa8"
HELD_OUT: Final = "#efeee2"


def measured_figure(diagnosis: Diagnosis) -> Figure:
    """Friction measured and simulated over time, and the residual before and after."""
    t = diagnosis.traces
    figure = blank_figure(5.6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))

    def shown(values: Any) -> Any:
        return np.where(t.used, values, np.nan)

    top.plot(t.time_s, shown(t.friction_N), color=MEASURED, linewidth=1.4, label="measured")
    top.plot(t.time_s, shown(t.nominal_N), color=BEFORE, linewidth=0.8, label="simulated, machine file as it is")
    bottom.plot(t.time_s, shown(t.residual_before), color=BEFORE, linewidth=0.6)
    if diagnosis.extended is not None:
        top.plot(
            t.time_s, shown(t.held_out_fit_N), color=AFTER, linewidth=0.9, linestyle="--", label="simulated, extended"
        )
        bottom.plot(t.time_s, shown(t.residual_after), color=AFTER, linewidth=0.6)
    kept = [(t.time_s[a], t.time_s[b - 1] - t.time_s[a]) for a, b in find_runs(t.held_out)]
    for axis in (top, bottom):
        axis.margins(x=0)
        axis.broken_barh(kept, (0.0, 1.0), transform=axis.get_xaxis_transform(), color=HELD_OUT, linewidth=0, zorder=0)
    top.set_ylabel(axis_units().balance)
    bottom.set_ylabel(f"measured -\nsimulated [{axis_units().force}]")
    bottom.set_xlabel("time [s]; shaded: kept from the fit")
    top.set_title(diagnosis.machine.name, loc="left")
    top.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2, fontsize="small"
    )
    return figure


def residual_figure(diagnosis: Diagnosis, views: Sequence[View]) -> Figure:
    """The residual over every coordinate, before and after."""
    figure = blank_figure(7.6)
    for axis, view in zip(figure.subplots(3, 2).flat, views, strict=True):
        pairs = [("machine file as it is", BEFORE, view.before, view.mean_before)]
        if diagnosis.extended is not None:
            pairs.append(("extended", AFTER, view.after, view.mean_after))
        for label, colour, cloud, mean in pairs:
            if len(view.x):
                axis.plot(view.x, cloud, ".", color=colour, markersize=1.2, alpha=0.25, rasterized=True)
            axis.plot(view.centres, mean, color=colour, linewidth=1.6 if len(view.x) else 0.8, label=label)
        if view.logarithmic and len(view.centres):
            axis.set_xscale("log")
        if view.key == "frequency" and any((m > 0).any() for _, _, _, m in pairs):
            axis.set_yscale("log")
        axis.set_xlabel(f"{view.title} [{view.unit}]")
        said = "amplitude" if view.key == "frequency" else "residual"
        axis.set_ylabel(f"{said} [{axis_units().force}]")
        axis.grid(color="0.92")
        axis.set_axisbelow(True)
    axis.legend(frameon=False, fontsize="small")
    return figure


def candidates_figure(diagnosis: Diagnosis) -> Figure:
    """How much force every candidate would explain."""
    scores = ranked_scores(diagnosis.scores)[::-1]
    figure = blank_figure(1.0 + 0.24 * max(4, len(scores)))
    axis = figure.subplots()
    axis.barh(
        [s.name for s in scores],
        [np.nan_to_num(s.gain_N if np.isnan(s.refit_gain_N) else s.refit_gain_N) for s in scores],
        color=[AFTER if s.outcome == NAMED else "0.7" for s in scores],
    )
    axis.set_xlabel(f"{axis_units().push} explained on data kept from its fit, RMS [{axis_units().force}]; blue: named")
    axis.tick_params(axis="y", labelsize="small")
    axis.margins(y=0.01)
    return figure


def gain_figure(diagnosis: Diagnosis, estimator: EstimatorGain | None) -> Figure:
    """RMS before and after, of the simulation and of the estimator."""
    rms = diagnosis.rms
    names, before, after = ["simulation, data\nkept from the fit"], [rms.held_out_before], [rms.held_out_after]
    if estimator is not None:
        names.append("estimator's prediction,\nlog it has not seen")
        before.append(estimator.base.predicted_rms_N)
        after.append(estimator.extended.predicted_rms_N)
    figure = blank_figure(3.4, 0.6 * WIDTH_IN)
    axis = figure.subplots()
    at = np.arange(len(names))
    axis.bar(at - 0.19, before, 0.36, color=BEFORE, label="machine file as it is")
    if diagnosis.extended is not None:
        axis.bar(at + 0.19, after, 0.36, color=AFTER, label="extended")
    axis.axhline(diagnosis.noise_floor_N, color="0.3", linestyle="--", linewidth=1.0, label="noise of the measurement")
    axis.set_xticks(at, names)
    axis.set_xlim(-0.6, len(names) - 0.4)
    axis.set_ylabel(f"RMS [{axis_units().force}]")
    axis.legend(frameon=False, fontsize="small")
    return figure
