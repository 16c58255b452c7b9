"""The paper's experiment on a simulated axis: friction and parameters of every estimator, figures 3, 6, 7 and 8.

The axis moves in closed loop, its encoder counts steps, its force carries noise, and its stiffness is not the nominal
one. Truth is compared where the estimator stands: behind the same filters and delays as its signals.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine, override_machine
from sgms_mhe.plant.simulation import AxisConfig, SimulatedRun, simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.reference import estimate_reference, estimate_smoother
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.signals.estimates import Estimates, write_estimates
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import write_text
from sgms_mhe.support.tables import Table

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

DURATION_S: Final = 20.0
# True over nominal stiffness, repeated over the elements.
TRUE_STIFFNESS: Final = (1.25, 0.8, 1.15, 0.9)
# The window fills and the filters settle: not counted.
SKIPPED_UPDATES: Final = 25
# Simulation, four estimators, the paper's weights, figures, files.
_STEPS: Final = 8

PAPER_WEIGHTS: Final[dict[str, Any]] = {
    "noise": {
        "measurement": 0.5,
        "state": 0.1,
        "parameter": 0.05,
        "parameter_drift": 0.0,
        "initial_state": 1.0,
        "state_as": "deflection",
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


@dataclass(frozen=True)
class Record:
    """A simulated run as estimators see it, and the truth at their updates.

    Attributes:
        run: log and truth.
        signals: behind the signal chain.
        nodes: samples of the updates (u).
        friction: true friction behind the chain's filters and delay (u) [N].
        theta: true over nominal value of the estimated parameters (n_p).
    """

    run: SimulatedRun
    signals: Signals
    nodes: NDArray[np.int64]
    friction: Array
    theta: Array


@dataclass(frozen=True)
class Outcome:
    """One estimator on one record."""

    name: str
    estimates: Estimates
    nominal: Array
    seconds: float

    @property
    def theta(self) -> Array:
        """Estimated over nominal parameters (u, n_p)."""
        return self.estimates.parameters / self.nominal

    @property
    def std(self) -> Array:
        """Standard deviation over nominal parameters (u, n_p)."""
        return self.estimates.std / np.abs(self.nominal)


@dataclass(frozen=True)
class Experiment:
    """Results of the experiment: tables (their text is str()), outcomes by estimator, figures written."""

    tables: tuple[Table, ...]
    record: Record
    outcomes: dict[str, Outcome]
    figures: tuple[Path, ...]

    def __str__(self) -> str:
        return "\n\n".join(map(str, self.tables))


def simulate_record(
    machine: Machine,
    stiffness: Sequence[float],
    *,
    trajectory: str = "paper",
    duration_s: float = DURATION_S,
    config: AxisConfig | None = None,
) -> Record:
    """Move an axis whose true stiffness is `stiffness` (n_z) times the machine's; other parameters are nominal."""
    path = make_trajectory(
        trajectory,
        machine.sampling.rate,
        duration_s=duration_s,
        max_velocity=machine.sampling.max_velocity,
    )
    run = simulate_axis(machine, path, config, scale={"stiffness": list(stiffness)})
    return record_of(machine, run, stiffness)


def record_of(machine: Machine, run: SimulatedRun, stiffness: Sequence[float]) -> Record:
    """A run as the machine's estimators see it; `stiffness` is its true over nominal one."""
    if run.truth is None:
        raise ValueError("the run was simulated without truth")
    samples = machine.sampling.samples_per_update
    signals = signals_from_log(run.log, machine)
    nodes = np.arange(samples, len(signals), samples)
    # The chain filters and delays a force as it does the measured one.
    behind = signals_from_log(replace(run.log, force_N=run.truth.friction_N), machine)
    theta = [value for name in machine.estimator.parameters for value in (stiffness if name == "stiffness" else (1.0,))]
    return Record(run, signals, nodes, behind.force[nodes], np.array(theta))


def run_estimator(name: str, machine: Machine, record: Record) -> Outcome:
    """Run the emitted C of a machine over a record."""
    estimator = CompiledEstimator(machine)
    return _timed(name, machine, lambda: estimator.estimate(record.signals))


def friction_rms(outcome: Outcome, record: Record) -> float:
    """RMS of estimated minus true friction, the first updates left out [N]."""
    error = outcome.estimates.friction_N - record.friction
    return float(np.sqrt(np.mean(error[SKIPPED_UPDATES:] ** 2)))


def smoothness(outcome: Outcome) -> Array:
    """Mean absolute change per update of each parameter, over its nominal value (n_p)."""
    return np.asarray(np.mean(np.abs(np.diff(outcome.theta[SKIPPED_UPDATES:], axis=0)), axis=0))


