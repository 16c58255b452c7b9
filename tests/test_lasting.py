"""Errors of the model that stay: what the emitted estimators state about an axis that is not the machine file's."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from reference_cases import estimate_once
from sgms_bench.studies.cases import rms
from sgms_bench.studies.faults import VARIANTS
from sgms_bench.studies.lasting import (
    ERRORS,
    FOLLOWED,
    MOTIONS,
    TRIED,
    UNCERTAIN,
    WITH_LEVEL,
    LastingOutcome,
    erroneous_record,
    lasting_outcome,
)
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.reference import NodeRecord, ReferenceIntegrator
from sgms_mhe.reference.lasting import InnovationColour, LastingErrors, ParameterWander
from sgms_mhe.reference.readings import Innovation
from sgms_mhe.reference.smoother import run_smoother
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.status import FLAGS

Array = NDArray[np.float64]


@lru_cache
def outcome(
    name: str, motion: str = "mixed", variant: str = "ekf double", duration_s: float = 8.0, seed: int = 0
) -> LastingOutcome:
    error = next(error for error in TRIED if error.name == name)
    return lasting_outcome(erroneous_record(error, motion, seed, duration_s), motion, variant)


# --- the two factors, against sums written out ---------------------------------------------------------------------


def intervals(standards: Array, needs: Array, measurements: int) -> list[list[Innovation]]:
    pairs = [Innovation(float(z), float(need)) for z, need in zip(standards, needs, strict=True)]
    return [pairs[k : k + measurements] for k in range(0, len(pairs), measurements)]


def colour_of(standards: Array, needs: Array, measurements: int = 4) -> InnovationColour:
    colour = InnovationColour(50.0 * measurements)
    for interval in intervals(standards, needs, measurements):
        colour.take(interval)
    return colour


def test_colour_is_the_mean_of_squared_sums_with_their_information() -> None:
    """Seven blocks of 50 intervals and a part of one; each is forgotten by 5 % with every later one."""
    rng = np.random.default_rng(0)
    n, blocks = 4 * 50, 7
    standards, needs = rng.standard_normal(n * blocks + 30) + 0.4, 1.0 + rng.exponential(3.0, n * blocks + 30)
    weights = 0.95 ** np.arange(blocks - 1, -1, -1)
    parts = [slice(k * n, (k + 1) * n) for k in range(blocks)]
    squares = np.array([min(standards[part].sum() ** 2 / n, 100.0) for part in parts])
    information = np.array([np.sum(1.0 / needs[part]) for part in parts])
    first = 0.95**blocks * n
    mean = (first + np.sum(weights * squares * information)) / (first + np.sum(weights * information))
    assert mean > 3.0
    assert colour_of(standards, needs).factor == pytest.approx(mean, rel=1e-12)


def test_independent_innovations_have_no_colour_and_alike_ones_have() -> None:
    rng = np.random.default_rng(1)
    white = rng.standard_normal(200 * 200)
    parts = np.split(white, 20)
    assert np.mean([colour_of(part, np.ones_like(part)).factor for part in parts]) == pytest.approx(1.1, abs=0.1)
    # Of an AR(1) sequence with coefficient a the sum's variance is (1 + a)/(1 - a) times that of independent ones.
    coloured = np.empty_like(white)
    coloured[0] = white[0]
    for k in range(1, len(white)):
        coloured[k] = 0.8 * coloured[k - 1] + 0.6 * white[k]
    assert colour_of(coloured, np.ones_like(white)).factor == pytest.approx(9.0, rel=0.3)


def test_a_fault_that_is_over_counts_for_little() -> None:
    """Measurements that were weighed down by 300 brought no information, and their colour says nothing of the rest."""
    rng = np.random.default_rng(2)
    standards, needs = rng.standard_normal(200 * 20), np.ones(200 * 20)
    fault = slice(200 * 10, 200 * 12)
    standards[fault], needs[fault] = 3.0, 300.0
    assert colour_of(standards, needs).factor < 1.5
    assert colour_of(standards, np.ones_like(needs)).factor > 5.0


def test_intervals_without_measurements_are_no_block() -> None:
    colour = InnovationColour(100.0)
    for _ in range(120):
        colour.take([])
    assert colour.factor == 1.0 and colour.information == 100.0


def test_wander_is_the_square_of_moves_over_what_blocks_take_from_the_variance() -> None:
    """Four blocks of 50 updates and a part of one; the first counts from its first update on."""
    rng = np.random.default_rng(3)
    drift = np.array([0.002, 0.01])
    theta = 1.0 + np.cumsum(0.05 * rng.standard_normal((220, 2)), axis=0)
    variance = 0.1 / (1.0 + 0.05 * np.arange(220))[:, None] * np.array([1.0, 2.0])
    wander = ParameterWander(drift)
    for each, its in zip(theta, variance, strict=True):
        wander.take(each, its)
    ends = [0, 49, 99, 149, 199]
    moves, before = np.diff(theta[ends], axis=0) ** 2, variance[ends[:-1]] + 50.0 * drift**2
    taken = before - variance[ends[1:]]
    forgotten = 0.95 ** np.arange(3, -1, -1.0)[:, None]
    squares = 0.95**4 + np.sum(forgotten * np.minimum(moves, 100.0 * taken) / before, axis=0)
    share = 0.95**4 + np.sum(forgotten * taken / before, axis=0)
    assert np.all(squares / share > 1.0)
    np.testing.assert_allclose(wander.factor, squares / share, rtol=1e-12)


def test_an_estimate_that_knows_its_variance_does_not_wander() -> None:
    """Kalman filter of a walking constant: a mean over 4000 of them; with half the noise stated it does."""
    rng = np.random.default_rng(4)
    noise, drift, n = 0.3, 0.002, 4000

    def mean_wander(stated: float) -> float:
        truth, theta, variance = 1.0 + 0.4 * rng.standard_normal(n), np.ones(n), np.full(n, 0.16)
        wander = ParameterWander(np.full(n, drift))
        for _ in range(500):
            truth = truth + drift * rng.standard_normal(n)
            variance = variance + drift**2
            gain = variance / (variance + stated**2)
            theta = theta + gain * (truth + noise * rng.standard_normal(n) - theta)
            variance = (1.0 - gain) * variance
            wander.take(theta, variance)
        return float(np.mean(wander.squares) / np.mean(wander.share))

    assert mean_wander(noise) == pytest.approx(1.0, abs=0.03)
    assert mean_wander(0.5 * noise) > 1.5


def test_wander_is_bounded() -> None:
    """An estimate that leaps by far more than its variance counts a hundred times what the block takes."""
    wander = ParameterWander(np.zeros(1))
    for k in range(50):
        wander.take(np.array([1.0 + 4.0 * (k > 20)]), np.array([2e-6 - 1e-6 * (k > 20)]))
    np.testing.assert_allclose(wander.factor, [(0.95 + 100.0 * 0.5) / (0.95 + 0.5)], rtol=1e-12)


def test_what_takes_nothing_from_the_variance_is_no_wander() -> None:
    wander = ParameterWander(np.zeros(1))
    for k in range(100):
        wander.take(np.array([1.0 + 0.1 * (k > 60)]), np.array([1e-4]))
    assert wander.factor == 1.0


def test_factors_are_one_where_measurements_count_as_stated() -> None:
    for enabled in (False, True):
        errors = LastingErrors(np.full(2, 0.002), 1, enabled=enabled)
        for k in range(100):
            errors.take([Innovation(3.0, 1.0)], np.array([1.0, 1.0 + 0.1 * (k > 50)]), np.full(2, 1e-6))
        assert errors.doubts == enabled
        assert np.all(errors.spread > 2.0) == enabled
        assert enabled or np.all(errors.spread == 1.0)


# --- C against the reference ---------------------------------------------------------------------------------------


def check_against_reference(machine: Machine, signals: Signals) -> Estimates:
    expected, found = estimate_once(machine, signals), CompiledEstimator(machine).estimate(signals)
    tolerance = 1e-9 if machine.code.precision == "double" else 2e-3
    for name in ("parameters", "std"):
        reference = getattr(expected, name)
        off = np.max(np.abs(getattr(found, name) - reference)) / np.max(np.abs(reference))
        assert off < tolerance, f"{name}: {off:.1e}"
    np.testing.assert_array_equal(found.status, expected.status)
    return expected


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize(
    "estimator",
    [
        pytest.param({"relinearise": "all", "horizon": 8}, id="all"),
        pytest.param({"relinearise": "auto"}, id="auto"),
        pytest.param({"relinearise": "newest"}, id="newest"),
        pytest.param({"kind": "ekf"}, id="ekf"),
        pytest.param({"kind": "ekf", "parameters": ["stiffness", "coulomb"]}, id="ekf and level"),
        pytest.param({"noise": {"colour": 8.0}}, id="known colour"),
    ],
)
def test_emitted_deviations_are_those_of_the_reference(estimator: dict[str, Any], precision: str) -> None:
    """Under an offset and cogging, which widen the deviations of all parameters."""
    machine = override_machine(load_machine("etel_xy"), {"estimator": estimator, "code": {"precision": precision}})
    signals = erroneous_record(ERRORS[-1], "paper", 0, 4.0).signals
    expected = check_against_reference(machine, signals)
    as_stated = override_machine(machine, {"estimator": {"noise": {"self_scaling": False}}})
    assert np.all(expected.std[-1] > 1.5 * estimate_once(as_stated, signals).std[-1])


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize(
    "estimator",
    [
        pytest.param({"relinearise": "all", "horizon": 8, "disturbance": {"force": 0.2}}, id="all, place"),
        pytest.param({"relinearise": "auto", "disturbance": {"force": 0.2}}, id="auto, place"),
        pytest.param(
            {"relinearise": "newest", "arrival_cost": {"update": "fixed"}, "disturbance": {"force": 0.2}},
            id="newest, fixed, place",
        ),
        pytest.param({"kind": "ekf", "disturbance": {"force": 0.2, "length": 2e-3}}, id="ekf, place"),
    ],
)
def test_an_emitted_force_of_a_place_is_that_of_the_reference(estimator: dict[str, Any], precision: str) -> None:
    machine = override_machine(load_machine("etel_xy"), {"estimator": estimator, "code": {"precision": precision}})
    check_against_reference(machine, erroneous_record(ERRORS[-1], "mixed", 0, 3.0).signals)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("kind", ["mhe", "ekf"])
def test_slow_motion_counts_when_it_has_come_as_far(kind: str, precision: str) -> None:
    """At 5 um/s an interval comes 0.05 um far, and 0.22 um count; a tremor of as much comes nowhere."""
    machine = override_machine(load_machine("etel_xy"), {"estimator": {"kind": kind}, "code": {"precision": precision}})
    samples = machine.sampling.samples_per_update
    for there, back, expected in ((1.0, 1.0, [1, 1, 1, 1, 0]), (1.0, -1.0, [1, 1, 1, 1, 1])):
        velocity = np.concatenate([[0.0], 5e-6 * np.tile(np.repeat([there, back], samples), 25)])
        zeros = np.zeros(len(velocity))
        signals = Signals(
            time=machine.sampling.step * np.arange(len(velocity)),
            position=machine.sampling.step * np.cumsum(velocity),
            velocity=velocity,
            acceleration=zeros,
            force=zeros,
            friction=zeros,
            valid=zeros == 0.0,
            missing=zeros != 0.0,
        )
        found = (estimate_once(machine, signals), CompiledEstimator(machine).estimate(signals))
        for estimates in found:
            holds = estimates.status & FLAGS["hold"] > 0
            np.testing.assert_array_equal(holds, np.tile(np.array(expected) > 0, 10))


# --- what is stated ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", MOTIONS)
def test_without_an_error_the_deviations_hold(motion: str) -> None:
    found = outcome("none", motion)
    assert found.beyond[1] == found.silent == found.doubted == 0.0
    assert found.covered > 0.93
    assert found.friction < 0.02


def test_deviations_without_an_error_are_those_of_the_covariance() -> None:
    """Nothing is added where there is nothing: the mean deviation is within a percent of that of the plain filter."""
    record = erroneous_record(TRIED[0], "mixed", 0, 8.0)
    machine = override_machine(load_machine("etel_xy"), VARIANTS["ekf double"])
    plain = override_machine(machine, {"estimator": {"noise": {"self_scaling": False}}})
    stated, expected = (CompiledEstimator(each).estimate_log(record.run.log).std for each in (machine, plain))
    assert np.mean(stated[300:] / expected[300:]) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("name", ["force's gain 1.005", "force's gain 1.02", "mass 1 % more", "viscous 20 % more"])
@pytest.mark.parametrize("variant", ["mhe double", "ekf single"])
def test_deviations_hold_under_an_error_that_stays(name: str, variant: str) -> None:
    """All of these are beyond three deviations of the covariance for most of the time."""
    found = outcome(name, variant=variant, duration_s=12.0)
    assert found.beyond[1] < 0.02
    assert found.doubted > 0.9


@pytest.mark.parametrize("name", ["force's gain 1.005", "mass 1 % more"])
@pytest.mark.parametrize("variant", ["mhe double", "ekf single"])
def test_a_mass_that_is_uncertain_leaves_the_stiffness_alone(name: str, variant: str) -> None:
    """Its error, and that of the force's gain, is found beside the stiffnesses; without one it costs no deviation."""
    found, certain = outcome(name, variant=f"{variant}, {UNCERTAIN}"), outcome(name, variant=variant)
    assert found.beyond[1] == 0.0
    assert found.after[-1] < 0.5 * certain.after[-1]
    clean, without = outcome("none", variant=f"{variant}, {UNCERTAIN}"), outcome("none", variant=variant)
    assert clean.sigma == pytest.approx(without.sigma, rel=0.02)
    assert clean.doubted == 0.0


