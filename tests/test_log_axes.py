"""Logs of many axes, stamps in two columns, channels of several groups: one is read, or which one is asked."""

import logging
from pathlib import Path

import numpy as np
import pytest

from cli_cases import refused, run
from sgms_mhe.api.inputs import read_log
from sgms_mhe.logfiles.names import is_usual
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError


def motion(seed: int, rate: float = 500.0) -> Log:
    """A rotor of 2 kg m^2 with a starting time that no float holds to the microsecond."""
    rng = np.random.default_rng(seed)
    time = np.arange(1500) / rate
    position = rng.uniform(1.0, 3.0) * np.sin(3.0 * time) + 0.2 * np.sin(11.0 * time)
    speed = np.gradient(position, 1.0 / rate)
    torque = 2.0 * np.gradient(speed, 1.0 / rate) + np.tanh(speed / 0.01)
    return Log(time, position, torque, rate, velocity_m_s=speed, kind="rotary")


def write(path: Path, **columns: object) -> Path:
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]))
    return path


def close(found: Log, log: Log) -> bool:
    return bool(np.allclose(found.position_m, log.position_m) and np.allclose(found.force_N, log.force_N))


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("q1", "position"),
        ("q_0 [rad]", "position"),
        ("actual_q_3", "position"),
        ("Joint Position 2 [deg]", "position"),
        ("tau_J1 [Nm]", "force"),
        ("tau_J", "force"),
        ("X Position [mm]", "position"),
        ("Position_Y_mm", "position"),
        ("Z-Achse Position", "position"),
        ("Fz [N]", "force"),
        ("actual_current_5", "force"),
        ("dq7", "velocity"),
        ("actual_qd_2", "velocity"),
    ],
)
def test_names_of_one_of_many_axes_are_known(name: str, role: str) -> None:
    roles = ("time", "position", "force", "velocity")
    assert [other for other in roles if is_usual(name, other, numbered=True)] == [role]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "name",
    [
        "t1",
        "time2",
        "target_q_0",
        "q1_ref",
        "tau_J_d",
        "phase1",
        "q123",
        "Index",
        "matrix",
        "Tx",
        "y",
        "fx_ref",
        "joint3",
    ],
)
def test_other_numbered_names_are_none(name: str) -> None:
    roles = ("time", "position", "force", "velocity")
    assert not any(is_usual(name, role, numbered=n) for role in roles for n in (False, True))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("position", "unit", "force"),
    [
        ("pos_estimate [turns]", 1.0 / (2.0 * np.pi), "iq_measured [N m]"),
        ("axis0.encoder.pos_estimate [rev]", 1.0 / (2.0 * np.pi), "axis0.motor.torque_estimate [N m]"),
        ("G1_XIST1 [deg]", 180.0 / np.pi, "r80: Actual torque value [Nm]"),
        ("r482[0]: Encoder actual position value Gn_XIST1: Encoder 1 [rad]", 1.0, "Active Torque [mN m]"),
        ("q4 [rad]", 1.0, "tau_J4 [Nm]"),
        ("MAIN.fbAxis.fActPos [deg]", 180.0 / np.pi, "MAIN.fbAxis.lrActTorque [Nm]"),
        ("angular_position [rad]", 1.0, "Torque sensor [Nm]"),
    ],
)
def test_a_single_axis_is_read(position: str, unit: float, force: str, tmp_path: Path) -> None:
    log = motion(1)
    push = log.force_N * (1e3 if "mN" in force else 1.0)
    assert close(
        read_log(write(tmp_path / "a.csv", **{"t [s]": log.time_s, position: unit * log.position_m, force: push})), log
    )


@pytest.mark.parametrize("count", [2, 7])
def test_which_of_many_axes_is_asked(count: int, tmp_path: Path) -> None:
    logs = [motion(seed) for seed in range(count)]
    columns = {f"q{k} [rad]": log.position_m for k, log in enumerate(logs)}
    columns |= {f"tau_J{k} [mN m]": 1e3 * log.force_N for k, log in enumerate(logs)}
    path = write(tmp_path / "log.csv", **{"t [s]": logs[0].time_s}, **columns)
    with pytest.raises(InputError, match=r'one column; .*position_rad = \{ variable = "q0 \[rad\]", unit = "rad" \}'):
        read_log(path)
    stated = {"position_rad": "q1 [rad]", "torque_Nm": {"variable": "tau_J1 [mN m]", "unit": "mN m"}}
    assert close(read_log(path, table=stated), logs[1])


