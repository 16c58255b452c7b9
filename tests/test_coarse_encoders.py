"""A diagnosis through a coarse encoder: the true machine is adequate, and what is above its steps has its name."""

import math
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest import approx

from diagnosis_cases import Causes, assert_found
from sgms_bench.diagnosis.motions import draw_motion
from sgms_bench.studies.coarse import draw_coarse_axis, has_curve
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.diagnosis.alignment import find_chain_error, find_encoder_force
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.identification import Wanted, identify
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import SimulatedRun, simulate_axis
from sgms_mhe.recordings.path import reading_error, smooth_blocks, smooth_path
from sgms_mhe.recordings.recording import Recording, add_encoder, prepare
from sgms_mhe.report.content import _says
from test_stated_residual import motion

Array = NDArray[np.float64]
RATE = 2000.0
COGGING: Final = ("force_ripple", {"amplitude_N": 3.0, "pitch_m": 0.012, "phase_rad": 0.7})


def screw(cutoff: float, rate: float = RATE) -> Machine:
    """A slow axis of much friction: a step of 1 um is 3 N where all of its elements stick."""
    changes = {
        "plant": {"mass": 35.0},
        "friction": {
            "stiffness": [2.0e6, 8.0e5, 3.0e5, 6.0e4],
            "fraction": [0.35, 0.3, 0.2, 0.15],
            "micro_viscous": [0.0] * 4,
            "viscous": 120.0,
            "coulomb": 40.0,
            "stribeck_ratio": 0.2,
            "stribeck_velocity": 6e-3,
        },
        "sampling": {"rate": rate, "velocity_cutoff": cutoff, "max_velocity": 0.3},
    }
    return override_machine(load_machine("etel_xy_switching"), changes)


@cache
def run_screw(step_m: float, *, cogging: bool = False) -> SimulatedRun:
    """A simulation that shares no code with the model, its loop closed over the encoder."""
    machine = screw(100.0)
    motion = draw_motion("loops", machine, 16.0, np.random.default_rng(2))
    config = AxisConfig("maxwell_slip", bandwidth_Hz=18.0, encoder_resolution_m=step_m, force_noise_N=0.02, seed=2)
    return simulate_axis(machine, motion, config, hidden_effects=(COGGING,) if cogging else ())


def read_screw(cutoff: float, step_m: float) -> tuple[Recording, Array, SimulatedRun]:
    """A record with its encoder, and the force that its steps leave in truth (m) [N]."""
    machine, run = screw(cutoff), run_screw(step_m)
    known = replace(run.log, position_m=run.truth.position_m)
    records = [add_encoder(prepare(machine, log), log) for log in (run.log, known)]
    residuals = []
    for record in records:
        subject = Subject.of(machine, record)
        fit = fit_model(subject, (), refitted=())
        residuals.append(fit.residual - find_chain_error(subject, fit))
    return records[0], residuals[0] - residuals[1], run


def rms(series: Array) -> float:
    return float(np.sqrt(np.mean(series**2)))


@pytest.mark.parametrize("cutoff", [25.0, 50.0])
def test_a_low_cutoff_makes_no_friction(cutoff: float) -> None:
    """Elements along a filtered motion turn round too late; along the axis's own they leave a tenth of that."""
    machine, run = screw(cutoff), run_screw(0.0)
    subject = Subject.of(machine, add_encoder(prepare(machine, run.log), run.log))
    fit = fit_model(subject, (), refitted=())
    used = subject.recording.used
    late = rms(fit.residual[used])
    assert late > 0.01 * machine.friction.coulomb
    assert rms((fit.residual - find_chain_error(subject, fit))[used]) < 0.25 * late


@pytest.mark.parametrize("cutoff", [25.0, 200.0])
@pytest.mark.parametrize("step_m", [1e-6, 1e-7])
def test_what_an_encoders_steps_leave_is_known(cutoff: float, step_m: float) -> None:
    """Through stiff elements at a low cutoff, through the mass at a high one: to a factor of 1.6."""
    record, true, _ = read_screw(cutoff, step_m)
    subject = Subject.of(record.machine, record)
    force = find_encoder_force(subject, fit_model(subject, (), refitted=()))
    assert force is not None
    assert abs(math.log(rms(force[record.used]) / rms(true[record.used]))) < math.log(1.6)
    slow = record.used & (np.abs(record.velocity) < 1e-4)
    fast = record.used & (np.abs(record.velocity) > 1e-2)
    if cutoff < 100.0:  # a function of speed: large where elements stick, next to nothing where they slip
        assert rms(force[slow]) > 4.0 * rms(force[fast])
        assert rms(true[slow]) > 4.0 * rms(true[fast])