@pytest.mark.parametrize("name", ["Coulomb level 10 % less", "Coulomb level falls by 10 % in 20 s"])
@pytest.mark.parametrize("variant", ["mhe double", "ekf single"])
def test_a_wrong_level_beside_a_force_of_a_place_is_found(name: str, variant: str) -> None:
    """It passes for such a force in part, and makes the deviations too small, unless it is estimated too."""
    found, hidden = (outcome(name, "paper", f"{variant}, {each}", 20.0) for each in (WITH_LEVEL, FOLLOWED))
    assert found.beyond[1] == found.doubted == 0.0
    assert found.after[-1] < 0.5 * hidden.after[-1]


@pytest.mark.parametrize(
    ("name", "motion"),
    [("offset 0.5 N", "paper"), ("cogging 0.3 N / 2 mm", "contour"), ("cogging 1 N / 32 mm", "contour")],
)
@pytest.mark.parametrize("variant", ["mhe double", "ekf single"])
def test_a_force_that_belongs_to_the_place_is_followed(name: str, motion: str, variant: str) -> None:
    """It leaves the stiffness alone, and the friction is better known; where there is none it costs little."""
    followed = f"{variant}, {FOLLOWED}"
    found, without = (outcome(name, motion, each, 20.0) for each in (followed, variant))
    assert found.beyond[1] == 0.0
    assert found.after[-1] < 0.5 * without.after[-1]
    assert found.friction < 0.5 * without.friction
    clean, plain = (outcome("none", motion, each, 20.0) for each in (followed, variant))
    assert clean.beyond[1] == clean.doubted == 0.0
    assert clean.sigma < 1.15 * plain.sigma


