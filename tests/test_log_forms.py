"""Logs in odd forms: names of drives, no position, no force, repeated stamps, wraps, columns that are missing."""

import gzip
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from cli_cases import refused, run
from sgms_mhe.api.inputs import read_log, read_logs
from sgms_mhe.configuration import load_machine
from sgms_mhe.logfiles import reading, text
from sgms_mhe.logfiles.names import is_usual
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.logfiles.reading import read_table, understand
from sgms_mhe.logfiles.table import Table
from sgms_mhe.machine import LogMapping
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]


def rotor(seed: int, *, rate: float = 800.0, seconds: float = 8.0, travel: float = 9.0) -> Log:
    """A rotor under two sines, with Coulomb and viscous friction."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * rate)) / rate
    low, high = rng.uniform(0.15, 0.3), rng.uniform(1.0, 1.6)
    position = travel * np.sin(2 * np.pi * low * time) + 0.05 * travel * np.sin(2 * np.pi * high * time)
    velocity = np.gradient(position, 1.0 / rate)
    friction = 0.05 * np.tanh(velocity / 0.01) + 0.002 * velocity
    torque = 2e-3 * np.gradient(velocity, 1.0 / rate) + friction + rng.normal(0.0, 2e-3, len(time))
    return Log(time, position, torque, rate, velocity_m_s=velocity, friction_N=friction, kind="rotary")


def write(path: Path, **columns: Array) -> Path:
    values = np.column_stack(list(columns.values()))
    np.savetxt(path, values, delimiter=",", header=",".join(columns), comments="", fmt="%.15g")
    return path


def own(log: Log, *names: str) -> dict[str, Array]:
    found = dict(zip(("time_s", "position_rad", "torque_Nm"), (log.time_s, log.position_m, log.force_N), strict=True))
    return {name: found[name] for name in names or found}


# --- names --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("Position actual value [mm]", "position"),
        ("Position Actual Value (deg)", "position"),
        ("pos.act", "position"),
        ("X_act", "position"),
        ("Lageistwert [mm]", "position"),
        ("Istposition [mm]", "position"),
        ("Axes.A1.ActPos", "position"),
        ("run.pos.act", "position"),
        ("rec/axis:torque.act [Nm]", "force"),
        ("Current Position [um]", "position"),
        ("Axis 1 Position Feedback [rad]", "position"),
        ("Zeit [ms]", "time"),
        ("Time stamp [s]", "time"),
        ("Torque actual value [N m]", "force"),
        ("Drehmoment Istwert [Nm]", "force"),
        ("Istmoment [Nm]", "force"),
        ("Motorstrom [A]", "force"),
        ("Actual current [A]", "force"),
        ("Istgeschwindigkeit [mm/s]", "velocity"),
        ("Velocity actual value [rpm]", "velocity"),
        ("r80 Actual torque value [Nm]", "force"),
        ("r61[1] Actual encoder velocity [rpm]", "velocity"),
        ("S-0-0051 Position feedback value 1 [Deg]", "position"),
        ("S-0-0084 Torque/force feedback value [Nm]", "force"),
        ("0x6064 Position actual value [inc]", "position"),
        ("PL.FB (deg)", "position"),
        ("IL.FB (A)", "force"),
        ("/joint_states/joint1/effort", "force"),
        ("position[0]", "position"),
        ("Temps (s)", "time"),
        ("Velocità [rad/s]", "velocity"),
        ("Posición {rad}", "position"),
        ("Couple <Nm>", "force"),
        ("位置(rad)", "position"),
        ("τ (N·m)", "force"),
        ("Istdrehzahl [1/min]", "velocity"),
    ],
)
def test_names_of_drives_are_known(name: str, role: Any) -> None:
    assert is_usual(name, role)
    assert not any(is_usual(name, other) for other in ("time", "position", "force", "velocity") if other != role)


@pytest.mark.parametrize(
    "name",
    "Lagesollwert [mm]|Position demand value [mm]|pos.set|x_cmd|Target position|Schleppabstand [mm]|pos_err [mm]|"
    "Following error actual value [mm]|error.position|Reference.angle|Max torque|Torque limit|Torque set|q_ref|"
    "Solldrehmoment|Positionsabweichung|Software position limit|run.pos.set|axis.set.pos|"
    "p1122 Torque limit|S-0-0047 Position command value|0x607A Target position|IL.CMD (A)|PL.ERR (deg)".split("|"),
)
def test_set_points_and_errors_are_no_measurements(name: str) -> None:
    assert not any(is_usual(name, role) for role in ("position", "force", "velocity"))  # type: ignore[arg-type]


def test_a_drive_s_trace_needs_no_more_than_the_force_s_scale(tmp_path: Path) -> None:
    log = rotor(3)
    degrees = np.rad2deg(log.position_m)
    path = write(
        tmp_path / "trace.csv",
        **{
            "Time [ms]": 1e3 * log.time_s,
            "Position demand value [deg]": degrees + 1.0,
            "Position actual value [deg]": degrees,
            "Following error [deg]": np.full(len(log), 1.0),
            "Velocity actual value [rpm]": log.velocity_m_s * 30.0 / np.pi,  # type: ignore[operator]
            "Current actual value [A]": log.force_N / 0.13,
        },
    )
    assert "scale = ..." in run("inspect", path).stdout
    found = read_log(path, table={"torque_Nm": {"scale": 0.13}})
    assert found.position_m == pytest.approx(log.position_m) and found.force_N == pytest.approx(log.force_N)
    assert found.velocity_m_s is None  # beside a position it is computed


# --- what stands for something else -----------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "factor"), [("sec", 1.0), ("s", 1.0), ("ms", 1e3), ("min", 1.0 / 60.0)])
@pytest.mark.parametrize("rate", [100.0, 500.0])
def test_durations_and_clocks_with_milliseconds_are_times(
    unit: str, factor: float, rate: float, tmp_path: Path
) -> None:
    log = rotor(5, rate=rate, seconds=4.0)
    spans = [f"{factor * t:.9g} {unit}" for t in log.time_s]
    clocks = [f"10:59:{57 + int(k // 1000)}:{k % 1000:03d}" for k in np.round(1e3 * log.time_s).astype(int)]
    for name, times in (("spans.csv", spans), ("clocks.csv", clocks[: int(3.0 * rate)])):
        rows = zip(times, log.position_m, log.force_N, strict=False)
        content = "Period,2 ms\nTime,position_rad,torque_Nm\n" + "".join(f"{t},{q:.17g},{u:.17g}\n" for t, q, u in rows)
        (tmp_path / name).write_text(content)
        found = read_log(tmp_path / name)
        assert found.rate == pytest.approx(rate, rel=1e-3) and len(found) == len(times)
        assert found.position_m == pytest.approx(log.position_m[: len(times)])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("names", "turn", "push"),
    [
        (("Temps (s)", "Position (deg)", "Vitesse (rpm)", "Couple (N.m)"), 180.0 / np.pi, 1.0),
        (("Tempo <s>", "Posizione <rad>", "Velocità <rpm>", "Coppia <mNm>"), 1.0, 1e3),
        (("Tiempo [s]", "Posición [rev]", "Velocidad [rpm]", "Par [N-m]"), 0.5 / np.pi, 1.0),
        (("Zeit [Sek]", "Lageistwert [Grad]", "Drehzahlistwert [1/min]", "Drehmomentistwert [Nm]"), 180.0 / np.pi, 1.0),
        (("时间{s}", "角度{deg}", "速度{rpm}", "扭矩{Nm}"), 180.0 / np.pi, 1.0),
        (("t (s)", "θ (°)", "ω (rpm)", "τ (N·m)"), 180.0 / np.pi, 1.0),
    ],
)
def test_names_in_other_languages_are_read(
    names: tuple[str, ...], turn: float, push: float, seed: int, tmp_path: Path
) -> None:
    log = rotor(seed, rate=500.0 + 250.0 * seed)
    assert log.velocity_m_s is not None
    values = (log.time_s, turn * log.position_m, log.velocity_m_s * 30.0 / np.pi, push * log.force_N)
    found = read_log(write(tmp_path / "log.csv", **dict(zip(names, values, strict=True))))
    assert found.kind == "rotary" and found.velocity_m_s is None
    assert found.position_m == pytest.approx(log.position_m) and found.force_N == pytest.approx(log.force_N)


@pytest.mark.parametrize("unit", ["", " [grad]", " [furlong]", " [A]"])
def test_a_position_without_a_usable_unit_is_no_missing_one(unit: str, tmp_path: Path) -> None:
    log = rotor(4)
    assert log.velocity_m_s is not None
    columns = {"Position actual value" + unit: log.position_m, "Velocity actual value [rad/s]": log.velocity_m_s}
    path = write(tmp_path / "log.csv", time_s=log.time_s, torque_Nm=log.force_N, **columns)
    with pytest.raises(InputError, match=r"Position actual value.* is there (without a unit|in )"):
        read_log(path)
    stated = {"velocity_rad_s": {"variable": "Velocity actual value"}}
    moved = log.position_m - log.position_m[0]
    assert read_log(path, table=stated).position_m == pytest.approx(moved, abs=1e-2 * np.ptp(moved))


@pytest.mark.parametrize(
    ("names", "missing"),
    [
        (("Time [s]", "J1 [deg]", "Load J1 [Nm]"), "position_rad"),
        (("Time [s]", "J1", "Load J1 [N m]"), "position_rad"),
        (("Time [s]", "Stage [mm]", "Coil"), "position_m"),
        (("Time [s]", "Stage", "Coil"), "position_m"),
    ],
)
def test_what_is_missing_is_of_the_kind_that_units_tell(names: tuple[str, ...], missing: str, tmp_path: Path) -> None:
    log = rotor(6)
    path = write(tmp_path / "log.csv", **dict(zip(names, (log.time_s, log.position_m, log.force_N), strict=True)))
    force = "torque_Nm" if missing == "position_rad" else "force_N"
    with pytest.raises(InputError, match=f"missing: a column {missing} and a column {force};"):
        read_log(path)
    assert json.loads(run("inspect", path, "--json").stdout)["missing"] == [missing, force]


@pytest.mark.parametrize("header", ["velocity_rad_s", "Velocity actual value [rpm]", "omega (deg/s)"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_velocity_alone_is_integrated_and_said(header: str, seed: int, tmp_path: Path) -> None:
    log = rotor(seed)
    assert log.velocity_m_s is not None
    factor = {"velocity_rad_s": 1.0, "Velocity actual value [rpm]": np.pi / 30.0, "omega (deg/s)": np.pi / 180.0}[
        header
    ]
    velocity = log.velocity_m_s / factor
    velocity[100:103] = np.nan
    notes: list[str] = []
    path = write(tmp_path / "log.csv", time_s=log.time_s, **{header: velocity}, torque_Nm=log.force_N)
    found = read_log(path, note=notes.append)
    expected = log.position_m - log.position_m[0]
    good = np.isfinite(found.position_m)
    assert np.flatnonzero(~good).tolist() == [100, 101, 102]
    assert found.position_m[good] == pytest.approx(expected[good], abs=1e-3 * np.ptp(expected))
    assert len(notes) == 1 and "is integrated from 0" in notes[0] and "rad by the end" in notes[0]


@pytest.mark.parametrize("has_position", [True, False], ids=["position", "none"])
@pytest.mark.parametrize("timing", ["instant", "mean"])
def test_a_recorded_velocity_makes_the_acceleration_that_a_position_makes(
    timing: str, has_position: bool, tmp_path: Path
) -> None:
    """An acceleration half a sample ahead of the force is a delay of it that the axis has not."""
    (tmp_path / "relay.toml").write_text(RELAY)
    machine, log = load_machine(tmp_path / "relay.toml"), rotor(3, rate=1000.0)
    assert log.velocity_m_s is not None
    mean = np.diff(log.position_m, prepend=2.0 * log.position_m[0] - log.position_m[1]) * log.rate
    velocity = mean if timing == "mean" and has_position else log.velocity_m_s  # integrated: of the instants
    names = ("time_s", "position_rad", "torque_Nm") if has_position else ("time_s", "torque_Nm")
    found, plain = (
        prepare(machine, read_log(write(tmp_path / "log.csv", **columns))).signals
        for columns in ({**own(log, *names), "velocity_rad_s": velocity}, own(log))
    )
    change = np.gradient(plain.acceleration)[200:-200]  # the filters have settled
    apart = (found.acceleration - plain.acceleration)[200:-200]
    assert abs(float(apart @ change) / float(change @ change)) < 0.02  # samples


def test_a_friction_alone_stands_for_the_force(tmp_path: Path) -> None:
    log = rotor(4)
    assert log.friction_N is not None
    notes: list[str] = []
    path = write(tmp_path / "log.csv", **own(log, "time_s", "position_rad"), friction_Nm=log.friction_N)
    found = read_log(path, note=notes.append)
    assert found.force_N == pytest.approx(log.friction_N) and found.friction_N is not None
    assert len(notes) == 1 and "friction_Nm stands for it" in notes[0]
    check_plausible(found, None)
    assert "torque_Nm" in refused(
        "start", write(tmp_path / "no.csv", **own(log, "time_s", "position_rad")), "--out", tmp_path / "x.toml"
    )


# --- repeated stamps ----------------------------------------------------------------------------------------------


def test_a_row_that_was_written_twice_is_left_out_and_said(tmp_path: Path) -> None:
    log = rotor(5)
    twice = {name: np.insert(values, 700, values[699]) for name, values in own(log).items()}
    notes: list[str] = []
    found = read_log(write(tmp_path / "log.csv", **twice), note=notes.append)
    assert found.position_m == pytest.approx(log.position_m)
    assert len(notes) == 1 and "row 701 (line 702)" in notes[0] and "one sample fewer" in notes[0]


@pytest.mark.parametrize("count", [1, 6])
def test_jittery_stamps_with_repeats_are_resampled(count: int, tmp_path: Path) -> None:
    log = rotor(6, rate=500.0)
    rng = np.random.default_rng(count)
    late = log.time_s + 2e-5 * rng.standard_normal(len(log))
    for k in rng.choice(np.arange(10, len(log)), count, replace=False):
        late[k] = late[k - 1]
    path = write(tmp_path / "log.csv", **{**own(log), "time_s": late})
    notes: list[str] = []
    with pytest.raises(InputError, match="resample = true"):
        read_log(path, note=notes.append)
    assert len(notes) == 1 and "one sample fewer" in notes[0]  # said, though the log is refused
    found = read_log(path, table={"resample": True})
    assert found.position_m == pytest.approx(np.interp(found.time_s, log.time_s, log.position_m), abs=5e-3)


def test_logs_of_one_axis_are_resampled_to_the_lowest_of_their_rates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each by itself goes to its own mean rate, and logs of one call share one."""
    paths = []
    for rate in (500.0, 530.0, 620.0):
        log = rotor(8, rate=rate)
        late = log.time_s + 0.04 / rate * np.random.default_rng(int(rate)).standard_normal(len(log))
        paths.append(write(tmp_path / f"{rate:g}.csv", **{**own(log), "time_s": late}))
    notes: list[str] = []
    read_tables: list[Path] = []

    def count(path: Path, mapping: LogMapping | None) -> Table:
        read_tables.append(path)
        return read_table(path, mapping)

    monkeypatch.setattr(reading, "read_table", count)
    read = read_logs(paths, table={"resample": True}, note=notes.append)
    assert sorted(map(read_tables.count, paths)) == [1, 2, 2]  # that of the lowest rate is read once
    assert len({log.rate for log in read}) == 1 and read[0].rate == pytest.approx(500.0, rel=1e-3)
    assert len(notes) == 3  # each said once
    assert {log.rate for log in read_logs(paths[2], table={"resample": True, "rate": 400.0})} == {400.0}
    with pytest.raises(InputError, match="rate"):
        read_log(paths[0], table={"rate": 400.0})


