"""Reading logs: what is understood of a file, what is refused and with which sentence, uneven time, inspect."""

import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cli_cases import refused, run
from record_cases import simulate_log
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.logfiles.decimals import told_by, value_of
from sgms_mhe.logfiles.names import split_name
from sgms_mhe.logfiles.reading import LogContent, read_log, understand
from sgms_mhe.machine import Machine, normal_unit
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.errors import InputError

pytestmark = pytest.mark.core

Row = Callable[[int], Sequence[str]]
PLAIN = "t [s];x [m];F [N]"


@pytest.fixture(scope="module")
def machine(small: Path) -> Machine:
    return load_machine(small)


def written(
    folder: Path, header: str, row: Row, *, separator: str = ";", rows: int = 20, name: str = "log.csv", after: str = ""
) -> Path:
    path = folder / name
    lines = [header, *(separator.join(row(k)) for k in range(rows)), after]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def usual(k: int) -> tuple[str, str, str]:
    return f"{k * 1e-3:.3f}", f"{1.5 + 0.01 * k:.4f}", f"{2.5 - 0.1 * k:.2f}"


def reading(
    folder: Path, header: str, row: Row = usual, log: Mapping[str, Any] | None = None, **options: Any
) -> LogContent:
    machine = None if log is None else override_machine(load_machine("etel_xy"), {"log": dict(log)})
    return understand(written(folder, header, row, **options), machine)


def refusal(folder: Path, header: str, row: Row = usual, log: Mapping[str, Any] | None = None, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        reading(folder, header, row, log, **options)
    assert str(caught.value).startswith(str(folder))
    return str(caught.value)


# --- names and units --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "base", "unit"),
    [
        ("Position [mm]", "Position", "mm"),
        ("F (N)", "F", "N"),
        ("pos_mm", "pos", "mm"),
        ("act_pos_um", "act_pos", "um"),
        ("Velocity_actual_value_deg_s", "Velocity_actual_value", "deg/s"),
        ("motor_torque_N_m", "motor_torque", "N m"),
        ("x_in_mm", "x_in", "mm"),
        ("Axis/Speed/mm_s", "Axis/Speed", "mm/s"),
        ("_s", "_s", ""),
        ("t/ms", "t", "ms"),
        ("x / mm", "x", "mm"),
        ("Position, µm", "Position", "µm"),
        ("Position in mm", "Position", "mm"),
        ("v_mm_s", "v", "mm/s"),
        ("torque [Nm]", "torque", "Nm"),
        ("velocity", "velocity", ""),
        ("drive_force", "drive_force", ""),
        ("Position [furlong]", "Position", "furlong"),
        ("Speed/m/min", "Speed", "m/min"),
        ("Axis/Speed/mm", "Axis/Speed", "mm"),
    ],
)
def test_units_in_names_are_split_off(name: str, base: str, unit: str) -> None:
    assert split_name(name) == (base, unit)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("µm", "um"),  # the micro sign
        ("\u03bcm", "um"),  # the Greek letter
        ("[mm]", "mm"),
        ("Nm", "N m"),
        ("N·m", "N m"),
        ("mNm", "mN m"),
        ("mm/s²", "mm/s^2"),
        ("mm s^-2", "mm/s^2"),
        ("m/s", "m/s"),
        ("ms", "ms"),
        ("°", "deg"),
        ("1/min", "rpm"),
        ("inc", "counts"),
        ("°C", "degC"),
        ("furlong", "furlong"),
    ],
)
def test_units_are_spelled_one_way(text: str, unit: str) -> None:
    assert normal_unit(text) == unit


@pytest.mark.parametrize(
    ("log", "factor"),
    [
        ({"variable": "x", "unit": "mm"}, 1e-3),
        ({"variable": "x", "unit": "µm"}, 1e-6),
        ({"variable": "x", "unit": "nm"}, 1e-9),
        ({"variable": "x", "unit": "in"}, 0.0254),
        ({"variable": "x", "unit": "counts", "counts_per": 4000.0}, 1 / 4000.0),
        ({"variable": "x", "unit": "mm", "scale": 2.0}, 2e-3),
        ({"variable": "x", "scale": -1.0}, -1.0),
        ("x", 1.0),
    ],
)
def test_log_table_states_the_unit(log: Any, factor: float, tmp_path: Path) -> None:
    found = reading(tmp_path, "t [s];x;F [N]", log={"position_m": log}).columns["position_m"]
    np.testing.assert_allclose(found, factor * (1.5 + 0.01 * np.arange(20)), rtol=1e-12)