def coverage(outcome: Outcome, record: Record) -> Array:
    """Part of the updates at which the truth lies within two standard deviations (n_p)."""
    inside = np.abs(outcome.theta - record.theta) <= 2.0 * outcome.std
    return np.asarray(inside[SKIPPED_UPDATES:].mean(axis=0))


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
    from sgms_mhe.evaluation import figures

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
    runs: dict[str, Callable[[], Outcome]] = {
        "MHE, C": lambda: run_estimator("MHE, C", mhe, record),
        "EKF, C": lambda: run_estimator("EKF, C", ekf, record),
        "MHE, reference": lambda: _reference("MHE, reference", mhe, record),
        "batch smoother": lambda: _smoother("batch smoother", mhe, record),
    }
    outcomes: dict[str, Outcome] = {}
    for name, run in runs.items():
        outcomes[name] = run()
        step()
    paper = {
        "MHE, C": run_estimator("MHE, C", override_machine(machine, {"estimator": PAPER_WEIGHTS}), record),
        "EKF, C": run_estimator("EKF, C", override_machine(machine, {"estimator": PAPER_WEIGHTS_EKF}), record),
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
    default, filtered = outcomes["MHE, C"], outcomes["EKF, C"]
    drawn = {
        "fig3_hysteresis": figures.hysteresis_figure(machine),
        "fig6_signals": figures.signals_figure(record),
        "fig7_friction": figures.friction_figure(record, default, filtered),
        "fig8_stiffness": figures.stiffness_figure(record, default, filtered, f"weights of {machine.name}"),
        "fig8_stiffness_paper": figures.stiffness_figure(
            record, paper["MHE, C"], paper["EKF, C"], "the paper's weights"
        ),
    }
    names = [out_dir / f"{name}.png" for name in drawn]
    for path, figure in zip(names, drawn.values(), strict=True):
        figures.save_figure(path, figure)
    step()
    experiment = Experiment(tables, record, outcomes, tuple(names))
    for name, outcome in (("mhe", outcomes["MHE, C"]), ("ekf", outcomes["EKF, C"])):
        write_estimates(out_dir / f"estimates_{name}.csv", outcome.estimates)
    write_text(out_dir / "experiment.txt", f"{experiment}\n")
    write_text(
        out_dir / "experiment.json", json.dumps({"tables": [table.as_dict() for table in tables]}, indent=2) + "\n"
    )
    step()
    return experiment


def _timed(name: str, machine: Machine, run: Callable[[], Estimates]) -> Outcome:
    start = time.perf_counter()
    estimates = run()
    seconds = (time.perf_counter() - start) / max(1, len(estimates))
    return Outcome(name, estimates, np.array(machine.friction.stiffness), seconds)


def _reference(name: str, machine: Machine, record: Record) -> Outcome:
    return _timed(name, machine, lambda: estimate_reference(machine, record.signals, "mhe"))


def _smoother(name: str, machine: Machine, record: Record) -> Outcome:
    return _timed(name, machine, lambda: estimate_smoother(machine, record.signals))


def _table(title: str, outcomes: Sequence[Outcome], record: Record, notes: tuple[str, ...]) -> Table:
    count = len(record.theta)
    formats = {"estimator": "", "friction RMS [N]": ".4f", "coverage": ".0%", "time [us]": ".0f"}
    formats |= {f"error {k + 1}": "+.1f" for k in range(count)}
    formats |= {f"change {k + 1}": ".4f" for k in range(count)}
    rows = []
    for outcome in outcomes:
        row: dict[str, Any] = {
            "estimator": outcome.name,
            "friction RMS [N]": friction_rms(outcome, record),
            "coverage": float(coverage(outcome, record).mean()),
            "time [us]": 1e6 * outcome.seconds,
        }
        final = 100.0 * (outcome.theta[-1] - record.theta)
        row |= {f"error {k + 1}": float(final[k]) for k in range(count)}
        row |= {f"change {k + 1}": float(100.0 * value) for k, value in enumerate(smoothness(outcome))}
        rows.append(row)
    legend = "error k: of stiffness_k at the end [%]; change k: its mean absolute change per update [%]"
    return Table(title, formats, rows, (legend, *notes))


def _finding(paper: dict[str, Outcome]) -> tuple[str, ...]:
    ratio = smoothness(paper["EKF, C"]) / smoothness(paper["MHE, C"])
    listed = ", ".join(f"{value:.1f}" for value in ratio)
    return (
        f"the MHE's parameters are {listed} times smoother than the EKF's;",
        "the EKF has the paper's 5 % as its parameters' walk per update",
    )
