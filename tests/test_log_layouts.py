"""Layouts of tables: key rows of scopes, channels with clocks of their own, long format, struct arrays of MAT files."""

import contextlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from cli_cases import run
from sgms_bench.logs.layouts import Channel, ScopeChannel, control_desk, events, long_rows, named_values, scope
from sgms_mhe.api.inputs import read_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]


def motion(seed: int, rate: float, seconds: float = 3.0) -> Log:
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * rate)) / rate
    position = 0.04 * np.sin(5.0 * time) + 0.002 * np.sin(31.0 * time)
    speed = np.gradient(position, 1.0 / rate)
    force = 12.0 * np.gradient(speed, 1.0 / rate) + 3.0 * np.tanh(speed / 1e-3) + rng.normal(0.0, 0.05, len(time))
    return Log(time, position, force, rate)


# --- scope exports ------------------------------------------------------------------------------------------------


def grouped(channels: Sequence[ScopeChannel], *sizes: int) -> list[Sequence[ScopeChannel]]:
    """Groups of so many channels."""
    rest = iter(channels)
    return [[next(rest) for _ in range(size)] for size in sizes]


@pytest.mark.parametrize("sizes", [(1, 1, 1), (3,), (2, 1), (1, 2)])
@pytest.mark.parametrize(("separator", "mark"), [("\t", ","), ("\t", "."), (";", ","), (";", "."), (",", ".")])
@pytest.mark.parametrize("keys", [(), ("Offset", "ScaleFactor", "IndexGroup", "IndexOffset", "VariableSize", "Factor")])
def test_key_rows_are_understood(
    sizes: tuple[int, ...], separator: str, mark: str, keys: Sequence[str], tmp_path: Path
) -> None:
    """Rows of a key and a number stand between the units and the samples: taken for samples, nothing was read."""
    log, slow = motion(1, 2000.0, 1.0), motion(1, 1000.0, 1.0)
    at, other = 1e3 * log.time_s, log if len(sizes) == 1 or sizes[-1] == 2 else slow
    channels = [
        ("ActPos", "mm (Millimeter)", at, 1e3 * log.position_m),
        ("Temperature", "(None)", 1e3 * other.time_s, other.force_N),
        ("ActForce", "N (Newton)", 1e3 * other.time_s, 100.0 * other.position_m),
    ]
    if sizes[0] == 2:  # the second of the group of position
        channels[1] = ("Temperature", "(None)", at, log.force_N)
    numbers = [(key, ["0" if key == "Offset" else "1"] * 3) for key in keys]
    path = scope(tmp_path / "s.csv", grouped(channels, *sizes), separator=separator, mark=mark, keys=numbers, blank=" ")
    notes: list[str] = []
    found = read_log(path, note=notes.append)
    assert found.rate == pytest.approx(2000.0) and len(found) == len(log)
    assert found.position_m == pytest.approx(log.position_m, abs=1e-12)
    assert found.force_N[:-1] == pytest.approx(100.0 * log.position_m[:-1], abs=2e-3)
    assert "EOF" in notes[0] and len(notes) == 1 + (other is slow)


def test_keys_in_any_order_and_pairs_of_other_words_are_understood(tmp_path: Path) -> None:
    log = motion(12, 500.0)
    rows = ["Unit,rad,Unit,Nm", "Timestamp,2024-01-02 03:04:05,Timestamp,2024-01-02 03:04:05"]
    rows += ["Interval,0.002,Interval,0.002", "Gain,1,Gain,1", 'Channel name,"Position",Channel name,"Torque"']
    clocks = [f"{t:.3f}" for t in log.time_s], [""] * len(log)
    for order in (rows, rows[::-1], [*rows[2:], *rows[:2]]):
        for clock in clocks:  # times that stand there, and such that are counted
            samples = zip(clock, log.position_m, clock, log.force_N, strict=True)
            lines = [f"{t},{x:.12g},{at},{f:.12g}" for t, x, at, f in samples]
            (tmp_path / "log.csv").write_text("\n".join([*order, *lines]))
            found = read_log(tmp_path / "log.csv")
            assert (found.rate, found.kind, len(found)) == (pytest.approx(500.0), "rotary", len(log))
            assert found.force_N == pytest.approx(log.force_N, abs=1e-9)


