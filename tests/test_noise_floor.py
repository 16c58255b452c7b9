"""The noise floor of records that hold more than noise: pushes, reversals, a model of the wrong law; coloured noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sgms_bench.diagnosis.motions import draw_motion
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.recordings.evidence import noise_floor
from sgms_mhe.recordings.recording import Recording, prepare
from sgms_mhe.signals.chain import signals_from_log

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