def test_an_axis_without_a_number_comes_first(tmp_path: Path) -> None:
    log = motion(3)
    columns = {
        "t [s]": log.time_s,
        "angle [rad]": log.position_m,
        "q2 [rad]": -log.position_m,
        "torque [N m]": log.force_N,
    }
    assert close(read_log(write(tmp_path / "log.csv", **columns)), log)


def test_axes_without_units_are_all_named(tmp_path: Path) -> None:
    log = motion(4)
    columns = {"t [s]": log.time_s, "q1": log.position_m, "q2": log.position_m, "tau [N m]": log.force_N}
    message = r'q1, q2 are there without a unit; .* says which: position_rad = \{ variable = "q1", unit = "\.\.\."'
    with pytest.raises(InputError, match=message):
        read_log(write(tmp_path / "log.csv", **columns))


def test_counts_without_their_number_are_refused_with_the_line_to_write(tmp_path: Path) -> None:
    log = motion(5)
    columns = {"Time [sec]": log.time_s, "Position [cnt]": log.position_m * 4096 / (2 * np.pi)}
    columns |= {"Velocity [cnt/sec]": log.position_m, "Active Current [A]": 2.0 * log.force_N}
    path = write(tmp_path / "log.csv", **columns)
    line = '{ variable = "Position [cnt]", unit = "counts", counts_per = ... }'
    assert f"position_m = {line} or position_rad = {line}" in run("inspect", path).stdout
    said = refused("inspect", path, "--unit", "position=counts")
    assert 'position_rad = { unit = "counts", counts_per = ... }' in said and "--log FILE.toml" in said
    table = {"position_rad": {"unit": "counts", "counts_per": 4096.0}, "torque_Nm": {"scale": 0.5}}
    assert close(read_log(path, table=table), log)


# --- clocks -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("whole", "part", "per_second"),
    [
        ("header.stamp.sec", "header.stamp.nanosec", 10**9),
        ("secs", "nsecs", 10**9),
        ("time_sec", "time_usec", 10**6),
        ("/joint_states/header/stamp/sec", "/joint_states/header/stamp/nanosec", 10**9),
    ],
)
def test_seconds_in_two_columns_are_one_time(whole: str, part: str, per_second: int, tmp_path: Path) -> None:
    log = motion(6)
    ticks = np.round(log.time_s * per_second).astype(np.int64) + int(0.7 * per_second)
    columns = {whole: 1_700_000_000 + ticks // per_second, part: ticks % per_second}
    path = write(tmp_path / "log.csv", **columns, position_rad=log.position_m, torque_Nm=log.force_N)
    found = read_log(path)
    assert close(found, log) and found.time_s == pytest.approx(log.time_s, abs=1e-9)


def test_a_total_beside_seconds_is_no_part_of_them(tmp_path: Path) -> None:
    log = motion(7)
    nanoseconds = np.round(1e9 * log.time_s).astype(np.int64) + 5 * 10**9
    columns = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds}
    path = write(tmp_path / "log.csv", **columns, position_rad=log.position_m, torque_Nm=log.force_N)
    with pytest.raises(InputError, match="missing: a column time_s"):
        read_log(path)
    found = read_log(path, table={"time_s": {"variable": "nanosec", "unit": "ns"}})
    assert found.rate == pytest.approx(500.0)