@pytest.mark.parametrize(
    ("header", "log", "factors"),
    [
        ("t [ms];angle [deg];torque [Nm]", {}, (1e-3, np.pi / 180, 1.0)),
        ("t [s];angle [rev];torque [mNm]", {}, (1.0, 2 * np.pi, 1e-3)),
        (
            "t [s];enc;i",
            {
                "position_rad": {"variable": "enc", "unit": "counts", "counts_per": 8192.0},
                "torque_Nm": {"variable": "i", "unit": "A", "scale": 0.25},
            },
            (1.0, 2 * np.pi / 8192, 0.25),
        ),
        ("time_s;position_rad;torque_Nm", {}, (1.0, 1.0, 1.0)),
    ],
)
def test_rotary_logs_are_read_in_radians_and_newton_metres(
    header: str, log: dict[str, Any], factors: tuple[float, ...], tmp_path: Path
) -> None:
    found = reading(tmp_path, header, log=log or None)
    assert found.kind == "rotary"
    raw = np.array([[float(field) for field in usual(k)] for k in range(20)]).T
    for name, column, factor in zip(("time_s", "position_rad", "torque_Nm"), raw, factors, strict=True):
        np.testing.assert_allclose(found.columns[name], factor * column, rtol=1e-12)


def test_a_rotary_log_is_no_log_of_a_linear_axis(tmp_path: Path, machine: Machine) -> None:
    path = written(tmp_path, "t [s];angle [deg];torque [Nm]", usual)
    with pytest.raises(InputError, match=r"rotary axis.*linear axis, as small is.*maps time_s, position_m, force_N"):
        read_log(path, machine)


def test_a_mapped_unit_stands_above_the_one_in_the_file(tmp_path: Path) -> None:
    found = reading(tmp_path, "t [s];x [mm];F [N]", log={"position_m": {"variable": "x", "unit": "um"}})
    assert found.columns["position_m"][0] == pytest.approx(1.5e-6)
    found = reading(tmp_path, "t [s];x [mm];F [N]", log={"position_m": "x"})
    assert found.columns["position_m"][0] == pytest.approx(1.5e-3)


def test_set_points_are_no_positions(tmp_path: Path) -> None:
    def row(k: int) -> tuple[str, ...]:
        return (*usual(k), "99")

    found = reading(tmp_path, "t [s];x [m];F [N];Position setpoint [m]", row)
    assert found.columns["position_m"][0] == 1.5