@pytest.mark.parametrize("suffix", [".log", ".t", ".csv"])
@pytest.mark.parametrize(("mark", "step_ns"), [(",", 1e6), (".", 50_000.0)])
@pytest.mark.parametrize("separator", [" ", "\t"])
def test_rows_of_names_and_values_are_columns(
    suffix: str, mark: str, step_ns: float, separator: str, tmp_path: Path
) -> None:
    log, notes = motion(13, 1000.0), list[str]()
    channels = [("joint.0.torque-fb", log.force_N), ("joint.0.motor-pos-fb", 1e3 * log.position_m)]
    path = named_values(tmp_path / f"scope{suffix}", step_ns, channels, mark)
    path.write_text(
        path.read_text().replace("nSec", "nsec") if separator == " " else path.read_text().replace(" ", "\t")
    )
    table = {"position_m": {"unit": "mm"}, "force_N": {"unit": "%", "scale": 10.0}}
    found = read_log(path, table=table, note=notes.append)
    assert found.rate == pytest.approx(1e9 / step_ns) and len(found) == len(log)
    assert found.force_N == pytest.approx(10.0 * log.force_N, abs=1e-9)
    assert len(notes) == 1 and f"counted in the step of {step_ns:g} ns that the file states" in notes[0]
    lines = path.read_text().splitlines()
    lines[-1] = lines[-1].replace("torque", "force")
    path.write_text("\n".join(lines))
    with pytest.raises(InputError):  # a name that changes names no column
        read_log(path, table=table)


@pytest.mark.parametrize("name", ["ms", "[ms]", "( ms )"])
def test_a_column_with_a_unit_of_time_for_a_name_is_time(name: str, tmp_path: Path) -> None:
    log, path = motion(14, 500.0), tmp_path / "log.csv"
    rows = [f"{1e3 * t:g},{x:.9g},{f:.9g}" for t, x, f in zip(log.time_s, log.position_m, log.force_N, strict=True)]
    path.write_text("\n".join(["Interval(ms),2", "Time,Analog 1,Analog 2", f"{name},Position(m),Force(N)", *rows]))
    assert read_log(path).rate == pytest.approx(500.0)
    shown = json.loads(run("inspect", path, "--json").stdout)
    assert shown["columns"][0] | {"because": "unit alone", "unit": "ms"} == shown["columns"][0]
    path.write_text("\n".join([f"{name},t [ms],Position(m),Force(N)", *(f"7,{row}" for row in rows)]))
    assert read_log(path).rate == pytest.approx(500.0)  # one that is called time comes first


@pytest.mark.parametrize("unit", ["ms", "us", "s"])
def test_the_key_of_the_step_says_the_unit_of_time(unit: str, tmp_path: Path) -> None:
    log = motion(2, 500.0)
    at = log.time_s * {"ms": 1e3, "us": 1e6, "s": 1.0}[unit]
    channels = [("ActPos", "mm", at, 1e3 * log.position_m), ("Force", "N", at, log.force_N)]
    path = scope(tmp_path / "scope.csv", grouped(channels, 1, 1))
    path.write_text(path.read_text().replace("SampleTime[ms]", f"SampleTime[{unit}]"))
    assert read_log(path).rate == pytest.approx(500.0)


@pytest.mark.parametrize("longer", [0, 1])
def test_channels_with_clocks_of_their_own_are_put_on_that_of_position(longer: int, tmp_path: Path) -> None:
    log, slow = motion(3, 1000.0, 3.0 + longer), motion(3, 250.0, 4.0 - longer)
    channels = [
        ("Force", "N", 1e3 * slow.time_s, 100.0 * slow.position_m),
        ("ActPos", "mm", 1e3 * log.time_s, 1e3 * log.position_m),
    ]
    notes: list[str] = []
    found = read_log(scope(tmp_path / "scope.csv", grouped(channels, 1, 1)), note=notes.append)
    assert len(found) == len(log) and found.position_m == pytest.approx(log.position_m, abs=1e-12)
    inside = log.time_s <= slow.time_s[-1]
    assert found.force_N[inside] == pytest.approx(100.0 * log.position_m[inside], abs=2e-3)
    assert np.isnan(found.force_N[log.time_s > slow.time_s[-1] + 0.003]).all()
    assert len(notes) == 2 and "force_N: sampled at other times than position" in notes[1]


