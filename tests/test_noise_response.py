"""A cause explains a force, not an encoder's noise; and what is only a curve over speed is no ageing contact."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis_cases import assert_found
from record_cases import simulate_log
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.diagnosis.alignment import find_sampling_columns
from sgms_mhe.diagnosis.fits import Fit, Subject, fit_model
from sgms_mhe.diagnosis.parametrisation import CandidateEffect
from sgms_mhe.diagnosis.uncertainty import (
    add_noise,
    covariance,
    explains_noise,
    find_explained_noise,
    inertial_noise,
    standard_deviations,
)
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.model.effects.motion import Extents
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.evidence import gain_force, noise_floor
from sgms_mhe.recordings.recording import Recording, add_encoder, prepare
from sgms_mhe.signals.chain import apply_chain, signals_from_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.noise import noise_course

NOISE_m = 2e-8
"""Of the encoder: mass times the noise of its acceleration is then 0.2 N, most of what a good model leaves."""
STEP_m = 2e-6
"""Of a coarse encoder."""
RESONANCE = {"frequency_Hz": 45.0, "damping_ratio": 0.05, "mass_kg": 4.0}


@pytest.fixture(scope="module")
def machine() -> Machine:
    return override_machine(load_machine("etel_xy"), {"sampling": {"rate": 2000.0, "velocity_cutoff": 300.0}})


@cache
def clean(hidden: tuple[str, ...]) -> Log:
    """Every fifth sample of a controller at 10 kHz, whose encoder has no noise."""
    controller = load_machine("etel_xy")
    log = simulate_log(controller, *((name, RESONANCE) for name in hidden), seconds=8.0, fastest=0.3, seed=1)
    columns: dict[str, Any] = {name: np.ascontiguousarray(values[::5]) for name, values in log.columns.items()}
    return replace(log, rate=log.rate / 5.0, **columns)


def recorded(machine: Machine, *hidden: str, noise: float = NOISE_m) -> Recording:
    log = clean(hidden)
    white = np.random.default_rng(4).standard_normal(len(log))
    return prepare(machine, replace(log, position_m=log.position_m + noise * white))


def fitted(subject: Subject) -> tuple[Fit, float]:
    """A resonance, from where noise would have it, and what it gains [N]."""
    without = fit_model(subject, ())
    found = fit_model(subject, [CandidateEffect("structural_resonance", {**RESONANCE, "mass_kg": 15.0})], warm=without)
    return found, gain_force(without.cross, found.cross, found.rows)


def test_a_resonance_that_takes_noise_out_of_the_force_is_none(machine: Machine) -> None:
    subject = Subject.of(machine, recorded(machine))
    found, gain = fitted(subject)
    assert gain > 0.1  # a quarter of what is left, on data that the fit has not seen
    assert 5.0 < found.effects[0].parameters["mass_kg"] < machine.plant.moved
    assert find_explained_noise(subject, found) == pytest.approx(gain, rel=0.3)
    assert explains_noise(subject, found, gain)


@pytest.mark.parametrize("noise", [0.0, NOISE_m])
def test_a_resonance_that_rings_is_one(noise: float, machine: Machine) -> None:
    subject = Subject.of(machine, recorded(machine, "structural_resonance", noise=noise))
    found, gain = fitted(subject)
    assert found.effects[0].parameters["frequency_Hz"] == pytest.approx(RESONANCE["frequency_Hz"], rel=0.01)
    assert not explains_noise(subject, found, gain)


def rms_of(recording: Recording, force: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(force[recording.used] ** 2)))


def coarse(machine: Machine, extra_mass: float = 0.0, step_m: float = STEP_m) -> Log:
    """What an encoder of micrometres reads: noise where the axis moves, and none at rest."""
    log = clean(())
    still = log.position_m * 0.0
    force = log.force_N + extra_mass * signals_from_log(replace(log, force_N=still), machine).acceleration
    return replace(log, position_m=np.round(log.position_m / step_m) * step_m, force_N=force)


def read_in_steps(machine: Machine, step_m: float) -> Recording:
    log = coarse(machine, step_m=step_m)
    return add_encoder(prepare(machine, log), log)


@pytest.mark.slow
def test_a_mass_that_takes_a_coarse_encoders_noise_out_of_the_force_is_none(machine: Machine) -> None:
    found = diagnose(machine, coarse(machine))
    assert_found(found, {}, "unexplained")
    assert found.encoder_noise_N == pytest.approx(found.rms.held_out_after, rel=0.15)
    assert "noise of the encoder" in found.summary
    assert "noise of the encoder" in found.limits[0]
    assert found.separating_experiment is not None
    assert "velocity_cutoff" in found.separating_experiment


@pytest.mark.parametrize("extra_mass", [0.0, 1.0])
def test_a_lower_cutoff_shows_what_is_below_a_coarse_encoders_noise(extra_mass: float, machine: Machine) -> None:
    calmer = override_machine(machine, {"sampling": {"velocity_cutoff": 60.0}})
    found = diagnose(calmer, coarse(machine, extra_mass))
    assert_found(found, {"mass_mismatch": {}} if extra_mass else {}, "explained" if extra_mass else "adequate")


@pytest.mark.parametrize("step_m", [2e-7, 5e-7, 2e-6, 1e-5])
def test_what_an_encoders_steps_make_of_the_force_is_known(step_m: float, machine: Machine) -> None:
    true, read = (signals_from_log(log, machine).acceleration for log in (clean(()), coarse(machine, step_m=step_m)))
    recording = read_in_steps(machine, step_m)
    made = rms_of(recording, recording.reduce(machine.plant.moved * (read - true)))
    assert rms_of(recording, inertial_noise(recording)) == pytest.approx(made, rel=0.1)


def test_friction_that_was_recorded_itself_holds_no_inertia(machine: Machine) -> None:
    """No mass was taken off a force: neither its noise nor its timing is that of an acceleration."""
    log = coarse(machine)
    alone = replace(log, friction_N=log.force_N)
    recording = add_encoder(prepare(machine, alone), alone)
    assert recording.inertia == 0.0
    assert not inertial_noise(recording).any()
    assert not find_sampling_columns(Subject.of(machine, recording), np.zeros(len(recording.time))).any()


def test_the_noise_floor_knows_an_encoders_steps(machine: Machine) -> None:
    calmer = override_machine(machine, {"sampling": {"velocity_cutoff": 110.0}})
    subject = Subject.of(calmer, read_in_steps(calmer, STEP_m))
    floor = noise_floor(subject.recording, fit_model(subject, (), refitted=()).residual)
    assert floor == pytest.approx(rms_of(subject.recording, inertial_noise(subject.recording)), rel=0.01)
    assert fit_model(subject, ()).rms == pytest.approx(floor, rel=0.15)


@pytest.mark.slow
def test_a_coarse_encoder_does_not_hide_a_payload(machine: Machine) -> None:
    assert_found(diagnose(machine, coarse(machine, extra_mass=0.5 * machine.plant.moved)), {"mass_mismatch": {}})


def test_noise_is_told_where_it_is() -> None:
    white = np.random.default_rng(2).standard_normal(8000)
    sizes = np.where(np.arange(8000) < 4000, 1e-9, 1e-6)
    turn = 1e-3 * np.sin(2.0 * np.pi * np.arange(8000) / 2000.0)
    course = noise_course(turn + sizes * white)
    apart = np.abs(np.arange(8000) - 4000) > 200
    assert np.median(course[:4000] / 1e-9) == pytest.approx(1.0, rel=0.1)  # the least of three orders
    assert np.median(course[4000:] / 1e-6) == pytest.approx(1.0, rel=0.1)
    assert np.max(np.abs(np.log(course / sizes))[apart]) < math.log(1.6)
    short = noise_course(1e-6 * white[:300])
    assert short.shape == (300,)
    assert np.ptp(short) == 0.0
    assert short[0] == pytest.approx(1e-6, rel=0.2)


def test_a_delay_makes_other_noise_but_not_less(machine: Machine) -> None:
    subject = Subject.of(machine, recorded(machine))
    late = fit_model(subject, [CandidateEffect("force_delay", {"delay_s": 1.5e-3})], iterations=0)
    assert find_explained_noise(subject, late) < 0.1 * noise_floor(subject.recording, late.residual)


def test_the_interval_of_a_mass_knows_of_errors_in_variables(machine: Machine) -> None:
    """Noise of an acceleration is in the force that is left and in the mass's slope: a mass comes out too small."""
    subject = Subject.of(machine, recorded(machine, noise=5.0 * NOISE_m))
    fit = fit_model(subject, [CandidateEffect("mass_mismatch", {"mass_kg": 0.0})])
    (column,) = [i for i, c in enumerate(fit.model.columns) if c.name == "mass_kg"]
    missed = fit.model.columns[column].si(float(fit.theta[column]))  # there is none
    spread = standard_deviations(covariance(subject, fit), fit)[column]
    record = subject.recording
    added = record.reduce(add_noise(record).signals.acceleration - record.signals.acceleration)
    share = np.var(added[record.used]) / np.var(record.acceleration[record.used])
    wanted = -machine.plant.moved * float(share)
    assert missed == pytest.approx(wanted, rel=0.3)
    assert abs(missed) < 2.0 * spread < 6.0 * abs(missed)