def test_an_axis_stops_between_uneven_lines_at_another_place_each_time() -> None:
    stops = np.repeat(1e-6 * np.arange(2000.0), 10)
    uneven, even = reading_error(stops, 1e-6, uneven=True), reading_error(stops, 1e-6)
    assert rms(uneven) == pytest.approx(1e-6 / math.sqrt(12.0), rel=0.05)
    assert np.max(np.abs(uneven)) <= 0.5e-6
    assert np.ptp(even) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cutoff", "step_m", "says"), [(25.0, 1e-6, None), (200.0, 1e-6, True), (50.0, 1e-7, None), (100.0, 1e-8, False)]
)
def test_the_true_machine_is_adequate_however_coarse_its_encoder(
    cutoff: float, step_m: float, says: bool | None
) -> None:
    """Where its steps make most of a residual over acceleration, that is said, and where they do not it is not."""
    found = diagnose(screw(cutoff), run_screw(step_m).log)
    assert_found(found, {}, "adequate")
    assert says is None or ("encoder" in _says("acceleration", found)) is says
    if says:
        over = next(s for s in found.structure_before if s.coordinate == "acceleration")
        assert over.encoder_N > 0.25 * over.rms_N
        assert "encoder's steps make" in _says("acceleration", found)


@pytest.mark.slow
def test_cogging_above_a_coarse_encoders_steps_is_named() -> None:
    found = diagnose(screw(50.0), run_screw(1e-6, cogging=True).log)
    assert_found(found, {"force_ripple": {"amplitude_N": approx(3.0, rel=0.1)}}, "explained")


@pytest.mark.slow
def test_pushes_above_a_coarse_encoders_steps_are_not_called_its_noise() -> None:
    """Pushes that no effect has: three times as much as the encoder leaves."""
    log = run_screw(1e-6).log
    random, t = np.random.default_rng(3), log.time_s
    force = log.force_N.copy()
    for at in random.uniform(1.0, t[-1], 60):
        force += random.choice([-1.0, 1.0]) * 12.0 * np.exp(-(((t - at) / 0.02) ** 2))
    found = diagnose(screw(50.0), replace(log, force_N=force))
    assert found.verdict == "unexplained"
    assert found.encoder_noise_N == 0.0
    assert "no cause in the catalogue" in found.limits[0]


ASYMMETRIC: Final = ("asymmetric_coulomb", {"ratio": 0.15})
RIPPLED: Final = ("force_ripple", {"amplitude_N": 2.2, "pitch_m": 4e-3, "phase_rad": 0.7})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "hidden", "factor", "causes"),
    [
        # The smooth law goes down at each reversal that a path makes of the encoder's steps; 611 has the other one. Its
        # force was found 1.2 to 9 times too small: along a path read once more that had its steps already.
        (504, (), 1.0, {}),
        (611, (), 1.0, {}),
        # Beside a noise of the encoder that is a third to a fifth of what it makes.
        (513, (ASYMMETRIC,), 1.0, {"asymmetric_coulomb": {"ratio": approx(0.15, rel=0.2)}}),
        (500, (), 1.6, {"viscous": {}}),
        # A ripple makes a file look rough; begun from the file, the search took the other law and named no cause.
        (504, (RIPPLED,), 1.0, {"force_ripple": {"pitch_m": approx(4e-3, rel=0.01)}}),
    ],
    ids=["smooth", "switching", "asymmetry", "damping of the file", "ripple"],
)
def test_what_acts_on_an_axis_behind_a_coarse_encoder_is_found_and_nothing_else(
    seed: int, hidden: tuple[tuple[str, dict[str, float]], ...], factor: float, causes: Causes
) -> None:
    """`factor`: of the axis's damping over the file's."""
    axis = draw_coarse_axis(seed, hidden=hidden)
    true = axis.machine.friction.viscous
    found = diagnose(override_machine(axis.machine, {"friction": {"viscous": true / factor}}), axis.log)
    assert_found(found, causes, "explained" if causes else "adequate")
    assert factor == 1.0 or found.causes[0].parameters["viscous_N_s_m"] == approx(true, rel=0.1)


@pytest.mark.slow
def test_an_encoders_steps_make_no_curve_over_speed() -> None:
    axis = draw_coarse_axis(3050)
    found = identify([axis.log], Wanted("axis", axis.machine.plant.moved if axis.mass_given else None))
    assert found.held_out_rms_N < 1.1 * found.noise_floor_N
    assert not has_curve(found)


def test_a_path_begins_and_ends_as_its_readings_do() -> None:
    """Free at its ends it made more than a step of a start from rest, a third of a level to stiff elements."""
    true, step = motion(np.arange(18000) / 1000.0), 1e-6
    forth, back = (smooth_path(np.round(way / step) * step, step / math.sqrt(12.0)) for way in (true, true[::-1]))
    assert max(np.abs(forth - true)[:32].max(), np.abs(back[::-1] - true)[:32].max()) < 0.5 * step


def test_a_creeping_axis_goes_down_no_steps() -> None:
    """Beside a fast move, whose weight is the path's: blocks of their own leave the creep without reversals."""
    time, step = np.arange(8000) / 2000.0, 1e-7
    true = np.where(time < 2.0, 1e-5 * time, 2e-5 + 0.02 * np.sin(2.0 * np.pi * 4.0 * (time - 2.0)) ** 3)
    readings, slow = np.round(true / step) * step, slice(64, 3800)
    whole, blocks = (smooth(readings, step / math.sqrt(12.0)) for smooth in (smooth_path, smooth_blocks))
    back = [float(-np.sum(np.minimum(np.diff(path[slow]), 0.0))) for path in (whole, blocks)]
    assert back[1] < 0.2 * back[0]
    assert np.max(np.abs(blocks - true)[slow]) < step
