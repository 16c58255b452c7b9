"""What identification hands over at least: numbers of least squares, and no more elements than logs tell apart."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from sgms_mhe.api.estimation import estimate, predict
from sgms_mhe.configuration import override_machine
from sgms_mhe.identification import Identification, Wanted, identify
from sgms_mhe.identification.description import _number
from sgms_mhe.identification.fits import NumberEstimate
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.status import measure_doubt
from sgms_mhe.support.statements import Rule

Array = NDArray[np.float64]
COUNT = 2.0 * math.pi / 2**14


def joint_log(velocity: Array, rate: float, count: float, torque: Callable[[Array, Array, Array], Array]) -> Log:
    """A joint that moves as told from 0 on, read in counts; `torque` of acceleration, velocity and angle."""
    time = np.arange(len(velocity)) / rate
    angle = np.cumsum(velocity) / rate
    read = np.round(angle / count) * count
    return Log(
        time, read, torque(np.gradient(velocity, time), velocity, angle), rate, kind="rotary", source="joint.csv"
    )


def within(found: Identification, **truth: float) -> None:
    for name, value in truth.items():
        number = found.number(name.replace("__", "."))
        assert abs(number.value - value) <= 3.0 * number.std, number


# --- elements -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "std", "upper", "stated"),
    [
        (0.118, 4.6e3, 1.0, False),
        (0.16, 0.22, 1.0, True),
        (0.9, 0.55, 1.0, False),
        (500.0, 1300.0, math.inf, True),
        (1.3e5, 5e11, math.inf, False),
    ],
)
def test_no_deviation_is_wider_than_a_numbers_range(value: float, std: float, upper: float, stated: bool) -> None:
    number = _number("fraction_1", NumberEstimate(value, std), upper=upper)
    assert math.isfinite(number.std) == stated
    assert not number.determined and number.rule is Rule.STAND_IN


def test_flicker_at_rest_is_no_motion_of_a_placeholder() -> None:
    """A placeholder is no stiffer than a count shows; measurements within a step move no friction or parameter."""
    rate, random = 500.0, np.random.default_rng(4)

    def torque(a: Array, v: Array, _: Array) -> Array:
        return 0.02 * a + 0.57 * np.tanh(200.0 * v) + 0.5 * v + 0.01 * random.standard_normal(len(v))

    speeds = np.repeat([0.1, -0.1, 0.3, -0.3, 0.8, -0.8, 1.5, -1.5], int(rate))
    moves = np.convolve(speeds, np.hanning(81) / np.hanning(81).sum(), "same")
    found = identify([joint_log(moves, rate, COUNT, torque)], Wanted("joint"))
    stiffness = found.number("stiffness_1")
    assert found.machine.friction.n_z == 1
    assert not stiffness.determined and found.to_json()["numbers"][2]["std"] is None
    assert 0.8 * COUNT <= found.number("coulomb").value / stiffness.value <= 1.2 * COUNT
    assert found.machine.sampling.position_step == pytest.approx(COUNT, rel=1e-5)
    assert f"# stiffness: {stiffness.value:.6g} (not determined: assumed)" in found.toml
    within(found, coulomb=0.57, viscous=0.5)

    rest = np.convolve(np.tile(np.repeat([0.3, 0.0, -0.9, 0.0], 500), 4), np.ones(30) / 30.0, "same")
    log = joint_log(rest, rate, COUNT, torque)
    log.position_m[:] += COUNT * random.integers(-1, 2, len(rest)) * (rest == 0.0)
    stands = np.concatenate([np.arange(k + 650, k + 980) for k in range(0, len(rest), 1000)])
    assert np.nanstd(np.diff(predict(found.machine, log).friction_N)[stands]) < 0.02 * 0.57
    estimates = estimate(found.machine, log)
    assert np.std(np.interp(log.time_s[stands], estimates.time_s, estimates.friction_N)) < 0.1 * 0.57
    assert estimates.parameter_names == ("coulomb", "viscous")
    assert np.all(np.abs(estimates.parameters[-1] - (0.57, 0.5)) <= 2.0 * estimates.std[-1])


@pytest.mark.slow
def test_laws_that_logs_do_not_tell_apart_have_the_fewer_elements() -> None:
    """Moved by hand, friction of one slope at rest: its other law had five elements, none of them known."""
    rate, random = 100.0, np.random.default_rng(0)
    time = np.arange(6000) / rate
    sines = zip((0.11, 0.23, 0.37, 0.61), (0.35, 0.18, 0.09, 0.05), random.uniform(0.0, 6.28, 4), strict=True)
    velocity = np.sum([2.0 * np.pi * f * a * np.cos(2.0 * np.pi * f * time + p) for f, a, p in sines], axis=0)

    def torque(a: Array, v: Array, q: Array) -> Array:
        return 0.05 * a + 0.8 * np.tanh(v / 3e-3) + 0.3 * v + 2.0 * q + 0.02 * random.standard_normal(len(v))

    found = identify([joint_log(velocity, rate, 1e-7, torque)], Wanted("joint"))
    assert found.machine.friction.n_z == 1
    within(found, mass=0.05, coulomb=0.8, viscous=0.3, position_spring__stiffness_N_m=2.0)


# --- least squares ------------------------------------------------------------------------------------------------


def pendulum(late: int, load: float, disturbance: float) -> Log:
    """A pendulum below a quarter turn under a disturbance that wanders; its angle is late by some samples."""
    rate, random = 188.0, np.random.default_rng(0)
    time = np.arange(int(6.0 * rate)) / rate
    angle = 1.15 * np.sin(1.9 * time**2) * np.minimum(1.0, time)
    velocity = np.gradient(angle, time)
    wander = lfilter([1.0], [1.0, -0.97], random.standard_normal(len(time)))
    gravity = 0.48 * np.sin(angle + 0.03)
    torque = 0.0067 * np.gradient(velocity, time) + gravity + 0.05 * velocity
    torque += np.tanh(velocity / 0.02) * (0.06 + load * np.abs(gravity)) + disturbance * wander / np.std(wander)
    read = np.concatenate((np.full(late, angle[0]), angle[: len(angle) - late]))
    step = 0.001534
    return Log(time, np.round(read / step) * step, torque, rate, kind="rotary", source="pendulum.csv")


@pytest.mark.slow
@pytest.mark.parametrize(("late", "load", "disturbance"), [(0, 0.1, 0.2), (2, 0.0, 0.15)])
def test_no_refusal_says_what_friction_is_where_more_is_left_than_friction(
    late: int, load: float, disturbance: float
) -> None:
    """Nor a spring that all of it is, nor none of it: the file is written, its numbers as open as they are."""
    found = identify([pendulum(late, load, disturbance)], Wanted("pendulum"))
    assert found.is_plain and found.to_json()["plain"]["written"]
    assert any("N m rms is left that nothing here explains" in sentence for sentence in found.limits)
    assert not found.number("coulomb").determined
    gravity = found.number("unbalance.amplitude_N")
    assert abs(gravity.value - 0.48) <= 2.0 * gravity.std
    assert found.number("mass").value == pytest.approx(0.0067, rel=0.15)


@pytest.mark.slow
def test_runs_of_one_direction_each_are_told_by_all_together() -> None:
    """An own offset of each run would be its friction: least squares of all of them leaves less."""
    random = np.random.default_rng(5)

    def torque(a: Array, v: Array, q: Array) -> Array:
        noise = 0.3 * random.standard_normal(len(v))
        return 2.5 * a + 38.5 * np.sin(q) + 8.0 * np.tanh(v / 5e-3) + 2.3 * v + noise

    time = np.arange(334) * 0.015
    speeds = [sign * math.radians(speed) for speed in (20.0, 60.0) for sign in (1.0, -1.0)]
    logs = [joint_log(speed * (1.0 - np.exp(-time / 0.08)), 1.0 / 0.015, 1.6e-6, torque) for speed in speeds]
    found = identify(logs, Wanted("arm", mass=2.5))
    assert found.is_plain and found.held_out_rms_N < 0.31
    within(found, coulomb=8.0, viscous=2.3, unbalance__amplitude_N=38.5)
    assert found.number("coulomb").std < 0.1 and found.number("coulomb").determined
    assert found.limits[0].startswith("the file is that of least squares")


# --- what is left of the logs, for the estimator ---------------------------------------------------------------------


@pytest.mark.slow
def test_an_estimator_is_quiet_on_the_logs_that_made_it_and_loud_on_another_axis() -> None:
    """A force that nothing explains, 0.2 N m over 0.5 s, colours what is left: that is no news of the axis."""
    rate = 250.0
    time = np.arange(int(20 * rate)) / rate
    velocity = 2.0 * np.sin(2.3 * time) + 1.0 * np.sin(5.1 * time)

    def log(seed: int, ripple: float) -> Log:
        white = np.random.default_rng(seed).standard_normal((2, len(time)))
        keep = math.exp(-1.0 / (0.5 * rate))
        left = lfilter([0.2 * math.sqrt(1.0 - keep**2)], [1.0, -keep], white[0]) + 0.01 * white[1]

        def torque(a: Array, v: Array, q: Array) -> Array:
            return 0.02 * a + 0.15 * np.tanh(v / 0.01) + 0.05 * v + ripple * np.sin(3.0 * q) + left

        return joint_log(velocity, rate, COUNT, torque)

    def doubt(machine: Machine, log: Log) -> float:
        return measure_doubt(estimate(machine, log).status)

    made = log(1, 0.0)
    machine = identify([made], Wanted("joint")).machine
    unknown = override_machine(machine, {"estimator": {"noise": {"colour": 1.0}}})
    assert doubt(unknown, made) > 0.8 and doubt(machine, made) <= 0.05
    assert doubt(machine, log(2, 0.0)) < 0.5 * doubt(unknown, log(2, 0.0))
    assert doubt(machine, log(4, 0.5)) > 0.9


# --- at rest within a count ------------------------------------------------------------------------------------------


def stuck_servo(stiffness: float, frequencies: tuple[float, float], load: float, level: float, seed: int) -> Log:
    """A geared servo under its own position loop turns a pendulum, and stands while the loop's torque grows.

    Friction is a level and a share of the motor's torque; the axis sticks as long as the rest of the torque is less.
    """
    random, inner, rate = np.random.default_rng(seed), 1e-4, 200.0
    count, phase = 2.0 * math.pi / 4096, random.uniform(0.0, 2.0 * math.pi, 2)
    angle, speed, torque, rows = 0.0, 0.0, 0.0, []
    for i in range(int(8.0 / inner)):
        time = i * inner
        if i % 10 == 0:
            waves = np.sin(2.0 * np.pi * np.array(frequencies) * time + phase) - np.sin(phase)
            torque = float(np.clip(stiffness * (float(waves @ (0.9, 0.7)) - round(angle / count) * count), -0.9, 0.9))
        if i % 50 == 0:
            rows.append((time, round(angle / count) * count, torque))
        driven, rubs = torque - 0.5 * math.sin(angle) - 0.05 * speed, level + load * abs(torque)
        if speed == 0.0 and abs(driven) <= rubs:
            continue
        direction = math.copysign(1.0, speed or driven)
        new = speed + inner * (driven - rubs * direction) / 0.008
        speed = 0.0 if speed * new < 0.0 else new
        angle += inner * speed
    time, read, driven_by = np.array(rows).T
    return Log(time, read, driven_by, rate, kind="rotary", source=f"servo{seed}.csv")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "level", "draw"), [(0.25, 0.02, 1), (0.15, 0.03, 2), (0.35, 0.015, 3)], ids=["some", "less", "more"]
)
def test_rest_within_a_count_does_not_measure_friction(load: float, level: float, draw: int) -> None:
    logs = [
        stuck_servo(0.4, (0.3, 0.8), load, level, 10 * draw),
        stuck_servo(0.6, (0.25, 0.9), load, level, 10 * draw + 1),
    ]
    assert all(np.mean(np.diff(log.position_m) == 0.0) > 0.05 for log in logs)
    found = identify(logs, Wanted("servo"))
    within(found, mass=0.008, viscous=0.05, unbalance__amplitude_N=0.5, load_dependent_friction__ratio=load)
    assert found.number("unbalance.amplitude_N").std < 0.02