def test_scales_in_key_rows_are_taken_and_said(tmp_path: Path) -> None:
    log, notes = motion(4, 500.0), list[str]()
    at = 1e3 * log.time_s
    channels = [("ActPos", "mm", at, np.round(1e6 * log.position_m)), ("Force", "N", at, log.force_N)]
    keys = [("Offset", ["0", "0"]), ("ScaleFactor", ["0.001", "1"])]
    found = read_log(scope(tmp_path / "scope.csv", grouped(channels, 1, 1), keys=keys), note=notes.append)
    assert found.position_m == pytest.approx(log.position_m, abs=1e-6)
    assert len(notes) == 2 and "ActPos: taken times 0.001 plus 0" in notes[1]


def test_a_header_with_a_row_of_units_is_no_key_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = "".join(f"{k},{0.5 * k},{k % 7}\n" for k in range(30))
    path.write_text(f"Name,x,F\nUnit,mm,N\n{rows}")
    with pytest.raises(InputError, match="time_s"):
        read_log(path)
    assert read_log(path, table={"time_s": {"variable": "Name", "unit": "ms"}}).rate == pytest.approx(1000.0)


def test_a_file_without_a_header_may_say_so(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("".join(f"{k / 1000},{0.5 * k},{k % 7}\n" for k in range(30)))
    table = {"header_line": 0, "time_s": "column 1", "position_m": "column 2", "force_N": "column 3"}
    assert read_log(path, table=table).position_m[-1] == 14.5


# --- long format --------------------------------------------------------------------------------------------------


def pair(log: Log, names: tuple[str, str]) -> list[tuple[str, Array]]:
    return list(zip(names, (log.position_m, log.force_N), strict=True))


@pytest.mark.parametrize(
    ("header", "order", "separator"),
    [
        ("t [s],signal,value", lambda t, n, v: [t, n, v], ","),
        ("t [s];Name;Wert", lambda t, n, v: [t, n, v], ";"),
        ("signal,value,time [s]", lambda t, n, v: [n, v, t], ","),
    ],
)
@pytest.mark.parametrize(
    "names", [("act_pos [m]", "force [N]"), ("AX1:position_m", "AX1:force_N"), ("drive/x/m", "F (N)")]
)
def test_long_format_is_pivoted_and_said(
    header: str, order: Callable[[str, str, str], list[str]], separator: str, names: tuple[str, str], tmp_path: Path
) -> None:
    log, notes = motion(5, 400.0), list[str]()
    path = events(tmp_path / "log.csv", long_rows(log.time_s, pair(log, names), order), header, separator)
    table = {} if "[" in names[0] else {"position_m": names[0], "force_N": names[1]}
    found = read_log(path, table=table, note=notes.append)
    assert found.rate == pytest.approx(400.0)
    assert found.position_m == pytest.approx(log.position_m, abs=1e-10)
    assert found.force_N == pytest.approx(log.force_N, abs=1e-9)
    assert len(notes) == 1 and f"{names[0]} {len(log)}" in notes[0]


def test_long_format_takes_each_variable_at_its_own_times(tmp_path: Path) -> None:
    log = motion(6, 500.0)
    rows = long_rows(log.time_s, pair(log, ("x [m]", "F [N]")), later=0.0007)
    notes: list[str] = []
    found = read_log(events(tmp_path / "log.csv", rows, "time [s],id,value"), note=notes.append)
    assert found.position_m == pytest.approx(log.position_m, abs=1e-10)
    smooth = slice(5, -5)
    expected = np.interp(log.time_s, log.time_s + 0.0007, log.force_N)
    assert found.force_N[smooth] == pytest.approx(expected[smooth], abs=1e-6)
    assert any("other times" in note for note in notes)


def test_long_format_with_stamps_and_a_stated_column(tmp_path: Path) -> None:
    log = motion(7, 100.0)
    stamps = [f"2026-03-04T05:06:{t:09.6f}Z" for t in log.time_s]
    rows = []
    for stamp, x, f in zip(stamps, log.position_m, log.force_N, strict=True):
        rows += [[stamp, "x", f"{x:.12g}", "192", "0"], [stamp, "F", f"{f:.12g}", "192", "1"]]
    path = events(tmp_path / "log.csv", rows, "stamp,channel,data,quality,source")
    units = {"position_m": {"unit": "m"}, "force_N": {"unit": "N"}}
    with pytest.raises(InputError, match="missing: a column"):  # five columns are no long format by themselves
        read_log(path, table=units)
    found = read_log(path, table={"channel": "channel", **units})
    assert found.position_m == pytest.approx(log.position_m, abs=1e-10) and found.rate == pytest.approx(100.0)
    with pytest.raises(InputError, match=r"\[log\] channel = 'topic'"):
        read_log(path, table={"channel": "topic", **units})


def test_a_short_row_of_a_long_format_is_refused(tmp_path: Path) -> None:
    log = motion(17, 200.0)
    path = events(tmp_path / "log.csv", long_rows(log.time_s, pair(log, ("x [m]", "F [N]"))), "t [s],signal,value")
    lines = path.read_text().splitlines()
    lines[-2] = lines[-2].partition(",")[0]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"line \d+\) = .1 fields"):
        read_log(path)


