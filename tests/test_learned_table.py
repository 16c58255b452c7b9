"""The table of a learned residual: against other splines, in machine files, in emitted C, and beyond its data."""

import math
import re
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis.coordinates import follow_late, memory_of_reversals
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import CAUSE_NAMES, EFFECT_NAMES, cause_names, effect_definition
from sgms_mhe.model.effects.checks import faults_of
from sgms_mhe.model.effects.learned_residual import TableCoordinate, table_entry
from sgms_mhe.model.effects.spline_table import GridPlace, spline_sum, spline_table
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]

PLACE = TableCoordinate("place", 1.0, 0.004, 0.011, 6)
SPEED = TableCoordinate("speed", 0.05, -0.1, 0.12, 5)
TRAVEL = TableCoordinate("travel", 0.002, -1.0, 1.0, 4)
LATE = TableCoordinate("speed", 0.02, -0.1, 0.12, 5, lag=0.03)
TERMS = [(PLACE,), (SPEED,), (TRAVEL,), (PLACE, SPEED), (SPEED, TRAVEL), (PLACE, TRAVEL), (LATE, TRAVEL)]


def coefficients_of(*coordinates: TableCoordinate) -> Array:
    """Coefficients up to 1 N, none of them zero but the first and the last, as where a record ends; of four digits."""
    table = np.random.default_rng(len(coordinates)).uniform(-1.0, 1.0, [c.cells + 3 for c in coordinates]).round(4)
    table.flat[0] = table.flat[-1] = 0.0
    return table


def evaluate_splines(coordinate: TableCoordinate, value: Array) -> Array:
    """Every spline (m, size) at values (m), by scipy; zero beyond."""
    low, high = coordinate.low, coordinate.high
    if coordinate.over == "speed":
        value, low, high = (x / (np.abs(x) + coordinate.scale) for x in (value, np.float64(low), np.float64(high)))
    knots = low + (high - low) / coordinate.cells * np.arange(-3, coordinate.cells + 4)
    elements = [BSpline.basis_element(knots[k : k + 5], extrapolate=False) for k in range(coordinate.cells + 3)]
    return np.nan_to_num(np.column_stack([element(value) for element in elements]))


def force_of(coordinates: tuple[TableCoordinate, ...], *values: Array) -> Array:
    first, table = evaluate_splines(coordinates[0], values[0]), coefficients_of(*coordinates)
    if len(coordinates) == 1:
        return np.asarray(first @ table)
    return np.asarray(np.einsum("mi,ij,mj->m", first, table, evaluate_splines(coordinates[1], values[1])))


# --- splines ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cells", [(1,), (7,), (3, 5)])
def test_the_table_is_the_sum_of_its_splines(cells: tuple[int, ...]) -> None:
    """By scipy's, on the grid, at its knots, and beyond them as far as numbers go; so are two derivatives."""
    values = [ca.SX.sym(f"x{i}") for i in range(len(cells))]
    places = [GridPlace.of(x, ca.SX(-0.4), ca.SX(0.7), n) for x, n in zip(values, cells, strict=True)]
    coordinates = tuple(TableCoordinate("place", 1.0, -0.4, 0.7, n) for n in cells)
    table = coefficients_of(*coordinates)
    x = ca.vertcat(*values)
    whole, parts = spline_table(table, places), spline_sum([ca.SX(c) for c in table.ravel().tolist()], places)
    f = ca.Function("f", [x], [whole, parts, ca.gradient(whole, x), ca.gradient(parts, x)])
    random = np.random.default_rng(1)
    reach = [-1e300, -1e17, -3.0, -0.4, 0.7, 3.0, 1e17, 1e300]
    points = [*random.uniform(-1.5, 2.0, (300, len(cells))), *random.choice(reach, (40, len(cells)))]
    for point in points:
        found, other, slope, other_slope = (np.asarray(value).ravel() for value in f(point))
        expected = force_of(coordinates, *(np.array([value]) for value in point))
        assert found == pytest.approx(expected, abs=1e-13) and other == pytest.approx(expected, abs=1e-13)
        assert slope == pytest.approx(other_slope, abs=1e-11)
    assert float(f(np.full(len(cells), 0.1))[0]) != 0.0


def test_the_definition_is_consistent_and_no_cause() -> None:
    definition = effect_definition("learned_residual")
    assert not list(faults_of(definition, CAUSE_NAMES)) and definition.learned
    assert "learned_residual" in EFFECT_NAMES and "learned_residual" not in CAUSE_NAMES
    assert "learned_residual" not in cause_names("linear")


# --- machine files ----------------------------------------------------------------------------------------------


def with_tables(*entries: dict[str, Any], base: str = "etel_xy", **changes: Any) -> Machine:
    machine = load_machine(base)
    effects = [machine.plant.units.keyed({"name": "learned_residual", **entry}) for entry in entries]
    return override_machine(machine, {"name": "tabled", "effects": effects, **changes})


GOOD: dict[str, Any] = {"place_cells": 2, "place_low_m": 0.0, "place_high_m": 0.1, "force_N": [0.1] * 5}


