"""Random axes in closed loop: what the machine file says, how the true axis is drawn, and what is counted of it."""

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgms_bench.records import Record, simulate_record
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.signals.estimates import Estimates

Array = NDArray[np.float64]


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


def weight_changes(stiffness_bounds: tuple[float, float] | None = None, **noise: Any) -> dict[str, Any]:
    """Changes of a machine file: entries of its noise, and bounds of the stiffness over nominal."""
    bounds = {} if stiffness_bounds is None else {"bounds": {"stiffness": list(stiffness_bounds)}}
    return {"estimator": {"noise": noise, **bounds}}


def thirty_percent(rng: np.random.Generator) -> Array:
    """Every element 30 % softer or stiffer than nominal."""
    return rng.choice([0.7, 1.3], 4)


def simulate_case(machine: Machine, case: Case, seed: int, duration_s: float) -> Record:
    """One of the case's axes in closed loop, as estimators see it."""
    rng = np.random.default_rng([seed, 2])
    config = AxisConfig(force_noise_N=case.force_noise_N, seed=seed)
    return simulate_record(
        machine, case.stiffness(rng).tolist(), trajectory=case.trajectory, duration_s=duration_s, config=config
    )


def counted_updates(record: Record) -> NDArray[np.bool_]:
    """Return the updates that count (u)."""
    # The first quarter second: the filters settle.
    return np.asarray(record.signals.time[record.nodes] > 0.25)


def friction_error(estimates: Estimates, record: Record) -> float:
    """RMS of estimated minus true friction over the updates that count [N]."""
    return rms((estimates.friction_N - record.friction)[counted_updates(record)])


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def say(text: str) -> None:
    """Tell how far a study has come."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def done_of(what: str) -> Callable[[int, int], None]:
    """Return a reporter of (parts done, parts in all) with the time that the rest may take."""
    started = time.monotonic()

    def tell(done: int, total: int) -> None:
        left = (time.monotonic() - started) * (total - done) / done
        say(f"{what}: {done} of {total}, {left:.0f} s left")

    return tell


def positive(rng: np.random.Generator, sigma: float, count: int) -> Array:
    """1 + sigma N(0, 1), drawn again where a stiffness would be negative."""
    while True:
        theta = 1.0 + sigma * rng.standard_normal(count)
        if np.all(theta > 0.05):
            return theta