def test_a_column_of_modes_makes_no_long_format(tmp_path: Path) -> None:
    log = motion(8, 100.0)
    rows = [
        [f"{t:.6f}", ("run", "hold")[k % 2], f"{x:.9g}", f"{f:.9g}"]
        for k, (t, x, f) in enumerate(zip(log.time_s, log.position_m, log.force_N, strict=True))
    ]
    found = read_log(events(tmp_path / "log.csv", rows, "time_s,mode,position_m,force_N"))
    assert len(found) == len(log)


def test_inspect_lists_the_variables_of_a_long_format(tmp_path: Path) -> None:
    log = motion(9, 200.0)
    rows = long_rows(log.time_s, pair(log, ("lever", "weight")))
    result = run("inspect", events(tmp_path / "log.csv", rows, "t [s],pv,value"), "--json")
    content: dict[str, Any] = json.loads(result.stdout)
    assert result.exit_code == 1 and content["missing"] == ["position_m", "force_N"]
    by_name = {column["from"]: column for column in content["columns"]}
    assert by_name["lever"]["max"] == pytest.approx(log.position_m.max())
    assert by_name["weight"]["min"] == pytest.approx(log.force_N.min())


# --- struct arrays of MAT files ---------------------------------------------------------------------------------


def rasters(logs: Sequence[Log], labels: tuple[str, str], units: tuple[str, str]) -> dict[str, Any]:
    """Position in thousandths in the first raster, force in the last."""
    fast, slow = logs[0], logs[-1]
    position = Channel(labels[0], units[0], 1e3 * fast.position_m)
    force = Channel(labels[1], units[1], slow.force_N)
    if len(logs) == 1:
        return control_desk([(fast.time_s, [position, force])])
    return control_desk([(fast.time_s, [position]), (slow.time_s, [force])])


@pytest.mark.parametrize("nested", [True, False])
@pytest.mark.parametrize("compressed", [True, False])
@pytest.mark.parametrize("labels", [("Model Root/Axis/ActPos", "Model Root/Axis/Force"), ("ActPos", "ActForce")])
def test_channels_of_struct_arrays_are_read(
    nested: bool, compressed: bool, labels: tuple[str, str], tmp_path: Path
) -> None:
    log = motion(10, 1000.0)
    content = rasters([log], labels, ("mm", "N"))
    savemat(tmp_path / "rec.mat", {"rec_001": content} if nested else content, do_compression=compressed)
    found = read_log(tmp_path / "rec.mat")
    assert found.rate == pytest.approx(1000.0)
    assert found.position_m == pytest.approx(log.position_m) and found.force_N == pytest.approx(log.force_N)


def test_members_of_struct_arrays_have_a_path(tmp_path: Path) -> None:
    log = motion(11, 500.0)
    savemat(tmp_path / "rec.mat", {"rec": rasters([log], ("lever", "weight"), ("", ""))})
    listed = json.loads(run("inspect", tmp_path / "rec.mat", "--json").stdout)
    assert {"rec.X.Data", "rec.Y(1).Data", "rec.Y(2).Data", "rec.Y(3).Data"} <= {c["from"] for c in listed["columns"]}
    for position, force in (("rec.Y(2).Data", "rec.Y(3).Data"), ("lever", "weight")):
        table = {"position_m": {"variable": position, "unit": "mm"}, "force_N": {"member": force}}
        assert read_log(tmp_path / "rec.mat", table=table).position_m == pytest.approx(log.position_m)