REFUSALS: list[tuple[str, str, Row, dict[str, Any] | None, str]] = [
    ("no unit", "time;pos;force", usual, None, r"time is there without a unit; \[log\].*says: time_s = \{"),
    ("odd unit", "t [s];x [furlong];F [N]", usual, None, "x .furlong. is there in furlong, which is none of m, "),
    ("two", "t [s];x [m];pos [mm]", usual, None, r"column position_m = 'x \[m\], pos \[mm\]': one column"),
    ("counts", "t [s];x [counts];F [N]", usual, None, 'unit = "counts", counts_per = ...'),
    ("current", "t [s];x [m];F [A]", usual, None, 'force_N = { variable = "F .A.", unit = "A", scale = ... }'),
    ("name and unit row", "time_s;position_m;force_N\ns;mm;N", usual, None, "position_m, unit = 'mm'.*which holds"),
    ("both kinds", "t [s];position_m;position_rad", usual, None, "position_m = .* or position_rad = .* unit = .rad. "),
    ("twice", "t [s];x [m];x [m];F [N]", lambda k: (*usual(k), "1"), {"position_m": "x [m]"}, r"x \[m\] \(1\) or"),
    ("absent", "t [s];x [m];F [N]", usual, {"force_N": "u"}, r"\(log.force_N\)"),
    ("no header", "", usual, None, "no header was found above its rows"),
    (
        "names and fields",
        "t [s];x [m];F [N]",
        lambda k: (*usual(k), "9"),
        None,
        "3 names.*4 names, as many as the rows",
    ),
    (
        "decimal commas between commas",
        "t [s],x [m],F [N]",
        lambda k: (f"0,{k:03d},1,5,2,5",),
        None,
        "3 names.*6 names.*separator, decimal or header_line",
    ),
    (
        "thousands or not",
        PLAIN,
        lambda k: (str(k), f"1,{100 + k}", f"2,{200 + k}"),
        None,
        r"line 2 = '1,100'.*decimal = \",\" or decimal = \"\.\"",
    ),
    (
        "groups by points or decimals",
        PLAIN,
        lambda k: (f"0,{k:03d}", "1,5", f"1.{200 + k}"),
        None,
        r"row 1 \(line 2\), column F \[N\] = '1\.200'.*decimal = \",\" or",
    ),
    ("other mark", PLAIN, lambda k: (usual(k)[0], "1,5", "2.5"), None, r"row 1 \(line 2\), column x \[m\] = '1,5'"),
    ("space in number", PLAIN, lambda k: (usual(k)[0], "12 34.5", "2.5"), None, "= '12 34.5': a number"),
    ("unit in field", PLAIN, lambda k: (usual(k)[0], "1.5 m", "2.5"), None, "= '1.5 m': a number"),
    ("header again", PLAIN, lambda k: usual(k) if k != 9 else ("t", "x", "F"), None, r"row 10 \(line 11\)"),
    ("coarse clock", PLAIN, lambda k: (f"10:00:{k // 10:02d}", "1", "2"), None, "time stamps coarser than the samples"),
    ("no date", PLAIN, lambda k: (f"2026-13-01 10:00:{k:02d}", "1", "2"), None, "a date of the calendar"),
    ("no time", PLAIN, lambda k: (f"2026-12-01 10:61:{k:02d}", "1", "2"), None, "a time of day up to 23:59:59"),
    (
        "day or month",
        PLAIN,
        lambda k: (f"03/0{4 + k // 10}/2026 10:00:{k:02d}", "1", "2"),
        None,
        'dates = "dmy" or dates = "mdy"',
    ),
    ("stamps and numbers", PLAIN, lambda k: (f"10:00:{k:02d}" if k < 9 else "9", "1", "2"), None, "row 10.*like the"),
    ("nothing but words", "hello", lambda k: ("this is", "no log"), None, "no row of numbers"),
    ("no such line", PLAIN, usual, {"header_line": 30}, "no row of numbers|a line above the rows"),
    ("no encoding", PLAIN, usual, {"encoding": "utf-9"}, "an encoding that Python knows"),
]


@pytest.mark.parametrize(("header", "row", "log", "message"), [c[1:] for c in REFUSALS], ids=[c[0] for c in REFUSALS])
def test_refusals_say_what_to_write(
    header: str, row: Row, log: dict[str, Any] | None, message: str, tmp_path: Path
) -> None:
    text = refusal(tmp_path, header, row, log)
    assert re.search(message, text), text


@pytest.mark.parametrize(("log", "change"), [({"decimal": ","}, lambda x: x / 1000.0), ({"decimal": "."}, lambda x: x)])
def test_a_stated_decimal_mark_ends_the_doubt(
    log: dict[str, Any], change: Callable[[float], float], tmp_path: Path
) -> None:
    found = reading(tmp_path, PLAIN, lambda k: (str(k), f"1,{100 + k}", f"2,{200 + k}"), log)
    np.testing.assert_allclose(found.columns["position_m"], [change(1100.0 + k) for k in range(20)])


@pytest.mark.parametrize(("order", "days"), [("dmy", 31), ("mdy", 1)])
def test_a_stated_order_of_dates_ends_the_doubt(order: str, days: int, tmp_path: Path) -> None:
    """From 04/05 to 04/06 it is a month or a day."""
    found = reading(tmp_path, PLAIN, lambda k: (f"04/0{5 + k}/2026 10:00:00", "1", "2"), {"dates": order}, rows=2)
    assert found.columns["time_s"][-1] == days * 86400.0


