"""Identification through coarse encoders: what their steps add to an acceleration makes no inertia smaller."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from sgms_mhe.identification import Wanted, identify
from sgms_mhe.identification.fits import MOST_NOISE, fit_axis
from sgms_mhe.identification.identify import explore
from sgms_mhe.signals.logs import Log
from test_late_readings import spinning_axis

INERTIA, LEVEL, VISCOUS = 0.9, 6.0, 9.0


def joint(bits: int, rate: float, seed: int, size: float = 1.0, seconds: float = 20.0) -> Log:
    """A joint of 6 N m of friction that swings in four sines, read by an encoder of so many bits a turn."""
    random, time = np.random.default_rng(seed), np.arange(int(seconds * rate)) / rate
    angle = np.zeros(len(time))
    for frequency, amplitude in ((0.13, 0.5), (0.37, 0.3), (0.71, 0.15), (1.3, 0.05)):
        angle += amplitude * np.sin(2.0 * np.pi * frequency * time + random.uniform(0.0, 2.0 * np.pi))
    velocity = np.gradient(angle, 1.0 / rate)
    distances, friction = np.array([3e-4, 1e-3, 3e-3]), VISCOUS * velocity
    deflection = np.zeros(3)
    for k, step in enumerate(np.diff(angle, prepend=angle[0])):
        deflection = np.clip(deflection + step, -distances, distances)
        friction[k] += LEVEL / 3.0 * float(np.sum(deflection / distances))
    torque = INERTIA * np.gradient(velocity, 1.0 / rate) + friction + 0.03 * random.standard_normal(len(time))
    line = 2.0 * np.pi / 2**bits
    return Log(time, np.round(angle / line) * line, size * torque, rate, kind="rotary", source="joint.csv")


@pytest.mark.slow
@pytest.mark.parametrize(("bits", "rate", "seed", "size"), [(13, 1000.0, 1, 1.0), (14, 500.0, 4, 0.02)])
def test_inertia_behind_coarse_steps_is_within_its_interval(bits: int, rate: float, seed: int, size: float) -> None:
    """Plain least squares has it 3 to 5 deviations too small."""
    found = identify([joint(bits, rate, seed, size)], Wanted("joint"))
    for name, truth in (("inertia", INERTIA), ("coulomb", LEVEL)):
        number = found.number("mass" if name == "inertia" else name)
        assert abs(number.value - size * truth) <= 3.0 * number.std
    assert found.number("mass").std < (0.2 if bits == 13 else 0.02) * size * INERTIA


@pytest.mark.slow
def test_noise_is_taken_off_once_and_never_all() -> None:
    """The mass grows by what the noise hid; noise that no log can have makes it finite still."""
    explored = explore([joint(14, 500.0, 4)], Wanted("joint", elements=1))
    view, fit = explored.views.fine, explored.final.fit
    masses = []
    for noise in (0.0, view.rows.acceleration_noise, 1e6):
        terms = [term if term.name != "mass" else replace(term, noise=noise) for term in fit.terms]
        found = fit_axis(view, terms, fit.shape)
        masses.append(view.rows.machine.plant.moved + float(found.coefficient("mass")[0]))
    assert masses[0] < masses[1] < masses[2] < masses[0] / (1.0 - MOST_NOISE) ** 2


def held_joint(bits: int, seed: int, late: int = 0) -> Log:
    """The joint under a controller that reads the encoder itself; its torque is logged so many samples late."""
    random, rate, substeps = np.random.default_rng(seed), 1000.0, 10
    time, line, h = np.arange(int(20.0 * rate)) / rate, 2.0 * np.pi / 2**bits, 1.0 / rate / substeps
    wanted = np.zeros(len(time))
    for frequency, amplitude in ((0.11, 0.4), (0.23, 0.25), (0.41, 0.15), (0.7, 0.08)):
        phase = random.uniform(0.0, 2.0 * np.pi)
        wanted += amplitude * (np.sin(2.0 * np.pi * frequency * time + phase) - math.sin(phase))
    ahead = np.gradient(wanted, 1.0 / rate)
    distances, deflections = (3e-4, 1e-3, 3e-3), [0.0, 0.0, 0.0]
    angle = speed = seen = slow = 0.0
    read, torque = np.empty(len(time)), np.empty(len(time))
    for k in range(len(time)):
        read[k] = round(angle / line) * line
        slow, seen = slow + 0.2 * ((read[k] - seen) * rate - slow), read[k]
        torque[k] = 900.0 * (wanted[k] - read[k]) + 45.0 * (ahead[k] - slow)
        for _ in range(substeps):
            deflections = [min(max(z + speed * h, -d), d) for z, d in zip(deflections, distances, strict=True)]
            friction = sum(LEVEL / 3.0 * z / d for z, d in zip(deflections, distances, strict=True)) + VISCOUS * speed
            speed += (torque[k] - friction) / INERTIA * h
            angle += speed * h
    logged = np.concatenate((np.full(late, torque[0]), torque[: len(torque) - late]))
    return Log(time, read, logged + 0.03 * random.standard_normal(len(time)), rate, kind="rotary", source="held.csv")


def said_delay(log: Log) -> str:
    """The sentence on torque and motion that are apart in time; empty where there is none."""
    found = identify([log], Wanted("joint", mass=INERTIA))
    return next((limit for limit in found.limits if "the motion that it makes" in limit), "")


@pytest.mark.slow
@pytest.mark.parametrize(("bits", "seed"), [(11, 3), (12, 1)])
def test_what_an_encoder_makes_of_a_controllers_torque_is_no_delay(bits: int, seed: int) -> None:
    """The torque answers to the steps, whose acceleration stands in the measured friction: 14 to 18 ms were said."""
    assert not said_delay(held_joint(bits, seed))


@pytest.mark.slow
def test_a_delay_that_the_encoder_shows_is_said() -> None:
    """Its size is that of the first order in the delay: a fifth short of twenty samples."""
    said = re.match(r"the torque comes (\S+) ms after", said_delay(held_joint(16, 1, late=20)))
    assert said and 15.0 <= float(said[1]) <= 20.4


@pytest.mark.slow
def test_a_force_that_is_held_over_a_sample_is_not_late() -> None:
    """Half a sample was said as a delay where nothing else is left."""
    axis = spinning_axis(500.0, 0.0, 1)
    found = identify([axis], Wanted("spinning"))
    assert not any("the motion that it makes" in limit for limit in found.limits)
    later = replace(axis, force_N=np.concatenate((axis.force_N[:5], axis.force_N[:-5])))
    found = identify([later], Wanted("spinning"))
    assert any("after the motion that it makes" in limit for limit in found.limits)