def test_rasters_have_clocks_of_their_own(tmp_path: Path) -> None:
    fast, slow = motion(12, 1000.0), motion(12, 200.0)
    slow = Log(slow.time_s, slow.position_m, 50.0 * slow.position_m, slow.rate)
    savemat(tmp_path / "rec.mat", {"rec": rasters([fast, slow], ("ActPos", "Force"), ("mm", "N"))})
    found = read_log(tmp_path / "rec.mat")
    inside = fast.time_s <= slow.time_s[-1]
    assert found.position_m == pytest.approx(fast.position_m)
    assert found.force_N[inside] == pytest.approx(50.0 * fast.position_m[inside], abs=2e-3)


@pytest.mark.parametrize("shape", [(-1, 1), (1, 1, -1)])
def test_simulink_s_scope_is_read(shape: tuple[int, ...], tmp_path: Path) -> None:
    log = motion(13, 250.0)
    signals = np.zeros((1, 2), dtype=[("values", object), ("dimensions", object), ("label", object)])
    signals[0, 0] = (log.force_N.reshape(shape), 1, "Force [N]")
    signals[0, 1] = (log.position_m.reshape(shape), 1, "x_act [m]")
    other = {"time": np.arange(9.0).reshape(-1, 1), "signals": {"values": np.ones((9, 1)), "label": "temperature"}}
    scope_data = {"time": log.time_s.reshape(-1, 1), "signals": signals, "blockName": "model/Scope"}
    savemat(tmp_path / "scope.mat", {"Other": other, "ScopeData": scope_data})
    found = read_log(tmp_path / "scope.mat")
    assert found.position_m == pytest.approx(log.position_m) and found.force_N == pytest.approx(log.force_N)


def read_damaged(whole: Path, copies: int, seed: int) -> None:
    """Read copies of a MAT file with bytes changed and the end cut off; anything but InputError is raised."""
    rng, bad = np.random.default_rng(seed), whole.with_name("bad.mat")
    for _ in range(copies):
        content = bytearray(whole.read_bytes())
        for at in rng.integers(128, len(content), 3):
            content[at] = rng.integers(256)
        bad.write_bytes(bytes(content[: rng.integers(129, len(content))]))
        with contextlib.suppress(InputError):
            read_log(bad)


def test_a_damaged_struct_array_is_refused_and_never_trips(tmp_path: Path) -> None:
    savemat(tmp_path / "rec.mat", {"rec": rasters([motion(14, 100.0)], ("ActPos", "Force"), ("mm", "N"))})
    read_damaged(tmp_path / "rec.mat", 300, 1)


def test_any_damaged_length_in_a_struct_array_is_refused(tmp_path: Path) -> None:
    """The index of a channel's times is read before any column is asked for."""
    savemat(tmp_path / "rec.mat", {"rec": rasters([motion(18, 20.0, 1.0)], ("ActPos", "Force"), ("mm", "N"))})
    whole = (tmp_path / "rec.mat").read_bytes()
    for at in range(128, len(whole), 4):
        (tmp_path / "bad.mat").write_bytes(whole[:at] + b"\xff\xff\xff\x7f" + whole[at + 4 :])
        with contextlib.suppress(InputError):
            read_log(tmp_path / "bad.mat")


