"""Refit of a machine's numbers in the norm of its motion: the positions the measured force alone makes.

Output error, beside the equation error of all other fits: both are norms of one score, each over its own noise. From
short shots (multiple shooting, from which every run comes back) to free runs of whole stretches.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Final, Literal, get_args

import numpy as np
from scipy.optimize import least_squares

from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.free_run import FIRST, FreeRunRecord, ShotStart
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.parallel import run_parallel
from sgms_mhe.support.statements import Rule, Statement

Objective = Literal["force", "motion", "both"]
Shots = list[tuple[int, int]]
Starts = list[list[ShotStart]]

STEP: Final = 0.1
"""Of a number: unit of its coordinate [its value]."""
RIDGE: Final = 0.03
"""Residual of a coordinate of 1 over the noise: numbers that the motion does not tell apart stay near the file's."""
DIFFERENCE: Final = 1e-3
"""Of a coordinate: half of a central difference."""
PIECES: Final = 16
"""Shots that a record is cut into, before it is run whole; they are the blocks of the deviations too."""
FITS: Final = 2
"""Fits at most, each with starts that the one before says."""
SETTLED: Final = 1e-3
AWAY: Final = 1e3
"""Residual over the noise, at most: of a run that went away."""


def check_objective(command: str, objective: str) -> None:
    """Raise InputError for a norm that there is not."""
    if objective not in get_args(Objective):
        raise InputError(command, "objective", objective, f"one of {', '.join(get_args(Objective))}")


@dataclass(frozen=True)
class Refit:
    """Numbers of a machine in another norm.

    Attributes:
        values: by name, SI.
        std: deviation of each, of the spread between pieces of the records.
        motion: RMS error of free runs with them [m], and with the numbers before.
        force: RMS error of the force with them [N], and with the numbers before.
    """

    values: Mapping[str, float]
    std: Mapping[str, float]
    motion: tuple[float, float]
    force: tuple[float, float]

    def state(self, unit: str) -> Statement:
        """Return the statement on it; `unit`: of the position."""
        moved, before = self.motion
        return Statement(Rule.REFITTED_MOTION, "file", moved, None, unit, {"before": before})


def list_sizes(machine: Machine) -> dict[str, float]:
    """Return the numbers a free run sees, with the unit of their coordinate.

    Mass, level, damping and the sizes of effects; no elements, which it sees at reversals alone, nothing of the log.
    """
    friction, scales = machine.friction, scales_of(machine)
    base = {"mass": machine.plant.moved, "coulomb": friction.coulomb, "viscous": friction.viscous}
    sizes = {name: STEP * value for name, value in base.items() if value}
    if friction.stribeck_ratio:
        sizes["stribeck_ratio"] = STEP
    for effect in machine.effects:
        definition = effect_definition(effect.name)
        if definition.learned or definition.adds_mass or definition.stage in ("signal", "log", "actuator"):
            continue
        for name in definition.entries(effect.parameters):
            parameter = definition.parameter(name)
            if parameter.is_size and parameter.main and parameter.proportional and not parameter.frozen:
                sizes[f"{effect.label}.{name}"] = parameter.scale * scales.of(parameter.unit)
    return sizes


