"""Friction that bends about standstill as a force of another instant would: what is stated is what the file leaves."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from sgms_mhe.api.estimation import predict
from sgms_mhe.evaluation.prediction import force_error
from sgms_mhe.identification.identify import Wanted, identify
from sgms_mhe.identification.result import Identification, Number
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]
INERTIA = 4.8e-6
RATE = 1000.0
SECONDS = 13
LAWS: dict[str, Callable[[Array], Array]] = {
    "saturating": lambda v: 1.7e-3 * np.tanh(v / 20.0) + 7e-6 * v,
    "root": lambda v: 2.5e-3 * np.sign(v) * np.sqrt(np.abs(v) / 150.0),
}


def swung_motor(seed: int, friction: Callable[[Array], Array], spring: float = 0.0, faster: float = 0.0) -> Log:
    """A motor swung at 2 Hz, hardly the same amplitude twice, its speed recorded.

    `spring` [N m]: of a force over the position; `faster`: share of a second swing, of 5 Hz.
    """
    random = np.random.default_rng(seed)
    time = np.arange(int(SECONDS * RATE)) / RATE
    size = 150.0 * (1.0 + 0.05 * np.interp(time, np.arange(SECONDS + 1), random.standard_normal(SECONDS + 1)))
    speed = size * (np.sin(4.0 * np.pi * time) + faster * np.sin(10.0 * np.pi * time))
    position = np.cumsum(speed) / RATE
    torque = INERTIA * np.gradient(speed, 1.0 / RATE) + friction(speed) + spring * position
    return Log(
        time,
        position,
        torque + 2e-4 * random.standard_normal(len(time)),
        RATE,
        velocity_m_s=speed + 0.5 * random.standard_normal(len(time)),
        kind="rotary",
        source=f"motor {seed}",
    )


@cache
def identify_motor(law: str) -> Identification:
    """Identify it, its inertia given 4 % off."""
    return identify([swung_motor(1, LAWS[law])], Wanted("motor", 5e-6))


def find_spring(found: Identification) -> Number:
    return next(number for number in found.numbers if number.name == "position_spring.stiffness_N_m")


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_what_is_stated_is_left_on_another_record(law: str) -> None:
    """Ten times as much was left: a force twelve samples early had stood for a part of the friction."""
    found = identify_motor(law)
    left = force_error(predict(found.machine, swung_motor(2, LAWS[law]))).residual_rms_N
    assert left < 1.6 * found.held_out_rms_N
    assert not any("the motion that it makes" in limit for limit in found.limits)


@pytest.mark.slow
def test_one_frequency_shows_no_inertia_beside_a_spring() -> None:
    """2.7e-6 kg m^2 was stated for 4.8e-6."""
    with pytest.raises(InputError, match="--inertia: the motion does not show it"):
        identify([swung_motor(1, LAWS["saturating"])], Wanted("motor"))


@pytest.mark.slow
def test_one_frequency_shows_no_spring_beside_an_inertia_that_it_does_not_show() -> None:
    """2.5e-5 +- 0.2e-5 N m/rad were stated of an axis that has no spring: the inertia that was given is 4 % off."""
    found = identify_motor("saturating")
    spring = find_spring(found)
    assert not spring.determined
    assert spring.std > abs(spring.value)
    assert any(limit.startswith("position_spring: not determined") and "inertia" in limit for limit in found.limits)


@pytest.mark.slow
def test_two_frequencies_show_a_spring() -> None:
    found = identify([swung_motor(1, LAWS["saturating"], 1e-4, 0.5)], Wanted("motor", INERTIA))
    spring = find_spring(found)
    assert spring.value == pytest.approx(1e-4, rel=0.05)
    assert spring.std < 0.05 * spring.value
    assert not any("position_spring: not determined" in limit for limit in found.limits)


@pytest.mark.slow
def test_a_spring_beside_friction_that_was_recorded_hangs_on_no_inertia() -> None:
    log = swung_motor(1, LAWS["saturating"], 1e-4)
    speed = np.diff(log.position_m, prepend=0.0) * RATE
    friction = log.force_N - INERTIA * np.gradient(speed, 1.0 / RATE)
    found = identify([replace(log, force_N=friction, friction_N=friction)], Wanted("motor", 5e-6))
    spring = find_spring(found)
    assert spring.std < 0.05 * spring.value
    assert not any("position_spring: not determined" in limit for limit in found.limits)