def save_v73(path: Path, content: dict[str, Any], header: bool) -> None:
    """Structs, struct arrays and texts as MATLAB writes them with -v7.3."""
    h5py = pytest.importorskip("h5py")
    count = 0

    def put(group: Any, name: str, value: Any) -> Any:
        nonlocal count
        if isinstance(value, dict):
            made = group.create_group(name)
            made.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, item in value.items():
                put(made, key, item)
        elif isinstance(value, list):
            made = group.create_group(name)
            made.attrs["MATLAB_class"] = np.bytes_("struct")
            for key in value[0]:
                places = made.create_dataset(key, (len(value), 1), dtype=h5py.ref_dtype)
                for k, item in enumerate(value):
                    count += 1
                    places[k, 0] = put(file["#refs#"], f"r{count}", item[key]).ref
        else:
            is_text = isinstance(value, str)
            array = np.array([[ord(c)] for c in value], dtype="u2") if is_text else np.atleast_2d(value)
            made = group.create_dataset(name, data=array)
            made.attrs["MATLAB_class"] = np.bytes_("char" if is_text else "double")
        return made

    with h5py.File(path, "w", userblock_size=512 if header else 0) as file:
        file.create_group("#refs#")
        for key, item in content.items():
            put(file, key, item)
    if header:
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("header", [True, False])
@pytest.mark.parametrize("apart", [1.0, 0.5])
@pytest.mark.parametrize("seed", [20, 21])
def test_struct_arrays_of_version_7_3_are_read(seed: int, apart: float, header: bool, tmp_path: Path) -> None:
    log = motion(seed, 800.0)
    clocks = [{"Data": log.time_s, "Name": "fast"}, {"Data": log.time_s[:: round(1.0 / apart)], "Name": "slow"}]
    channels = [
        {"Name": "Root/valve", "Unit": "", "Data": np.ones(len(log)), "XIndex": 1.0},
        {"Name": "Root/ActPos", "Unit": "mm", "Data": 1e3 * log.position_m, "XIndex": 1.0},
        {"Name": "Root/Force", "Unit": "N", "Data": log.force_N[:: round(1.0 / apart)], "XIndex": 2.0},
    ]
    save_v73(tmp_path / "rec.mat", {"rec": {"X": clocks, "Y": channels, "Note": "a word"}}, header)
    found = read_log(tmp_path / "rec.mat")
    assert found.rate == pytest.approx(800.0) and found.position_m == pytest.approx(log.position_m)
    same = slice(None, None, round(1.0 / apart))
    assert found.force_N[same] == pytest.approx(log.force_N[same])
    table = {"position_m": {"variable": "rec.Y(2).Data", "unit": "mm"}, "force_N": {"member": "rec.Y(3).Data"}}
    assert read_log(tmp_path / "rec.mat", table=table).position_m == pytest.approx(log.position_m)


def test_simulink_s_scope_of_version_7_3_is_read(tmp_path: Path) -> None:
    log = motion(22, 250.0)
    signals = [{"values": log.force_N, "label": "Force [N]"}, {"values": log.position_m, "label": "x_act [m]"}]
    save_v73(tmp_path / "scope.mat", {"ScopeData": {"time": log.time_s, "signals": signals}}, True)
    found = read_log(tmp_path / "scope.mat")
    assert found.position_m == pytest.approx(log.position_m) and found.force_N == pytest.approx(log.force_N)


def test_a_damaged_file_of_version_7_3_is_refused_and_never_trips(tmp_path: Path) -> None:
    log = motion(23, 100.0, 1.0)
    save_v73(tmp_path / "rec.mat", {"ScopeData": {"time": log.time_s, "signals": [{"values": log.force_N}]}}, True)
    read_damaged(tmp_path / "rec.mat", 100, 2)


# --- a clock in another file ------------------------------------------------------------------------------------


@pytest.mark.parametrize("clock", ["clock.csv", "log_time.txt", "clock.npz"])
def test_the_clock_may_be_in_another_file(clock: str, tmp_path: Path) -> None:
    log = motion(15, 500.0)
    rows = "".join(f"{x:.12g},{f:.12g}\n" for x, f in zip(log.position_m, log.force_N, strict=True))
    (tmp_path / "log.csv").write_text(f"position_m,force_N\n{rows}")
    if clock.endswith(".npz"):
        np.savez(tmp_path / clock, stamp=1e3 * log.time_s)
    else:
        (tmp_path / clock).write_text("stamp\n" + "".join(f"{1e3 * t:.9g}\n" for t in log.time_s))
    for name in (clock, clock.replace("log", "{stem}")):
        found = read_log(tmp_path / "log.csv", table={"time_s": {"variable": f"{name}:stamp", "unit": "ms"}})
        assert found.rate == pytest.approx(500.0) and found.position_m == pytest.approx(log.position_m, abs=1e-10)
    with pytest.raises(InputError, match=r"absent\.csv"):
        read_log(tmp_path / "log.csv", table={"time_s": "absent.csv:stamp"})
    with pytest.raises(InputError, match=r"missing: a column .*:tick"):
        read_log(tmp_path / "log.csv", table={"time_s": f"{clock}:tick"})


def test_another_file_of_another_length_is_refused(tmp_path: Path) -> None:
    log = motion(16, 500.0)
    np.savez(tmp_path / "log.npz", position_m=log.position_m, force_N=log.force_N)
    np.savez(tmp_path / "clock.npz", stamp=log.time_s[:-200])
    with pytest.raises(InputError, match="as many rows as time_s has"):
        read_log(tmp_path / "log.npz", table={"time_s": "clock.npz:stamp"})
