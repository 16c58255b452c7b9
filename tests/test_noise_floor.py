"""The noise floor of records that hold more than noise: pushes, reversals, cogging, a wrong law; coloured noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sgms_bench.diagnosis.motions import draw_motion
from sgms_mhe.configuration import load_machine, make_machine, override_machine
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.recordings.evidence import noise_floor
from sgms_mhe.recordings.recording import Recording, prepare
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]

FAST = (10_000.0, 500.0)
"""Samples and cutoff [Hz]: of rows at 1 kHz."""
SLOW = (10_000.0, 50.0)
"""Of rows at 200 Hz: pieces of 80 ms, noise that the chain has made slow."""
PUSH, LENGTHS = 2.0, (2e-3, 10e-3)  # N, s


def axis(rate: float, cutoff: float) -> Machine:
    return override_machine(load_machine("etel_xy"), {"sampling": {"rate": rate, "velocity_cutoff": cutoff}})


def record(machine: Machine, noise: float, pushes: float, style: str = "dies") -> tuple[Recording, Array, Array]:
    """A jerky motion of an axis that switches, pushed so many times a second: rows, their noise, what a fit leaves."""
    motion = draw_motion(style, machine, 8.0, np.random.default_rng(3))
    config = AxisConfig(
        law="maxwell_slip", force_noise_N=noise, encoder_noise_m=1e-12, encoder_resolution_m=1e-11, seed=1
    )
    run = simulate_axis(machine, motion, config)
    true = replace(run.log, position_m=run.truth.position_m, force_N=run.truth.force_N)
    noisy = signals_from_log(run.log, machine).friction - signals_from_log(true, machine).friction
    random, t = np.random.default_rng(7), run.log.time_s
    force = np.zeros(len(t))
    for at in random.uniform(t[0], t[-1], int(pushes * (t[-1] - t[0]))):
        force += random.choice([-PUSH, PUSH]) * np.exp(-(((t - at) / random.uniform(*LENGTHS)) ** 2))
    recording = prepare(machine, replace(run.log, force_N=run.log.force_N + force))
    residual = fit_model(Subject.of(machine, recording), (), refitted=()).residual
    return recording, recording.reduce(noisy), residual


def rms(recording: Recording, series: Array) -> float:
    return float(np.sqrt(np.mean(series[recording.used] ** 2)))


@pytest.mark.parametrize(
    ("sampling", "noise", "pushes"),
    [
        (FAST, 0.3, 0.0),
        (FAST, 0.3, 15.0),
        (FAST, 0.02, 0.0),
        (FAST, 0.02, 15.0),  # the median of all pieces: 2.3 times the noise
        (FAST, 0.02, 30.0),  # 10 times
        (SLOW, 0.3, 6.0),  # 6 times
        (SLOW, 0.02, 15.0),  # 200 times: one piece in twenty holds noise alone
    ],
)
def test_the_floor_is_that_of_the_noise_however_much_pushes_the_axis(
    sampling: tuple[float, float], noise: float, pushes: float
) -> None:
    recording, noisy, residual = record(axis(*sampling), noise, pushes)
    true = rms(recording, noisy)
    assert rms(recording, residual) > (1.2 if pushes else 1.0) * true
    assert noise_floor(recording, residual) == pytest.approx(true, rel=0.2)


@pytest.mark.parametrize("sampling", [FAST, SLOW])
def test_noise_that_the_chain_has_coloured_is_not_taken_for_less(sampling: tuple[float, float]) -> None:
    """At 50 Hz a parabola takes a fifth of it out of a piece."""
    recording, noisy, _ = record(axis(*sampling), 0.3, 0.0)
    assert noise_floor(recording, noisy) == pytest.approx(rms(recording, noisy), rel=0.04)


def test_noise_of_friction_that_passes_no_filter_is_not_taken_for_more() -> None:
    """Of a log that brings friction and velocity a low cutoff says nothing: the floor was 1.8 times the noise."""
    machine = axis(1000.0, 10.0)
    motion = draw_motion("dies", machine, 8.0, np.random.default_rng(3))
    run = simulate_axis(machine, motion, AxisConfig(law="maxwell_slip", seed=1))
    velocity, noise = np.gradient(run.truth.position_m) * machine.sampling.rate, 0.3
    friction = run.truth.friction_N + noise * np.random.default_rng(5).standard_normal(len(run.log))
    log = replace(run.log, velocity_m_s=velocity, friction_N=friction, force_N=friction)
    recording = prepare(machine, log)
    residual = fit_model(Subject.of(machine, recording), (), refitted=()).residual
    assert noise_floor(recording, residual) == pytest.approx(noise / np.sqrt(recording.factor), rel=0.1)


def test_noise_of_an_encoder_counts_as_it_is() -> None:
    """Twice differentiated it is fast: a parabola leaves nearly all of it."""
    machine = axis(*FAST)
    motion = draw_motion("strokes", machine, 4.0, np.random.default_rng(2))
    config = AxisConfig(force_noise_N=0.0, encoder_noise_m=2e-9, encoder_resolution_m=0.0, seed=3)
    run = simulate_axis(machine, motion, config)
    true = replace(run.log, position_m=run.truth.position_m, force_N=run.truth.force_N)
    recording = prepare(machine, run.log)
    noisy = recording.reduce(signals_from_log(run.log, machine).friction - signals_from_log(true, machine).friction)
    assert noise_floor(recording, noisy) == pytest.approx(rms(recording, noisy), rel=0.04)


def test_rests_without_noise_do_not_hide_that_of_the_motion() -> None:
    recording, _, _ = record(axis(*FAST), 0.02, 0.0)
    noise = 0.1 * np.random.default_rng(1).normal(size=len(recording.time))
    still = np.abs(recording.velocity) < 1e-4
    assert 0.05 < still.mean() < 0.5
    # A white noise is between the force's and the encoder's.
    assert noise_floor(recording, np.where(still, 0.0, noise)) == pytest.approx(0.1, rel=0.06)


def rotor(rate: float, cutoff: float) -> Machine:
    """A rotor of 5e-6 kg m^2 with little friction, whose cogging is most of its torque."""
    return make_machine(
        {
            "name": "rotor",
            "plant": {"kind": "rotary", "inertia": 5e-6},
            "friction": {"law": "switching", "stiffness": [40.0], "fraction": [1.0], "coulomb": 0.002},
            "sampling": {"rate": rate, "update_rate": 100.0, "velocity_cutoff": cutoff, "max_velocity": 60.0},
        },
        Path("rotor.toml"),
    )


def turn(motion: str, rate: float) -> Array:
    """Speed of 14 s of about a turn a second (n) [rad/s]."""
    t = np.arange(int(14 * rate)) / rate
    speed = {
        "one": np.ones_like(t),
        "uneven": 1.0 + 0.1 * np.sin(2 * np.pi * 0.7 * t),
        "both ways": np.sign(np.sin(2 * np.pi * t / 5.0)),
        "three speeds": np.choose((t // 2).astype(int) % 3, [0.5, 1.0, 2.0]),
    }[motion]
    smooth = np.ones(int(0.1 * rate)) / int(0.1 * rate)
    return np.asarray(
        2 * np.pi * np.convolve(np.pad(speed, len(smooth), mode="edge"), smooth, "same")[len(smooth) :][: len(t)]
    )


def cogging_record(motion: str, rate: float, cutoff: float, orders: tuple[int, ...], seed: int) -> tuple[float, ...]:
    """A rotor's floor, its true noise, and the cogging in its record, which no model explains: RMS [N m]."""
    machine, random = rotor(rate, cutoff), np.random.default_rng(seed)
    speed = turn(motion, rate) * (1.0 + 1e-3 * random.standard_normal(1)[0])
    angle = np.cumsum(speed) / rate
    cogging = sum((0.006 * np.sin(n * angle + n) for n in orders), np.zeros_like(angle))
    noise = 5e-4 * random.standard_normal(len(angle))
    log = Log(np.arange(len(angle)) / rate, angle, cogging + noise, rate, kind="rotary")
    recording = prepare(machine, log)

    def friction(force: Array) -> Array:
        return recording.reduce(signals_from_log(replace(log, force_N=force), machine).friction)

    still = friction(np.zeros_like(angle))
    residual, noisy = friction(log.force_N) - still, friction(noise) - still
    return noise_floor(recording, residual), rms(recording, noisy), rms(recording, residual)


