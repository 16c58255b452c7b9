"""Axes that commands drive: [drive], logs without a force, free runs from the command, and their identification."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import done, files, refused
from sgms_mhe.api.estimation import predict
from sgms_mhe.api.exporting import export
from sgms_mhe.api.identification import identify
from sgms_mhe.api.inputs import read_log, read_logs
from sgms_mhe.configuration import carry_load, make_machine, override_machine
from sgms_mhe.identification.writing import machine_toml
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.recordings.free_run import FreeRunRecord, run_freely
from sgms_mhe.signals.chain import readings
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.statements import Rule

Array = NDArray[np.float64]

SERVO: Mapping[str, Any] = {
    "name": "servo",
    "plant": {"kind": "rotary", "inertia": 0.02, "weight_radius": 0.04},
    "friction": {"law": "switching", "stiffness": [20.0], "fraction": [1.0], "viscous": 0.03, "coulomb": 0.1},
    "sampling": {"rate": 100.0, "update_rate": 10.0, "velocity_cutoff": 20.0, "max_velocity": 10.0},
    "drive": {
        "kind": "position_loop",
        "torque_constant": 1.6,
        "resistance": 2.6,
        "supply": 12.0,
        "gain": 16.0,
        "gain_unit": 0.2,
        "clamp": 0.7,
        "delay": 0.03,
        "speed_limit": 4.0,
    },
    "effects": [{"name": "load_dependent_friction", "ratio": 0.15, "friction_ratio": 1.0}],
}
LOADS = ((0.5, 0.1), (0.5, 0.15), (1.0, 0.1), (1.2, 0.15))
"""Mass [kg] and length [m] of weights."""


@pytest.fixture(scope="module")
def servo() -> Machine:
    return make_machine(SERVO, Path("servo.toml"))


def move_arm(seed: int, rate: float = 100.0, seconds: float = 5.0) -> Trajectory:
    """Steps, then a sweep: what saturates the drive, and what shows its delay."""
    t = np.arange(round(rate * seconds)) / rate
    steps = np.where((t > 0.5) & (t < 1.7), 1.4, 0.0) * (-1.0) ** seed
    sweep = np.where(t > 2.5, np.sin(2.0 * (t - 2.5) ** 2), 0.0)
    return Trajectory(f"arm {seed}", rate, steps + sweep)


def record(machine: Machine, seed: int, load: tuple[float, float] = LOADS[0], gain: float = 16.0) -> Log:
    """A run as a servo on a bus records it: goal and position in counts, the load known."""
    mass, length = load
    run = {"mass": mass, "length": length, "gain": gain, "supply": 12.0}
    config = AxisConfig(encoder_resolution_m=2.0 * np.pi / 4096.0, seed=seed, substeps=50)
    log = simulate_axis(carry_load(machine, run), move_arm(seed), config, truth=False).log
    return replace(log, force_N=np.full(len(log), np.nan), run=run, source=f"run {seed}")


@pytest.mark.parametrize(
    ("drive", "key", "said"),
    [
        ({"kind": "force", "delay": 0.01}, "drive.delay", "does nothing"),
        ({"kind": "voltage", "torque_constant": 1.0, "resistance": 1.0, "gain": 2.0}, "drive.gain", "does nothing"),
        ({"kind": "voltage", "resistance": 1.0}, "drive.torque_constant", "required"),
        ({"kind": "voltage", "torque_constant": 1.0, "resistance": 1.0, "clamp": 0.5}, "drive.supply", "required"),
        ({"kind": "position_loop", "torque_constant": 1.0, "resistance": 1.0}, "drive.supply", "required"),
        ({"clamp": 1.5}, "drive.clamp", "<= 1"),
    ],
)
def test_a_key_that_would_not_act_is_refused(drive: Mapping[str, Any], key: str, said: str) -> None:
    with pytest.raises(InputError, match=key) as caught:
        make_machine({**SERVO, "drive": drive}, Path("servo.toml"))
    assert said in str(caught.value)


def test_every_number_of_a_drive_moves_the_axis(servo: Machine) -> None:
    def move(**drive: float) -> Array:
        return record(override_machine(servo, {"drive": drive}), 0).position_m

    same = move()
    wrong = {
        "torque_constant": 1.7,
        "resistance": 2.9,
        "gain_unit": 0.21,
        "clamp": 0.6,
        "delay": 0.04,
        "speed_limit": 3.0,
        "start": 0.05,
    }
    for key, value in wrong.items():
        assert np.max(np.abs(move(**{key: value}) - same)) > 2e-3, key
    # The goal ends its way at the speed limit, and rests where the loop's error carries the weight.
    slope = np.diff(same[80:110]) * 100.0
    assert np.percentile(slope, 90) == pytest.approx(4.0, rel=0.05)


def test_a_free_run_needs_the_command_alone(servo: Machine) -> None:
    log = record(servo, 1)
    loaded = carry_load(servo, log.run)
    assert log.is_commanded
    assert run_freely(loaded, log).rms < 0.01
    assert run_freely(loaded, log).rms < 0.5 * run_freely(servo, log).rms  # which has no weight
    off = replace(log, enabled=np.where(log.time_s > 1.0, 0.0, 1.0))
    fallen = run_freely(loaded, off).simulated_position_m
    assert np.abs(fallen[-100:]).max() < 0.3 < np.abs(fallen).max()
    with pytest.raises(InputError, match="goal_rad"):
        FreeRunRecord(loaded, replace(log, goal_m=None))


def test_a_voltage_or_a_duty_drives_too() -> None:
    drive = {"kind": "voltage", "torque_constant": 0.5, "resistance": 2.0, "supply": 10.0, "delay": 0.02}
    machine = make_machine({**SERVO, "drive": drive, "effects": []}, Path("motor.toml"))
    t = np.arange(300) / 100.0
    volts = np.where(t >= 0.5, 8.0, 0.0)
    # Only where it starts counts: it rests, in steps of an encoder.
    still = 1e-3 * (np.arange(300) % 2)
    log = Log(t, still, np.full(300, np.nan), 100.0, voltage_V=volts, kind="rotary", source="motor")
    moved = run_freely(machine, log).simulated_position_m
    speed = np.diff(moved)[-10:] * 100.0
    # k (U - k v) / R = f_C + sigma v
    assert speed == pytest.approx((0.5 * 8.0 / 2.0 - 0.1) / (0.5**2 / 2.0 + 0.03), rel=0.01)
    assert np.argmax(np.abs(moved) > 1e-3) in range(53, 56)
    same = run_freely(machine, replace(log, voltage_V=None, duty=0.1 * volts)).simulated_position_m
    assert np.array_equal(moved, same)


def test_runs_and_columns_of_commands_are_read(tmp_path: Path, servo: Machine) -> None:
    log = record(servo, 2)
    t = log.time_s + 1e-4 * np.random.default_rng(0).standard_normal(len(log))  # of a computer's clock
    assert log.goal_m is not None
    rows = zip(t.tolist(), log.position_m.tolist(), log.goal_m.tolist(), strict=True)
    named = ("timestamp", "position", "goal_position", "torque_enable")
    entries = [dict(zip(named, (*row, row[0] < 3.0), strict=True)) for row in rows]
    content = {"mass": 0.5, "length": 0.1, "kp": 16, "vin": 12.0, "entries": entries}
    path = tmp_path / "run.json"
    path.write_text(json.dumps(content))
    read = read_log(path, servo, note=lambda _: None)
    assert read.run == pytest.approx(log.run)
    assert read.is_commanded and read.goal_m is not None and read.enabled is not None
    assert set(np.unique(read.goal_m)) <= set(np.unique(log.goal_m))  # held, not between two goals
    assert int(read.enabled.sum()) == pytest.approx(300, abs=1)
    path.write_text(json.dumps(content | {"mass": "heavy"}))
    with pytest.raises(InputError, match="mass"):
        read_log(path, servo)
    write_log(tmp_path / "log.csv", read)
    again = read_log(tmp_path / "log.csv", servo, note=lambda _: None)
    assert again.is_commanded and again.goal_m is not None
    assert np.array_equal(again.goal_m, read.goal_m)


def test_one_run_leaves_its_numbers_open(servo: Machine) -> None:
    found = identify([record(servo, 0)], "one")
    sure = {said["about"]: said["sure"] for said in found.to_json()["statements"]}
    # One load does not tell inertia from that of the weight, nor the spread between runs.
    assert sure["weight_radius"] == "no" and sure["drive.delay"] == "yes"
    assert found.number("mass").std > 0.2 * found.number("mass").value
    assert "the record does not determine it" in found.toml
    assert {number["identified"] for number in found.to_json()["numbers"]} == {True, False}


def test_what_only_a_force_has_is_refused(servo: Machine, tmp_path: Path) -> None:
    log, machine = tmp_path / "log.csv", tmp_path / "servo.toml"
    write_log(log, record(servo, 0))
    machine.write_text(machine_toml(servo.plant.units, servo.content, (), ()), encoding="utf-8")
    for words, said in (
        (("identify", log, "--like", machine, "--out", tmp_path / "a.toml", "--elements", "2"), "elements"),
        (("identify", log, "--like", machine, "--out", tmp_path / "a.toml", "--inertia", "1"), "mass"),
        (("diagnose", machine, log, "--out", tmp_path / "d"), "torque_Nm"),
        (("predict", machine, log, "--out", tmp_path / "p.csv"), "--free-run"),
    ):
        assert said in refused(*words)


def test_a_drive_that_is_off_has_no_force_to_measure(servo: Machine) -> None:
    log = record(servo, 0)
    on = log.time_s < 2.0
    driven = replace(log, force_N=np.where(on, 0.3, 0.0), enabled=np.where(on, 1.0, 0.0))
    assert np.array_equal(np.isfinite(readings(driven).force_N), on)
    assert np.isfinite(readings(replace(driven, enabled=None)).force_N).all()


def test_runs_at_several_rates_share_the_lowest(servo: Machine, tmp_path: Path) -> None:
    for k, rate in enumerate((100.0, 125.0)):
        entries = [
            {"timestamp": j / rate, "position": 1e-3 * (j % 2), "goal_position": 0.0, "torque_enable": True}
            for j in range(200)
        ]
        run = {"mass": 0.5, "length": 0.1, "kp": 16, "vin": 12.0, "entries": entries}
        (tmp_path / f"{k}.json").write_text(json.dumps(run))
    logs = read_logs([tmp_path / "0.json", tmp_path / "1.json"], note=lambda _: None)
    assert [log.rate for log in logs] == pytest.approx([100.0, 100.0])


def test_command_and_function_predict_the_same_motion(servo: Machine, tmp_path: Path) -> None:
    log, machine = tmp_path / "log.csv", tmp_path / "servo.toml"
    write_log(log, record(servo, 0))
    machine.write_text(machine_toml(servo.plant.units, servo.content, (), ()), encoding="utf-8")
    words = ("predict", machine, log, "--out", tmp_path / "p.csv", "--free-run")
    said = json.loads(done(*words, "--json", "--plot", tmp_path / "figures").stdout)
    found = predict(machine, log, free_run=True)
    assert found.motion is not None and said["free_run"] == json.loads(json.dumps(found.motion.to_json()))
    assert set(said) == {"machine", "samples", "free_run"} and files(tmp_path / "figures") == {"motion.png"}
    head = (tmp_path / "p.csv").read_text().splitlines()[0]
    assert head == "time_s,position_rad,simulated_position_rad" == ",".join(found.columns)
    assert found.motion.describe() in done(*words).stdout and found.motion.describe() in repr(found)
    with pytest.raises(InputError, match="torque_Nm"):
        predict(machine, log)


@pytest.mark.slow
def test_a_hidden_drive_is_found(servo: Machine) -> None:
    gains = (8.0, 16.0, 32.0)
    logs = [record(servo, k, load, gains[k % 3]) for k, load in enumerate(LOADS + LOADS[:2])]
    found = identify(logs, "found")
    assert next(said for said in found.others if said.about == "free runs").value < 2e-3
    numbers = {number.name: number for number in found.numbers}
    # Without the torque constant the clamp is 1, and the constant takes it in.
    stall = 0.7 * 12.0 * 1.6 / 2.6
    drive = found.machine.drive
    assert drive.torque_constant is not None and drive.resistance is not None
    assert 12.0 * drive.torque_constant / drive.resistance == pytest.approx(stall, rel=0.05)
    for name, true, near in (
        ("drive.delay", 0.03, 0.001),
        ("drive.speed_limit", 4.0, 0.01),
        ("mass", 0.02, 0.001),
        ("weight_radius", 0.04, 0.005),
        ("coulomb", 0.1, 0.01),
        ("stiffness_1", 20.0, 3.0),
        ("load_dependent_friction.ratio", 0.15, 0.01),
    ):
        assert numbers[name].value == pytest.approx(true, abs=near), name
        assert 0.0 < numbers[name].std < near, name
    # Its elements yield within 5 mrad, which a gap would do too.
    assert [said.rule for said in found.others if said.about == "backlash"] == [Rule.NO_PLAY]
    # A load and a gain that no fit has seen.
    other = record(servo, 7, (0.8, 0.12), 24.0)
    assert run_freely(carry_load(found.machine, other.run), other).rms < 2e-3


@pytest.mark.slow
def test_a_known_torque_constant_tells_the_clamp(servo: Machine) -> None:
    logs = [record(servo, k, load) for k, load in enumerate(LOADS)]
    like = override_machine(servo, {"drive": {"clamp": 0.9, "delay": 0.02}, "plant": {"inertia": 0.03}})
    found = identify(logs, "found", like=like)
    assert found.machine.drive.clamp == pytest.approx(0.7, abs=0.03)
    assert found.machine.drive.torque_constant == 1.6
    assert found.machine.drive.delay == pytest.approx(0.03, abs=0.003)


def test_what_a_command_does_not_tell_is_refused(servo: Machine) -> None:
    log = replace(record(servo, 0), run={})
    with pytest.raises(InputError, match=r"--like"):
        identify([log])
    with pytest.raises(InputError, match="torque_Nm"):
        identify([log, replace(log, force_N=np.zeros(len(log)))], like=servo)
    with pytest.raises(InputError, match="drive"):
        identify([log], like=make_machine({**SERVO, "drive": {"kind": "force"}}, Path("driven.toml")))


def test_no_form_of_another_simulator_holds_a_drive(servo: Machine) -> None:
    with pytest.raises(InputError, match=r"drive\.kind"):
        export(servo, "csv")


@pytest.mark.slow
def test_a_servo_is_predicted_on_repetitions_that_no_fit_has_seen(measured_data: Callable[[str], Path]) -> None:
    folder = measured_data("servos") / "sts3215"

    def runs(repetition: int, step: int) -> list[Log]:
        paths = sorted(folder.glob(f"*_{repetition}.json.gz"))[::step]
        return [read_log(path, note=lambda _: None) for path in paths]

    found = identify(runs(1, 2), "sts3215")
    errors = [run_freely(carry_load(found.machine, log.run), log).to_json()["mae"] for log in runs(2, 3)]
    assert np.mean(errors) < 0.014
