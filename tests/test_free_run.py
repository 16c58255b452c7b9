"""Free runs: motion from the force alone, its start, gaps, drift and horizon."""

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
from sgms_mhe.recordings.output_error import Objective, refit_motion
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


def remove_samples(log: Log, *gaps: tuple[int, int]) -> Log:
    position, force = log.position_m.copy(), log.force_N.copy()
    for first, end in gaps:
        position[first:end] = np.nan
        force[first:end:2] = np.nan
    return replace(log, position_m=position, force_N=force)


def test_runs_start_anew_behind_gaps(machine: Machine, log: Log) -> None:
    # 30 samples between the last two gaps are too few to compare anything.
    run = run_freely(machine, remove_samples(log, (2000, 2100), (4000, 4001), (4031, 4040)))
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
        (lambda log: replace(log, friction_N=log.force_N), "a log with the force that moves the axis"),
        (lambda log: replace(log, payload=True), "no mass beside it"),
        (lambda log: remove_samples(log, *((k, k + 1) for k in range(0, len(log), 30))), "more than 40 in a row"),
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


# --- fits to the motion ------------------------------------------------------------------------------------------

WRONG = [{"mass": 1.1, "coulomb": 0.9, "viscous": 1.3}, {"mass": 0.85, "coulomb": 1.1, "viscous": 0.7}]


@pytest.fixture(scope="module")
def brisk(machine: Machine) -> Log:
    """A record that slides, of an axis with an offset that the machine file does not have right."""
    motion = make_trajectory("mixed", machine.sampling.rate, duration_s=6.0)
    return simulate_axis(machine, motion, AxisConfig(seed=3, force_noise_N=0.02, encoder_resolution_m=1e-8)).log


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["motion", "both"])
@pytest.mark.parametrize("wrong", WRONG)
def test_several_starts_end_at_one_answer(
    machine: Machine, brisk: Log, wrong: dict[str, float], objective: Objective
) -> None:
    true = {"mass": 20.0, "coulomb": 4.0, "viscous": 20.0}
    start = {name: value * wrong[name] for name, value in true.items()}
    table = {"plant": {"mass": start.pop("mass")}, "friction": start}
    table["effects"] = [{"name": "constant_offset", "force_N": 0.2}]
    refit = refit_motion(override_machine(machine, table), [brisk], objective)
    for name, value in true.items():
        assert refit.values[name] == pytest.approx(value, rel=0.01)
        assert 0.0 < refit.std[name] < 0.1 * value
    assert refit.values["constant_offset.force_N"] == pytest.approx(0.0, abs=0.01 * true["coulomb"])
    assert refit.motion[0] < 0.05 * refit.motion[1] and refit.force[0] < 0.5 * refit.force[1]


def test_numbers_that_are_given_stay(machine: Machine, brisk: Log) -> None:
    refit = refit_motion(override_machine(machine, {"friction": {"viscous": 26.0}}), [brisk], "motion", {"mass"})
    assert set(refit.values) == {"coulomb", "viscous"}
    assert refit.values["viscous"] == pytest.approx(20.0, rel=0.01)


@pytest.mark.slow
def test_published_numbers_refitted_to_the_motion(measured_data: Callable[[str], Path]) -> None:
    machine = load_machine("emps")
    log = read_log(measured_data("emps/DATA_EMPS.mat"), machine).part(end_s=12.42)
    motion, both = (refit_motion(machine, [log], objective) for objective in ("motion", "both"))
    assert motion.motion[1] == pytest.approx(2.67e-3, rel=0.01) and motion.motion[0] < 1.9e-3
    assert motion.motion[0] < both.motion[0] < 2.0e-3
    assert both.force[0] < 1.05 * both.force[1] < motion.force[0]


@pytest.mark.slow
def test_identify_states_both_errors_and_refits(brisk: Log, tmp_path: Path) -> None:
    write_log(tmp_path / "axis.csv", brisk)
    results = {}
    for objective in ("force", "motion"):
        arguments = ("--out", tmp_path / "axis.toml", "--objective", objective, "--json")
        results[objective] = json.loads(done("identify", tmp_path / "axis.csv", *arguments).stdout)
    force, motion = (results[name]["free_run"][0]["rms"] for name in ("force", "motion"))
    assert motion < force
    assert any(sentence.startswith("refitted to the motion") for sentence in results["motion"]["limits"])
    assert predict(tmp_path / "axis.toml", tmp_path / "axis.csv", free_run=True).motion.rms == pytest.approx(motion)  # type: ignore[union-attr]


def test_published_parameters_in_free_run(measured_data: Callable[[str], Path]) -> None:
    machine = load_machine("emps")
    run = run_freely(machine, read_log(measured_data("emps/DATA_EMPS.mat"), machine))
    assert run.rms == pytest.approx(5.03e-3, rel=0.01)
    assert run.horizon.seconds == pytest.approx(0.9, abs=0.1)
