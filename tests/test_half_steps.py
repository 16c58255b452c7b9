"""What the length of a model's steps does to its friction: against a simulation of steps far shorter."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from record_cases import simulate_log, slow_axis
from sgms_mhe.configuration import load_machine, override_machine, switch_law
from sgms_mhe.diagnosis import alignment
from sgms_mhe.diagnosis.alignment import decimate, find_step_error, halve_steps
from sgms_mhe.diagnosis.criteria import Criteria, ProgressReport
from sgms_mhe.diagnosis.final_fit import _time_step
from sgms_mhe.diagnosis.fits import EffectsError, Subject, fit_model
from sgms_mhe.diagnosis.models import UNSTABLE, CompiledFit, diverges
from sgms_mhe.diagnosis.parametrisation import CandidateEffect
from sgms_mhe.diagnosis.selection import Searched, search_causes
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import SimulatedRun, simulate_axis
from sgms_mhe.plant.trajectories import Motion, make_trajectory
from sgms_mhe.recordings.recording import Recording, prepare
from sgms_mhe.signals.chain import Signals
from sgms_mhe.signals.logs import align_velocity

Array = NDArray[np.float64]

RATE = 1000.0
EFFECTS = ("constant_offset", "hose_hysteresis")


@pytest.fixture(scope="module")
def slow() -> Machine:
    return slow_axis()


def simulated(machine: Machine, **options: object) -> SimulatedRun:
    path = make_trajectory("mixed", machine.sampling.rate, duration_s=6.0, max_velocity=0.3)
    config = AxisConfig(encoder_resolution_m=0.0, force_noise_N=0.0, seed=1)
    return simulate_axis(machine, path, config, **options)  # type: ignore[arg-type]


def exact(machine: Machine, run: SimulatedRun) -> Recording:
    """A recording of what happened: no chain, no noise."""
    truth, step = run.truth, machine.sampling.step
    position = truth.position_m
    velocity = np.diff(position, prepend=position[0]) / step
    prepared = prepare(machine, run.log)
    signals = Signals(
        time=truth.time_s,
        position=position,
        velocity=velocity,
        acceleration=truth.acceleration_m_s2,
        force=run.log.force_N,
        friction=truth.friction_N,
        valid=np.ones(len(position), dtype=np.bool_),
        missing=np.zeros(len(position), dtype=np.bool_),
    )
    return replace(prepared, signals=signals, clock=truth.time_s, runs=type(prepared.runs)())


def rms(series: Array) -> float:
    return float(np.sqrt(np.mean(series**2)))


@pytest.mark.parametrize("law", ["sgms", "switching"])
def test_what_a_step_gets_wrong_is_known(slow: Machine, law: str) -> None:
    """Elements that stick while the axis brakes, and viscous friction: nine tenths of the model's error go."""
    machine = slow if law == "sgms" else switch_law(slow)
    assert machine.friction.law == law
    recording = exact(machine, simulated(machine))
    subject = Subject.of(machine, recording)
    fit = fit_model(subject, (), refitted=())
    later = find_step_error(subject, fit)
    truth = recording.reduce(recording.signals.friction)
    moving = slice(len(truth) // 10, None)  # elements start relaxed; after the first move they have forgotten that
    before = rms((truth - subject.friction(fit))[moving])
    after = rms((truth - subject.friction(fit) - later)[moving])
    assert before > 1e-3
    assert after < 0.1 * before


def test_a_long_record_is_taken_in_parts(slow: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded, and what comes out is what comes out in one."""
    recording = exact(slow, simulated(slow))
    subject = Subject.of(slow, recording)
    fit = fit_model(subject, (), refitted=())
    at_once = find_step_error(subject, fit)
    monkeypatch.setattr(alignment, "SAMPLES_AT_A_TIME", 3000)
    monkeypatch.setattr(alignment, "LEADS", 2)
    assert rms(find_step_error(subject, fit) - at_once) < 0.02 * rms(at_once)


def test_half_steps_end_where_the_samples_do(slow: Machine) -> None:
    run = simulated(slow)
    recording = exact(slow, run)
    halved = halve_steps(recording, slow).signals
    step, signals = slow.sampling.step, recording.signals
    np.testing.assert_array_equal(halved.position[1::2], signals.position)
    np.testing.assert_array_equal(halved.acceleration[1::2], signals.acceleration)
    # Two halves travel what the whole step did, and the middle is between.
    np.testing.assert_allclose(
        0.5 * (halved.velocity[0::2] + halved.velocity[1::2])[1:], signals.velocity[1:], rtol=0.0, atol=1e-9
    )
    np.testing.assert_allclose(
        halved.position[1::2] - halved.position[0::2], 0.5 * step * halved.velocity[1::2], rtol=0.0, atol=1e-12
    )
    np.testing.assert_allclose(halved.time[1::2] - halved.time[0::2], 0.5 * step, rtol=1e-6)


def test_a_velocity_at_the_instants_becomes_the_mean_over_the_sample(slow: Machine) -> None:
    """A log may bring its own: a measurement of a tachometer, or a difference of positions, which stays what it is."""
    run = simulated(slow)
    truth, step = run.truth, slow.sampling.step
    travelled = np.diff(truth.position_m) / step
    for velocity in (truth.velocity_m_s, np.diff(truth.position_m, prepend=truth.position_m[0]) / step):
        aligned = align_velocity(replace(run.log, position_m=truth.position_m, velocity_m_s=velocity)).velocity_m_s
        assert aligned is not None
        assert rms(aligned[1:] - travelled) < 0.02 * rms(truth.velocity_m_s[1:] - travelled)
    assert np.array_equal(aligned, velocity)


def test_any_measurement_rate_can_be_thinned() -> None:
    """Readings are none of a search's business; a file that states their rate was refused there."""
    machine = override_machine(load_machine("etel_xy"), {"sampling": {"measurement_rate": 500.0}})
    thin = decimate(Subject.of(machine, prepare(machine, simulate_log(machine, seconds=3.0, fastest=0.3, seed=1))))
    assert thin.machine.sampling.rate == RATE


def test_steps_of_a_microsecond_are_short_enough() -> None:
    """Half of them would be more updates than a machine file may ask for."""
    sampling = {"rate": 1e6, "update_rate": 1e6, "velocity_cutoff": 1e4, "integrator": {"substeps": 1}}
    machine = override_machine(load_machine("etel_xy"), {"sampling": sampling})
    path = Motion(machine.sampling.rate)
    path.move_to(0.02, 0.2, 10.0, 1e4)
    log = simulate_log(machine, path=path.trajectory("stroke"), control="prescribed", seed=1)
    subject = Subject.of(machine, prepare(machine, log))
    assert not find_step_error(subject, fit_model(subject, (), refitted=())).any()


def test_a_model_that_diverges_at_another_rate_is_none_there(slow: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may stay finite: a hose of 1e23 N at half the step was taken off the measured friction."""
    subject = Subject.of(slow, prepare(slow, simulated(slow).log))
    fit = fit_model(subject, (), refitted=())
    assert find_step_error(subject, fit).any()
    run = CompiledFit.run

    def diverge(self: CompiledFit, recording: Recording, theta: Array, **options: Any) -> Any:
        friction, slopes = run(self, recording, theta, **options)
        return friction * (1e20 if recording.machine.sampling.rate > RATE else 1.0), slopes

    monkeypatch.setattr(CompiledFit, "run", diverge)
    assert not find_step_error(subject, fit).any()
    assert np.array_equal(subject.friction(fit), run(fit.model, subject.recording, fit.theta, derivatives=False)[0])


def test_a_step_goes_to_where_the_record_has_it(slow: Machine) -> None:
    """A search may have put it where something else was not known yet."""
    at, size = 3.7, -0.14
    hidden = [("step_disturbance", {"force_N": size, "time_s": at})]
    log = simulated(slow, hidden_effects=hidden).log
    subject = Subject.of(slow, prepare(slow, log))
    fit = fit_model(subject, (CandidateEffect("step_disturbance", {"force_N": size, "time_s": 4.3}),), refitted=())
    found = _time_step(subject, None, fit, fit.effects[0])
    assert found.parameters["time_s"] == pytest.approx(at, abs=0.02)
    assert found.parameters["force_N"] == fit.effects[0].parameters["force_N"]


def test_an_effect_that_ends_a_search_is_left_out_of_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a hose whose state was at the edge of what the steps can follow, once the record was in line with it."""
    machine = load_machine("etel_xy")
    asked: list[tuple[str, ...]] = []

    def search(laws: object, criteria: Criteria) -> Searched:
        asked.append(criteria.excited)
        if "hose_hysteresis" in criteria.excited:
            raise EffectsError("the model is not finite where its fit starts", ("constant_offset", "hose_hysteresis"))
        if "backlash" in criteria.excited:
            raise EffectsError("the model is not finite where its fit starts", ("backlash",))
        if "force_ripple" in criteria.excited:
            raise EffectsError("the model is not finite where its fit starts", ("force_ripple",))
        return Searched(laws, None, criteria, (), frozenset())  # type: ignore[arg-type]

    monkeypatch.setattr("sgms_mhe.diagnosis.selection._search", search)
    progress = ProgressReport(lambda step, share: None)
    criteria = Criteria(machine.diagnosis, 0.01, 0.01, EFFECTS, False, progress)
    found = search_causes(None, criteria)  # type: ignore[arg-type]
    assert found.left_out == ("hose_hysteresis",)
    assert asked == [EFFECTS, EFFECTS[:1]]
    two = search_causes(None, replace(criteria, excited=(*EFFECTS, "backlash")))  # type: ignore[arg-type]
    assert two.left_out == ("hose_hysteresis", "backlash")
    with pytest.raises(EffectsError):  # without an effect that has states of its own there is none to leave out
        search_causes(None, replace(criteria, excited=("force_ripple",)))  # type: ignore[arg-type]


def test_a_model_diverges_whatever_was_taken_off_the_measured_friction() -> None:
    machine = load_machine("etel_xy")
    recording = prepare(machine, simulate_log(machine, seconds=3.0))
    edge = np.array([0.999 * UNSTABLE * recording.largest_friction])
    less = replace(recording, friction=0.9 * recording.friction)
    assert not diverges(recording, edge)
    assert not diverges(less, edge)
    assert diverges(less, 1.01 * edge)
