"""An axis without a sensor of its force: what the emitted drive makes of commands, and an estimate from them alone."""

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_packages import STRICT
from cli_cases import done, refused
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.signals.drive import find_force
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, program
from ways_out import spoil_outputs

SERVO = """
name = "servo"
[plant]
kind = "rotary"
inertia = 0.02
[friction]
stiffness = [20.0, 5.0]
fraction = [0.4, 0.6]
viscous = 0.02
coulomb = 0.15
[drive]
kind = "position_loop"
torque_constant = 1.5
resistance = 4.0
supply = 7.4
gain = 32.0
gain_unit = 0.16
[sampling]
rate = 1000.0
update_rate = 50.0
velocity_cutoff = 60.0
max_velocity = 8.0
integrator = { scheme = "flow" }
[estimator]
horizon = 10
parameters = ["coulomb"]
"""
LOOP = {"start": 0.05, "clamp": 0.2, "delay": 0.0073, "speed_limit": 3.0}
VOLTAGE = {"kind": "voltage", "torque_constant": 1.5, "resistance": 4.0, "supply": 7.4, "clamp": 0.8, "delay": 0.004}
HARNESS = """
#include <stdio.h>
#include "servo.h"
int main(void)
{
    double row[3], sent = 0.0;
    servo_drive_t drive;
    servo_drive_init(&drive);
    for (int first = 1; fread(row, sizeof row, 1, stdin) == 1; first = 0) {
        sent = first ? row[1] : sent; /* the command of the row before */
        const servo_position position = servo_position_from_radians(row[0]);
        const double force = servo_drive_force(&drive, position, COMMAND, row[2] > 0.5);
        fwrite(&force, sizeof force, 1, stdout);
        sent = row[1];
    }
    return 0;
}
"""
DAMAGED = """
#include <string.h>
#include "servo.h"
int main(void)
{
    static const int fills[] = {0x00, 0x7f, 0x80, 0xff, 0x55};
    for (int k = 0; k < 5; k++) {
        servo_drive_t drive;
        memset(&drive, fills[k], sizeof drive);
        for (int i = 0; i < 40; i++) {
            const servo_position goal = servo_position_from_radians(i % 5 ? 0.1 * i : 1e9);
            (void)servo_drive_force(&drive, servo_position_from_radians(i % 7 ? 0.01 * i : 1e9), goal, true);
        }
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def servo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("servo") / "servo.toml"
    path.write_text(SERVO)
    return path


def move(machine: Machine, step: float = 4e-4, **scale: float) -> Log:
    """A log of the servo that follows two sines, its true Coulomb level scaled."""
    time = np.arange(8000) / 1000.0
    goal = Trajectory("sines", 1000.0, 0.8 * np.sin(4.4 * time) + 0.3 * np.sin(12.0 * time))
    return simulate_axis(
        machine, goal, AxisConfig(control="command", encoder_resolution_m=step, force_noise_N=0.0), scale=scale
    ).log


def driven(drive: dict[str, Any], precision: str, folder: Path) -> Machine:
    """The servo with more keys of its drive, or with another kind."""
    keys = "\n".join(f"{key} = {json.dumps(value)}" for key, value in drive.items())
    has_loop = drive.get("kind") != "voltage"
    (folder / "own.toml").write_text(
        SERVO.replace("[sampling]", f"{keys}\n[sampling]") if has_loop else change_drive(keys)
    )
    return override_machine(load_machine(folder / "own.toml"), {"code": {"precision": precision}})


def change_drive(table: str) -> str:
    """The servo's file with another table [drive]; empty: without one."""
    before, after = SERVO.partition("[drive]")[0], SERVO.partition("[sampling]")[2]
    return f"{before}[drive]\n{table}\n[sampling]{after}" if table else f"{before}[sampling]{after}"


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("drive", [{}, LOOP, VOLTAGE], ids=["loop", "loop with all", "voltage"])
def test_the_calls_are_the_drive_of_the_file(
    servo: Path, drive: dict[str, Any], precision: str, tmp_path: Path
) -> None:
    """Late commands, gaps of either signal, a drive that goes off: as the reference has them."""
    machine = load_machine(servo)
    loop = drive.get("kind") != "voltage"
    own = driven(drive, precision, tmp_path)
    folder = tmp_path / "package"
    write_package(emit_package(own, selftest=False), folder)
    source = folder / "harness.c"
    command = "servo_position_from_radians(sent)" if loop else "(servo_real)sent"
    source.write_text(HARNESS.replace("COMMAND", command))
    log = move(machine)
    assert log.goal_m is not None
    rng = np.random.default_rng(3)
    position, sent = log.position_m.copy(), log.goal_m * (1.0 if loop else 6.0)
    position[rng.integers(100, 8000, 40)] = np.nan
    sent[rng.integers(100, 8000, 40)] = np.nan
    on = np.ones(len(log))
    on[3000:3100] = 0.0
    columns = {"goal_m" if loop else "voltage_V": sent, "enabled": on}
    known = replace(log, position_m=position, force_N=np.full(len(log), np.nan), goal_m=None)
    expected = find_force(replace(known, **columns), own).force_N
    binary = program([source, folder / "servo.c"], flags=DEFAULT_FLAGS)
    fed = np.column_stack((position, sent, on)).tobytes()
    found = np.frombuffer(subprocess.run([binary], input=fed, capture_output=True, check=True).stdout)
    missing = np.isnan(position)
    assert (found[missing] > 1e9).all() and np.isnan(expected[missing]).all()
    np.testing.assert_allclose(found[~missing], expected[~missing], atol=1e-9 if precision == "double" else 1e-3)
    subprocess.run(["gcc", *STRICT, "-pedantic", "-O1", "-fsyntax-only", folder / "servo.c"], check=True)