@pytest.mark.parametrize("rate", [500.0, 2000.0])
def test_channels_of_several_groups_are_put_on_the_clock_of_position(rate: float, tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    log = motion(8)
    other = np.arange(int(3.0 * rate)) / rate
    force = np.interp(other, log.time_s, log.force_N)
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(samples=force, timestamps=other, name="ActTorque", unit="Nm")])
        file.append([asammdf.Signal(samples=log.position_m, timestamps=log.time_s, name="ActPos", unit="rad")])
        file.save(tmp_path / "log.mf4")
    notes: list[str] = []
    assert close(read_log(tmp_path / "log.mf4", note=notes.append), log)
    assert any("sampled at other times than position" in note for note in notes) == (rate != 500.0)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_a_channel_beyond_its_records_is_refused(version: str, tmp_path: Path) -> None:
    """By a damaged offset, which sends code in C through all of the memory."""
    asammdf = pytest.importorskip("asammdf")
    log = motion(12)
    with asammdf.MDF(version=version) as file:
        signals = [("ActPos", "rad", log.position_m), ("ActTorque", "Nm", log.force_N)]
        stamps = log.time_s
        file.append([asammdf.Signal(samples=v, timestamps=stamps, name=n, unit=u) for n, u, v in signals])
        saved = file.save(tmp_path / "log.mf4")
    assert close(read_log(saved), log)
    content, places = bytearray(saved.read_bytes()), []
    with asammdf.MDF(saved) as file:
        for channel in file.groups[0].channels:
            is_old = version[0] == "3"
            places.append(channel.address + (186 if is_old else 24 + 8 * channel.links_nr + 4))
    for place in places:
        for offset in (0xC9, 0x440000):
            damaged = bytearray(content)
            width = 2 if version[0] == "3" else 4
            damaged[place : place + width] = min(offset, 256**width - 1).to_bytes(width, "little")
            (tmp_path / "damaged.mf4").write_bytes(damaged)
            with pytest.raises(InputError, match="lies beyond its records"):
                read_log(tmp_path / "damaged.mf4")


def test_a_damaged_file_is_refused_without_its_reader_s_own_words(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    asammdf = pytest.importorskip("asammdf")
    log = motion(17)
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(samples=log.position_m, timestamps=log.time_s, name="ActPos", unit="rad")])
        saved = file.save(tmp_path / "log.mf4")
    saved.write_bytes(saved.read_bytes().replace(b"##FH", b"####"))
    said = logging.getLogger("asammdf")
    said.addHandler(caplog.handler)
    with pytest.raises(InputError, match="a whole MDF file"):
        read_log(saved)
    said.removeHandler(caplog.handler)
    assert caplog.records == [] and not said.disabled


# --- lists in cells -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("form", ['"[{}, {}]"', "[{} {}]", '"({}, {})"', "\"array('d', [{}, {}])\"", "[{}, {}]"])
def test_lists_in_cells_are_columns(form: str, separator: str, tmp_path: Path) -> None:
    first, second = motion(9), motion(10)
    lists = [[getattr(log, name).tolist() for log in (first, second)] for name in ("position_m", "force_N")]
    lines = [separator.join(["t [s]", "frame", "position", "effort"])]
    for k, t in enumerate(first.time_s.tolist()):
        cells = [form.format(own[k], other[k]) for own, other in lists]
        lines.append(separator.join([repr(t), "base", *cells]))
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"position\[0\], position\[1\] are there without a unit"):
        read_log(path)
    with pytest.raises(InputError, match=r'position_rad = \{ variable = "position\[0\]", unit = "deg" \}'):
        read_log(path, table={"position_rad": {"unit": "deg"}})
    table = {
        "position_rad": {"variable": "position[1]", "unit": "rad"},
        "torque_Nm": {"variable": "effort[1]", "unit": "N m"},
    }
    assert close(read_log(path, table=table), second)
    path.write_text(
        "\n".join([*lines[:9], lines[9].replace(form.format(lists[0][0][8], lists[0][1][8]), "[]"), *lines[10:]])
    )
    with pytest.raises(InputError, match=r"row 9 \(line 10\)"):
        read_log(path, table=table)


@pytest.mark.parametrize("cell", ["(a, b)", "[1]", "phase (1, 2) of 3"])
def test_brackets_around_something_else_are_left(cell: str, tmp_path: Path) -> None:
    log = motion(11)
    lines = ["t [s];q (rad);tau [N m];note"]
    rows = zip(log.time_s.tolist(), log.position_m.tolist(), log.force_N.tolist(), strict=True)
    lines += [f"{t!r};{x!r};{f!r};{cell}" for t, x, f in rows]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    assert close(read_log(tmp_path / "log.csv"), log)


