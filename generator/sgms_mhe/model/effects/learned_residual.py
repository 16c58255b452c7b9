"""A force a diagnosis learned and has no name for: a table over place, speed and travel since a reversal.

The speed may be one that follows late: friction that remembers a time and not a way.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.definition import Fault, Value
from sgms_mhe.model.effects.parameters import decided
from sgms_mhe.model.effects.search import Unsearched, Values
from sgms_mhe.model.effects.spline_table import DEGREE, GridPlace, spline_sum, spline_table
from sgms_mhe.model.effects.states import EffectState, share_effect_state
from sgms_mhe.support.arrays import Array

Over = Literal["place", "speed", "travel"]

MOST_COORDINATES: Final = 2
MOST_CELLS: Final = 64
LEAST_LENGTH: Final = 1e-9


@dataclass(frozen=True)
class TableCoordinate:
    """A coordinate of the table.

    Attributes:
        over: place [m]; speed [m/s] with its sign, as v / (|v| + scale); travel since a reversal as the state r of
            dr/ds = (sign v - r) / scale over the distance s, from -1 to 1.
        scale: speed or length of the warp; without meaning over place.
        low, high: ends of the grid, place or speed; without meaning over travel, whose grid goes from -1 to 1.
        cells: between them.
        lag: of a speed that follows late, dw/dt = (v - w) / lag [s]; 0: v itself.
    """

    over: Over
    scale: float
    low: float
    high: float
    cells: int
    lag: float = 0.0


_shape = partial(decided, role="shape")


def _cells(over: Over) -> EffectParameter:
    description = f"cells of the grid over {over}; 0: not a coordinate"
    return _shape(f"{over}_cells", 0.0, 1.0, description, lower=0.0, upper=MOST_CELLS, whole=True)


_ROWS: Final = "coefficients of the splines, row by row: place before speed before travel"
_FORCE: Final = EffectParameter("force_N", 0.0, 0.1, _ROWS, unit="coulomb", array=True)


def _grid(axis: SymbolicAxis, p: Expressions, nominal: Values) -> list[GridPlace]:
    """Where the axis is on the grid of each coordinate, as it is measured: so it was learned.

    Tables of one length, or one lag, have one state in common.
    """
    position, velocity = ca.vertsplit(axis.measured)[:2]
    places = []
    if cells := round(nominal["place_cells"]):
        places.append(GridPlace.of(position, p["place_low_m"], p["place_high_m"], cells))
    if cells := round(nominal["speed_cells"]):
        own = _follow_speed(axis, velocity, p, nominal) if nominal["speed_lag_s"] else velocity
        speeds = (own, p["speed_low_m_s"], p["speed_high_m_s"])
        value, low, high = (v / (ca.fabs(v) + p["speed_scale_m_s"]) for v in speeds)
        places.append(GridPlace.of(value, low, high, cells))
    if cells := round(nominal["travel_cells"]):
        per_metre = 1.0 / nominal["travel_length_m"]
        memory = EffectState("memory", rate_per_metre=per_metre, noise=1e-3, initial_state=1.0)
        state = share_effect_state(axis, memory, p["travel_length_m"])
        state.rate = (velocity - ca.fabs(velocity) * state.chi) / p["travel_length_m"]
        places.append(GridPlace.of(state.chi, ca.SX(-1.0), ca.SX(1.0), cells))
    return places


def _follow_speed(axis: SymbolicAxis, velocity: ca.SX, p: Expressions, nominal: Values) -> ca.SX:
    """Return the speed that follows the axis's late; its state has units of `scale`."""
    late = EffectState("speed", rate_per_second=1.0 / nominal["speed_lag_s"], initial_state=1.0)
    state = share_effect_state(axis, late, p["speed_lag_s"], p["speed_scale_m_s"])
    state.rate = (velocity / p["speed_scale_m_s"] - state.chi) / p["speed_lag_s"]
    return state.chi * p["speed_scale_m_s"]


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    """sum_ij force_ij B_i(a) B_j(b), a and b the places on the grids of the coordinates; B a cubic B-spline.

    From a table where these numbers are fixed, and spline by spline where an estimator or a fit moves them.
    """
    names = [_FORCE.entry(i) for i in range(1, sum(_FORCE.index(name) > 0 for name in p) + 1)]
    places = _grid(axis, p, nominal)
    sizes = [place.splines for place in places]
    if all(p[name].is_constant() for name in names):
        table = np.array([nominal[name] for name in names]).reshape(sizes)
        axis.add_force(spline_table(table, places))
    else:
        axis.add_force(spline_sum([p[name] for name in names], places))