def test_header_line_and_separator_may_be_stated(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    lines = ["1;2;3", "4;5;6", "t [s];x [m];F [N]", "a;b;c", *(";".join(usual(k)) for k in range(9))]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError):
        understand(path)
    stated = override_machine(load_machine("etel_xy"), {"log": {"header_line": 3, "separator": ";"}})
    assert understand(path, stated).columns["position_m"][0] == 1.5


def test_rows_of_types_and_labels_are_passed_over(tmp_path: Path) -> None:
    header = "Name;Axis.ActPos;Axis.ActForce\nType;LREAL;LREAL\nUnit;mm;N"
    found = reading(tmp_path, header, log={"time_s": "Name"})
    assert found.columns["position_m"][0] == pytest.approx(1.5e-3)


@pytest.mark.parametrize("spelling", ["", "NaN", "nan", "NA", "n/a", "null", "-", "1.#QNAN"])
def test_missing_samples_may_be_spelled_so(spelling: str, tmp_path: Path) -> None:
    found = reading(tmp_path, PLAIN, lambda k: (usual(k)[0], spelling if k % 3 else "1.5", "2.5"))
    np.testing.assert_array_equal(np.isnan(found.columns["position_m"]), np.arange(20) % 3 != 0)


def test_what_stands_below_the_samples_is_said(tmp_path: Path) -> None:
    found = reading(tmp_path, PLAIN, after="Mean;1;2\nend of file\n;;\n")
    assert len(found.columns["time_s"]) == 20
    assert found.notes == ("2 lines after the last sample are left out, the first: Mean;1;2",)


def test_a_file_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    assert "row 21 (line 22) = '2 fields'" in refusal(tmp_path, PLAIN, after="0.020;1.")


@given(st.floats(allow_nan=False, width=64), st.sampled_from([".", ","]))
def test_numbers_are_read_to_the_last_digit(value: float, mark: Any) -> None:
    assert value_of(repr(value).replace(".", mark), mark) == value


@pytest.mark.parametrize(
    ("token", "mark"),
    [
        ("1,5", ","),
        ("0,123", ","),
        ("1234,567", ","),
        ("1.234,5", ","),
        ("1,234,567", "."),
        ("1,234.5", "."),
        ("1.5", "."),
        ("1,234", "either"),
        ("1.234", None),
        ("1234", None),
        ("1'234,567", ","),
        ("\N{MINUS SIGN}1\N{NARROW NO-BREAK SPACE}234.5", "."),
        ("1 234", None),
        ("words, and", None),
    ],
)
def test_what_a_number_tells_of_the_decimal_mark(token: str, mark: str | None) -> None:
    assert told_by(token) == mark


@pytest.mark.parametrize("group", [" ", "'", "\N{RIGHT SINGLE QUOTATION MARK}", "\N{NO-BREAK SPACE}"])
@pytest.mark.parametrize("mark", [".", ","])
def test_groups_by_spaces_and_apostrophes_are_one_number(group: str, mark: str, tmp_path: Path) -> None:
    def form(value: float) -> str:
        grouped = f"{value:,.3f}".replace(",", "g").replace(".", mark).replace("g", group)
        return grouped.replace("-", "\N{MINUS SIGN}") if value < 0.0 else f"[{grouped}]"

    values = [1234.5, -1234567.25, 0.125, -999.5] * 5
    found = reading(tmp_path, PLAIN, lambda k: (str(k), form(values[k]), form(-values[k])))
    np.testing.assert_array_equal(found.columns["position_m"], values)
    np.testing.assert_array_equal(found.columns["force_N"], np.negative(values))


@pytest.mark.parametrize("token", ["12 34", "0 123", "1 234 56", "1' 234", "[1.5", "[1, 2]"])
def test_what_only_resembles_groups_is_no_number(token: str, tmp_path: Path) -> None:
    message = refusal(tmp_path, PLAIN, lambda k: (str(k), token if k == 7 else "1.5", "2"))
    assert "row 8 (line 9), column x [m]" in message and "a number with a decimal point" in message


# --- matrices, counts, optional libraries -----------------------------------------------------------------------


def saved(folder: Path, array: NDArray[Any]) -> Path:
    np.save(folder / "log.npy", array)
    return folder / "log.npy"


