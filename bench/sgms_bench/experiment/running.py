"""The paper's experiment on a simulated axis: friction and parameters of every estimator, figures 3, 6, 7 and 8.

The axis moves in closed loop, its encoder counts steps, its force carries noise, and its stiffness is not the nominal
one. Truth is compared where the estimator stands: behind the same filters and delays as its signals.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.experiment.figures import friction_figure, hysteresis_figure, signals_figure, stiffness_figure
from sgms_bench.records import (
    DURATION_S,
    EstimatorOutcome,
    Record,
    coverage,
    friction_rms,
    run_estimator,
    simulate_record,
    smoothness,
    time_estimator,
)
from sgms_mhe.configuration import override_machine
from sgms_mhe.evaluation.plots import save_figure
from sgms_mhe.machine import Machine
from sgms_mhe.reference import estimate_reference
from sgms_mhe.signals.estimates import write_estimates
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import write_text
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
# True over nominal stiffness, repeated over the elements.
TRUE_STIFFNESS: Final = (1.25, 0.8, 1.15, 0.9)
# Simulation, four estimators, the paper's weights, figures, files.
_STEPS: Final = 8

PAPER_WEIGHTS: Final[dict[str, Any]] = {
    "relinearise": "all",
    "noise": {
        "measurement": 0.5,
        "state": 0.1,
        "parameter": 0.05,
        "parameter_drift": 0.0,
        "initial_state": 1.0,
        "state_as": "deflection",
        "self_scaling": False,
    },
    "arrival_cost": {"update": "fixed"},
    "bounds": {"stiffness": [1e-3, 1e3]},
}
"""The paper's estimator, as in etel_xy_paper.toml."""

# A filter has no arrival cost: the paper's 5 % become the walk of its parameters per update. The wide prior lets the
# walk be one; a prior of 5 % would cap the variance there.
PAPER_WEIGHTS_EKF: Final[dict[str, Any]] = PAPER_WEIGHTS | {
    "kind": "ekf",
    "noise": PAPER_WEIGHTS["noise"] | {"parameter": 1.0, "parameter_drift": 0.05},
}


def papers(weights: Mapping[str, Any]) -> dict[str, Any]:
    """Changes of etel_xy that make it one of the paper's estimators, which take one measurement per update."""
    return {"sampling": {"measurement_rate": 100.0}, "estimator": weights}


@dataclass(frozen=True)
class Experiment:
    """Results of the experiment: tables (their text is str()), outcomes by estimator, figures written."""

    tables: tuple[CsvTable, ...]
    record: Record
    outcomes: dict[str, EstimatorOutcome]
    figures: tuple[Path, ...]

    def __str__(self) -> str:
        return "\n\n".join(map(str, self.tables))


def run_experiment(
    machine: Machine, out_dir: Path, progress: Progress | None = None, *, duration_s: float = DURATION_S
) -> Experiment:
    """Run the paper's experiment on a machine; figures, estimates and tables go into a folder.

    Args:
        machine: its friction model is the plant's too, its stiffness is estimated.
        out_dir: made where it does not exist; receives fig*.png, experiment.json, experiment.txt and estimates.
        progress: called with (steps done, steps in all).
        duration_s: of the simulated run.
    """
    if machine.estimator.parameters != ("stiffness",):
        raise InputError(
            machine.source, "estimator.parameters", list(machine.estimator.parameters), '["stiffness"] (experiment)'
        )
    if machine.friction.n_z != len(TRUE_STIFFNESS):
        raise InputError(machine.source, "friction.stiffness", None, f"{len(TRUE_STIFFNESS)} elements (experiment)")
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(out_dir, "output folder", None, f"a folder that can be made ({error.strerror})") from None
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, _STEPS)

    record = simulate_record(machine, TRUE_STIFFNESS, duration_s=duration_s)
    step()
    mhe, ekf = (override_machine(machine, {"estimator": {"kind": kind}}) for kind in ("mhe", "ekf"))
    runs: dict[str, Callable[[], EstimatorOutcome]] = {
        "MHE, C": lambda: run_estimator("MHE, C", mhe, record),
        "EKF, C": lambda: run_estimator("EKF, C", ekf, record),
        "MHE, reference": lambda: _reference("MHE, reference", mhe, record),
        "batch smoother": lambda: _smoother("batch smoother", mhe, record),
    }
    outcomes: dict[str, EstimatorOutcome] = {}
    for name, run in runs.items():
        outcomes[name] = run()
        step()
    paper = {
        "MHE, C": run_estimator("MHE, C", override_machine(machine, papers(PAPER_WEIGHTS)), record),
        "EKF, C": run_estimator("EKF, C", override_machine(machine, papers(PAPER_WEIGHTS_EKF)), record),
    }
    step()
    notes = (
        "friction: estimated minus true behind the same filters; parameters in % of their nominal value;",
        "coverage: updates at which the truth lies within +-2 sigma; time: one update with its 100 samples, this host",
    )
    true = ", ".join(f"{share:g}" for share in TRUE_STIFFNESS)
    tables = (
        _table(f"{machine.name}: {duration_s:g} s in closed loop, true stiffness [{true}] of nominal",
               list(outcomes.values()), record, notes),
        _table("the same record with the paper's weights", list(paper.values()), record, _finding(paper)),
    )  # fmt: skip
    drawn = _drawn(machine, record, outcomes, paper, out_dir)
    step()
    experiment = Experiment(tables, record, outcomes, drawn)
    for name, outcome in (("mhe", outcomes["MHE, C"]), ("ekf", outcomes["EKF, C"])):
        write_estimates(out_dir / f"estimates_{name}.csv", outcome.estimates)
    write_text(out_dir / "experiment.txt", f"{experiment}\n")
    write_text(
        out_dir / "experiment.json", json.dumps({"tables": [table.as_dict() for table in tables]}, indent=2) + "\n"
    )
    step()
    return experiment


