"""The benchmark of measured records, on a simulated record that stands for a measured one."""

import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sgms_bench.measured import __main__ as benchmark
from sgms_bench.measured import motions
from sgms_bench.measured.motions import FreeRuns, MotionOutcome, run_motion
from sgms_bench.measured.table import MeasuredMotion, MeasuredTable, read_table
from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import carry_load, load_machine, make_machine
from sgms_mhe.identification.result import Identification, Number
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.statements import Rule, Statement


def test_every_public_record_is_read_by_its_table(measured_data: Callable[[str], Path]) -> None:
    table = read_table(measured_data("emps").parent)
    assert table.absent == ()
    for record in table.records:
        machine = None if record.machine is None else load_machine(record.machine)
        log = read_log(table.locate(record.log), machine, table=record.table if machine is None else None)
        assert log.time_s[-1] - log.time_s[0] > 9.0


def test_runs_of_a_commanded_axis_have_a_table_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("servo_1.json", "servo_2.json"):
        (tmp_path / name).write_text(json.dumps({}))
    content = 'name = "servo"\nlogs = "servo_1*"\nother = "servo_2*"\npublished = { others = 0.03, better = 0.02 }\n'
    content += 'wanted = 0.013\nunseen = { "a load" = "*_1.json" }\n'
    (tmp_path / "measured.toml").write_text(f"[[motions]]\n{content}")

    def run(table: MeasuredTable, motion: MeasuredMotion, tell: object) -> MotionOutcome:
        runs = (
            FreeRuns(2, (0.0127, 0.0129), (0.0098, 0.0098)),
            FreeRuns(1, (0.0161,), (0.0098,), *motion.unseen, (0.0131,)),
        )
        delay = Statement.of_number(Rule.DETERMINED, "drive.delay", 0.025, 5e-4, "s")
        play = Statement(Rule.NO_PLAY, "backlash", 0.015, None, "rad", {"percent": 3.0})
        return MotionOutcome(motion.name, motion.published, motion.wanted, "rad", runs, (delay, play), 1.0)

    monkeypatch.setattr(benchmark, "run_motion", run)
    assert benchmark.main([str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    first, unseen = (line.split() for line in shown.splitlines() if line.startswith("  servo  ") and "mrad" in line)
    assert first[1:] == "2 2 mrad 12.8 12.8 9.8 30 others, 20 better, 13 wanted yes".split()
    assert unseen[1:] == "a load 1 1 mrad 16.1 16.1 13.1 9.8".split()
    assert re.search(r"servo +drive\.delay +0\.025 +0\.001 +s +yes", shown)
    assert "servo: backlash: refused, 0.015 rad of play" in shown
    (tmp_path / "servo_2.json").unlink()
    assert benchmark.main([str(tmp_path)]) == 2


SERVO = """
name = "servo"
[plant]
kind = "rotary"
inertia = 0.02
[friction]
law = "switching"
stiffness = [20.0]
fraction = [1.0]
viscous = 0.02
coulomb = 0.15
[sampling]
rate = 100.0
update_rate = 10.0
velocity_cutoff = 20.0
max_velocity = 8.0
[drive]
kind = "position_loop"
torque_constant = 1.5
resistance = 4.0
supply = 7.4
clamp = 0.5
gain = 32.0
gain_unit = 0.16
"""


def test_a_second_fit_has_not_seen_what_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Free runs of the true machine leave what the encoder does; the fits get all runs, and those that are kept."""
    machine = make_machine(tomllib.loads(SERVO), tmp_path / "servo.toml")
    time = np.arange(300) / 100.0
    goal = Trajectory("sines", 100.0, 0.5 * np.sin(4.4 * time) + 0.3 * np.sin(9.0 * time))

    def read(path: Path, note: object) -> Log:
        gain = float(re.findall(r"kp(\d+)", path.name)[0])
        run = {"mass": 0.5, "length": 0.1, "gain": gain, "supply": 7.4}
        config = AxisConfig(encoder_resolution_m=1e-4, substeps=50, seed=int(path.stem[-1]))
        log = simulate_axis(carry_load(machine, run), goal, config, truth=False).log
        return replace(log, force_N=np.full(len(log), np.nan), run=run)

    fitted: list[list[float]] = []

    def identify(logs: list[Log], progress: object) -> Identification:
        fitted.append([log.run["gain"] for log in logs])
        numbers = Number("drive.torque_constant", 1.5, 0.03), Number("drive.resistance", 4.0, 0.16)
        return Identification(machine, SERVO, numbers, (), ())

    for gain in (8, 16, 32):
        for again in (1, 2):
            (tmp_path / f"kp{gain:02d}_{again}.json").touch()
    monkeypatch.setattr(motions, "read_log", read)
    monkeypatch.setattr(motions, "identify", identify)
    told = {"constants": {"torque_constant": 3.0, "resistance": 8.0}, "unseen": {"gain of 16": "kp16*"}}
    entry = MeasuredMotion(name="servo", logs="*_1.json", other="*_2.json", **told)
    found = run_motion(MeasuredTable((), tmp_path), entry, lambda _: None)
    assert fitted == [[8.0, 16.0, 32.0], [8.0, 32.0]]
    assert [(runs.fitted, len(runs.errors), runs.unseen) for runs in found.runs] == [
        (3, 3, ""),
        (2, 2, "none, fitted without the following"),
        (2, 1, "gain of 16"),
    ]
    assert found.runs[2].seen == [found.runs[0].errors[1]]
    assert 0.0 < found.ours < 1e-3 and max(found.runs[0].again) < 1e-3
    force, clamp = found.statements[-2:]
    assert (force.value, clamp.value) == pytest.approx((7.4 * 0.5 * 1.5 / 4.0, 0.5))
    assert force.std == pytest.approx(force.value * np.hypot(0.02, 0.04))