@pytest.mark.parametrize(
    ("log", "message"),
    [
        ({}, "missing: a column time_s"),
        ({"time_s": {"row": 4}}, r"\[log\] time_s, row = 4: 1 to 3"),
        ({"time_s": {"variable": "array"}}, r"says which row: time_s = \{ variable = \"array\", row = 1 \}"),
    ],
)
def test_a_matrix_wants_rows(log: dict[str, Any], message: str, tmp_path: Path) -> None:
    rows = {"time_s": {"row": 1}, "position_m": {"row": 2}, "force_N": {"row": 3}}
    machine = override_machine(load_machine("etel_xy"), {"log": {**rows, **log} if log else {}})
    path = saved(tmp_path, np.arange(60.0).reshape(3, 20))
    with pytest.raises(InputError, match=message):
        understand(path, machine)


def test_a_position_that_starts_over_wants_its_period(tmp_path: Path) -> None:
    counts = (np.arange(500) * 300) % 65536

    def row(k: int) -> tuple[str, str, str]:
        return (f"{k * 1e-3:.3f}", str(counts[k]), "1")

    log = {"position_m": {"variable": "x", "unit": "counts", "counts_per": 1e5}}
    message = refusal(tmp_path, "t [s];x;F [N]", row, log, rows=500)
    assert "row 220 (line 221), column x" in message and "wrap = 65536" in message
    log["position_m"]["wrap"] = 65536.0
    found = reading(tmp_path, "t [s];x;F [N]", row, log, rows=500)
    np.testing.assert_allclose(found.columns["position_m"], np.arange(500) * 300 / 1e5, rtol=1e-12)


LIBRARIES = [(".h5", "h5py"), (".parquet", "pyarrow"), (".mf4", "asammdf"), (".bag", "rosbags"), (".mcap", "rosbags")]


@pytest.mark.parametrize(("suffix", "library"), LIBRARIES)
def test_an_absent_library_is_named(suffix: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in {library, *(name for name in sys.modules if name.startswith(f"{library}."))}:
        monkeypatch.setitem(sys.modules, name, None)
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"anything")
    with pytest.raises(InputError, match=rf"{library}': not installed, .* needs it: pip install 'sgms-mhe\[\w+\]'$"):
        understand(path)


@pytest.mark.parametrize(("suffix", "library"), [*LIBRARIES, (".db3", "rosbags")])
@pytest.mark.parametrize("content", [b"", b"anything", bytes(range(256)) * 40])
def test_a_damaged_container_is_refused(suffix: str, library: str, content: bytes, tmp_path: Path) -> None:
    pytest.importorskip(library, reason=f"library absent: {library}")
    path = tmp_path / f"log{suffix}"
    with pytest.raises(InputError, match="a readable log"):
        understand(path)
    path.write_bytes(content)
    with pytest.raises(InputError, match="whole"):
        understand(path)


# --- uneven time ------------------------------------------------------------------------------------------------


def uneven(machine: Machine, jitter: float, seed: int = 3) -> tuple[Log, Log]:
    """(a log at uneven instants, mean rate 1 kHz, drawn from one at 10 kHz; that one)."""
    fast = override_machine(machine, {"sampling": {"rate": 10000.0}})
    dense = simulate_log(fast, seconds=3.0, fastest=0.05, seed=1, force_noise_N=0.01)
    random = np.random.default_rng(seed)
    steps = 10 + np.round(10 * jitter * random.uniform(-1, 1, size=2900)).astype(int)
    at = np.cumsum(steps)
    at = at[at < len(dense)]
    columns = {name: values[at] for name, values in dense.columns.items()}
    return Log(**columns, rate=1000.0), dense  # type: ignore[arg-type]