@pytest.mark.slow
def test_the_smoother_follows_a_force_of_a_place_too() -> None:
    error = next(error for error in ERRORS if error.name == "cogging 1 N / 32 mm")
    record = erroneous_record(error, "contour", 0, 2.0)
    errors = []
    for force in (0.0, 0.2):
        machine = override_machine(load_machine("etel_xy"), {"estimator": {"disturbance": {"force": force}}})
        model = build_model(machine)
        smoothed = run_smoother(NodeRecord(model, record.signals, ReferenceIntegrator(model)))
        theta = smoothed.parameters[-1, :4] / np.array(machine.friction.stiffness)
        errors.append((rms(smoothed.friction_N - record.friction), float(np.max(np.abs(theta - record.theta)))))
    (friction, stiffness), (followed_friction, followed_stiffness) = errors
    assert followed_friction < 0.3 * friction
    assert followed_stiffness < 0.5 * stiffness


def test_a_force_that_belongs_to_the_place_is_a_first_order_process_along_the_path() -> None:
    """The rates of the model, integrated along a path, are those of a force that forgets itself over the length."""
    length, deviation = 2e-3, 0.3
    table = {"force": deviation, "length": length}
    model = build_model(override_machine(load_machine("etel_xy"), {"estimator": {"disturbance": table}}))
    states = [state.name for state in model.states]
    d, g = states.index("place_force"), states.index("place_slope")
    rhs, output = model.function("rhs"), model.function("output")
    for velocity in (1e-3, -2e-3):
        chi = np.zeros(model.n_x)
        chi[[d, g]] = 0.4, -0.7
        w = np.zeros(model.w.numel())
        w[1] = velocity
        rate = np.array(rhs(chi, w, np.ones(model.n_p))).ravel()
        forgets = abs(velocity) / length
        assert rate[g] == pytest.approx(0.7 * forgets)
        assert rate[d] == pytest.approx(-0.7 * velocity / length - 0.4 * forgets)
    rest = np.zeros(model.n_x)
    moved = rest.copy()
    moved[d] = 0.4
    zero = np.zeros(model.w.numel())
    step = float(output(moved, zero, np.ones(model.n_p))) - float(output(rest, zero, np.ones(model.n_p)))
    assert step == pytest.approx(0.4 * model.machine.friction.coulomb)
    assert model.state_noise[d] * model.machine.friction.coulomb == pytest.approx(deviation)
    record = NodeRecord(model, erroneous_record(TRIED[0], "paper", 0, 1.0).signals, ReferenceIntegrator(model))
    path = record.plan.path
    exact = model.state_noise[d] * np.sqrt(-np.expm1(-2.0 * path / length))
    np.testing.assert_allclose(record.sigma_x[:, d], exact, rtol=0.1, atol=2e-3 * model.state_noise[d])
    np.testing.assert_array_equal(record.sigma_x[:, :d], np.tile(model.state_noise[:d], (len(path), 1)))


