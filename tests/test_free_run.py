"""Free runs: motion from the force alone, its start, gaps, drift and horizon."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli_cases import done, files, refused
from sgms_mhe.api.estimation import predict
from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.recordings.free_run import FIRST, run_freely
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.errors import InputError

OFFSET_N = 0.1
"""Of a force that a model does not have."""


@pytest.fixture(scope="module")
def machine(small: Path) -> Machine:
    return load_machine(small)


@pytest.fixture(scope="module")
def log(machine: Machine) -> Log:
    motion = make_trajectory("paper", machine.sampling.rate, duration_s=6.0)
    return simulate_axis(machine, motion, AxisConfig(seed=2, force_noise_N=0.02, encoder_resolution_m=1e-8)).log


def with_missing(log: Log, *gaps: tuple[int, int]) -> Log:
    position, force = log.position_m.copy(), log.force_N.copy()
    for first, end in gaps:
        position[first:end] = np.nan
        force[first:end:2] = np.nan
    return replace(log, position_m=position, force_N=force)


def test_runs_start_anew_behind_gaps(machine: Machine, log: Log) -> None:
    # 30 samples between the last two gaps are too few to compare anything.
    run = run_freely(machine, with_missing(log, (2000, 2100), (4000, 4001), (4031, 4040)))
    assert [start.sample for start in run.starts] == [0, 2100, 4040]
    assert run.to_json()["skipped"] == 3 * FIRST + 100 + 1 + 30 + 9
    assert np.isnan(run.simulated_position_m[4001:4040]).all()
    # A reversal is in the first gap: which elements it has turned round, no sample says.
    assert run.rms < 0.02 * np.ptp(log.position_m)
    assert "started anew behind 2 gaps" in run.describe()


def test_a_start_in_motion_is_found(machine: Machine, log: Log) -> None:
    moving = int(np.argmax(np.abs(np.diff(log.position_m[: len(log) // 2]))))
    velocity = float(np.diff(log.position_m)[moving] * log.rate)
    for run in (run_freely(machine, log.part(moving / log.rate)), run_freely(machine, log, start_s=moving / log.rate)):
        assert run.starts[0].velocity == pytest.approx(velocity, rel=0.01)
        assert run.rms < 0.02 * np.ptp(log.position_m)


def test_an_error_of_force_is_a_drift_and_ends_the_horizon(machine: Machine, log: Log) -> None:
    wrong = [
        override_machine(machine, {"effects": [{"name": "constant_offset", "force_N": f}]})
        for f in (-OFFSET_N, OFFSET_N)
    ]
    right, ahead, behind = run_freely(machine, log), *(run_freely(axis, log) for axis in wrong)
    assert behind.drift_m_s < -5.0 * abs(right.drift_m_s) and ahead.drift_m_s > 5.0 * abs(right.drift_m_s)
    assert right.horizon.seconds == pytest.approx(3.0) and not right.horizon.reached
    assert ahead.horizon.reached and ahead.horizon.seconds < 1.5
    nearer = run_freely(wrong[0], log, tolerance_m=0.3 * ahead.horizon.error)
    assert nearer.horizon.seconds < ahead.horizon.seconds
    assert ahead.rms == pytest.approx(
        float(np.sqrt(np.mean((ahead.simulated_position_m - log.position_m)[FIRST:] ** 2)))
    )


def test_command_and_function_say_the_same(small: Path, log: Log, tmp_path: Path) -> None:
    write_log(tmp_path / "axis.csv", log)
    arguments = ("predict", small, tmp_path / "axis.csv", "--out", tmp_path / "p.csv", "--free-run")
    found = json.loads(done(*arguments, "--json", "--plot", tmp_path / "figures").stdout)["free_run"]
    motion = predict(small, tmp_path / "axis.csv", free_run=True).motion
    assert motion is not None and found == json.loads(json.dumps(motion.to_json()))
    assert set(found) >= {"mae", "rms", "unit", "skipped"} and found["unit"] == "m" and found["skipped"] == FIRST
    head, first = (tmp_path / "p.csv").read_text().splitlines()[:2]
    assert head == "time_s,friction_measured_N,friction_N,position_m,simulated_position_m"
    assert float(first.split(",")[-1]) == motion.simulated_position_m[0]
    assert files(tmp_path / "figures") == {"friction.png", "motion.png"}
    assert motion.describe() in done(*arguments).stdout
    assert "beside --free-run" in refused(*arguments[:-1], "--tolerance", "1e-3")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda log: replace(log, friction_N=log.force_N), "columns = 'friction_N': a force"),
        (lambda log: with_missing(log, *((k, k + 1) for k in range(0, len(log), 30))), "more than 40 in a row"),
    ],
)
def test_logs_that_no_free_run_can_take_are_refused(
    machine: Machine, log: Log, change: Callable[[Log], Log], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        run_freely(machine, change(log))


def test_a_model_that_runs_away_has_no_error(machine: Machine, log: Log) -> None:
    away = override_machine(machine, {"effects": [{"name": "position_spring", "stiffness_N_m": -1e6, "centre_m": 0.0}]})
    found = run_freely(away, log).to_json()
    assert found["rms"] is None and found["drift_per_s"] is None and found["horizon"]["seconds"] < 1.0


def test_published_parameters_in_free_run(measured_data: Callable[[str], Path]) -> None:
    machine = load_machine("emps")
    run = run_freely(machine, read_log(measured_data("emps/DATA_EMPS.mat"), machine))
    assert run.rms == pytest.approx(5.03e-3, rel=0.01)
    assert run.horizon.seconds == pytest.approx(0.9, abs=0.1)
