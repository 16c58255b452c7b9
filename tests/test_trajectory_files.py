"""A plan's CSV, or a controller's, as the reference of a simulated axis."""

from pathlib import Path

import numpy as np
import pytest

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis.plan import make_plan, write_plan
from sgms_mhe.machine import Machine
from sgms_mhe.plant.trajectory_files import read_trajectory
from sgms_mhe.support.errors import InputError


@pytest.fixture(scope="module")
def machine() -> Machine:
    return override_machine(load_machine("etel_xy"), {"sampling": {"rate": 1000.0, "velocity_cutoff": 200.0}})


@pytest.mark.parametrize("name", ["etel_xy", "etel_xy_rotary"])
def test_a_plan_is_read_back_as_it_was_made(name: str, tmp_path: Path) -> None:
    machine = load_machine(name)
    plan, path = make_plan(machine, ("force_ripple", "periodic_disturbance")), tmp_path / "plan.csv"
    write_plan(path, plan, machine.plant.units)
    found = read_trajectory(path, machine)
    assert found.rate == plan.trajectory.rate
    np.testing.assert_allclose(found.position_m, plan.trajectory.position_m, atol=1e-9)
    assert read_trajectory(path, machine, duration_s=1.0).duration_s == pytest.approx(1.0)


def written(path: Path, rows: list[str], header: str = "time_s,position_m") -> Path:
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_times_may_be_rounded(machine: Machine, tmp_path: Path) -> None:
    rows = [f"{k / 1000.0 + 1e-4:.4f},{1e-4 * k:.6f}" for k in range(50)]
    assert len(read_trajectory(written(tmp_path / "t.csv", rows), machine).position_m) == 50


@pytest.mark.parametrize(
    ("rows", "header", "message"),
    [
        (["0,0", "0.002,0", "0.004,0"], "time_s,position_m", r"time_s, .* samples 1/1000 s apart"),
        (["0,0", "0.001,0.002"], "time_s,position_m", r"position_m, .*2 m/s.* at most max_velocity = 1 m/s"),
        (["0,0", "0.001,nan"], "time_s,position_m", r"position_m, .* finite"),
        (["0,0", "0.001,0"], "time_s,position_rad", r"columns = 'position_rad, time_s': time_s and position_m"),
        (["0,0"], "time_s,position_m", r"rows = 1: 2 to"),
    ],
)
def test_what_cannot_be_followed_is_refused(
    machine: Machine, tmp_path: Path, rows: list[str], header: str, message: str
) -> None:
    path = written(tmp_path / "bad.csv", rows, header)
    with pytest.raises(InputError, match=message) as refused:
        read_trajectory(path, machine)
    assert str(path) in str(refused.value)


def test_no_such_file(machine: Machine, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a CSV file that exists, or the name of a trajectory"):
        read_trajectory(tmp_path / "none.csv", machine)