def test_stamps_coarser_than_the_samples_are_refused(tmp_path: Path) -> None:
    log = rotor(7)
    path = write(tmp_path / "log.csv", **{**own(log), "time_s": np.floor(log.time_s * 80.0) / 80.0})
    with pytest.raises(InputError, match="coarser than the samples"):
        read_log(path)


# --- positions that start over ----------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [25.0, 7.0, 2.0 * np.pi, 0.36, 12.75])
@pytest.mark.parametrize("seed", [1, 8])
def test_any_period_is_found(period: float, seed: int, tmp_path: Path) -> None:
    log = rotor(seed, rate=1000.0, travel=2.2 * period)
    wrapped = {**own(log), "position_rad": np.mod(log.position_m + 0.3 * period, period)}
    path = write(tmp_path / "log.csv", **wrapped)
    with pytest.raises(InputError, match=r"such jumps.*a position that goes on") as caught:
        read_log(path)
    stated = float(caught.value.allowed.partition("wrap = ")[2].partition(" ")[0])
    assert stated == pytest.approx(period, rel=1e-9)
    found = read_log(path, table={"position_rad": {"wrap": stated}})
    assert np.diff(found.position_m) == pytest.approx(np.diff(log.position_m), abs=1e-9)


@pytest.mark.parametrize("period", [0.442, 7.31, 0.0997])
def test_the_digits_of_a_period_are_those_of_the_jumps(period: float, tmp_path: Path) -> None:
    log = rotor(2, rate=400.0, travel=1.2 * period)  # steps so long that a rounder number lies among them
    step = period / 2e4
    wrapped = np.round(np.mod(log.position_m, period) / step) * step
    path = write(tmp_path / "log.csv", **{**own(log), "position_rad": wrapped})
    with pytest.raises(InputError) as caught:
        read_log(path)
    assert float(caught.value.allowed.partition("wrap = ")[2].partition(" ")[0]) == pytest.approx(period, rel=1e-9)