def test_the_plant_agrees(servo: Path) -> None:
    """The simulated drive, stepped much finer, makes the force that is found of its goals and positions."""
    table = load_machine(servo).drive.model_dump(exclude_none=True)
    machine = override_machine(load_machine(servo), {"drive": table | {"delay": 0.005, "clamp": 0.5}})
    log = move(machine, 1e-7)
    found, true = find_force(replace(log, force_N=np.full(len(log), np.nan)), machine).force_N[500:], log.force_N[500:]
    assert np.sqrt(np.mean((found - true) ** 2)) < 0.03 * np.std(true)


def test_friction_of_an_axis_without_a_force(servo: Path, tmp_path: Path) -> None:
    """`estimate` and `compare` take its goals; the level is found 1.4 times the file's."""
    machine = load_machine(servo)
    log = move(machine, coulomb=1.4)
    write_log(tmp_path / "log.csv", replace(log, force_N=np.full(len(log), np.nan)))
    said = done("estimate", servo, tmp_path / "log.csv", "--out", tmp_path / "e.csv", "--json")
    last = json.loads(said.stdout)["parameters"]["coulomb"]
    assert last["estimate"] == pytest.approx(1.4 * 0.15, abs=2.0 * last["std"]) and last["std"] < 0.03
    done("compare", servo, tmp_path / "log.csv")
    force = tmp_path / "force.toml"
    force.write_text(change_drive(""))
    assert "torque_Nm" in refused("estimate", force, tmp_path / "log.csv", "--out", tmp_path / "f.csv")


@pytest.mark.parametrize("drive", [{}, LOOP, VOLTAGE], ids=["loop", "loop with all", "voltage"])
def test_every_output_of_a_drive_counts(drive: dict[str, Any], tmp_path: Path) -> None:
    """The self-test notices another sign, zero, half, or the one before, in place of what either call hands out."""
    package = emit_package(driven(drive, "double", tmp_path))
    found = spoil_outputs(package, tmp_path, "drive_")
    assert [spoilt.title.split()[0] for spoilt in found] == ["drive_force"] * 4 + ["drive_command"] * 4
    assert all(spoilt.changed > 0 and spoilt.code == number_of_sentence(package) for spoilt in found), found


