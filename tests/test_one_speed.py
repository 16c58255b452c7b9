"""A record of one speed, one way: its cogging is found at any cutoff, and what one speed cannot tell is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sgms_mhe.configuration import make_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.identification.search import element_numbers
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.signals.logs import Log

RATE, COGGING = 1000.0, 0.006


def rotor(cutoff: float) -> Machine:
    """A rotor as a beginner's file describes it: its viscous friction is a hundred times too large."""
    return make_machine(
        {
            "name": "rotor",
            "plant": {"kind": "rotary", "inertia": 5e-6},
            "friction": {
                "coulomb": 0.002,
                "viscous": 0.002,
                "stiffness": [133.0, 60.0, 33.3, 20.0],
                "fraction": [0.1, 0.15, 0.25, 0.5],
            },
            "sampling": {
                "rate": RATE,
                "update_rate": 100.0,
                "velocity_cutoff": cutoff,
                "max_velocity": 20.0,
                "integrator": {"scheme": "flow"},
            },
            "estimator": {"parameters": ["coulomb", "viscous"]},
        },
        Path("rotor.toml"),
    )


def one_way(turns: float, order: int, step: float, seed: int) -> Log:
    """So many turns a second, drag, cogging and noise; an encoder of this step [rad]."""
    random, time = np.random.default_rng(seed), np.arange(14_000) / RATE
    angle = 2.0 * np.pi * turns * time
    torque = 0.002 + COGGING * np.sin(order * angle) + 5e-4 * random.standard_normal(len(time))
    return Log(time, np.round(angle / step) * step, torque, RATE, kind="rotary", source="one_way.csv")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cutoff", "turns", "order", "step"),
    [
        (100.0, 1.0, 72, 1e-4),
        (150.0, 1.0, 72, 1e-4),
        (200.0, 1.0, 72, 1e-4),
        (120.0, 1.7, 36, 2e-5),
        (60.0, 0.8, 48, 5e-4),
    ],
)
def test_cogging_at_one_speed_is_found_at_any_cutoff(cutoff: float, turns: float, order: int, step: float) -> None:
    found = diagnose(rotor(cutoff), one_way(turns, order, step, seed=order))
    assert found.verdict in ("explained", "ambiguous")
    assert found.rms.held_out_after < 1.3 * found.noise_floor_N
    sines = {cause.name: cause.parameters for cause in found.causes}
    if "periodic_disturbance" in sines:
        assert sines["periodic_disturbance"]["frequency_Hz"] == pytest.approx(turns * order, rel=1e-3)
    else:
        assert sines["force_ripple"]["pitch_m"] == pytest.approx(2.0 * np.pi / order, rel=1e-3)
    assert any("one speed" in limit and "in time or in place" in limit for limit in found.limits)


def test_numbers_to_start_from_are_of_elements_that_slid() -> None:
    """At one speed a spring that never slides is a force that grows with place; its level is anything."""
    machine, log = rotor(100.0), one_way(1.0, 72, 1e-4, seed=4)
    record = prepare(machine, log)
    for noise in (1e-5, 2e-4):
        found = element_numbers(record, noise)
        assert found.get("coulomb", 0.0) <= float(np.abs(record.friction[record.used]).max())
