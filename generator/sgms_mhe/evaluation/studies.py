"""Statistics of the estimator, from the command line: `python -m sgms_mhe.evaluation.studies NAME`.

`coverage` draws data from the estimator's own noise model, `plant` asks the same of the axis in closed loop,
`monte-carlo` compares MHE, EKF and batch smoother over random axes, `creep` follows the parameters over 10^5 updates,
`relinearise` asks what it costs the estimate to keep linearisations, `speed` what fast moves cost the integrators.
All numbers are seeded; the same command prints the same table.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.evaluation.experiment import PAPER_WEIGHTS
from sgms_mhe.evaluation.records import Record, simulate_record
from sgms_mhe.host.compiled import CompiledEstimator, CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.plant.simulation import AxisConfig, simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.reference import Integrator, estimate_smoother
from sgms_mhe.signals.chain import Signals, signal_array, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.tables import Table

Array = NDArray[np.float64]
Kind = Literal["mhe", "ekf"]

# --- data from the estimator's own noise model --------------------------------------------------------------------

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

    def measured(self, run: int, sigma: float) -> Signals:
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
    integrator = Integrator(model)
    rate, samples = machine.sampling.rate, machine.sampling.samples_per_update
    motion = make_trajectory("paper", rate).repeated(MOTION_START_S + updates / machine.sampling.update_rate + 1.0)
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
    w = signal_array(signals, machine.sampling.step)[::samples]
    thetas, frictions = [], []
    for run in range(first_run, first_run + runs):
        rng = np.random.default_rng([run, 0])
        theta = _positive(rng, machine.estimator.noise.parameter, model.n_p)
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
        estimates = estimator.estimate(drawn.measured(run, machine.estimator.noise.measurement))
        sigma = estimates.std[update - 1] / nominal
        errors.append((estimates.parameters[update - 1] / nominal - theta) / sigma)
        sigmas.append(sigma)
    return np.array(errors), np.array(sigmas)


def coverage_study(runs: int, updates: int, kinds: Sequence[Kind] = ("mhe", "ekf")) -> Table:
    """+-2 sigma coverage on the estimator's own noise model: default weights, then wider priors."""
    default = load_machine("etel_xy")
    rows = []
    # The filter's bounds are the MHE's at a twentieth of the time: enough to see what a wider prior does.
    few = max(1, runs // 3)
    cases: list[tuple[str, int, dict[str, Any], Sequence[Kind]]] = [
        ("default", runs, {}, kinds),
        ("prior 0.2", few, {"parameter": 0.2}, ("ekf",)),
        ("prior 0.3", few, {"parameter": 0.3}, ("ekf",)),
        ("prior 0.2, measurement 0.5 N", few, {"parameter": 0.2, "measurement": 0.5}, ("ekf",)),
    ]
    for name, count, noise, estimators in cases:
        machine = statistics_machine(default, **noise)
        drawn = draw(machine, count, updates)
        for kind in estimators:
            z, sigma = normalised_errors(override_machine(machine, {"estimator": {"kind": kind}}), drawn, updates)
            row: dict[str, Any] = {"weights": name, "estimator": kind.upper(), "runs": count}
            row |= {f"cover {k + 1}": float(np.mean(np.abs(z[:, k]) <= 2.0)) for k in range(z.shape[1])}
            row |= {f"bias {k + 1}": float(np.mean(z[:, k])) for k in range(z.shape[1])}
            row |= {f"sigma {k + 1}": float(np.mean(sigma[:, k])) for k in range(z.shape[1])}
            rows.append(row)
    elements = range(1, len(default.friction.stiffness) + 1)
    formats = {"weights": "", "estimator": "", "runs": "d"} | {f"cover {k}": ".1%" for k in elements}
    formats |= {f"bias {k}": "+.2f" for k in elements} | {f"sigma {k}": ".3f" for k in elements}
    return Table(
        f"coverage of +-2 sigma on the estimator's own noise model, after {updates} updates",
        formats,
        rows,
        (
            f"one standard deviation of a coverage of 95.4 % over {runs} runs is {_binomial(0.954, runs):.1%};",
            "bias k: mean error of stiffness_k over its sigma; sigma k: mean standard deviation, relative",
        ),
    )


# --- the axis in closed loop --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """One configuration of the Monte Carlo: what the machine file says, and how the axes are drawn.

    Attributes:
        name: of the configuration.
        changes: of etel_xy.toml.
        stiffness: draws true over nominal stiffness (n_z).
        force_noise_N: of the logged force; 0.1 N makes 0.03 N of the measured friction, 1.6 N 0.46 N.
        trajectory: by name.
    """

    name: str
    changes: Mapping[str, Any]
    stiffness: Callable[[np.random.Generator], Array]
    force_noise_N: float = 0.1
    trajectory: str = "paper"


def spread(rng: np.random.Generator) -> Array:
    """0.7 to 1.4 of nominal."""
    return rng.uniform(0.7, 1.4, 4)


def factor_of_two(rng: np.random.Generator) -> Array:
    """Every element at half or twice its nominal stiffness."""
    return rng.choice([0.5, 2.0], 4)


def _estimator(stiffness_bounds: tuple[float, float] | None = None, **noise: Any) -> dict[str, Any]:
    bounds = {} if stiffness_bounds is None else {"bounds": {"stiffness": list(stiffness_bounds)}}
    return {"estimator": {"noise": noise, **bounds}}


def _updates_at(rate: float) -> dict[str, Any]:
    return {"sampling": {"update_rate": rate}}


CASES: Final[tuple[Case, ...]] = (
    Case("default", {}, spread),
    Case("noise of the force 1.6 N", _estimator(measurement=0.5), spread, 1.6),
    Case("factor 2", {}, factor_of_two),
    Case("factor 2, prior 1.0", _estimator(parameter=1.0), factor_of_two),
    Case("bounds at truth's limits", _estimator((0.7, 1.4), parameter=0.3, measurement=0.5), spread, 1.6),
    Case("bounds 0.95, 1.05", _estimator((0.95, 1.05)), spread),
    Case("coulomb too", {"estimator": {"parameters": ["stiffness", "coulomb"]}}, spread),
    Case("fast moves", {}, spread, trajectory="mixed"),
    Case("50 ms", _updates_at(20.0), spread),
    Case("50 ms, factor 2, prior 0.5", _updates_at(20.0) | _estimator(parameter=0.5), factor_of_two),
    Case("100 ms, factor 2, prior 0.5", _updates_at(10.0) | _estimator(parameter=0.5), factor_of_two),
)


@dataclass(frozen=True)
class Comparison:
    """Friction RMS of one configuration [N], per seed; the smoother's only of the first ones."""

    case: Case
    mhe: Array
    ekf: Array
    smoother: Array

    @property
    def ratio(self) -> float:
        """RMS over all seeds, MHE over EKF."""
        return _rms(self.mhe) / _rms(self.ekf)


def compare_case(case: Case, seeds: Sequence[int], duration_s: float = 6.0, smoothed: int = 0) -> Comparison:
    """MHE and EKF with equal weights on the same simulated axes; the batch smoother on the first `smoothed` of them."""
    machine = override_machine(load_machine("etel_xy"), case.changes)
    estimators = {
        kind: CompiledEstimator(override_machine(machine, {"estimator": {"kind": kind}})) for kind in ("mhe", "ekf")
    }
    errors: dict[str, list[float]] = {"mhe": [], "ekf": [], "smoother": []}
    for index, seed in enumerate(seeds):
        record = _axis(machine, case, seed, duration_s)
        for kind, estimator in estimators.items():
            errors[kind].append(_friction_rms(estimator.estimate(record.signals), record))
        if index < smoothed:
            errors["smoother"].append(_friction_rms(estimate_smoother(machine, record.signals), record))
    return Comparison(case, *(np.array(errors[kind]) for kind in ("mhe", "ekf", "smoother")))


def monte_carlo_study(seeds: int, duration_s: float = 6.0, smoothed: int = 3) -> Table:
    """Friction RMS of MHE, EKF and batch smoother over random axes, every configuration."""
    rows = []
    for case in CASES:
        result = compare_case(case, range(seeds), duration_s, smoothed)
        ratio = result.mhe / result.ekf
        rows.append(
            {
                "configuration": case.name,
                "MHE [N]": _rms(result.mhe),
                "EKF [N]": _rms(result.ekf),
                "MHE/EKF": result.ratio,
                "median": float(np.median(ratio)),
                "worst": float(ratio.max()),
                "MHE/smoother": _rms(result.mhe[:smoothed]) / _rms(result.smoother) if smoothed else None,
            }
        )
        _say(f"{case.name}: {result.ratio:.4f}")
    formats = {"configuration": "", "MHE [N]": ".4f", "EKF [N]": ".4f", "MHE/EKF": ".3f", "median": ".3f"}
    return Table(
        f"friction RMS against truth, {seeds} seeds of {duration_s:g} s, equal weights",
        formats | {"worst": ".3f", "MHE/smoother": ".2f"},
        rows,
        (f"MHE/smoother: over the first {smoothed} seeds; median and worst: of the seeds' own MHE/EKF",),
    )


def plant_study(seeds: int, duration_s: float = 20.0) -> Table:
    """Coverage on the closed-loop plant, and what moves it."""
    default: dict[str, Any] = {}
    cases: tuple[Case, ...] = (
        Case("default", default, spread),
        Case("stiffness within the prior, 10 %", default, lambda rng: _positive(rng, 0.1, 4)),
        Case("factor 2", default, factor_of_two),
        Case("force noise 0.35 N (0.1 N of friction)", default, spread, 0.35),
        Case("force noise 1.6 N (0.46 N of friction)", default, spread, 1.6),
        Case("the same, measurement = 0.5", _estimator(measurement=0.5), spread, 1.6),
        Case("prior 0.3", _estimator(parameter=0.3), spread),
        Case("no drift", _estimator(parameter_drift=0.0), spread),
        Case("the paper's weights", {"estimator": PAPER_WEIGHTS}, spread),
    )
    rows = []
    for case in cases:
        machine = override_machine(load_machine("etel_xy"), case.changes)
        # The filter's covariance is the MHE's to the third digit, at a twentieth of the time.
        kind = "mhe" if machine.estimator.arrival_cost.update == "fixed" else "ekf"
        machine = override_machine(machine, {"estimator": {"kind": kind}})
        estimator = CompiledEstimator(machine)
        nominal = np.array(machine.friction.stiffness)
        inside, z = [], []
        for seed in range(seeds):
            record = _axis(machine, case, seed, duration_s)
            estimates = estimator.estimate(record.signals)
            error = (estimates.parameters / nominal - record.theta) / (estimates.std / nominal)
            second_half = error[len(error) // 2 :]
            inside.append(np.mean(np.abs(second_half) <= 2.0, axis=0))
            z.append(error[-1])
        cover = np.mean(inside, axis=0)
        row: dict[str, Any] = {"configuration": case.name, "estimator": kind.upper()}
        row |= {f"cover {k + 1}": float(value) for k, value in enumerate(cover)}
        row |= {f"rms z {k + 1}": float(value) for k, value in enumerate(np.sqrt(np.mean(np.square(z), axis=0)))}
        rows.append(row)
    formats = {"configuration": "", "estimator": ""} | {f"cover {k + 1}": ".0%" for k in range(4)}
    return Table(
        f"coverage of +-2 sigma on the closed-loop axis, {seeds} seeds of {duration_s:g} s, second half of each run",
        formats | {f"rms z {k + 1}": ".2f" for k in range(4)},
        rows,
        ("rms z: error over its sigma at the end",),
    )


# --- creep --------------------------------------------------------------------------------------------------------

CREEP_TRUTH: Final = (1.15, 0.9, 1.1, 0.97)


@dataclass(frozen=True)
class Formulation:
    """One way to weigh the parameters' memory."""

    name: str
    changes: Mapping[str, Any]


FORMULATIONS: Final[tuple[Formulation, ...]] = (
    Formulation("paper: fixed, deflection, 0.1", PAPER_WEIGHTS | {"bounds": {"stiffness": [0.2, 5.0]}}),
    Formulation(
        "riccati alone",
        {"noise": {"state": 0.1, "measurement": 0.5, "state_as": "deflection"}},
    ),
    Formulation(
        "force alone (fixed)",
        PAPER_WEIGHTS | {"noise": PAPER_WEIGHTS["noise"] | {"state_as": "force"}, "bounds": {"stiffness": [0.2, 5.0]}},
    ),
    Formulation("force, riccati, drift with hold; 0.1", {"noise": {"state": 0.1, "measurement": 0.5}}),
    Formulation("default, measurement = 0.5", {"noise": {"measurement": 0.5}}),
    Formulation("default", {}),
)


def creep_signals(updates: int, force_noise_N: float, trajectory: str = "long_mixed", seed: int = 0) -> Signals:
    """Closed-loop record of moves and standstill, `updates` updates long, of an axis of CREEP_TRUTH."""
    machine = load_machine("etel_xy")
    duration = (updates + 1) / machine.sampling.update_rate
    path = make_trajectory(trajectory, machine.sampling.rate, duration_s=duration)
    config = AxisConfig(force_noise_N=force_noise_N, seed=seed)
    run = simulate_axis(machine, path, config, scale={"stiffness": list(CREEP_TRUTH)}, truth=False)
    return signals_from_log(run.log, machine)


def follow(formulation: Formulation, signals: Signals) -> Array:
    """Estimated over nominal stiffness at every update (u, n_z)."""
    machine = override_machine(load_machine("etel_xy"), {"estimator": dict(formulation.changes)})
    return np.asarray(CompiledEstimator(machine).estimate(signals).parameters / np.array(machine.friction.stiffness))


def creep_study(updates: int, compared: int = 4000) -> Table:
    """Stiffness over time: what creeps within `compared` updates, and that the default does not in `updates`."""
    rows = []
    for noise in (1.6, 0.1):
        signals = creep_signals(compared, noise, "paper")
        rows += [_creep_row(form.name, noise, follow(form, signals), 0, compared) for form in FORMULATIONS]
    for name, noise in (("default", 0.1), ("default, measurement = 0.5", 1.6)):
        form = next(f for f in FORMULATIONS if f.name == name)
        theta = follow(form, creep_signals(updates, noise))
        edges = [0, *(round(updates * share) for share in (0.04, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0))]
        rows += [_creep_row(f"{name}, long", noise, theta[:last], first, last) for first, last in pairwise(edges)]
    formats = {"formulation": "", "noise [N]": ".1f", "updates": ""}
    formats |= {f"mean {k + 1}": ".3f" for k in range(4)} | {f"spread {k + 1}": ".3f" for k in range(4)}
    return Table(
        f"stiffness over nominal, true {', '.join(f'{t:g}' for t in CREEP_TRUTH)}",
        formats,
        rows,
        (
            "short runs along the paper's motion: the last quarter; long ones, moves and standstill: each stretch",
            "noise: of the logged force, per sample; 1.6 N is 0.46 N of the measured friction, 0.1 N is 0.03 N",
        ),
    )


def _creep_row(name: str, noise: float, theta: Array, first: int, last: int) -> dict[str, Any]:
    part = theta[first:] if first else theta[3 * len(theta) // 4 :]
    row: dict[str, Any] = {"formulation": name, "noise [N]": noise, "updates": f"{first}-{last}"}
    row |= {f"mean {k + 1}": float(value) for k, value in enumerate(part.mean(axis=0))}
    row |= {f"spread {k + 1}": float(value) for k, value in enumerate(part.std(axis=0))}
    return row


# --- linearisations that are kept ----------------------------------------------------------------------------------

RELINEARISE: Final = ("all", "auto", "newest")


def thirty_percent(rng: np.random.Generator) -> Array:
    """Every element 30 % softer or stiffer than nominal."""
    return rng.choice([0.7, 1.3], 4)


def _paper(**noise: float) -> dict[str, Any]:
    return {"estimator": PAPER_WEIGHTS | {"noise": PAPER_WEIGHTS["noise"] | noise}}


RELINEARISE_CASES: Final[tuple[Case, ...]] = (
    Case("default (state 0.01)", {}, spread),
    Case("state 0.003", _estimator(state=0.003), spread),
    Case("state 0.1", _estimator(state=0.1), spread),
    Case("measurement 0.5, noise 1.6 N", _estimator(measurement=0.5), spread, 1.6),
    Case("30 % off", {}, thirty_percent),
    Case("30 % off, prior 0.3", _estimator(parameter=0.3), thirty_percent),
    Case("coulomb too", {"estimator": {"parameters": ["stiffness", "coulomb"]}}, spread),
    Case("mixed motion", {}, spread, trajectory="mixed"),
    Case("mixed motion, noise 1.6 N", _estimator(measurement=0.5), spread, 1.6, "mixed"),
    Case("the paper's", _paper(), spread),
    Case("the paper's, noise 1.6 N", _paper(), spread, 1.6),
    Case("the paper's, state 0.01", _paper(state=0.01), spread),
)


def relinearise_errors(case: Case, seeds: Sequence[int], duration_s: float) -> dict[str, Array]:
    """RMS errors of friction [N] and of every parameter over nominal, against truth, by `relinearise` (1 + n_p)."""
    machine = override_machine(load_machine("etel_xy"), case.changes)
    records = [_axis(machine, case, seed, duration_s) for seed in seeds]
    errors = {}
    for relinearise in RELINEARISE:
        estimator = CompiledEstimator(override_machine(machine, {"estimator": {"relinearise": relinearise}}))
        nominal = np.array([parameter.nominal for parameter in estimator.model.parameters])
        rows = []
        for record in records:
            estimates = estimator.estimate(record.signals)
            counted = _counted(record)
            wrong = estimates.parameters[counted] / nominal - record.theta
            rows.append([_friction_rms(estimates, record), *np.sqrt(np.mean(wrong**2, axis=0))])
        errors[relinearise] = np.sqrt(np.mean(np.square(rows), axis=0))
    return errors


def relinearise_study(seeds: int, duration_s: float = 8.0) -> Table:
    """Estimate errors with linearisations that are kept over those with all intervals linearised anew."""
    rows: list[dict[str, Any]] = []
    for case in RELINEARISE_CASES:
        errors = relinearise_errors(case, range(seeds), duration_s)
        for relinearise in RELINEARISE[1:]:
            ratio = errors[relinearise] / errors["all"]
            row: dict[str, Any] = {"weights": case.name, "relinearise": relinearise, "friction": float(ratio[0])}
            row |= {f"p {k + 1}": float(ratio[k + 1]) if k + 1 < len(ratio) else None for k in range(5)}
            rows.append(row | {"worst": float(ratio.max())})
        _say(f"{case.name}: {rows[-2]['worst']:.4f} {rows[-1]['worst']:.4f}")
    formats = {"weights": "", "relinearise": "", "friction": ".3f"} | {f"p {k + 1}": ".3f" for k in range(5)}
    return Table(
        f"RMS errors against truth over those of relinearise = all, {seeds} seeds of {duration_s:g} s",
        formats | {"worst": ".3f"},
        rows,
        ("p 1 to 4: stiffness, 5: coulomb; noise: of the logged force; the paper's: its weights, DESIGN section 5",),
    )


# --- shared -------------------------------------------------------------------------------------------------------


def _axis(machine: Machine, case: Case, seed: int, duration_s: float) -> Record:
    rng = np.random.default_rng([seed, 2])
    config = AxisConfig(force_noise_N=case.force_noise_N, seed=seed)
    return simulate_record(
        machine,
        case.stiffness(rng).tolist(),
        trajectory=case.trajectory,
        duration_s=duration_s,
        config=config,
    )


def _counted(record: Record) -> NDArray[np.bool_]:
    # The first quarter second: the filters settle.
    return np.asarray(record.signals.time[record.nodes] > 0.25)


def _friction_rms(estimates: Estimates, record: Record) -> float:
    return _rms((estimates.friction_N - record.friction)[_counted(record)])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _binomial(probability: float, runs: int) -> float:
    return float(np.sqrt(probability * (1.0 - probability) / runs))


def _positive(rng: np.random.Generator, sigma: float, count: int) -> Array:
    """1 + sigma N(0, 1), drawn again where a stiffness would be negative."""
    while True:
        theta = 1.0 + sigma * rng.standard_normal(count)
        if np.all(theta > 0.05):
            return theta


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


# --- speed ---------------------------------------------------------------------------------------------------------


def speed_study(samples: int) -> Table:
    """Force error of the emitted integrators over moves to growing speed, against a converged solution."""
    machine = load_machine("etel_xy")
    shape = np.concatenate([np.linspace(0.0, 1.0, samples), np.ones(samples), np.linspace(1.0, 0.0, samples)])
    shape = np.concatenate([[0.0], shape, np.zeros(samples // 3), -shape])
    flat = np.zeros(len(shape))
    forces: dict[str, list[Array]] = {}
    samplings: dict[str, dict[str, Any]] = {
        "converged": {"integrator": {"scheme": "rk4", "substeps": 400, "displacement": 0.01}},
        "flow": {"integrator": {"scheme": "flow"}},
        "rk4": {"integrator": {"scheme": "rk4"}},
        "bs23": {"integrator": {"scheme": "bs23"}},
        "rk2": {"integrator": {"scheme": "rk2"}},
        "euler": {"integrator": {"scheme": "euler"}},
        # A machine that says it never moves fast gets no more steps than that needs.
        "rk4, one step per sample": {"integrator": {"scheme": "rk4", "displacement": 10.0}, "max_velocity": 0.01},
    }
    for name, sampling in samplings.items():
        model = CompiledModel(override_machine(machine, {"sampling": sampling}))
        forces[name] = [
            model.predict(Signals(flat, flat, peak * shape, flat, flat, flat, flat == 0.0, flat != 0.0)).friction_N
            for peak in SPEEDS
        ]
    columns = [f"{peak:g} m/s" for peak in SPEEDS]
    rows: list[dict[str, Any]] = []
    for name, force in forces.items():
        errors = [float(np.abs(f - c).max()) for f, c in zip(force, forces["converged"], strict=True)]
        if name != "converged":
            rows.append({"integrator": name} | dict(zip(columns, errors, strict=True)))
    return Table(
        "largest force error [N] over a move there and back, etel_xy",
        {"integrator": ""} | dict.fromkeys(columns, ".1e"),
        rows,
        ("against rk4 with steps of at most 0.01 of the smallest deflection scale",),
    )


SPEEDS: Final = (0.002, 0.02, 0.1, 0.3, 1.0)

STUDIES: Final[Mapping[str, tuple[Callable[[int, int], Table], int, int]]] = {
    "coverage": (coverage_study, 900, 400),
    "monte-carlo": (lambda runs, updates: monte_carlo_study(runs, updates / 100.0), 100, 400),
    "plant": (lambda runs, updates: plant_study(runs, updates / 100.0), 20, 2000),
    "creep": (lambda runs, updates: creep_study(updates), 1, 100_000),
    "relinearise": (lambda runs, updates: relinearise_study(runs, updates / 100.0), 10, 800),
    "speed": (lambda runs, updates: speed_study(updates), 1, 150),
}
"""Studies by name, with their numbers of runs and updates."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one study and print its table."""
    parser = argparse.ArgumentParser(prog="python -m sgms_mhe.evaluation.studies", description=__doc__.splitlines()[0])
    parser.add_argument("name", choices=[*STUDIES], help="which study")
    parser.add_argument("--runs", type=int, help="seeds or draws")
    parser.add_argument("--updates", type=int, help="updates per run (of 10 ms)")
    chosen = parser.parse_args(arguments)
    study, runs, updates = STUDIES[chosen.name]
    sys.stdout.write(f"{study(chosen.runs or runs, chosen.updates or updates)}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
