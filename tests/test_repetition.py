"""When time and the motion are one clock."""

import numpy as np
import pytest

from record_cases import simulate_log
from sgms_mhe.configuration import load_machine
from sgms_mhe.plant.trajectories import Motion
from sgms_mhe.recordings.excitation import clock_note, find_steady_blocks
from sgms_mhe.recordings.recording import Recording, prepare

SPEED = 0.02


def record(*moves: tuple[float, float]) -> Recording:
    """Of moves (way [m], speed [m/s]), one after the other."""
    machine = load_machine("etel_xy")
    path = Motion(machine.sampling.rate)
    path.wait(0.2)
    for way, speed in moves:
        path.move_by(way, speed, 2.0, 100.0)
    path.wait(0.2)
    return prepare(machine, simulate_log(machine, path=path.trajectory("moves"), control="prescribed"))


def test_one_speed_is_a_clock_where_it_is_kept() -> None:
    at_one = record((6.0 * SPEED, SPEED))
    steady = find_steady_blocks(at_one)
    assert steady is not None
    assert len(steady) - 6 <= np.count_nonzero(steady) < len(steady)
    assert not steady[0] and not steady[-1], "the axis starts and stops there"
    moving = np.isin(at_one.block, np.flatnonzero(steady)) & at_one.used
    np.testing.assert_allclose(at_one.velocity[moving], SPEED, rtol=0.05)
    (note,) = clock_note(at_one)
    assert "one speed" in note.sentence


@pytest.mark.parametrize(
    "moves",
    [[(3.0 * SPEED, SPEED), (6.0 * SPEED, 2.0 * SPEED)], [(3.0 * SPEED, SPEED), (-3.0 * SPEED, SPEED)]],
    ids=["two speeds", "out and back"],
)
def test_more_than_one_speed_is_none(moves: list[tuple[float, float]]) -> None:
    assert find_steady_blocks(record(*moves)) is None
    assert clock_note(record(*moves)) == ()