def test_a_gap_does_not_slow_the_grid(tmp_path: Path) -> None:
    log = rotor(14, rate=500.0)
    holes = {name: np.delete(values, np.arange(1000, 1100)) for name, values in own(log).items()}
    found = read_log(write(tmp_path / "log.csv", **holes), table={"resample": True})
    assert found.rate == pytest.approx(500.0, rel=1e-9) and len(found) == len(log)
    assert np.count_nonzero(np.isnan(found.position_m)) == pytest.approx(100, abs=2)


@pytest.mark.parametrize("group", ["run", "run/axis 1"])
def test_a_log_s_own_names_may_stand_in_groups(group: str, tmp_path: Path) -> None:
    h5py, log = pytest.importorskip("h5py"), rotor(15)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name, values in {**own(log, "time_s", "position_rad"), "friction_Nm": log.friction_N}.items():
            file[f"{group}/{name}"] = values
    assert read_log(tmp_path / "log.h5").force_N == pytest.approx(log.friction_N)
    with h5py.File(tmp_path / "log.h5", "a") as file:
        file["other/position_rad"] = log.position_m
    with pytest.raises(InputError, match="one column"):
        read_log(tmp_path / "log.h5")


def test_jumps_that_are_no_period_are_taken(tmp_path: Path) -> None:
    log = rotor(9)
    position = log.position_m.copy()
    for start in (1000, 2500):  # an encoder that stuck
        position[start : start + 900] = position[start]
    read_log(write(tmp_path / "stuck.csv", **{**own(log), "position_rad": position}))
    homed = np.where(log.time_s < 3.0, log.position_m, log.position_m + 41.3)
    read_log(write(tmp_path / "homed.csv", **{**own(log), "position_rad": homed}))