@pytest.mark.parametrize("motion", ["one", "uneven", "both ways", "three speeds"])
@pytest.mark.parametrize(
    ("rate", "cutoff", "orders"),
    [
        (1000.0, 100.0, (72,)),
        (1000.0, 150.0, (72,)),
        (1000.0, 150.0, (24, 72)),
        (4000.0, 100.0, (72,)),
        (4000.0, 500.0, (12, 72)),
    ],
)
def test_a_force_that_comes_again_in_place_is_no_noise(
    motion: str, rate: float, cutoff: float, orders: tuple[int, ...]
) -> None:
    """Faster than a parabola follows, and at one speed in every segment."""
    floor, noise, all_of_it = cogging_record(motion, rate, cutoff, orders, seed=3)
    assert all_of_it > 10.0 * noise
    assert 0.85 * noise < floor < 1.5 * noise


def test_a_force_that_comes_again_in_time_is_no_noise() -> None:
    machine, random = rotor(1000.0, 150.0), np.random.default_rng(5)
    t = np.arange(12_000) / 1000.0
    angle, noise = 3.0 * np.sin(2 * np.pi * 0.4 * t), 5e-4 * random.standard_normal(len(t))
    hum = Log(t, angle, noise + 0.004 * np.sin(2 * np.pi * 50.0 * t), 1000.0, kind="rotary")
    recording = prepare(machine, hum)
    residual, noisy = (
        recording.reduce(signals_from_log(replace(hum, force_N=force), machine).force) for force in (hum.force_N, noise)
    )
    assert rms(recording, residual) > 10.0 * rms(recording, noisy)
    assert noise_floor(recording, residual) == pytest.approx(rms(recording, noisy), rel=0.1)


@pytest.mark.parametrize("motion", ["one", "uneven", "both ways", "three speeds"])
@pytest.mark.parametrize(("rate", "cutoff"), [(1000.0, 25.0), (1000.0, 150.0), (4000.0, 100.0), (4000.0, 500.0)])
def test_noise_has_no_lines(motion: str, rate: float, cutoff: float) -> None:
    for seed in range(4):
        floor, noise, _ = cogging_record(motion, rate, cutoff, (), seed)
        assert floor == pytest.approx(noise, rel=0.1)


def test_noise_of_an_axis_at_rest_is_no_function_of_its_position() -> None:
    """The position is noise there, and mass times its acceleration goes with it."""
    machine, random = axis(*FAST), np.random.default_rng(2)
    still = Log(np.arange(40_000) / 1e4, 5e-9 * random.standard_normal(40_000), np.zeros(40_000), 1e4)
    recording = prepare(machine, still)
    assert noise_floor(recording, recording.friction) == pytest.approx(rms(recording, recording.friction), rel=0.06)
