"""Identification through coarse encoders: what their steps add to an acceleration makes no inertia smaller."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sgms_mhe.identification import Wanted, identify
from sgms_mhe.identification.fits import MOST_NOISE, fit_axis
from sgms_mhe.identification.identify import explore
from sgms_mhe.signals.logs import Log

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
@pytest.mark.parametrize(
    ("bits", "rate", "seed", "size"),
    [(13, 1000.0, 1, 1.0), (14, 500.0, 4, 0.02), (15, 1000.0, 2, 30.0), (17, 2000.0, 3, 1.0)],
)
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