# --- lengths and clocks -----------------------------------------------------------------------------------------


def test_channels_that_end_a_little_apart_are_cut_and_said(tmp_path: Path) -> None:
    log, notes = rotor(10), list[str]()
    columns = own(log)
    columns["torque_Nm"] = columns["torque_Nm"][:-7]
    savemat(tmp_path / "log.mat", columns)
    found = read_log(tmp_path / "log.mat", note=notes.append)
    assert len(found) == len(log) - 7 and found.position_m == pytest.approx(log.position_m[:-7])
    assert len(notes) == 1 and f"cut to the first {len(log) - 7}" in notes[0]
    savemat(tmp_path / "short.mat", {**columns, "torque_Nm": log.force_N[:-100]})
    with pytest.raises(InputError, match="as many rows as time_s has"):
        read_log(tmp_path / "short.mat")


# --- what is missing ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("left_out", "missing"), [("time_s", ["time_s"]), ("position_rad", ["position_rad"]), ("torque_Nm", ["torque_Nm"])]
)
def test_inspect_lists_every_column_where_one_is_missing(left_out: str, missing: list[str], tmp_path: Path) -> None:
    log = rotor(11)
    columns = {name: values for name, values in own(log).items() if name != left_out}
    extra = np.where(np.arange(len(log)) % 9 == 0, np.nan, 40.0)
    path = write(tmp_path / "log.csv", **columns, winding=extra)
    result = run("inspect", path, "--json")
    content = json.loads(result.stdout)
    assert result.exit_code == 1
    assert content["missing"] == missing and len(content["problems"]) == 1
    by_name = {column["from"]: column for column in content["columns"]}
    assert list(by_name) == [*columns, "winding"]
    for name, values in columns.items():
        assert (by_name[name]["min"], by_name[name]["max"]) == pytest.approx((values.min(), values.max()))
    assert by_name["winding"]["missing"] == len(extra[np.isnan(extra)])
    text = run("inspect", path).stdout
    assert all(name in text for name in by_name) and f"missing       {missing[0]}" in text
    assert run("inspect", write(tmp_path / "whole.csv", **own(log)), "--json").exit_code == 0


