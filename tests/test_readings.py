"""Friction readings inside intervals, what each of them counts, and what faults in them do to the estimate."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from reference_cases import estimate_once
from sgms_bench.records import simulate_record
from sgms_bench.studies.cases import counted_updates
from sgms_bench.studies.faults import FAULTS, Fault, FaultTrial
from sgms_bench.studies.readings import readings_row
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.reference import NodeRecord, ReferenceIntegrator
from sgms_mhe.reference.readings import Gaussian, Scaling, fold, take_reading
from sgms_mhe.signals.chain import Signals
from sgms_mhe.support.errors import InputError


def machine_with(**changes: Any) -> Machine:
    return override_machine(load_machine("etel_xy"), changes)


# --- how many ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sampling", "readings"),
    [
        pytest.param({}, 10, id="twice the cutoff"),
        pytest.param({"velocity_cutoff": 499.0}, 5, id="the next that divides"),
        pytest.param({"velocity_cutoff": 20.0}, 1, id="never less than one per update"),
        pytest.param({"measurement_rate": 100.0}, 1, id="the paper"),
        pytest.param({"measurement_rate": 10000.0}, 100, id="every sample"),
        pytest.param({"integrator": {"substeps": 5}}, 5, id="whole steps of merged samples"),
    ],
)
def test_readings_per_update(sampling: dict[str, Any], readings: int) -> None:
    machine = machine_with(sampling=sampling)
    assert machine.sampling.readings_per_update == readings
    record = NodeRecord(build_model(machine), quiet(machine, 3), ReferenceIntegrator(build_model(machine)))
    assert record.inner_y.shape == (3, readings - 1)


def quiet(machine: Machine, updates: int) -> Signals:
    """Signals of an axis that stands; the friction of sample k is k."""
    n = 1 + updates * machine.sampling.samples_per_update
    zeros = np.zeros(n)
    return Signals(
        time=np.arange(n) * machine.sampling.step,
        position=zeros,
        velocity=zeros,
        acceleration=zeros,
        force=zeros,
        friction=np.arange(n, dtype=float),
        valid=zeros == 0.0,
        missing=zeros != 0.0,
    )


def test_readings_stand_at_equal_distances() -> None:
    machine = machine_with(sampling={"measurement_rate": 500.0})
    record = NodeRecord(build_model(machine), quiet(machine, 2), ReferenceIntegrator(build_model(machine)))
    np.testing.assert_array_equal(record.inner_y, [[20, 40, 60, 80], [120, 140, 160, 180]])
    np.testing.assert_array_equal(record.y, [0, 100, 200])


@pytest.mark.parametrize(
    ("sampling", "allowed"),
    [
        ({"measurement_rate": 250.0}, "a multiple of update_rate that divides rate"),
        ({"measurement_rate": 300.0}, "100, 200, 400, 500"),
        ({"measurement_rate": 50.0}, "a multiple of update_rate"),
        ({"measurement_rate": 1000.0, "integrator": {"substeps": 5}}, "whole steps of 20 samples"),
    ],
)
def test_rates_that_do_not_fit_are_refused(sampling: dict[str, Any], allowed: str) -> None:
    with pytest.raises(InputError, match=allowed) as refused:
        machine_with(sampling=sampling)
    assert f"sampling.measurement_rate = {sampling['measurement_rate']}" in str(refused.value)


def test_more_readings_find_the_stiffness_sooner() -> None:
    config = [AxisConfig(seed=seed) for seed in (0, 1)]
    records = [
        simulate_record(load_machine("etel_xy"), (1.25, 0.8, 1.15, 0.9), duration_s=10.0, config=c) for c in config
    ]
    once, often = readings_row(100.0, records), readings_row(1000.0, records)
    assert often["3 s"] <= 0.03
    assert often["5 s"] <= 0.02
    assert often["10 s"] <= 0.015
    assert all(often[key] < once[key] for key in ("3 s", "5 s", "10 s"))
    assert often["friction, mN"] < 0.7 * once["friction, mN"]
    assert often["covered"] >= 0.93


@pytest.mark.parametrize("kind", ["mhe", "ekf"])
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_stiffness_off_by_a_factor_of_two_is_found(factor: float, kind: str) -> None:
    """The default prior says how little is known: within six seconds, and inside the stated bounds."""
    machine = override_machine(load_machine("etel_xy"), {"estimator": {"kind": kind, "relinearise": "auto"}})
    config = AxisConfig(seed=3)
    record = simulate_record(machine, (factor,) * 4, trajectory="mixed", duration_s=6.0, config=config)
    estimates = CompiledEstimator(machine).estimate(record.signals)
    nominal = np.array(machine.friction.stiffness)
    wrong = np.abs(estimates.parameters / nominal - record.theta)
    assert np.max(wrong[-1] / record.theta) < 0.12
    assert np.mean((wrong < 2.0 * estimates.std / nominal)[counted_updates(record)]) > 0.93


# --- what a reading counts --------------------------------------------------------------------------------------


BELIEF = Gaussian(np.array([0.3, -0.2]), np.array([[2.0, 0.5], [0.5, 1.0]]))
ROW = np.array([1.0, -2.0])  # variance of the prediction: 4


def test_a_predicted_reading_counts_as_stated() -> None:
    scaling = Scaling(enabled=True, fast=0.5, slow=0.5)
    belief, reading = take_reading(BELIEF, ROW, 1.5, 0.5, scaling)
    assert reading.test_ratio == pytest.approx(1.5**2 / 4.25)
    assert reading.scale == 1.0
    np.testing.assert_allclose(belief.mean, fold(BELIEF, ROW, 1.5, 0.25).mean)
    # The textbook's: posterior information is the sum of both.
    information = np.linalg.inv(BELIEF.covariance) + np.outer(ROW, ROW) / 0.25
    np.testing.assert_allclose(belief.covariance, np.linalg.inv(information), rtol=1e-12)
    assert (scaling.fast, scaling.slow) == (
        pytest.approx(0.5 + 0.1 * (reading.test_ratio - 0.5)),
        pytest.approx(0.5 + 0.003 * (reading.test_ratio - 0.5)),
    )


def test_a_wild_reading_is_weighed_down_at_once() -> None:
    scaling = Scaling(enabled=True)
    innovation = 30.0 * np.sqrt(4.25)
    belief, reading = take_reading(BELIEF, ROW, float(innovation), 0.5, scaling)
    fast = 1.0 + 0.1 * (900.0 - 1.0)
    need = 900.0 / 9.0 * fast
    assert reading.scale == pytest.approx(np.sqrt(0.25 + (need - 1.0) * 4.25) / 0.5)
    # With that variance the innovation is 3 / sqrt(fast) of its standard deviations.
    assert innovation**2 / (4.0 + (0.5 * reading.scale) ** 2) == pytest.approx(9.0 / fast)
    assert np.abs(belief.mean - BELIEF.mean).max() < 0.02
    assert scaling.doubts


def test_means_forget_and_are_bounded() -> None:
    scaling = Scaling(enabled=True)
    assert scaling.variance_factor(1e30) < 1e33
    assert scaling.fast <= 101.0
    for _ in range(2000):
        need = scaling.variance_factor(0.5)
    assert need == 1.0
    assert not scaling.doubts


def test_without_scaling_a_reading_counts_as_stated_and_doubt_is_said_all_the_same() -> None:
    scaling = Scaling(enabled=False)
    assert scaling.variance_factor(1e4) == 1.0
    assert scaling.doubts


# --- C against the reference ------------------------------------------------------------------------------------


@lru_cache
def disturbed() -> Signals:
    """Four seconds of the paper's motion with readings that are missing, noisy and frozen."""
    record = simulate_record(load_machine("etel_xy"), (1.25, 0.8, 1.15, 0.9), duration_s=4.0, config=AxisConfig(seed=0))
    signals, rng = record.signals, np.random.default_rng(1)
    friction, valid = signals.friction.copy(), signals.valid.copy()
    valid[rng.integers(0, len(valid), 800)] = False
    valid[15_000:15_350] = False
    friction[20_000:20_500] += 20.0 * rng.standard_normal(500)
    friction[30_000:30_800] = friction[30_000]
    return replace(signals, friction=friction, valid=valid)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"estimator": {"relinearise": "all", "horizon": 8}}, id="all"),
        pytest.param({"estimator": {"relinearise": "auto"}}, id="auto"),
        pytest.param({"estimator": {"relinearise": "newest"}}, id="newest"),
        pytest.param({"estimator": {"kind": "ekf"}}, id="ekf"),
        pytest.param({"estimator": {"relinearise": "auto", "noise": {"self_scaling": False}}}, id="as stated"),
        pytest.param(
            {"estimator": {"relinearise": "auto"}, "sampling": {"measurement_rate": 500.0}}, id="fewer than unknowns"
        ),
        pytest.param(
            {"estimator": {"relinearise": "auto"}, "sampling": {"integrator": {"substeps": 20}}}, id="merged samples"
        ),
        pytest.param(
            {"estimator": {"relinearise": "auto", "arrival_cost": {"update": "fixed"}}}, id="fixed arrival cost"
        ),
    ],
)
def test_emitted_readings_are_those_of_the_reference(changes: dict[str, Any], precision: str) -> None:
    machine = machine_with(**changes, code={"precision": precision})
    expected = estimate_once(machine, disturbed())
    found = CompiledEstimator(machine).estimate(disturbed())
    tolerance = 1e-10 if precision == "double" else 1e-3  # as everywhere for parameters in single precision
    for name in ("friction_N", "parameters", "std", "innovation_N", "test_ratio", "noise_scale"):
        reference = getattr(expected, name)
        apart = np.abs(getattr(found, name) - reference).reshape(len(reference), -1).max(axis=1)
        off = np.sort(apart) / np.max(np.abs(reference))
        # Where two intervals are as far from their linearisation, rounding says which one is linearised anew.
        others = 1 if precision == "single" else 0
        assert off[-1 - others] < tolerance, f"{name}: {off[-1 - others]:.1e}"
        assert off[-1] < 10.0 * tolerance, f"{name}: {off[-1]:.1e}"
    np.testing.assert_array_equal(found.status, expected.status)
    assert np.any(expected.status & 64)
    assert (expected.noise_scale.max() > 10.0) == machine.estimator.noise.self_scaling


# --- faults -----------------------------------------------------------------------------------------------------


@lru_cache
def trial(variant: str) -> FaultTrial:
    return FaultTrial(variant, axes=3)


@pytest.mark.parametrize("variant", ["mhe double", "mhe single", "ekf single"])
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.name} {fault.duration_s:g} s")
def test_a_fault_leaves_the_estimate_within_its_bounds(fault: Fault, variant: str) -> None:
    outcome = trial(variant).run(fault, seed=1)
    # A force that is off by a quarter of the Coulomb level for seconds looks like another axis (docs/faults.md).
    assert outcome.sigmas < (4.0 if fault.name == "force off by 1 N" else 3.0)
    assert outcome.recovery_s < (1.0 if fault.duration_s <= 0.5 else 3.0)


@pytest.mark.parametrize("variant", ["mhe double", "ekf single"])
def test_good_data_are_not_doubted(variant: str) -> None:
    assert trial(variant).doubted_when_clean() <= 0.001
