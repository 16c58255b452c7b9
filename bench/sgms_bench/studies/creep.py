"""Parameters followed over 10^5 updates: whether they creep, and to where."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.experiment.running import PAPER_WEIGHTS
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]


CREEP_TRUTH: Final = (1.15, 0.9, 1.1, 0.97)


@dataclass(frozen=True)
class Formulation:
    """One way to weigh the parameters' memory."""

    name: str
    changes: Mapping[str, Any]


FORMULATIONS: Final[tuple[Formulation, ...]] = (
    Formulation("paper: fixed, deflection, 0.1", PAPER_WEIGHTS | {"bounds": {"stiffness": [0.2, 5.0]}}),
    Formulation("riccati alone", {"noise": {"state": 0.1, "measurement": 0.5, "state_as": "deflection"}}),
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


def creep_study(updates: int, compared: int = 4000) -> CsvTable:
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
    return CsvTable(
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
