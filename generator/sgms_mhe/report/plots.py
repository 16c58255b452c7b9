"""What the page's plots draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sgms_mhe.diagnosis import Diagnosis
from sgms_mhe.report.series import View, numbers, pack, runs
from sgms_mhe.report.units import axis_units

MEASURED, BEFORE, AFTER = "#374151", "#c2540a", "#0b6aa8"


def plots(diagnosis: Diagnosis, views: Sequence[View]) -> dict[str, Any]:
    """What the page's plots draw, by their names."""
    t = diagnosis.traces
    extended = diagnosis.extended is not None
    step, unit, length = 1.0 / t.rate, axis_units().force, axis_units().position

    def masked(values: Any) -> Any:
        return np.where(t.used, values, np.nan)

    common = {
        "uniform": True,
        "start": float(t.time_s[0]) if len(t.time_s) else 0.0,
        "step": step,
        "group": "time",
        "xLabel": "time [s]",
        "xUnit": "s",
        "unit": unit,
        "shaded": [(float(t.time_s[a]), float(t.time_s[b - 1]) + step) for a, b in runs(t.held_out)],
    }
    simulated = [_line("simulated, machine file as it is", pack(masked(t.nominal_N)), BEFORE)]
    residuals = [_line("residual, machine file as it is", pack(masked(t.residual_before)), BEFORE, 1.0)]
    if extended:
        simulated.append(_line("simulated, extended", pack(masked(t.held_out_fit_N)), AFTER, dash=[7, 4], width=1.6))
        residuals.append(_line("residual, extended", pack(masked(t.residual_after)), AFTER, 1.0))
    content: dict[str, Any] = {
        "friction": common
        | {
            "yLabel": f"friction [{unit}]",
            "series": [_line("measured", pack(masked(t.friction_N)), MEASURED, 1.8), *simulated],
        },
        "residual": common | {"yLabel": f"residual [{unit}]", "zero": True, "series": residuals},
    }
    factor, small = (1e3, f"m{length}") if np.ptp(t.position_m) > 1e-3 else (1e6, f"µ{length}")
    content["motion"] = common | {
        "yLabel": f"position [{small}]",
        "unit": small,
        "series": [_line("position", pack(t.position_m * factor), MEASURED)],
    }
    for view in views:
        if len(view.centres):
            content[f"view_{view.key}"] = _view(view, extended)
    return content


def _line(
    name: str, packed: Mapping[str, Any], colour: str, width: float = 1.3, dash: Sequence[int] | None = None
) -> dict[str, Any]:
    return {"name": name, "packed": packed, "colour": colour, "width": width} | ({"dash": dash} if dash else {})


def _view(view: View, extended: bool) -> dict[str, Any]:
    series: list[dict[str, Any]] = []
    pairs = [("before", BEFORE, view.before, view.mean_before)]
    if extended:
        pairs.append(("after", AFTER, view.after, view.mean_after))
    for name, colour, cloud, _ in pairs:
        if len(cloud):
            series.append(
                {
                    "name": name,
                    "cloud": True,
                    "packedX": pack(view.x),
                    "packed": pack(cloud),
                    "colour": colour,
                    "alpha": 0.13,
                }
            )
    labels = {"before": "machine file as it is", "after": "extended"}
    for name, colour, _, means in pairs:
        series.append(
            {"name": name, "label": labels[name], "x": numbers(view.centres), "y": numbers(means), "colour": colour}
            | ({"width": 2.2, "cased": True} if view.key != "frequency" else {"width": 1.3})
        )
    spectrum, unit = view.key == "frequency", axis_units().force
    return {
        "series": series,
        "xLog": view.logarithmic,
        "yLog": spectrum,
        "zero": not spectrum,
        "xLabel": f"{view.title} [{view.unit}]",
        "xUnit": view.unit,
        "yLabel": f"amplitude [{unit}]" if spectrum else f"residual [{unit}]",
        "unit": unit,
    }
