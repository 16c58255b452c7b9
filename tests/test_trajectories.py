"""Reference trajectories: continuous, within their limits, closed where they are to be repeated."""

import os
import subprocess
import sys

import numpy as np
import pytest

from sgms_mhe.plant.trajectories import TRAJECTORIES, Motion, Trajectory, circle, hysteresis, make_trajectory, paper
from sgms_mhe.support.errors import InputError

LIMITS = {  # m/s, m/s^2
    "paper": (2e-3, 0.13),
    "mixed": (1.0, 10.0),
    "long_mixed": (1.0, 10.0),
    "trapezoids": (1.0, 10.0),
    "step_and_settle": (0.3, 3.0),
    "circle_x": (0.02, 0.2),
    "circle_y": (0.02, 0.2),
    "hysteresis": (4e-6, 2e-4),
}


@pytest.mark.parametrize("rate", [1000.0, 10000.0])
@pytest.mark.parametrize("name", TRAJECTORIES)
def test_named_trajectory_is_smooth_and_returns(name: str, rate: float) -> None:
    trajectory = make_trajectory(name, rate)
    velocity, acceleration = LIMITS[name]
    assert trajectory.name == name
    assert np.abs(trajectory.velocity_m_s).max() <= velocity * (1 + 1e-9)
    assert np.abs(trajectory.acceleration_m_s2).max() <= acceleration * (1 + 1e-6)
    # At rest at both ends and back at the start, so that repetitions join.
    assert abs(trajectory.position_m[-1] - trajectory.position_m[0]) < 1e-15
    assert abs(trajectory.velocity_m_s[-1]) <= 0.01 * velocity


def test_paper_slides_at_two_millimetres_per_second_and_creeps_in_loops() -> None:
    velocity = np.abs(paper(1e4).velocity_m_s)
    assert velocity.max() == pytest.approx(2e-3)
    assert np.mean(velocity > 1.9e-3) > 0.1
    assert np.mean((velocity > 0) & (velocity < 2.1e-4)) > 0.01
    assert np.mean(velocity == 0) > 0.02


def test_velocity_and_acceleration_are_differences_of_position() -> None:
    trajectory = make_trajectory("mixed", 1e4)
    n = len(trajectory.position_m)
    assert trajectory.time_s[-1] == pytest.approx((n - 1) / 1e4)
    assert trajectory.duration_s == n / 1e4
    np.testing.assert_allclose(np.cumsum(trajectory.velocity_m_s) / 1e4, trajectory.position_m, atol=1e-12)
    np.testing.assert_allclose(np.diff(trajectory.velocity_m_s) * 1e4, trajectory.acceleration_m_s2[:-1], atol=1e-5)


@pytest.mark.parametrize("distance", [1e-6, 1e-4, 5e-3, 0.05, 0.5, -0.5])
def test_move_keeps_velocity_acceleration_and_jerk(distance: float) -> None:
    rate, (velocity, acceleration, jerk) = 1e4, (0.3, 3.0, 100.0)
    motion = Motion(rate, 0.1)
    motion.move_by(distance, velocity, acceleration, jerk)
    trajectory = motion.trajectory("move")
    assert trajectory.position_m[-1] == 0.1 + distance
    assert np.abs(trajectory.velocity_m_s).max() <= velocity * (1 + 1e-9)
    assert np.abs(trajectory.acceleration_m_s2).max() <= acceleration * (1 + 1e-9) + 1e-6
    third = np.abs(np.diff(trajectory.acceleration_m_s2)) * rate
    assert third.max() <= jerk * (1 + 1e-9) + 0.03  # the rounding of positions
    assert np.all(np.diff(trajectory.position_m) * np.sign(distance) >= -1e-16)
    # No slower than need be: the same limits as an upper bound of the shortest time.
    ideal = abs(distance) / velocity + velocity / acceleration + acceleration / jerk
    assert trajectory.duration_s <= ideal + 1e-3


def test_long_move_reaches_its_velocity() -> None:
    motion = Motion(1e4)
    motion.move_to(1.0, 0.3, 3.0, 100.0)
    trajectory = motion.trajectory("move")
    assert trajectory.velocity_m_s.max() == pytest.approx(0.3, rel=1e-3)
    assert trajectory.acceleration_m_s2.max() == pytest.approx(3.0, rel=1e-3)


def test_hysteresis_nests_and_scales() -> None:
    loop = hysteresis(1e4, amplitude_m=5e-6, frequency_Hz=2.0)
    assert loop.position_m.max() == 5e-6
    assert loop.position_m.min() == -5e-6
    turns = loop.position_m[:-1][np.diff(np.sign(np.diff(loop.position_m)), append=0.0) != 0]
    assert len(np.unique(np.round(turns / 5e-6, 6))) >= 6


def test_circle_is_round() -> None:
    x, y = circle(1e4, radius_m=3e-3)
    np.testing.assert_allclose(np.hypot(x.position_m, y.position_m - 3e-3), 3e-3, rtol=1e-12)
    assert np.hypot(x.velocity_m_s, y.velocity_m_s).max() == pytest.approx(0.02, rel=1e-4)


def test_repetition_and_cut() -> None:
    once = make_trajectory("hysteresis", 1000.0)
    n = len(once.position_m)
    twice = once.repeat(2 * once.duration_s)
    np.testing.assert_array_equal(twice.position_m, np.tile(once.position_m, 2))
    cut = make_trajectory("hysteresis", 1000.0, duration_s=0.5)
    np.testing.assert_array_equal(cut.position_m, once.position_m[:500])
    assert len(once.repeat(3.5 * once.duration_s).position_m) == round(3.5 * n)
    # What does not return goes on from where it ended.
    ramp = Trajectory("ramp", 10.0, np.array([0.0, 1.0, 2.0])).repeat(0.6)
    np.testing.assert_array_equal(ramp.position_m, [0.0, 1.0, 2.0, 2.0, 3.0, 4.0])


def test_limited_axis_is_not_driven_faster() -> None:
    for name in ("mixed", "trapezoids", "step_and_settle"):
        trajectory = make_trajectory(name, 1e4, max_velocity=0.05)
        assert np.abs(trajectory.velocity_m_s).max() <= 0.05 * (1 + 1e-9)


@pytest.mark.parametrize(
    ("name", "rate", "options", "where"),
    [
        ("spiral", 1e4, {}, "name"),
        ("paper", 0.0, {}, "rate"),
        ("paper", float("nan"), {}, "rate"),
        ("paper", 1e4, {"duration_s": -1.0}, "duration"),
        ("paper", 1e4, {"max_velocity": float("inf")}, "max_velocity"),
    ],
)
def test_bad_input_is_named(name: str, rate: float, options: dict[str, float], where: str) -> None:
    with pytest.raises(InputError) as caught:
        make_trajectory(name, rate, **options)
    assert caught.value.where == where


@pytest.mark.parametrize("kernels", ["Prescott", "Haswell"])
def test_a_trajectory_does_not_hang_on_the_processor(kernels: str) -> None:
    """A closed loop with an encoder's steps makes of a last digit another course of the noise."""
    script = (
        "from sgms_mhe.plant.trajectories import TRAJECTORIES\n"
        "for name, path in TRAJECTORIES.items():\n"
        "    print(name, path(2000.0, 0.05).position_m.tobytes().hex())\n"
    )
    narrow = {"OPENBLAS_CORETYPE": kernels, "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"}
    here, there = (
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", script],
            check=True,
            env=os.environ | changes,
            capture_output=True,
            text=True,
        ).stdout
        for changes in ({}, narrow)
    )
    assert here.count("\n") == len(TRAJECTORIES)
    assert here == there