@pytest.mark.parametrize("jitter", [0.3, 0.7])
def test_uneven_time_is_interpolated_within_the_error_that_is_stated(
    jitter: float, machine: Machine, tmp_path: Path
) -> None:
    log, dense = uneven(machine, jitter)
    path = tmp_path / "log.csv"
    write_log(path, log)
    with pytest.raises(InputError, match=r"uniform time within 1 %.*resample = true"):
        read_log(path, machine)
    resampling = override_machine(machine, {"log": {"resample": True}})
    found = understand(path, resampling)
    assert found.resampling is not None
    assert found.resampling.rate == 1000.0
    assert np.ptp(np.diff(found.columns["time_s"])) < 1e-9
    at = np.round(found.columns["time_s"] * 1e4).astype(int)
    for name, largest in (("position_m", 1e-7), ("force_N", 0.5)):
        known = np.isfinite(found.columns[name])
        error = np.sqrt(np.mean((found.columns[name] - dense.columns[name][at])[known] ** 2))
        stated = found.resampling.interpolations[name].error
        assert error <= stated <= largest
    assert f"{found.resampling.interpolations['force_N'].error:.2g} rms" in found.notes[-1]


def test_gaps_stay_gaps(machine: Machine, tmp_path: Path) -> None:
    log, _ = uneven(machine, 0.3)
    kept = (log.time_s < 1.0) | (log.time_s > 1.05)
    columns: dict[str, Any] = {name: values[kept] for name, values in log.columns.items()}
    write_log(tmp_path / "log.csv", Log(**columns, rate=1000.0))
    resampling = override_machine(machine, {"log": {"resample": True}})
    found = read_log(tmp_path / "log.csv", resampling)
    gap = (found.time_s > 1.001) & (found.time_s < 1.049)
    assert np.isnan(found.position_m[gap]).all() and np.isnan(found.force_N[gap]).all()
    assert np.isfinite(found.position_m[~gap]).mean() > 0.99


def test_a_grid_far_from_the_log_s_rate_is_refused(machine: Machine, tmp_path: Path) -> None:
    log, _ = uneven(machine, 0.3)
    write_log(tmp_path / "log.csv", log)
    for rate in (250.0, 4000.0):
        changes = {"log": {"resample": True}, "sampling": {"rate": rate, "velocity_cutoff": 50.0}}
        with pytest.raises(InputError, match=r"sampling\.rate from"):
            read_log(tmp_path / "log.csv", override_machine(machine, changes))


def test_even_time_is_left_alone(machine: Machine, tmp_path: Path) -> None:
    log = simulated(machine)
    write_log(tmp_path / "log.npz", log)
    found = understand(tmp_path / "log.npz", override_machine(machine, {"log": {"resample": True}}))
    assert found.resampling is None
    np.testing.assert_array_equal(found.columns["force_N"], log.force_N)


# --- inspect ----------------------------------------------------------------------------------------------------


def simulated(machine: Machine) -> Log:
    return simulate_log(machine, seconds=3.0, fastest=0.05, seed=1)


def test_inspect_shows_what_was_understood(machine: Machine, small: Path, tmp_path: Path) -> None:
    log = simulated(machine)
    lines = ["Axis X", "Time [ms]\tPosition [mm]\tForce [N]\tTemperature"]
    rows = zip(1e3 * log.time_s, 1e3 * log.position_m, log.force_N, strict=True)
    lines += [f"{t:.1f}\t{x:.9f}\t{'' if k == 7 else f'{f:.6f}'}\t20" for k, (t, x, f) in enumerate(rows)]
    path = tmp_path / "axis.txt"
    path.write_text("\n".join(lines).replace(".", ","), encoding="utf-16")
    result = run("inspect", path, "--machine", small, "--json")
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert content["format"] == "text" and content["kind"] == "linear"
    assert content["dialect"]["encoding"] == "utf-16" and content["dialect"]["decimal mark"] == "comma"
    columns = {column["name"]: column for column in content["columns"]}
    assert [columns[name]["unit"] for name in ("time_s", "position_m", "force_N")] == ["ms", "mm", "N"]
    assert columns["force_N"]["missing"] == 1
    assert columns["position_m"]["max"] == pytest.approx(log.position_m.max(), abs=1e-9)
    assert content["not_read"] == ["Temperature"]
    assert content["time"]["rate_Hz"] == pytest.approx(1000.0)
    assert content["time"]["gaps"] == 0 and content["time"]["uniform"]
    assert content["problems"] == []
    text = run("inspect", path).stdout
    assert all(word in text for word in ("utf-16", "tab", "comma", "Position [mm]", "1000 Hz", "Temperature"))


