"""Data from the estimator's own noise model: whether its standard deviations are true."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from sgms_bench.studies.cases import done_of, positive
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.reference import ReferenceIntegrator
from sgms_mhe.signals.chain import Signals, mean_samples, signal_array
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]
Kind = Literal["mhe", "ekf"]

# Nothing in the statistics depends on the sample rate, and ten samples per update cost a tenth of a hundred. The
# paper's motion stays below 2 mm/s.
STATISTICS_SAMPLING: Final[dict[str, Any]] = {
    "rate": 1000.0,
    "velocity_cutoff": 50.0,
    "max_velocity": 0.004,
    "integrator": {"scheme": "rk4"},
}
# Where the paper's motion begins to move [s].
MOTION_START_S: Final = 0.25


@dataclass(frozen=True)
class Drawn:
    """Runs of the noise model along one motion.

    Attributes:
        signals: the motion; friction is zero.
        samples: per update.
        theta: true scaled parameters (runs, n_p).
        friction: true friction at nodes 0 .. updates (runs, updates + 1) [N].
    """

    signals: Signals
    samples: int
    theta: Array
    friction: Array

    def add_noise(self, run: int, sigma: float) -> Signals:
        """Signals of a run with measurement noise [N]."""
        noise = np.random.default_rng([run, 1]).standard_normal(self.friction.shape[1])
        friction = np.zeros(len(self.signals))
        friction[:: self.samples] = self.friction[run] + sigma * noise
        return replace(self.signals, friction=friction)


def statistics_machine(machine: Machine, **noise: Any) -> Machine:
    """The machine at a low sample rate, parameters constant, bounds out of the way, some weights replaced."""
    changes = {"parameter_drift": 0.0} | noise
    return override_machine(
        machine,
        {"sampling": STATISTICS_SAMPLING, "estimator": {"noise": changes, "bounds": {"stiffness": [0.02, 50.0]}}},
    )


def draw(machine: Machine, runs: int, updates: int, *, first_run: int = 0) -> Drawn:
    """Draw x_{k+1} = f(x_k, theta) + w with x_0, theta and w from the machine's weights, along the paper's motion."""
    model = build_model(machine)
    integrator = ReferenceIntegrator(model)
    rate, samples = machine.sampling.rate, machine.sampling.samples_per_update
    motion = make_trajectory("paper", rate).repeat(MOTION_START_S + updates / machine.sampling.update_rate + 1.0)
    part = slice(int(MOTION_START_S * rate), int(MOTION_START_S * rate) + updates * samples + 1)
    n = part.stop - part.start
    zeros = np.zeros(n)
    signals = Signals(
        time=np.arange(n) / rate,
        position=motion.position_m[part],
        velocity=motion.velocity_m_s[part],
        acceleration=zeros,
        force=zeros,
        friction=zeros,
        valid=np.ones(n, dtype=np.bool_),
        missing=np.zeros(n, dtype=np.bool_),
    )
    plan = integrator.plan(signals)
    w = signal_array(signals, machine.sampling.step, mean=mean_samples(machine))[::samples]
    thetas, frictions = [], []
    for run in range(first_run, first_run + runs):
        rng = np.random.default_rng([run, 0])
        theta = positive(rng, machine.estimator.noise.parameter, model.n_p)
        noise = model.state_noise * rng.standard_normal((updates, model.n_x))
        x = np.empty((updates + 1, model.n_x))
        x[0] = model.initial_state * rng.standard_normal(model.n_x)
        for k in range(updates):
            x[k + 1] = integrator.intervals(plan, k, x[k : k + 1], theta).x1[0] + noise[k]
        thetas.append(theta)
        frictions.append(integrator.outputs(x, w, theta).y)
    return Drawn(signals, samples, np.array(thetas), np.array(frictions))


def normalised_errors(machine: Machine, drawn: Drawn, update: int) -> tuple[Array, Array]:
    """(estimate - truth) / sigma and sigma of every parameter after `update` updates (runs, n_p)."""
    estimator = CompiledEstimator(machine)
    nominal = np.array(machine.friction.stiffness)
    errors, sigmas = [], []
    for run, theta in enumerate(drawn.theta):
        estimates = estimator.estimate(drawn.add_noise(run, machine.estimator.noise.measurement))
        sigma = estimates.std[update - 1] / nominal
        errors.append((estimates.parameters[update - 1] / nominal - theta) / sigma)
        sigmas.append(sigma)
    return np.array(errors), np.array(sigmas)


def _part(noise: Mapping[str, Any], kind: Kind, runs: int, updates: int) -> tuple[Array, Array]:
    machine = statistics_machine(load_machine("etel_xy"), **noise)
    drawn = draw(machine, runs, updates)
    return normalised_errors(override_machine(machine, {"estimator": {"kind": kind}}), drawn, updates)


def coverage_study(runs: int, updates: int, place: WorkerSlot = HERE) -> CsvTable:
    """+-2 sigma coverage on the estimator's own noise model: default weights, then wider priors."""
    default = load_machine("etel_xy")
    # The filter's bounds are the MHE's at a twentieth of the time: enough to see what a wider prior does.
    few = max(1, runs // 3)
    cases: list[tuple[str, Kind, int, dict[str, Any]]] = [
        ("default", "mhe", runs, {}),
        ("default", "ekf", runs, {}),
        ("prior 0.2", "ekf", few, {"parameter": 0.2}),
        ("prior 0.3", "ekf", few, {"parameter": 0.3}),
        ("prior 0.2, measurement 0.5 N", "ekf", few, {"parameter": 0.2, "measurement": 0.5}),
    ]
    tasks = [Task(f"{name}, {kind}", _part, (noise, kind, count, updates)) for name, kind, count, noise in cases]
    rows = []
    for (name, kind, count, _), (z, sigma) in zip(cases, results(tasks, place, done_of("weights")), strict=True):
        row: dict[str, Any] = {"weights": name, "estimator": kind.upper(), "runs": count}
        row |= {f"cover {k + 1}": float(np.mean(np.abs(z[:, k]) <= 2.0)) for k in range(z.shape[1])}
        row |= {f"bias {k + 1}": float(np.mean(z[:, k])) for k in range(z.shape[1])}
        row |= {f"sigma {k + 1}": float(np.mean(sigma[:, k])) for k in range(z.shape[1])}
        rows.append(row)
    elements = range(1, len(default.friction.stiffness) + 1)
    formats = {"weights": "", "estimator": "", "runs": "d"} | {f"cover {k}": ".1%" for k in elements}
    formats |= {f"bias {k}": "+.2f" for k in elements} | {f"sigma {k}": ".3f" for k in elements}
    return CsvTable(
        f"coverage of +-2 sigma on the estimator's own noise model, after {updates} updates",
        formats,
        rows,
        (
            f"one standard deviation of a coverage of 95.4 % over {runs} runs is {_binomial(0.954, runs):.1%};",
            "bias k: mean error of stiffness_k over its sigma; sigma k: mean standard deviation, relative",
        ),
    )


def _binomial(probability: float, runs: int) -> float:
    return float(np.sqrt(probability * (1.0 - probability) / runs))
