"""The next experiment: whether the move that is to tell two causes apart does."""

from __future__ import annotations

from pathlib import Path

import pytest

from cli_cases import done
from sgms_bench.diagnosis import planned
from sgms_bench.diagnosis.planned import PlannedExperiment, experiments, run_experiment, run_planned, verdict_on
from sgms_bench.diagnosis.scoring import ScoredDiagnosis
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis.plan import LEAST_S, make_plan
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import cause, separating_moves

QUICK = PlannedExperiment("viscous", "quadratic_drag", "sgms")


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("etel_xy")


def found(verdict: str, *names: str, rivals: tuple[str, ...] = ()) -> ScoredDiagnosis:
    return ScoredDiagnosis(verdict, causes=tuple((n, {}, {}) for n in names), rivals=tuple((n, None) for n in rivals))


def test_every_pair_is_tried_both_ways_on_both_laws(machine: Machine) -> None:
    tried = experiments(machine)
    assert len(set(tried)) == len(tried) > 200
    assert all(separating_moves(e.hidden, e.other) for e in tried)
    for e in tried:
        assert PlannedExperiment(e.other, e.hidden, "maxwell_slip") in tried
    turning = {e.hidden for e in experiments(load_machine("etel_xy_rotary"))}
    assert "unbalance" in turning and "unbalance" not in {e.hidden for e in tried}


def test_a_plan_lasts_and_its_laps_differ(machine: Machine) -> None:
    plan = make_plan(machine, ("force_delay", "actuator_lag"))
    path = plan.trajectory.position_m
    assert plan.trajectory.duration_s >= LEAST_S
    first = path[: len(path) // 4]
    assert not any(
        (path[shift : shift + len(first)] == first).all() for shift in range(100, len(path) - len(first), 10)
    )


@pytest.mark.parametrize(
    ("said", "word"),
    [
        (None, "no log"),
        (found("explained", "viscous"), "right"),
        (found("explained", "viscous", "stribeck"), "wrong"),
        (found("explained", "quadratic_drag"), "wrong"),
        (found("ambiguous", "quadratic_drag", rivals=("viscous",)), "ambiguous"),
        (found("ambiguous", "quadratic_drag", rivals=("coulomb",)), "wrong"),
        (found("adequate"), "nothing"),
        (found("unexplained", "viscous"), "unexplained"),
    ],
)
def test_what_counts_as_right(said: ScoredDiagnosis | None, word: str) -> None:
    assert verdict_on(QUICK, said) == word


@pytest.mark.slow
@pytest.mark.parametrize(
    "experiment",
    [
        QUICK,
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


def test_results_are_kept_and_said(machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = PlannedExperiment("quadratic_drag", "viscous", "sgms")
    asked: list[PlannedExperiment] = []

    def run(_: Machine, experiment: PlannedExperiment) -> ScoredDiagnosis:
        asked.append(experiment)
        return found("explained", "viscous")

    monkeypatch.setattr(planned, "experiments", lambda _: [QUICK, other])
    monkeypatch.setattr(planned, "run_experiment", run)
    steps: list[tuple[int, int]] = []
    table = run_planned(machine, tmp_path, jobs=1, progress=lambda *step: steps.append(step))
    assert asked == [QUICK, other] and steps == [(1, 2), (2, 2)]
    assert [row["outcome"] for row in table.rows] == ["wrong"]
    assert "the one right name: 1 of 2 logs, 50.0%" in str(table)
    said = done("bench-diagnosis", "etel_xy", "--planned", "--jobs", "1", "--out", tmp_path).stdout
    assert len(asked) == 2 and said.strip() == str(table).strip() == (tmp_path / "planned.txt").read_text().strip()