# --- units with a number, stamps of minutes -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "factors"),
    [
        (("Time [0.1 ms]", "Position [0.001 deg]", "Torque [Nm]"), (1e4, 180e3 / np.pi, 1.0)),
        (("Zeit (10 us)", "Lageistwert (0,001 °)", "Drehmoment (0.01 Nm)"), (1e5, 180e3 / np.pi, 100.0)),
        (("t [s]", "q [1e-6 rad]", "M [mNm]"), (1.0, 1e6, 1e3)),
    ],
)
@pytest.mark.parametrize("as_row", [False, True])
def test_a_unit_may_have_a_number(
    names: tuple[str, ...], factors: tuple[float, ...], as_row: bool, tmp_path: Path
) -> None:
    log = motion(13)
    columns = [f * values for f, values in zip(factors, (log.time_s, log.position_m, log.force_N), strict=True)]
    lines = [";".join(map(repr, row)) for row in zip(*(values.tolist() for values in columns), strict=True)]
    header = [";".join(names)]
    if as_row:
        header = [";".join(name[: name.index(" ")] for name in names), ";".join(n[n.index(" ") + 1 :] for n in names)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*header, *lines]))
    found = read_log(path)
    assert close(found, log) and found.rate == pytest.approx(500.0)
    position = names[1] if not as_row else names[1][: names[1].index(" ")]
    assert close(read_log(path, table={"position_rad": position}), log)  # named alone: the file's unit holds
    other = read_log(path, table={"position_rad": {"variable": position, "unit": "mrad"}})
    np.testing.assert_allclose(other.position_m, columns[1] / 1e3)


def test_a_wrap_of_a_unit_with_a_number_keeps_the_number(tmp_path: Path) -> None:
    log = motion(14)
    ticks = 40.0 * log.position_m * 180e3 / np.pi
    columns = {"t [s]": log.time_s, "q [0.001 deg]": np.mod(ticks, 360e3), "M [Nm]": log.force_N}
    path = write(tmp_path / "log.csv", **columns)
    with pytest.raises(InputError, match=r'unit = "deg", scale = 0\.001, wrap = 360000\.0 \}'):
        read_log(path)
    table = {"position_rad": {"variable": "q [0.001 deg]", "unit": "deg", "scale": 0.001, "wrap": 360e3}}
    for stated in (table, {"position_rad": {"wrap": 360e3}}):
        moved = read_log(path, table=stated).position_m
        np.testing.assert_allclose(moved - moved[0], 40.0 * (log.position_m - log.position_m[0]), atol=1e-9)


@pytest.mark.parametrize("unit", ["0.1 %", "0.1 furlong", "0 rad", "2 counts"])
def test_a_number_before_what_no_factor_makes_si_is_refused(unit: str, tmp_path: Path) -> None:
    log = motion(15)
    columns = {"t [s]": log.time_s, f"q [{unit}]": log.position_m, "M [Nm]": log.force_N}
    with pytest.raises(InputError, match=f"is there in {unit}, which is none of"):
        read_log(write(tmp_path / "log.csv", **columns))


@pytest.mark.parametrize("mark", [".", ","])
@pytest.mark.parametrize("start", [0.0, 3598.5])
def test_minutes_and_seconds_are_times_over_the_hour(mark: str, start: float, tmp_path: Path) -> None:
    log = motion(16)
    lines = ["time;position [rad];torque [Nm]"]
    for t, x, f in zip(log.time_s.tolist(), log.position_m.tolist(), log.force_N.tolist(), strict=True):
        whole = round(1e3 * (start + t))
        stamp = f"{whole // 60000 % 60:02d}:{whole // 1000 % 60:02d}{mark}{whole % 1000:03d}"
        lines.append(f"{stamp};{x!r};{f!r}")
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    found = read_log(path)
    assert close(found, log) and found.time_s == pytest.approx(log.time_s, abs=1e-9)
