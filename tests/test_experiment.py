"""The paper's experiment: its table, its figures, and what the paper found."""

import numpy as np
import pytest

from sgms_bench.experiment import figures
from sgms_bench.experiment.running import PAPER_WEIGHTS, PAPER_WEIGHTS_EKF, TRUE_STIFFNESS, papers
from sgms_bench.records import Record, coverage, friction_rms, run_estimator, simulate_record, smoothness
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion
from sgms_mhe.support.tables import CsvTable


@pytest.fixture(scope="module")
def record() -> Record:
    return simulate_record(load_machine("etel_xy"), TRUE_STIFFNESS, duration_s=10.0)


def test_default_weights_find_the_stiffness(record: Record) -> None:
    machine = load_machine("etel_xy")
    outcome = run_estimator("MHE, C", machine, record)
    assert friction_rms(outcome, record) < 0.025  # 0.014 N in 20 s
    assert coverage(outcome, record).mean() > 0.8
    start, end = (float(np.abs(theta - record.theta).max()) for theta in (np.ones(4), outcome.theta[-1]))
    assert end < 0.5 * start


def test_the_papers_weights_are_those_of_its_machine_file() -> None:
    paper = load_machine("etel_xy_paper")
    ours = override_machine(load_machine("etel_xy"), papers(PAPER_WEIGHTS))
    assert ours.estimator == paper.estimator
    assert ours.sampling.measurement_rate == paper.sampling.measurement_rate


def test_with_the_papers_weights_the_mhe_is_five_times_smoother(record: Record) -> None:
    machine = load_machine("etel_xy")
    mhe, ekf = (
        run_estimator("", override_machine(machine, papers(weights)), record)
        for weights in (PAPER_WEIGHTS, PAPER_WEIGHTS_EKF)
    )
    assert np.all(smoothness(ekf) > 5.0 * smoothness(mhe))


def test_truth_is_compared_behind_the_filters(record: Record) -> None:
    # What is left between measured and true friction is noise: no delay, no transient.
    measured = record.signals.friction[record.nodes][25:]
    assert np.sqrt(np.mean((measured - record.friction[25:]) ** 2)) < 0.05


def test_figure_3_has_the_papers_parameters_and_non_local_memory() -> None:
    machine = figures.figure_3_machine(load_machine("etel_xy"))
    friction = machine.friction
    assert friction.coulomb * (1.0 + friction.stribeck_ratio) == pytest.approx(3.0)
    # Memory: an inner loop that closed leaves no trace, and one that is open does.
    plain, closed = (friction_at(machine, 0.4e-6, targets) for targets in ((), (0.2e-6, 0.0)))
    inside = friction_at(machine, 0.1e-6, (0.2e-6, 0.0))
    assert closed == pytest.approx(plain, abs=0.01)
    assert inside < friction_at(machine, 0.1e-6, ()) - 0.1


def friction_at(machine: Machine, position_m: float, inner: tuple[float, ...]) -> float:
    """Friction [N] at the last upward pass of a position, after the reversals at 1, -0.5 and `inner` micrometres."""
    velocity = 4e-6
    motion = Motion(machine.sampling.rate)
    for target in (1e-6, -0.5e-6, *inner, 0.6e-6):
        motion.move_to(target, velocity, 100.0 * velocity, 2e4 * velocity)
    path = motion.trajectory("loops")
    run = simulate_axis(machine, path, AxisConfig(control="prescribed", encoder_resolution_m=0.0, force_noise_N=0.0))
    assert run.truth is not None
    return float(run.truth.friction_N[np.flatnonzero(path.position_m < position_m)[-1]])


def test_tables_align_and_leave_what_is_absent_empty() -> None:
    table = CsvTable(
        "title", {"name": "", "value": ".2f"}, ({"name": "a", "value": 1.0}, {"name": "longer"}), ("note",)
    )
    assert str(table).splitlines() == ["title", "  name    value", "  a        1.00", "  longer", "  note"]
    assert table.as_dict()["rows"][0] == {"name": "a", "value": 1.0}
