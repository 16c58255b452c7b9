"""A learned residual on a report's page: a sentence, and its curves."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from sgms_mhe.diagnosis.coordinates import Coordinate, Kind
from sgms_mhe.diagnosis.learned import Learned, LearnedTerm
from sgms_mhe.report.plots import Role
from sgms_mhe.report.series import numbers
from sgms_mhe.report.units import axis_units, reading
from sgms_mhe.support.arrays import Array

POINTS: Final = 120
"""Of a curve."""
LEVELS: Final = (0.1, 0.5, 0.9)
"""Of the second coordinate, over its range on the grid, that curves are drawn at."""
ROLES: Final[tuple[Role, ...]] = ("before", "measured", "after")
TITLES: Final[Mapping[Kind, str]] = {"travel": "memory of the last reversal"}


def learned_titles(learned: Learned) -> list[dict[str, str]]:
    """Return its plots' keys and titles."""
    titles = (" and ".join(TITLES.get(c.kind, c.kind) for c in term.coordinates) for term in learned.terms)
    return [{"key": f"learned_{k}", "title": f"Learned force over {title}"} for k, title in enumerate(titles, start=1)]


def learned_plots(learned: Learned) -> dict[str, Any]:
    """Return the data of its plots: each term over its first coordinate, at three values of its second."""
    return {f"learned_{k}": _plot(term) for k, term in enumerate(learned.terms, start=1)}


def _plot(term: LearnedTerm) -> dict[str, Any]:
    first, unit = term.coordinates[0], axis_units().force
    grid = np.linspace(first.low, first.high, POINTS)
    curves: list[tuple[Role, str, tuple[Array, ...]]] = [("after", "learned", ())]
    if len(term.coordinates) == 2:
        second = term.coordinates[1]
        levels = [second.low + level * (second.high - second.low) for level in LEVELS]
        curves = [
            (role, f"{TITLES.get(second.kind, second.kind)} {_value(second, level)}", (np.full(POINTS, level),))
            for role, level in zip(ROLES, levels, strict=True)
        ]
    x = numbers(first.warp.unwarp(grid))
    return {
        "series": [
            {"name": name, "x": x, "y": numbers(term.at(grid, *others)), "role": role, "width": 2.0}
            for role, name, others in curves
        ],
        "zero": True,
        "xLabel": f"{TITLES.get(first.kind, first.kind)} {_unit_label(first)}".strip(),
        "xUnit": _unit(first),
        "yLabel": f"force [{unit}]" if unit == "N" else f"torque [{unit}]",
        "unit": unit,
    }


def _unit(coordinate: Coordinate) -> str:
    units = axis_units()
    return {"place": units.position, "travel": ""}.get(coordinate.kind, units.velocity)


def _unit_label(coordinate: Coordinate) -> str:
    if coordinate.kind == "travel":
        return f"(over {reading(coordinate.warp.scale, axis_units().position)})"
    late = f"(by {reading(coordinate.warp.lag, 's')}) " if coordinate.warp.lag else ""
    return f"{late}[{_unit(coordinate)}]"


def _value(coordinate: Coordinate, warped: float) -> str:
    value = float(coordinate.warp.unwarp(np.asarray(warped)))
    return str(reading(value, _unit(coordinate))) if _unit(coordinate) else f"{value:.2g}"
