"""The next experiment: whether the move that is to tell two causes apart does."""

import pytest

from sgms_bench.diagnosis.planned import PlannedExperiment, run_experiment, verdict_on
from sgms_mhe.diagnosis.plan import LEAST_S, make_plan
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import cause


def test_a_plan_lasts_and_its_laps_differ(machine: Machine) -> None:
    plan = make_plan(machine, ("force_delay", "actuator_lag"))
    path = plan.trajectory.position_m
    assert plan.trajectory.duration_s >= LEAST_S
    first = path[: len(path) // 4]
    assert not any(
        (path[shift : shift + len(first)] == first).all() for shift in range(100, len(path) - len(first), 10)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "experiment",
    [
        # Acts in a few blocks alone: the interval of its gain draws sets without any of them.
        PlannedExperiment("mass_mismatch", "micro_viscous", "sgms"),
        # Stands on smooth elements alone: what stands in for the ones that switch is not quite them.
        PlannedExperiment("micro_viscous", "stiffness", "maxwell_slip"),
    ],
    ids=lambda e: e.key,
)
def test_the_planned_move_gives_the_one_name(experiment: PlannedExperiment, machine: Machine) -> None:
    said = run_experiment(machine, experiment)
    assert said is not None
    assert verdict_on(experiment, said) == "right", said


def test_a_cause_that_the_move_cannot_show_has_no_log(machine: Machine) -> None:
    assert cause("encoder_periodic_error").moves
    assert (
        run_experiment(machine, PlannedExperiment("encoder_periodic_error", "structural_resonance", "maxwell_slip"))
        is None
    )