def test_what_is_slower_than_noise_is_not_asked(machine: Machine) -> None:
    subject = Subject.of(machine, recorded(machine))
    assert not explains_noise(subject, fit_model(subject, [CandidateEffect("constant_offset", {})]), 0.0)
    assert not explains_noise(subject, fit_model(subject, ()), 0.0)


@pytest.mark.parametrize("noise", [3e-9, 3e-8])
def test_noise_of_an_encoder_is_told_behind_the_chain(noise: float, machine: Machine) -> None:
    """As large as the difference to the record without it, whatever the motion."""
    quiet, record = recorded(machine, noise=0.0), recorded(machine, noise=noise)
    there = record.signals.acceleration - quiet.signals.acceleration
    added = add_noise(record).signals.acceleration - record.signals.acceleration
    assert float(np.std(added)) == pytest.approx(float(np.std(there)), rel=0.1)


@pytest.mark.parametrize("brought", ["friction", "acceleration"])
def test_noise_of_a_velocity_or_acceleration_is_not_the_encoders(brought: str, machine: Machine) -> None:
    """A robot's log brings them from sensors, or a differentiation, of their own: they move no element."""
    log, noise = clean(()), 3e-8
    white = np.random.default_rng(6).standard_normal((2, len(log)))
    signals = signals_from_log(log, machine)
    own: dict[str, Any] = {"position_m": log.position_m + noise * white[0]}
    if brought == "friction":  # past the chain
        own |= {"velocity_m_s": signals.velocity + 1e-2 * white[1], "friction_N": signals.friction}
        wanted = noise
    else:
        own["acceleration_m_s2"] = signals.acceleration + white[1]
        wanted = float(np.std(apply_chain(machine, noise * white[0])))
    record = prepare(machine, replace(log, **own))
    added = add_noise(record).signals.position - record.signals.position
    assert float(np.std(added)) == pytest.approx(wanted, rel=0.15)


def test_a_contact_grows_stronger_at_rest_and_takes_longer_than_samples(machine: Machine) -> None:
    definition = effect_definition("dwell_dependence")
    aged = {"ratio": 0.3, "time_constant_s": 0.2, "length_m": 1e-4}
    extents = Extents(travel=0.1, speed=0.1, duration=10.0, end=10.0, rate=500.0)
    assert definition.possible(aged, scales_of(machine))
    assert not definition.possible({**aged, "ratio": -0.3}, scales_of(machine))
    assert not definition.simpler.reached(aged, extents)
    assert definition.simpler.reached({**aged, "time_constant_s": 1e-3}, extents)
