"""Simulated records as estimators see them, and how each estimator does on one.

Truth is compared where the estimator stands: behind the same filters and delays as its signals.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import SimulatedRun, simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.signals.estimates import Estimates

Array = NDArray[np.float64]

DURATION_S: Final = 20.0
# The window fills and the filters settle: not counted.
SKIPPED_UPDATES: Final = 25


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
class EstimatorOutcome:
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
        trajectory, machine.sampling.rate, duration_s=duration_s, max_velocity=machine.sampling.max_velocity
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


def run_estimator(name: str, machine: Machine, record: Record) -> EstimatorOutcome:
    """Run the emitted C of a machine over a record."""
    estimator = CompiledEstimator(machine)
    return time_estimator(name, machine, lambda: estimator.estimate(record.signals))


def friction_rms(outcome: EstimatorOutcome, record: Record) -> float:
    """RMS of estimated minus true friction, the first updates left out [N]."""
    error = outcome.estimates.friction_N - record.friction
    return float(np.sqrt(np.mean(error[SKIPPED_UPDATES:] ** 2)))


def smoothness(outcome: EstimatorOutcome) -> Array:
    """Mean absolute change per update of each parameter, over its nominal value (n_p)."""
    return np.asarray(np.mean(np.abs(np.diff(outcome.theta[SKIPPED_UPDATES:], axis=0)), axis=0))


def coverage(outcome: EstimatorOutcome, record: Record) -> Array:
    """Part of the updates at which the truth lies within two standard deviations (n_p)."""
    inside = np.abs(outcome.theta - record.theta) <= 2.0 * outcome.std
    return np.asarray(inside[SKIPPED_UPDATES:].mean(axis=0))


def time_estimator(name: str, machine: Machine, run: Callable[[], Estimates]) -> EstimatorOutcome:
    """Run an estimator of the stiffness and take its time per update."""
    start = time.perf_counter()
    estimates = run()
    seconds = (time.perf_counter() - start) / max(1, len(estimates))
    return EstimatorOutcome(name, estimates, np.array(machine.friction.stiffness), seconds)