def _find_fault(values: Mapping[str, Value]) -> Fault | None:
    """Ends of a grid the wrong way round, or another number of coefficients than the grid has splines."""
    numbers = {key: value for key, value in values.items() if isinstance(value, float)}
    used: list[Over] = [over for over in ("place", "speed", "travel") if numbers[f"{over}_cells"] > 0.0]
    if len(used) > MOST_COORDINATES:
        return Fault(f"{used[-1]}_cells", f"0: a table is over at most {MOST_COORDINATES} coordinates")
    for over, unit in (("place", "m"), ("speed", "m_s")):
        low, high = numbers[f"{over}_low_{unit}"], f"{over}_high_{unit}"
        if over in used and not numbers[high] > low:
            return Fault(high, f"a number above {low:g}, the grid's lower end")
    sizes = [round(numbers[f"{over}_cells"]) + DEGREE for over in used]
    forces = values[_FORCE.name]
    if not isinstance(forces, Sequence) or len(forces) != math.prod(sizes):
        grid = " times ".join(f"{size} over {over}" for over, size in zip(used, sizes, strict=True))
        why = f"{grid}, {DEGREE} more than cells" if used else "over no coordinate"
        return Fault(_FORCE.name, f"{math.prod(sizes)} numbers: {why}")
    return None


def table_entry(coordinates: Sequence[TableCoordinate], coefficients: Array) -> dict[str, Value | str]:
    """Return the entry of [[effects]] of a table, in the names of a linear axis; forces of six digits.

    Args:
        coordinates: one or two, place before speed before travel.
        coefficients: of their splines (size) or (size, size) [N].
    """
    entry: dict[str, Value | str] = {"name": DEFINITION.name}
    for c in coordinates:
        entry[f"{c.over}_cells"] = c.cells
        if c.over == "place":
            entry |= {"place_low_m": c.low, "place_high_m": c.high}
        elif c.over == "speed":
            entry |= {"speed_scale_m_s": c.scale, "speed_low_m_s": c.low, "speed_high_m_s": c.high}
            entry |= {"speed_lag_s": c.lag} if c.lag else {}
        else:
            entry["travel_length_m"] = c.scale
    return {**entry, _FORCE.name: tuple(float(f"{force:.6g}") for force in coefficients.ravel().tolist())}


DEFINITION = EffectDefinition(
    name="learned_residual",
    summary="force without a name, learned over place, speed and travel since a reversal",
    parameters=(
        _cells("place"),
        _shape("place_low_m", 0.0, 0.1, "lower end of its grid"),
        _shape("place_high_m", 1.0, 0.1, "upper end"),
        _cells("speed"),
        _shape("speed_scale_m_s", 0.1, 0.1, "speed that lies half-way between rest and the fastest", lower=1e-9),
        _shape("speed_low_m_s", -1.0, 0.1, "lower end of its grid"),
        _shape("speed_high_m_s", 1.0, 0.1, "upper end"),
        _shape("speed_lag_s", 0.0, 0.1, "time by which a speed that follows late does; 0: it does not", lower=0.0),
        _cells("travel"),
        _shape("travel_length_m", 1e-3, 1e-3, "travel behind which 37 % of a reversal are left", lower=LEAST_LENGTH),
        _FORCE,
    ),
    contribute=_contribute,
    fault=_find_fault,
    search=Unsearched(),
    repeatable=True,
    excitation=Excitation(
        "the places, speeds and reversals that it is to hold for, several times each",
        (Need("travel_m", 0.0), Need("moving_s", 0.3)),
    ),
    confused_with={},
    moves=("travel", "speeds", "places"),
    states=("speed", "memory"),
)