def test_inspect_lists_columns_without_units_and_with_words(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,pos,mode,force\n" + "".join(f"{0.001 * k:.3f},{k % 7},run,{k % 5}\n" for k in range(50)))
    result = run("inspect", path, "--json")
    content = json.loads(result.stdout)
    assert result.exit_code == 1 and "without a unit" in content["problems"][0]
    assert content["missing"] == ["time_s", "position_m", "force_N"]
    mode = next(column for column in content["columns"] if column["from"] == "mode")
    assert (mode["min"], mode["max"]) == (None, None)
    assert run("inspect", path, "--unit", "time=s", "--unit", "position=mm", "--unit", "force=N").exit_code == 0


def test_notes_are_kept_by_the_reading(tmp_path: Path) -> None:
    log = rotor(12)
    reading = understand(
        write(tmp_path / "log.csv", time_s=log.time_s, velocity_rad_s=log.velocity_m_s, torque_Nm=log.force_N)
    )  # type: ignore[arg-type]
    assert len(reading.notes) == 1
    assert replace(reading, notes=()).notes == ()


# --- a force of two values --------------------------------------------------------------------------------------

RELAY = """
name = "relay"
description = "a rotor"
[plant]
kind = "rotary"
inertia = 2e-3
[friction]
stiffness = [50.0]
fraction = [1.0]
viscous = 0.002
coulomb = 0.05
[sampling]
rate = 1000.0
update_rate = 100.0
velocity_cutoff = 100.0
max_velocity = 500.0
integrator = { scheme = "flow" }
[estimator]
horizon = 5
parameters = ["coulomb"]
"""


def driven(torque: Array) -> Log:
    """A rotor of 2e-3 kg m^2 with friction under a torque at 1 kHz."""
    angle = speed = 0.0
    angles = []
    for value in torque:
        angles.append(angle)
        for _ in range(10):
            speed += 1e-4 * (value - 0.05 * np.tanh(speed / 0.01) - 0.002 * speed) / 2e-3
            angle += 1e-4 * speed
    return Log(np.arange(len(torque)) / 1e3, np.round(np.array(angles) / 1e-5) * 1e-5, torque, 1e3, kind="rotary")


@pytest.mark.parametrize(("level", "period"), [(0.4, 1.0), (0.15, 0.31)])
def test_a_torque_of_two_values_is_no_saturation(level: float, period: float, tmp_path: Path) -> None:
    (tmp_path / "relay.toml").write_text(RELAY)
    machine = load_machine(tmp_path / "relay.toml")
    time = np.arange(9000) / 1e3
    found = prepare(machine, driven(level * np.where(np.mod(time, period) < period / 2, 1.0, -1.0)))
    assert not any("saturated" in warning for warning in found.warnings)
    assert np.mean(found.block >= 0) > 0.9
    swing = 1.5 * level * np.sin(2.0 * np.pi * time / period)  # cut off at the level for half of the time, or less
    clipped = driven(swing)
    cut = replace(clipped, force_N=np.clip(swing, -1.2 * level, 1.2 * level))
    assert any("saturated" in warning for warning in prepare(machine, cut).warnings)


# --- compressed texts -----------------------------------------------------------------------------------------------


def test_a_compressed_text_is_read_as_it_is(tmp_path: Path) -> None:
    plain = write(tmp_path / "log.csv", **own(rotor(3)))
    packed = tmp_path / "log.csv.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    a, b = read_log(plain), read_log(packed)
    assert np.array_equal(a.position_m, b.position_m) and np.array_equal(a.force_N, b.force_N)


@pytest.mark.parametrize("keep", [0, 6, 3000, -4])
def test_a_damaged_compressed_text_is_refused(keep: int, tmp_path: Path) -> None:
    packed = tmp_path / "log.csv.gz"
    content = gzip.compress(write(tmp_path / "log.csv", **own(rotor(3))).read_bytes())
    packed.write_bytes(content[:keep] if keep else b"no gzip at all")
    said = refused("inspect", packed)
    assert "log.csv.gz" in said and "a text that gzip compressed, whole" in said


def test_a_compressed_text_that_no_memory_holds_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text, "LARGEST", 1000)
    packed = tmp_path / "log.csv.gz"
    packed.write_bytes(gzip.compress(write(tmp_path / "log.csv", **own(rotor(3))).read_bytes()))
    with pytest.raises(InputError, match="more than 1000 bytes"):
        read_log(packed)


def test_another_compressed_format_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "log.mat.gz").write_bytes(gzip.compress(b"MATLAB\x00\x01"))
    assert "needs its own suffix" in refused("inspect", tmp_path / "log.mat.gz")
