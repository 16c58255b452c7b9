"""Data of the page's plots. Series have roles; the page's style sheet gives each role a colour."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from sgms_mhe.diagnosis import Diagnosis, Traces
from sgms_mhe.identification.survey import Survey
from sgms_mhe.recordings.series import find_runs
from sgms_mhe.report.rivals import InPlace
from sgms_mhe.report.series import View, bin_view, numbers, pack
from sgms_mhe.report.units import axis_units
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array

Role = Literal["measured", "before", "after", "rival"]

MOST_SAMPLES: Final = 20_000
"""Of a log that nothing was fitted to."""


@dataclass(frozen=True)
class _Pair:
    """How the two residuals of a `View` are told apart on a plot: roles and labels."""

    first: tuple[Role, str]
    second: tuple[Role, str] | None


def plots(diagnosis: Diagnosis, views: Sequence[View], rivals: Sequence[InPlace]) -> dict[str, Any]:
    """Return the data of the page's plots, by their names."""
    t, unit = diagnosis.traces, axis_units().force
    extended = diagnosis.extended is not None
    common = _over_time(t)
    simulated = [line("simulated, machine file as it is", _mask(t, t.nominal_N), "before")]
    residuals = [line("residual, machine file as it is", _mask(t, t.residual_before), "before", 1.0)]
    if extended:
        after = _mask(t, t.held_out_fit_N)
        simulated.append(line("simulated, extended", after, "after", dash=[7, 4], width=1.6))
        residuals.append(line("residual, extended", _mask(t, t.residual_after), "after", 1.0))
    content: dict[str, Any] = {
        "friction": common
        | {
            "yLabel": axis_units().balance,
            "series": [line("measured", _mask(t, t.friction_N), "measured", 1.8), *simulated],
        },
        "residual": common | {"yLabel": f"residual [{unit}]", "zero": True, "series": residuals},
        "motion": common | _position(t.position_m),
    }
    pair = _Pair(("before", "machine file as it is"), ("after", "extended") if extended else None)
    content |= {f"view_{view.key}": _view(view, pair) for view in views if len(view.centres)}
    for rival in rivals:
        content |= _rival(rival, t, common)
    return content


def log_plots(log: Log) -> dict[str, Any]:
    """Force and position of a log that nothing was fitted to."""
    every = -(-len(log) // MOST_SAMPLES)
    units = axis_units()
    common = uniform(0.0, every / log.rate)
    force = {
        "yLabel": f"{units.push} [{units.force}]",
        "unit": units.force,
        "zero": True,
        "series": [line(units.push, log.force_N[::every], "measured")],
    }
    return {"log_force": common | force, "log_position": common | _position(log.position_m[::every])}


def survey_plots(found: Survey) -> dict[str, Any]:
    """Return the data of the plots of a first look: the force less inertia over time and over speed, and its fit."""
    rows, names = found.explored.final.view.rows, ("measured", "friction, damping, constant force")
    fitted = rows.friction - found.explored.final.fit.residual
    series = [np.where(rows.used, values, np.nan) for values in (rows.friction, fitted)]
    over_time = [line(names[0], series[0], "measured"), line("not explained", series[0] - series[1], "before")]
    label, seen = {"yLabel": axis_units().balance}, rows.used
    speed = bin_view("velocity", "velocity", axis_units().velocity, rows.velocity[seen], *(s[seen] for s in series))
    pair = _Pair(("measured", names[0]), ("after", names[1]))
    return {
        "over_time": uniform(float(rows.time[0]), 1.0 / rows.rate) | label | {"series": over_time},
        "over_speed": _view(speed, pair) | label,
    }


def _rival(rival: InPlace, t: Traces, common: Mapping[str, Any]) -> dict[str, Any]:
    """Residuals with the cause that is listed and with a rival in its place."""
    residual = {
        "yLabel": f"residual [{axis_units().force}]",
        "zero": True,
        "series": [
            # The one that leaves less hides less of the other.
            line(f"residual with {rival.words}", _mask(t, rival.fit.residual_N), "rival", 1.0),
            line(f"residual with {rival.cause_words}", _mask(t, t.residual_after), "after", 1.0),
        ],
    }
    pair = _Pair(("after", rival.cause_words), ("rival", rival.words))
    drawn = {rival.plot(view.key): _view(view, pair) for view in rival.views if len(view.centres)}
    return {rival.plot("residual"): {**common, **residual}, **drawn}


def _over_time(t: Traces) -> dict[str, Any]:
    step = 1.0 / t.rate
    return uniform(float(t.time_s[0]) if len(t.time_s) else 0.0, step) | {
        "shaded": [(float(t.time_s[a]), float(t.time_s[b - 1]) + step) for a, b in find_runs(t.held_out)]
    }


def uniform(start: float, step: float) -> dict[str, Any]:
    """Return the common part of plots over a uniform time: from `start`, a value every `step` [s]."""
    return {
        "uniform": True,
        "start": start,
        "step": step,
        "group": "time",
        "xLabel": "time [s]",
        "xUnit": "s",
        "unit": axis_units().force,
    }


def _position(position: Array) -> dict[str, Any]:
    length = axis_units().position
    factor, unit = (1e3, f"m{length}") if np.nanmax(position) - np.nanmin(position) > 1e-3 else (1e6, f"µ{length}")
    series = [line("position", position * factor, "measured")]
    return {"yLabel": f"position [{unit}]", "unit": unit, "series": series}


def _mask(t: Traces, values: Array) -> Array:
    return np.where(t.used, values, np.nan)


def line(name: str, values: Array, role: Role, width: float = 1.3, dash: Sequence[int] | None = None) -> dict[str, Any]:
    """A curve."""
    return {"name": name, "packed": pack(values), "role": role, "width": width} | ({"dash": dash} if dash else {})


def _view(view: View, pair: _Pair) -> dict[str, Any]:
    spectrum, unit = view.key == "frequency", axis_units().force
    shown = [(*pair.first, view.before, view.mean_before)]
    if pair.second is not None:
        shown.append((*pair.second, view.after, view.mean_after))
    x = pack(view.x)
    clouds = [
        {"name": label, "cloud": True, "packedX": x, "packed": pack(cloud), "role": role, "alpha": 0.13}
        for role, label, cloud, _ in shown
        if len(cloud)
    ]
    width = {"width": 1.3} if spectrum else {"width": 2.2, "cased": True}
    centres = numbers(view.centres)
    means = [{"name": label, "x": centres, "y": numbers(mean), "role": role, **width} for role, label, _, mean in shown]
    return {
        "series": [*clouds, *means],
        "xLog": view.logarithmic,
        "yLog": spectrum,
        "zero": not spectrum,
        "xLabel": f"{view.title} [{view.unit}]",
        "xUnit": view.unit,
        "yLabel": f"amplitude [{unit}]" if spectrum else f"residual [{unit}]",
        "unit": unit,
    }