FAULTS = {
    "a command acts early": (r"\? drive->place : 0", "? (drive->place + 1) % (SERVO_DRIVE_DELAY + 1) : 0"),
    "a missing command is taken": (r"is_known \? newest", "true ? newest"),
    "no command is one": (r"if \(!is_known && is_first\)", "if (false)"),
    "no clamp": (r"volts = sgms_fmax[^;]*;", ""),
    "no least share": (r"share \+= [^;]*;", ""),
    "the goal is there at once": (r"sgms_fabs\(way\) > most", "sgms_fabs(way) > 1e6 * most"),
    "the goal starts from memory": (r"is_first \? 0\.0 : (?=sgms_metres)", ""),
    "a missing position is taken": (r"sgms_position_is_good\(position\.rad\) == 0", "false"),
    "a gap is a sample": (r"drive->since \+= [^;]*;", ""),
    "speed of half a sample ago": (r"mean \+ \(mean - drive->mean\) \* 0\.5", "mean"),
    "speed over a gap is not kept": (r"drive->mean = drive->since > 1 \? velocity : mean", "drive->mean = mean"),
    "always on": (r"enabled \? force : 0\.0", "force"),
    "init leaves the speed": (r"    drive->mean = 0\.0;", ""),
    "init leaves the position": (r"    drive->since = 0;", ""),
    "init leaves the count": (r"    drive->count = 0;", ""),
}
"""Faults inside of the calls: a pattern of the source, and what takes its place."""


def test_faults_of_a_drive_get_the_number_of_its_sentence(tmp_path: Path) -> None:
    package = emit_package(driven(LOOP, "double", tmp_path))
    folder = tmp_path / "package"
    write_package(package, folder)
    estimator, mark, drive = package.files["servo.c"].partition("/* No force,")
    (folder / "servo.c").write_text(estimator)
    (folder / "main.c").write_text('#include "servo.h"\nint main(void)\n{\n    return servo_selftest();\n}\n')
    words, parts = ["gcc", "-std=c99", "-O1"], ["main", "servo", "servo_selftest"]
    for part in parts:
        subprocess.run([*words, "-c", folder / f"{part}.c", "-o", folder / f"{part}.o"], check=True)
    others, answers = [folder / f"{part}.o" for part in parts], {}
    for what, (pattern, wrong) in {"none": (r"\Z", ""), **FAULTS}.items():
        text, count = re.subn(pattern, wrong, drive)
        assert count == 1, what
        (folder / "drive.c").write_text(f'#include "servo.h"\n#include "servo_config.h"\n{mark}{text}')
        subprocess.run([*words, folder / "drive.c", *others, "-o", folder / "selftest"], check=True)
        answers[what] = subprocess.run([folder / "selftest"], check=False).returncode
    assert answers == {"none": 0, **dict.fromkeys(FAULTS, number_of_sentence(package))}


def number_of_sentence(package: Package) -> int:
    """Answer of the self-test where a drive is another one: beyond all updates, 12."""
    header = package.files["servo_selftest.h"]
    assert "12  The drive makes" in header
    updates, second = (int(re.findall(rf"SELFTEST_{name} = (\d+)", header)[0]) for name in ("UPDATES", "SECOND"))
    return updates + 2 * second + 12


def test_damaged_memory_of_a_drive_leads_nowhere_else(tmp_path: Path) -> None:
    """Counts that no call has left there: the sanitizers find no other memory read or written, and no overflow."""
    package = emit_package(driven(LOOP, "single", tmp_path), selftest=False)
    write_package(package, tmp_path / "package")
    (tmp_path / "main.c").write_text(DAMAGED)
    sources = [tmp_path / "main.c", tmp_path / "package" / "servo.c", "-o", tmp_path / "damaged"]
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    subprocess.run(["gcc", "-std=c99", "-O1", "-g", *checks, f"-I{tmp_path / 'package'}", *sources], check=True)
    subprocess.run([tmp_path / "damaged"], check=True)