@pytest.mark.parametrize(
    ("changes", "key", "value", "allowed"),
    [
        ({"place_cells": 2.5}, "place_cells", "2.5", "a whole number from 0 to 64"),
        ({"place_cells": 65}, "place_cells", "65", "a whole number from 0 to 64"),
        ({"place_high_m": 0.0}, "place_high_m", "0.0", "a number above 0, the grid's lower end"),
        ({"speed_cells": 1, "speed_high_m_s": -2.0}, "speed_high_m_s", "-2.0", "a number above -1"),
        ({"speed_scale_m_s": 0.0}, "speed_scale_m_s", "0.0", "a number from 1e-09 on"),
        ({"travel_length_m": -1.0}, "travel_length_m", "-1.0", "a number from 1e-09 on"),
        ({"force_N": [0.1] * 4}, "force_N", "0.1", "5 numbers: 5 over place, 3 more than cells"),
        ({"travel_cells": 1}, "force_N", "0.1", "20 numbers: 5 over place times 4 over travel, 3 more than cells"),
        ({"place_cells": 0}, "force_N", "0.1", "1 numbers: over no coordinate"),
        ({"travel_cells": 1, "speed_cells": 1}, "travel_cells", "1", "0: a table is over at most 2 coordinates"),
        ({"force_N": [0.1] * 4 + [math.nan]}, "force_N", "nan", "number"),
        ({"force_N": [0.1] * 269}, "force_N", "0.1", "at most 268"),
    ],
)
def test_tables_that_do_not_fit_are_refused(changes: dict[str, Any], key: str, value: str, allowed: str) -> None:
    with pytest.raises(InputError) as error:
        with_tables(GOOD | changes)
    said = str(error.value)
    assert key in said and value in said and allowed in said, said


def test_a_rotary_axis_has_names_of_its_own() -> None:
    machine = with_tables(GOOD, base="etel_xy_rotary")
    entry = machine.as_dict()["effects"][0]
    assert entry["place_high_rad"] == 0.1 and entry["torque_Nm"] == [0.1] * 5
    with pytest.raises(InputError, match="torque_Nm"):
        with_tables(GOOD | {"force_N": [0.1]}, base="etel_xy_rotary")


# --- emitted C --------------------------------------------------------------------------------------------------


@cache
def motion() -> Signals:
    """A motion that leaves the grids over place and speed on both sides."""
    machine = load_machine("etel_xy")
    path = make_trajectory("mixed", machine.sampling.rate, duration_s=1.5, max_velocity=0.2)
    log = Log(path.time_s, path.position_m, np.zeros(len(path.time_s)), machine.sampling.rate)
    return signals_from_log(log, machine)


def along_motion(coordinate: TableCoordinate, signals: Signals, step: float) -> Array:
    if coordinate.over == "place":
        return signals.position
    if coordinate.over == "speed":
        return follow_late(signals.velocity, step, coordinate.lag) if coordinate.lag else signals.velocity
    return memory_of_reversals(signals.velocity * step, coordinate.scale)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize(
    "coordinates", TERMS, ids=lambda term: " and ".join("late speed" if c.lag else c.over for c in term)
)
def test_the_emitted_model_has_the_table(coordinates: tuple[TableCoordinate, ...], precision: str) -> None:
    """Its force on top of the same axis without it, as scipy says it; none beyond the data."""
    entry, signals = table_entry(coordinates, coefficients_of(*coordinates)), motion()
    code = {"code": {"precision": precision}}
    machine = with_tables(entry, **code)
    found = CompiledModel(machine).predict(signals)
    without = CompiledModel(override_machine(load_machine("etel_xy"), code)).predict(signals)
    step = machine.sampling.step
    expected = force_of(coordinates, *(along_motion(c, signals, step) for c in coordinates))
    assert np.ptp(expected) > 0.3
    rows = slice(5, None)
    assert np.abs(found - without - expected)[rows].max() < {"double": 1e-11, "single": 1e-4}[precision]
    outside = expected == 0.0
    if coordinates[0] is PLACE:
        assert outside[signals.position > 0.02].all() and (signals.position > 0.02).any()
        np.testing.assert_array_equal(found[outside][5:], without[outside][5:])


@pytest.mark.parametrize(("coordinates", "taps"), [((PLACE,), 4), ((PLACE, SPEED), 16)])
def test_the_work_does_not_hang_on_the_table(coordinates: tuple[TableCoordinate, ...], taps: int) -> None:
    """A table of four times the length takes as many operations; its memory is that of its numbers."""
    texts, tables = [], []
    for factor in (1, 4) if taps == 4 else (1,):
        grid = tuple(TableCoordinate(c.over, c.scale, c.low, c.high, factor * c.cells) for c in coordinates)
        package = emit_package(with_tables(table_entry(grid, coefficients_of(*grid))), selftest=False)
        text = package.files["tabled_model.h"]
        texts.append(text[text.index("/* Friction force") : text.index("/* What signals alone")])
        tables.append(int(re.findall(r"table_1\[(\d+)\]", package.files["tabled_table.h"])[0]))
    assert texts[0].count("sgms_entry(table_1") == taps
    operations = [re.findall(r"Operations: .*\.", text) for text in texts]
    assert operations[0] and all(found == operations[0] for found in operations)
    # Three zeros, the splines without the last one, whose coefficient is zero, and a zero behind them.
    rows = 3 + PLACE.cells + 2
    assert tables == ([rows + 1, rows + 3 * PLACE.cells + 1] if taps == 4 else [rows * (SPEED.cells + 10) + 3 + 7 + 1])