def test_inspect_says_what_the_other_commands_refuse(machine: Machine, small: Path, tmp_path: Path) -> None:
    log = simulated(machine)
    path = tmp_path / "axis.csv"
    write_log(path, Log(log.time_s, log.position_m, -log.force_N, log.rate))
    result = run("inspect", path, "--machine", small, "--json")
    assert result.exit_code == 1
    (problem,) = json.loads(result.stdout)["problems"]
    assert "scale = -1.0" in problem
    assert problem in refused("estimate", small, path, "--out", tmp_path / "e.csv")
    assert run("inspect", path).exit_code == 1  # the sign needs no machine


def test_inspect_shows_uneven_time_and_says_the_remedy(machine: Machine, tmp_path: Path) -> None:
    write_log(tmp_path / "axis.csv", uneven(machine, 0.5)[0])
    result = run("inspect", tmp_path / "axis.csv", "--json")
    content = json.loads(result.stdout)
    assert result.exit_code == 1
    assert content["time"]["jitter"] > 0.1 and not content["time"]["uniform"]
    assert "resample = true" in content["problems"][0]


def test_inspect_takes_a_rotary_log_and_refuses_it_for_a_linear_axis(small: Path, tmp_path: Path) -> None:
    path = written(tmp_path, "t [s];angle [deg];torque [Nm]", lambda k: (*usual(k)[:2], f"{2.5 - 0.1 * (k % 7):.2f}"))
    result = run("inspect", path, "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["kind"] == "rotary"
    result = run("inspect", path, "--machine", small)
    assert result.exit_code == 1 and "rotary axis" in result.stdout


def test_inspect_refuses_what_it_cannot_read(tmp_path: Path) -> None:
    assert "readable log" in refused("inspect", tmp_path / "absent.csv")


def test_time_in_milliseconds_read_as_seconds_is_said(machine: Machine, small: Path, tmp_path: Path) -> None:
    log = simulated(machine)
    path = tmp_path / "axis.csv"
    write_log(path, Log(1e3 * log.time_s, log.position_m, log.force_N, 1.0))
    assert 'time in ms? [log] (machine file, --log) has time_s = { variable = "...", unit = "ms" }' in refused(
        "estimate", small, path, "--out", tmp_path / "e.csv"
    )
    assert "time in another unit?" in run("inspect", path).stdout


# --- measured files, as they are --------------------------------------------------------------------------------

KUKA = {
    "time_s": {"member": "rec.time_cont"},
    "position_rad": {"member": "rec.act_pos_mot_deg", "row": 1, "unit": "deg"},
    "torque_Nm": {"member": "rec.act_torque_abs_nm", "row": 1},
}
ODRIVE = {
    "resample": True,
    "time_s": {"row": 1},
    "position_rad": {"row": 2, "unit": "counts", "counts_per": 8192.0},
    "torque_Nm": {"row": 3, "unit": "A", "scale": 0.0083},
}


def test_a_robot_s_struct_is_read_as_it_is(measured_data: Callable[[str], Path]) -> None:
    changes = {"log": KUKA, "sampling": {"rate": 250.0, "update_rate": 25.0, "velocity_cutoff": 30.0}}
    found = understand(measured_data("kuka/A.mat"), override_machine(load_machine("etel_xy"), changes))
    assert found.kind == "rotary" and found.timing.rate == pytest.approx(250.0) and found.timing.samples == 2501
    assert np.degrees(found.columns["position_rad"][0]) == pytest.approx(0.059679, abs=1e-6)
    assert np.ptp(found.columns["torque_Nm"]) == pytest.approx(17.8, abs=0.1)


def test_a_motor_s_uneven_matrix_is_read_as_it_is(measured_data: Callable[[str], Path]) -> None:
    changes = {"log": ODRIVE, "sampling": {"rate": 400.0, "update_rate": 40.0, "velocity_cutoff": 50.0}}
    path = measured_data("odrive/slow2_slower_nocomp_0.npy")
    found = understand(path, override_machine(load_machine("etel_xy"), changes))
    assert found.kind == "rotary" and found.resampling is not None
    assert found.timing.rate == pytest.approx(442.0, abs=0.5)
    assert found.resampling.interpolations["position_rad"].relative < 1e-3
    assert np.nanmax(found.columns["position_rad"]) == pytest.approx(2 * np.pi, rel=0.01)