def _drawn(
    machine: Machine,
    record: Record,
    outcomes: Mapping[str, EstimatorOutcome],
    paper: Mapping[str, EstimatorOutcome],
    out_dir: Path,
) -> tuple[Path, ...]:
    """Draw the paper's figures into a folder; returns the files."""
    default, filtered = outcomes["MHE, C"], outcomes["EKF, C"]
    figures = {
        "fig3_hysteresis": hysteresis_figure(machine),
        "fig6_signals": signals_figure(record),
        "fig7_friction": friction_figure(record, default, filtered),
        "fig8_stiffness": stiffness_figure(record, default, filtered, f"weights of {machine.name}"),
        "fig8_stiffness_paper": stiffness_figure(record, paper["MHE, C"], paper["EKF, C"], "the paper's weights"),
    }
    names = tuple(out_dir / f"{name}.png" for name in figures)
    for path, figure in zip(names, figures.values(), strict=True):
        save_figure(path, figure)
    return names


def _reference(name: str, machine: Machine, record: Record) -> EstimatorOutcome:
    return time_estimator(name, machine, lambda: estimate_reference(machine, record.signals, "mhe"))


def _smoother(name: str, machine: Machine, record: Record) -> EstimatorOutcome:
    return time_estimator(name, machine, lambda: estimate_reference(machine, record.signals, "smoother"))


def _table(title: str, outcomes: Sequence[EstimatorOutcome], record: Record, notes: tuple[str, ...]) -> CsvTable:
    count, error = len(record.theta), f"friction RMS [{record.run.log.units.force}]"
    formats = {"estimator": "", error: ".4f", "coverage": ".0%", "time [us]": ".0f"}
    formats |= {f"error {k + 1}": "+.1f" for k in range(count)}
    formats |= {f"change {k + 1}": ".4f" for k in range(count)}
    rows = []
    for outcome in outcomes:
        row: dict[str, Any] = {
            "estimator": outcome.name,
            error: friction_rms(outcome, record),
            "coverage": float(coverage(outcome, record).mean()),
            "time [us]": 1e6 * outcome.seconds,
        }
        final = 100.0 * (outcome.theta[-1] - record.theta)
        row |= {f"error {k + 1}": float(final[k]) for k in range(count)}
        row |= {f"change {k + 1}": float(100.0 * value) for k, value in enumerate(smoothness(outcome))}
        rows.append(row)
    legend = "error k: of stiffness_k at the end [%]; change k: its mean absolute change per update [%]"
    return CsvTable(title, formats, rows, (legend, *notes))


def _finding(paper: dict[str, EstimatorOutcome]) -> tuple[str, ...]:
    ratio = smoothness(paper["EKF, C"]) / smoothness(paper["MHE, C"])
    listed = ", ".join(f"{value:.1f}" for value in ratio)
    return (
        f"the MHE's parameters are {listed} times smoother than the EKF's;",
        "the EKF has the paper's 5 % as its parameters' walk per update",
    )
