"""How the comparison of the emitted C with the reference decides."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.evaluation.comparison import TOLERANCES, Comparison, compare_estimates, undecided_flags
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.signals.chain import Signals
from sgms_mhe.signals.estimates import Estimates

UPDATES = 40
PRIOR = np.array([0.3, 0.3])


@pytest.fixture(params=["double", "single"])
def machine(request: pytest.FixtureRequest) -> Machine:
    return override_machine(load_machine("etel_xy"), {"code": {"precision": request.param}})


@pytest.fixture
def reference() -> Estimates:
    rng = np.random.default_rng(3)
    return Estimates(
        time_s=np.arange(UPDATES) / 100.0,
        friction_measured_N=rng.normal(size=UPDATES),
        friction_N=np.linspace(-2.0, 2.0, UPDATES),
        z_m=1e-6 * rng.normal(size=(UPDATES, 3)),
        parameters=1.0 + 0.1 * rng.random((UPDATES, 2)),
        std=np.tile([0.1, 0.29], (UPDATES, 1)),  # the second one is hardly better known than before
        status=np.zeros(UPDATES, dtype=np.int64),
        innovation_N=0.1 * rng.normal(size=UPDATES),
        test_ratio=rng.random(UPDATES),
        noise_scale=np.ones(UPDATES),
        parameter_names=("stiffness_1", "coulomb"),
    )


def verdict(machine: Machine, reference: Estimates, undecided: Any = None, **changes: Any) -> Comparison:
    return compare_estimates(machine, replace(reference, **changes), reference, PRIOR, undecided)


def test_equal_estimates_agree(machine: Machine, reference: Estimates) -> None:
    comparison = verdict(machine, reference)
    assert comparison.agrees
    assert comparison.updates == UPDATES
    assert [quantity.name for quantity in comparison.quantities] == [
        *("friction_N", "z_1_m", "z_2_m", "z_3_m"),
        *("stiffness_1", "coulomb", "std_stiffness_1", "std_coulomb"),
    ]


@pytest.mark.parametrize("inside", [True, False])
def test_friction_is_related_to_its_range(machine: Machine, reference: Estimates, inside: bool) -> None:
    limit = TOLERANCES[machine.code.precision].friction * 4.0
    friction = reference.friction_N.copy()
    friction[7] += (0.99 if inside else 1.01) * limit
    comparison = verdict(machine, reference, friction_N=friction)
    assert comparison.agrees is inside
    assert comparison.quantities[0].difference == pytest.approx(limit, rel=0.02)


@pytest.mark.parametrize("column", ["friction_N", "z_m", "parameters", "std"])
def test_what_is_not_finite_never_agrees(machine: Machine, reference: Estimates, column: str) -> None:
    for value in (np.nan, np.inf):
        broken = getattr(reference, column).copy()
        broken.flat[0] = value
        assert not verdict(machine, reference, **{column: broken}).agrees


def test_a_parameter_that_is_not_excited_counts_in_double_precision_alone(
    machine: Machine, reference: Estimates
) -> None:
    parameters = reference.parameters.copy()
    parameters[:, 1] *= 1.01
    comparison = verdict(machine, reference, parameters=parameters)
    counted = {quantity.name: quantity.updates for quantity in comparison.quantities}
    is_single = machine.code.precision == "single"
    assert comparison.agrees is is_single
    assert counted["stiffness_1"] == UPDATES
    assert counted["coulomb"] == (0 if is_single else UPDATES)


def test_the_excited_parameter_counts(machine: Machine, reference: Estimates) -> None:
    parameters = reference.parameters.copy()
    parameters[9, 0] *= 1.01
    assert not verdict(machine, reference, parameters=parameters).agrees


def test_status_differs(machine: Machine, reference: Estimates) -> None:
    status = reference.status.copy()
    status[3], status[4], status[5] = 4, 16 + 2, -2
    comparison = verdict(machine, reference, status=status)
    assert (comparison.status_mismatches, comparison.status_undecided) == (3, 0)
    assert not comparison.agrees
    undecided = np.full(UPDATES, 4 + 8 + 16)
    comparison = verdict(machine, reference, undecided, status=status)
    # MISSING and a refusal compare no number with a limit.
    assert (comparison.status_mismatches, comparison.status_undecided) == (2, 1)


def test_bounds_are_counted_on_both_sides(machine: Machine, reference: Estimates) -> None:
    status = np.where(np.arange(UPDATES) < 5, 8, 0)
    comparison = verdict(machine, replace(reference, status=status), status=np.where(np.arange(UPDATES) < 6, 8, 0))
    assert comparison.bounds_active == (6, 5)


def test_estimates_of_unequal_length_are_an_error(machine: Machine, reference: Estimates) -> None:
    shorter = replace(reference, status=reference.status[:-1], time_s=reference.time_s[:-1])
    with pytest.raises(ValueError, match="40 updates against 39"):
        compare_estimates(machine, reference, shorter, PRIOR)


def test_flags_are_undecided_where_their_number_is_on_the_limit() -> None:
    machine = override_machine(load_machine("etel_xy"), {"code": {"precision": "single"}})
    parameters = build_model(machine).parameters
    samples, updates = machine.sampling.samples_per_update, 4
    velocity = np.full(1 + updates * samples, 0.1)
    velocity[1 + samples] = 1.0 + 1e-6  # max_velocity, in the second interval
    velocity[1 + 2 * samples : 1 + 3 * samples] = 2.2333333e-7 / (samples * machine.sampling.step)  # hold_path
    zeros = np.zeros(len(velocity))
    signals = Signals(zeros, zeros, velocity, zeros, zeros, zeros, zeros == 0, zeros != 0)
    values = np.array([[p.nominal for p in parameters]] * updates)
    values[3, 1] *= 5.0 * (1 - 1e-5)
    estimates = Estimates(
        *(np.zeros(updates),) * 3,
        np.zeros((updates, 4)),
        values,
        0 * values,
        np.zeros(updates, int),
        *(np.zeros(updates),) * 3,
        ("",) * 4,
    )
    np.testing.assert_array_equal(undecided_flags(machine, signals, estimates, parameters), [0, 16, 4, 8])
