"""Records whose directions have speeds of their own: friction over speed and gravity are one there, which is said."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from sgms_mhe.configuration import make_machine
from sgms_mhe.identification import Wanted, identify
from sgms_mhe.recordings.excitation import find_speeds_apart
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.signals.logs import Log

INERTIA, GRAVITY, LEVEL, SHORT = 0.4, 9.0, 0.6, 0.004


def strokes(forth: Sequence[float], back: Sequence[float], seed: int, rate: float, travel: float = 2.8) -> Log:
    """Strokes at these speeds in turn, with ramps, of an arm whose friction falls with speed and grows with load."""
    steps = []
    for out, home in zip(forth, back, strict=True):
        for speed in (out, -home):
            ramp = np.linspace(0.0, 1.0, max(2, round(abs(speed) / 8.0 * rate)))
            hold = np.ones(round(max(travel / abs(speed) - abs(speed) / 8.0, 0.1) * rate))
            steps.append(speed * np.concatenate((ramp, hold, ramp[::-1])))
    velocity = np.concatenate(steps)
    angle = 0.05 + np.cumsum(velocity) / rate
    gravity = GRAVITY * np.sin(angle)
    level = (LEVEL + 0.1 * np.abs(gravity)) * (1.0 + np.exp(-((velocity / 0.1) ** 2)))
    bristle, last = np.empty(len(angle)), 0.0
    for k, moved in enumerate(velocity / rate):  # exact for a steady speed over a sample
        way = np.sign(moved)
        last = way + (last - way) * np.exp(-abs(moved) / SHORT) if moved else last
        bristle[k] = last
    noise = np.random.default_rng(seed).normal(0.0, 0.02, len(angle))
    torque = INERTIA * np.gradient(velocity) * rate + gravity + level * bristle + 0.3 * velocity + noise
    time = np.arange(len(angle)) / rate
    return Log(time, np.round(angle / 1e-4) * 1e-4, torque, rate, kind="rotary", source="arm.csv")


MOTIONS = [
    ((0.05,), (0.1,), True),
    ((0.3, 0.25), (0.1, 0.12), True),
    ((0.4, 0.5, 0.3), (1.2, 0.9, 1.5), True),
    ((0.2, 0.8), (0.4, 0.1), False),
    ((0.3, 0.1), (0.3, 0.1), False),
    ((0.1, 0.4), (0.4, 1.0), False),
]


@pytest.mark.parametrize(("forth", "back", "apart"), MOTIONS)
@pytest.mark.parametrize(("rate", "unit"), [(200.0, 1.0), (500.0, 1e-3), (1000.0, 50.0)])
def test_speeds_of_one_direction_alone_are_found(
    forth: Sequence[float], back: Sequence[float], apart: bool, rate: float, unit: float
) -> None:
    log = strokes(forth, back, 1, rate)
    log = Log(log.time_s, unit * log.position_m, log.force_N, rate, kind="rotary", source="arm.csv")
    content = {
        "name": "arm",
        "plant": {"kind": "rotary", "inertia": INERTIA},
        "friction": {"stiffness": [150.0 / unit], "fraction": [1.0], "coulomb": LEVEL},
        "sampling": {"rate": rate, "update_rate": 50.0, "velocity_cutoff": 20.0, "max_velocity": 2.0 * unit},
        "estimator": {"parameters": ["coulomb"]},
    }
    found = find_speeds_apart(prepare(make_machine(content, Path("arm.toml")), log))
    if apart:
        assert found is not None
        for speed, way in zip(found, (forth, back), strict=True):
            assert 0.99 * min(way) <= speed / unit <= 1.01 * max(way)
    else:
        assert found is None


@pytest.mark.slow
def test_numbers_that_hang_on_equal_speeds_are_open() -> None:
    seed, rate = 1, 100.0
    apart = identify([strokes((0.4, 0.5), (1.2, 0.9), seed, rate)], Wanted("arm", INERTIA))
    assert any("coulomb" in said and "Needed: the same speeds both ways" in said for said in apart.limits)
    numbers = {number.name: number for number in apart.numbers}
    assert not any(n.determined for name, n in numbers.items() if name == "coulomb" or name.startswith("unbalance"))
    both = identify([strokes((0.4, 1.0), (0.4, 1.0), seed, rate)], Wanted("arm", INERTIA))
    assert not any("speeds both ways" in said for said in both.limits)
    gravity = next(number for number in both.numbers if number.name == "unbalance.amplitude_N")
    assert gravity.determined and gravity.value == pytest.approx(GRAVITY, rel=0.03)