@pytest.mark.parametrize("variant", ["mhe double", "ekf single"])
def test_deviations_hold_where_the_axis_crawls(variant: str) -> None:
    """Under an offset, at 20 um/s, where no single interval comes far enough to count, most of 14 to 15 s."""
    found = outcome("offset 0.5 N", "crawl", variant, duration_s=20.0, seed=1)
    assert found.beyond[1] < 0.03


def test_noise_of_the_encoder_makes_no_mass() -> None:
    """10 nm make 0.9 N of friction that goes with the acceleration; the mean over the chain's settling has none of it.

    A mass that is estimated by the acceleration itself is far from the truth then.
    """
    error = next(error for error in ERRORS if error.encoder_noise_m > 0.0)
    log = erroneous_record(error, "crawl", 0, 8.0).run.log
    off = []
    for changes in (
        {"estimator": {"kind": "ekf", "disturbance": {"mass": 0.01}}},
        {
            "effects": [{"name": "mass_mismatch"}],
            "estimator": {
                "kind": "ekf",
                "parameters": ["stiffness", "mass_mismatch.mass_kg"],
                "prior": {"mass_mismatch.mass_kg": 0.2},
            },
        },
    ):
        estimates = CompiledEstimator(override_machine(load_machine("etel_xy"), changes)).estimate_log(log)
        off.append(np.max(np.abs(estimates.parameters[:, -1] / estimates.std[:, -1])))
    assert off[0] < 3.0 < 10.0 < off[1]