class _NormedResiduals:
    """Residuals of a machine's numbers in both norms along its records."""

    def __init__(self, machine: Machine, logs: Sequence[Log], fixed: Collection[str]) -> None:
        self.machine = machine
        self.records = [FreeRunRecord(machine, log) for log in logs]
        sizes = {name: unit for name, unit in list_sizes(machine).items() if name not in fixed}
        self.names, self.unit = list(sizes), np.array(list(sizes.values()))
        axis = self.records[0].axis(machine)
        self.nominal = np.array([axis.number(name) for name in self.names])
        limits = np.array([axis.limits(name) for name in self.names]).reshape(-1, 2).T
        self.lower, self.upper = (limits - self.nominal) / self.unit + np.array([[DIFFERENCE], [-DIFFERENCE]]) * 2.0

    def numbers(self, x: Array) -> dict[str, float]:
        """Return numbers by name, SI, of coordinates."""
        return dict(zip(self.names, (self.nominal + self.unit * x).tolist(), strict=True))

    def cut(self, pieces: int) -> list[Shots]:
        """Cut every record into so many shots, of stretches of the same length."""
        shots = []
        for record in self.records:
            length = max(3 * FIRST, sum(b - a for a, b in record.stretches) // pieces)
            edges = [np.linspace(a, b, 1 + max(1, (b - a) // length)).astype(int).tolist() for a, b in record.stretches]
            shots.append([pair for edge in edges for pair in pairwise(edge)])
        return shots

    def find_starts(self, x: Array, cut: list[Shots]) -> Starts:
        """Return the starts of all shots with these numbers."""
        numbers = self.numbers(x)
        return [r.run(r.axis(self.machine, numbers), s)[1] for r, s in zip(self.records, cut, strict=True)]

    def motion(self, x: Array, cut: list[Shots], starts: Starts) -> list[Array]:
        """Return errors of position (n) [m] of every shot, infinite from where a run went away."""
        numbers, errors = self.numbers(x), []
        for record, shots, begun in zip(self.records, cut, starts, strict=True):
            runs, _ = record.run(record.axis(self.machine, numbers), shots, begun)
            errors += [
                run[FIRST::e] - record.position[a + FIRST : b : e]
                for run, (a, b, e) in zip(runs, record.rows(shots), strict=True)
            ]
        return [np.nan_to_num(error, nan=math.inf) for error in errors]

    def force(self, x: Array, cut: list[Shots]) -> list[Array]:
        """Return errors of the force (n) [N] at the same samples."""
        numbers, errors = self.numbers(x), []
        for record, shots in zip(self.records, cut, strict=True):
            residual = record.force_residual(record.axis(self.machine, numbers))
            errors += [residual[a + FIRST : b : e] for a, b, e in record.rows(shots)]
        return errors

    def blocks(self, cut: list[Shots], starts: Starts, noise: tuple[float, float], x: Array) -> list[Array]:
        """Return the residual of every shot, positions and forces over their noise [m, N]; 0 N: no forces."""
        motion = [np.clip(error / noise[0], -AWAY, AWAY) for error in self.motion(x, cut, starts)]
        if noise[1]:
            pairs = zip(motion, self.force(x, cut), strict=True)
            motion = [np.append(moved, pushed / noise[1]) for moved, pushed in pairs]
        return [block / math.sqrt(sum(map(len, motion))) for block in motion]


def _rms(errors: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def refit_motion(machine: Machine, logs: Sequence[Log], objective: Objective, fixed: Collection[str] = ()) -> Refit:
    """Fit the numbers that a free run sees to the motion, or to both norms, each over the noise that it has at best.

    Args:
        machine: from whose numbers the fit starts.
        logs: of the axis.
        objective: motion or both.
        fixed: numbers that stay.

    Raises:
        InputError: a log no free run can take.
    """
    score = _NormedResiduals(machine, logs, fixed)
    whole, nominal = score.cut(1), np.zeros(len(score.names))

    def error(x: Array) -> float:
        return _rms(score.motion(x, whole, score.find_starts(x, whole)))

    force = _rms(score.force(nominal, whole))
    x, std = _fit(score, score.cut(PIECES), nominal, 0.0)
    x = min((nominal, x, _fit(score, whole, x, 0.0)[0]), key=error)
    if objective == "both":
        motion = error(x)

        def both(x: Array) -> float:
            return (error(x) / motion) ** 2 + (_rms(score.force(x, whole)) / force) ** 2

        x = min((x, _fit(score, whole, x, force)[0]), key=both)
    deviations = dict(zip(score.names, (score.unit * std).tolist(), strict=True))
    return Refit(score.numbers(x), deviations, (error(x), error(nominal)), (_rms(score.force(x, whole)), force))


def _fit(score: _NormedResiduals, cut: list[Shots], x: Array, force: float) -> tuple[Array, Array]:
    """Return coordinates of the least squares along shots, and their deviations by the spread between shots.

    `force`: RMS [N] that the force's error counts over; 0: it does not count. Starts are those of the numbers before.
    """
    for _ in range(FITS):
        starts, before = score.find_starts(x, cut), x
        finite = [np.clip(error, -1.0, 1.0) for error in score.motion(x, cut, starts)]
        blocks = partial(score.blocks, cut, starts, (_rms(finite), force))

        def residual(x: Array, blocks: Callable[[Array], list[Array]] = blocks) -> Array:
            return np.concatenate((*blocks(x), RIDGE * x))

        def jacobian(x: Array, residual: Callable[[Array], Array] = residual) -> Array:
            ends = [x + step for step in DIFFERENCE * np.vstack((np.eye(len(x)), -np.eye(len(x))))]
            ahead = np.array(run_parallel([partial(residual, end) for end in ends])).T
            return np.asarray((ahead[:, : len(x)] - ahead[:, len(x) :]) / (2.0 * DIFFERENCE))

        found = least_squares(residual, x, jacobian, (score.lower, score.upper), ftol=1e-5, xtol=1e-5, max_nfev=20)
        x = found.x
        if np.max(np.abs(x - before), initial=0.0) < SETTLED:
            break
    edges = np.cumsum([len(block) for block in blocks(x)])[:-1]
    parts = zip(np.split(found.jac[: -len(x)], edges), np.split(found.fun[: -len(x)], edges), strict=True)
    gradients = np.array([jac.T @ rest for jac, rest in parts])
    spread = gradients @ np.linalg.inv(found.jac.T @ found.jac)
    return x, np.sqrt(np.sum(spread**2, axis=0))
