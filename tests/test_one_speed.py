"""A record of one speed, one way: its cogging is found at any cutoff, and what one speed cannot tell is said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sgms_mhe.configuration import make_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.diagnosis.harmonics import list_smoothed
from sgms_mhe.diagnosis.parts import Cause, Rms
from sgms_mhe.identification.search import element_numbers
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.excitation import in_step
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.signals.logs import Log

RATE, COGGING = 1000.0, 0.006
PASS = "pass velocity_cutoff"


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
@pytest.mark.parametrize(("cutoff", "turns", "order", "step"), [(100.0, 1.0, 72, 1e-4), (60.0, 0.8, 48, 5e-4)])
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
    sizes = [cause.parameters["amplitude_N"] for cause in found.causes if "amplitude_N" in cause.parameters]
    said = [float(limit.partition(" is about ")[2].partition(";")[0]) for limit in found.limits if PASS in limit]
    assert (said or sizes) == [pytest.approx(COGGING, rel=0.02 if said else 0.05)]


@pytest.mark.parametrize("cutoff", [25.0, 60.0, 120.0])
@pytest.mark.parametrize(("turns", "order", "swing"), [(1.0, 72, 0.0), (0.7, 48, 0.9), (1.5, 30, 0.5), (0.1, 36, 0.5)])
def test_the_share_that_the_chain_took_of_a_ripple_is_said(
    cutoff: float, turns: float, order: int, swing: float
) -> None:
    """The share is that of a sine fitted to the friction behind the chain, at speeds that swing too."""
    time = np.arange(20_000) / RATE
    angle = 2.0 * np.pi * turns * (time - swing * np.cos(2.0 * np.pi * 0.2 * time) / (2.0 * np.pi * 0.2))
    torque = 0.5 * np.sin(order * angle)
    record = prepare(rotor(cutoff), Log(time, angle, torque, RATE, kind="rotary", source="swing.csv"))
    signals = record.signals
    waves = np.column_stack((np.sin(order * signals.position), np.cos(order * signals.position)))[signals.valid]
    friction = signals.friction[signals.valid]
    fitted = np.hypot(*np.linalg.lstsq(waves, friction, rcond=None)[0])
    values = {"amplitude_N": float(fitted), "pitch_m": 2.0 * np.pi / order, "phase_rad": 0.0}
    rms = Rms(1.0, 1.0, 1.0, 1.0)
    cause = Cause("force_ripple", "force_ripple", values, {}, {}, rms, 1.0, (1.0, 1.0), 0.0)
    said = list_smoothed(record, [cause])
    if fitted > 0.97 * 0.5:
        assert not said
    elif fitted < 0.93 * 0.5:
        assert said[0].value == pytest.approx(0.5, rel=0.06)
    assert not list_smoothed(record, [replace(cause, name="constant_offset", parameters={"force_N": 1.0})])


def test_numbers_to_start_from_are_of_elements_that_slid() -> None:
    """At one speed a spring that never slides is a force that grows with place; its level is anything."""
    machine, log = rotor(100.0), one_way(1.0, 72, 1e-4, seed=4)
    record = prepare(machine, log)
    for noise in (1e-5, 2e-4):
        found = element_numbers(record, noise)
        assert found.get("coulomb", 0.0) <= float(np.abs(record.friction[record.used]).max())


@pytest.mark.parametrize(("laps", "known"), [(3.4, False), (5.3, True), (9.6, True)])
def test_a_motion_that_comes_again_shows_no_clock_at_multiples_of_its_laps(laps: float, known: bool) -> None:
    """Forth and back at one speed: a force over place and direction is a sum of sines in time, multiples of a lap's."""
    lap, time = 2.0, np.arange(round(laps * 2.0 * RATE)) / RATE
    angle = 0.5 * np.abs((time / lap) % 1.0 - 0.5)
    torque = 0.002 * np.sign(np.gradient(angle))
    log = Log(time, angle, torque, RATE, kind="rotary", source="laps.csv")
    recording = prepare(rotor(100.0), log)
    times = np.array([3.0, 6.0, 6.5, 11.5]) / lap
    assert in_step(recording, times).tolist() == [known, known, False, False]