@pytest.mark.parametrize("precision", ["double", "single"])
def test_an_uncertain_mass_through_the_chain_is_that_of_the_reference(precision: str) -> None:
    """Lost samples too: the velocities that the mean is over are those that the chain goes on with."""
    changes = {"estimator": {"disturbance": {"mass": 0.01}}, "code": {"precision": precision}}
    machine = override_machine(load_machine("etel_xy"), changes)
    log = erroneous_record(next(error for error in ERRORS if error.is_inertia is False), "mixed", 0, 3.0).run.log
    position = log.position_m.copy()
    position[12000:12040] = np.nan
    log = replace(log, position_m=position)
    expected = estimate_once(machine, signals_from_log(log, machine))
    found = CompiledEstimator(machine).estimate_log(log, mode="tasks")
    off = np.abs(found.parameters[:, -1] - expected.parameters[:, -1]) / expected.std[:, -1]
    assert np.max(off) < (1e-6 if precision == "double" else 2e-2)
    np.testing.assert_allclose(found.std, expected.std, rtol=1e-6 if precision == "double" else 2e-3)
    assert np.ptp(expected.parameters[:, -1]) > expected.std[-1, -1]


def test_an_error_is_in_the_log_and_in_the_count() -> None:
    """A gain of 2 % on a fast motion is contradicted; without it, the same axis has a smaller error."""
    found, clean = outcome("force's gain 1.02"), outcome("none")
    assert found.doubted > 0.5
    assert np.all(found.after > clean.after)
    assert found.friction > 2.0 * clean.friction
