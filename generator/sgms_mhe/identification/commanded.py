"""Identification of a commanded axis: the motion that its commands alone make, over several runs at once.

No force was recorded, so the fit is one of output error. Loads that the runs state tell inertia and torque apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from sgms_mhe.configuration import G_N, carry_load, make_machine
from sgms_mhe.identification.result import Number
from sgms_mhe.identification.writing import check_toml, machine_toml
from sgms_mhe.machine import Machine, plant_content
from sgms_mhe.model.effects import GEAR_FRICTION, WEIGHT
from sgms_mhe.recordings.free_run import MotionRecord, ShotStart
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.json_values import finite
from sgms_mhe.support.notebooks import Presentation, Shown
from sgms_mhe.support.numbers import SIGMAS, round_number
from sgms_mhe.support.parallel import run_parallel
from sgms_mhe.support.statements import Rule

FEW: Final = 16
"""Runs, spread over all, that the first fits take."""
INERTIAS: Final = (0.3, 1.0, 3.0)
"""Of the mean load's: inertias of the drive that are started from."""
OUTLYING: Final = (0.05, 0.005)
"""Errors over the extent of the motion from which on they count by their size alone, of the first fits and the last."""
DIFFERENCE: Final = 2e-2
"""Of a number's unit: step of a difference; a delay moves the commands by whole steps of the integration."""
LEAST: Final = 1e-3
"""Of its unit: the least value of a number that has to be positive."""
RADIUS: Final = "weight_radius"
LOAD: Final = f"{GEAR_FRICTION}.ratio"
ARM: Final = f"{WEIGHT}.amplitude_N"
_MOTOR: Final = ("torque_constant", "resistance", "gain_unit", "speed_limit")
_POSITIVE: Final = ("mass", "coulomb", *(f"drive.{key}" for key in _MOTOR))


@dataclass(frozen=True, repr=False)
class CommandedAxis(Shown):
    """A commanded axis from its runs.

    Attributes:
        machine: as it is written.
        toml: its file.
        numbers: with deviations by the spread between runs.
        mae, rms: errors of the free run along each log, of the file, all samples [m].
        sources: the logs.
    """

    machine: Machine
    toml: str
    numbers: tuple[Number, ...]
    mae: tuple[float, ...]
    rms: tuple[float, ...]
    sources: tuple[str, ...]

    def _shown(self) -> Presentation:
        names = self.machine.plant.units.named
        rows = [(names(number.name), number.interval, number.note) for number in self.numbers]
        return f"{self.machine.name}: {self.describe()}", ("number", "value +- 2 sigma", ""), rows

    def describe(self) -> str:
        """Return the errors in words."""
        unit, count = self.machine.plant.units.position, len(self.mae)
        mean, worst = f"{np.mean(self.mae):.4g} {unit}", f"{max(self.mae):.4g} {unit}"
        return f"free run from the command alone: {mean} mean absolute error over {count} runs, at most {worst}"

    def to_json(self) -> dict[str, Any]:
        """Plain data; None where a number has no deviation."""
        units = self.machine.plant.units
        runs = zip(self.sources, self.mae, self.rms, strict=True)
        content = {
            "machine": self.machine.name,
            "numbers": [number.to_json(units) for number in self.numbers],
            "statements": [number.state(units).to_json() for number in self.numbers],
            "free_run": [{"log": log, "mae": mae, "rms": rms, "unit": units.position} for log, mae, rms in runs],
        }
        found: dict[str, Any] = finite(content)
        return found


def identify_commanded(logs: Sequence[Log], name: str, like: Machine | None) -> CommandedAxis:
    """Fit drive, inertia and friction of a commanded axis to the motion of its runs.

    Args:
        logs: without a force, each with the load that it states, or the one of `like`.
        name: of the machine.
        like: machine with a [drive]; its torque_constant and resistance stay. Without one the logs are runs that state
            load, gain and supply, and the clamp is 1: without the torque constant nothing tells it apart.

    Raises:
        InputError: neither a drive nor what makes one.
    """
    source = logs[0].source or "log"
    if like is None and not all(log.run and log.goal_m is not None and log.kind == "rotary" for log in logs):
        allowed = "a machine with a [drive] (--like), or runs that state load, gain and supply, as BAM's do"
        raise InputError(source, "column " + logs[0].units.named("force_N"), None, allowed)
    if like is not None and like.drive.kind == "force":
        raise InputError(source, "like", like.name, "a machine whose [drive] says what the command does")
    begin = _FreeRuns(logs, _begin(logs, name) if like is None else _extend(like, name, logs), like is not None)
    spread = np.unique(np.linspace(0, len(logs) - 1, min(FEW, len(logs))).round().astype(int))
    few = begin.part(spread.tolist())
    inertia = begin.machine.plant.moved if like is None else 0.0
    starts = [{"mass": factor * inertia} for factor in INERTIAS] if inertia else [{}]
    tried = [few.fit(few.start(start), 15, OUTLYING[0]) for start in starts]
    best = min(tried, key=lambda found: float(found.cost))
    found = begin.fit(begin.fit(best.x, 8, OUTLYING[0]).x, 40, OUTLYING[1])
    return _write(begin, found, name)


def _begin(logs: Sequence[Log], name: str) -> Machine:
    """Return a servo with numbers of the order of those of its runs."""
    speed = float(np.mean([np.percentile(np.abs(np.diff(log.position_m)) * log.rate, 99.0) for log in logs]))
    loads = [log.run["mass"] * log.run["length"] for log in logs]
    length = float(np.mean([log.run["length"] for log in logs]))
    gravity, inertia = G_N * max(loads), float(np.mean(loads)) * length
    supply, extent = logs[0].run["supply"], max(float(np.ptp(log.position_m)) for log in logs)
    torque, rate = 5.0 * gravity, float(f"{np.mean([log.rate for log in logs]):.3g}")
    constant = supply / (1.2 * speed)
    # At rest the loop's error carries the load.
    error = np.concatenate([log.run["gain"] * (log.goal_m - log.position_m) for log in logs if log.goal_m is not None])
    held = np.concatenate([G_N * load * np.sin(log.position_m) for load, log in zip(loads, logs, strict=True)])
    moving = np.concatenate([np.abs(np.gradient(log.position_m)) * log.rate for log in logs]) > 0.05 * speed
    error, held = error[~moving], held[~moving]
    slope = float(np.sum(np.abs(held)) / max(np.sum(np.abs(error)), 1e-9))
    coulomb = 0.05 * gravity
    content = {
        "name": name,
        "description": "identified from commands and motion",
        "plant": {**plant_content("rotary", inertia), "weight_radius": 0.3 * length},
        "friction": {
            "law": "switching",
            "stiffness": [float(f"{coulomb / (2e-4 * extent):.2g}")],
            "fraction": [1.0],
            "viscous": 0.0,
            "coulomb": coulomb,
        },
        "sampling": {
            "rate": rate,
            "update_rate": rate / 10.0,
            "velocity_cutoff": 0.2 * rate,
            "max_velocity": float(f"{3.0 * speed:.2g}"),
        },
        "drive": {
            "kind": "position_loop",
            "torque_constant": constant,
            "resistance": supply * constant / torque,
            "supply": supply,
            "gain": logs[0].run["gain"],
            "gain_unit": slope / torque,
            "clamp": 1.0,
            "delay": 2.0 / rate,
            "speed_limit": 0.9 * speed,
        },
        "effects": _effects((), runs=True),
    }
    return make_machine(content, Path(f"{name}.toml"))


def _effects(own: Sequence[Mapping[str, Any]], *, runs: bool) -> list[Mapping[str, Any]]:
    """Return effects with friction that grows with the load, and what an arm adds to the weight that runs state."""
    names = {effect["name"] for effect in own}
    added = [{"name": GEAR_FRICTION, "ratio": 0.2, "friction_ratio": 1.0}] if GEAR_FRICTION not in names else []
    if runs and WEIGHT not in names:
        added.append({"name": WEIGHT, "amplitude_Nm": 0.0, "phase_rad": 0.0})
    return [*own, *added]


def _extend(like: Machine, name: str, logs: Sequence[Log]) -> Machine:
    """Return a machine under another name, with the effects that a fit looks for."""
    effects = like.content.get("effects", ())
    if like.plant.kind == "rotary":
        effects = _effects(effects, runs=any(log.run for log in logs))
    return make_machine({**like.content, "name": name, "effects": list(effects)}, like.source)


class _FreeRuns:
    """Errors of free runs over the numbers of a machine, in units of each."""

    def __init__(self, logs: Sequence[Log], machine: Machine, is_known: bool) -> None:
        self.logs, self.machine = logs, machine
        loaded = [carry_load(machine, log.run) for log in logs]
        self.records = [MotionRecord(m, log) for m, log in zip(loaded, logs, strict=True)]
        self.axes = [record.axis(m) for record, m in zip(self.records, loaded, strict=True)]
        self.starts: list[list[ShotStart]] = []
        axis, keys = self.axes[0], machine.drive.model_dump(exclude={"kind", "gain"}, exclude_none=True)
        fixed = {"supply", "torque_constant", "resistance"} if is_known else {"supply", "clamp"}
        own = [f"drive.{key}" for key in keys if key not in fixed]
        effects = [LOAD, *([ARM] if logs[0].run else [])] if machine.plant.kind == "rotary" else []
        radius = [RADIUS] if machine.plant.weight_radius is not None else []
        numbers = ["mass", *radius, "coulomb", "viscous", *own, *effects]
        self.names = numbers
        plant = {"mass": machine.plant.moved, RADIUS: machine.plant.weight_radius or 0.0}
        self.nominal = np.array([plant[name] if name in plant else axis.number(name) for name in numbers])
        force = machine.friction.coulomb
        small = {"viscous": 0.1 * force, "drive.delay": 0.01, LOAD: 0.1, ARM: force, RADIUS: 0.05}
        self.unit = np.array([small.get(n, abs(v) or 1.0) for n, v in zip(numbers, self.nominal, strict=True)])
        limits = np.array([(0.0, 10.0) if name == RADIUS else axis.limits(name) for name in numbers]).T
        if "drive.speed_limit" in numbers:  # beyond the speeds that were seen it does nothing
            k = numbers.index("drive.speed_limit")
            limits[1, k] = 2.0 * self.nominal[k]
        least = [LEAST * unit if n in _POSITIVE else -math.inf for n, unit in zip(numbers, self.unit, strict=True)]
        self.bounds = np.maximum(limits[0], least) / self.unit, limits[1] / self.unit
        self.extent = max(record.extent for record in self.records)

    def part(self, which: Sequence[int]) -> _FreeRuns:
        """Return the problem of some runs."""
        other = object.__new__(_FreeRuns)
        other.__dict__.update(vars(self))
        other.logs = [self.logs[k] for k in which]
        other.records, other.axes = [self.records[k] for k in which], [self.axes[k] for k in which]
        return other

    def start(self, values: Mapping[str, float]) -> Array:
        """Return the coordinates of the machine with other values."""
        named = zip(self.names, self.nominal, strict=True)
        return np.asarray(np.array([values.get(name, value) for name, value in named]) / self.unit)

    def _run(self, k: int, x: Array, starts: Sequence[ShotStart]) -> tuple[Array, list[ShotStart]]:
        record, axis = self.records[k], self.axes[k]
        values = dict(zip(self.names, (self.unit * x).tolist(), strict=True))
        radius, run = values.pop(RADIUS, 0.0), self.logs[k].run
        for name, value in values.items():
            load = run["mass"] * (run["length"] ** 2 + radius**2) if run and name == "mass" else 0.0
            axis.replace(name, value + load)
        axis.place(float(record.position[record.stretches[0][0]]))
        runs, taken = record.run(axis, record.stretches, starts)
        parts = zip(runs, record.stretches, strict=True)
        error = np.concatenate([run - record.position[a:b] for run, (a, b) in parts])
        return np.nan_to_num(error, nan=self.extent), taken

    def errors(self, x: Array) -> list[Array]:
        """Return the error of every run (n) [m]."""
        many = range(len(self.records))
        return [error for error, _ in run_parallel([partial(self._run, k, x, self.starts[k]) for k in many])]

    def begin(self, x: Array) -> None:
        """Take the starts of all runs with these coordinates."""
        self.starts = [s for _, s in run_parallel([partial(self._run, k, x, ()) for k in range(len(self.records))])]

    def fit(self, x: Array, most: int, outlying: float) -> Any:
        """Return the least squares from these coordinates, with the starts that they say."""
        x = np.clip(x, self.bounds[0] + 1e-9, self.bounds[1] - 1e-9)
        self.begin(x)

        def residual(at: Array) -> Array:
            return np.concatenate(self.errors(at)) / self.extent

        def jacobian(at: Array) -> Array:
            here, upper = residual(at), self.bounds[1]
            steps = np.where(at + DIFFERENCE < upper, DIFFERENCE, -DIFFERENCE)
            return np.array([(residual(at + row) - here) / row.sum() for row in np.diag(steps)]).T

        return least_squares(
            residual, x, jacobian, bounds=self.bounds, loss="soft_l1", f_scale=outlying, ftol=1e-5, max_nfev=most
        )

    def spread(self, found: Any) -> Array:
        """Return the deviation of every number by the spread of its gradient between runs."""
        edges = np.cumsum([sum(b - a for a, b in record.stretches) for record in self.records])[:-1]
        weight = 1.0 / np.sqrt(1.0 + (found.fun / OUTLYING[1]) ** 2)
        parts = zip(np.split(found.jac, edges), np.split(found.fun * np.sqrt(weight), edges), strict=True)
        gradients = np.array([jac.T @ rest for jac, rest in parts])
        spread = gradients @ np.linalg.pinv(found.jac.T @ found.jac)
        runs = len(gradients)
        return np.asarray(self.unit * np.sqrt(np.sum(spread**2, axis=0) * runs / max(runs - 1, 1)))


def _state(name: str, value: float, std: float, is_at_limit: bool) -> Number:
    if is_at_limit:
        return Number(name, value, math.nan, Rule.AT_LIMIT)
    return Number(name, value, std, Rule.DETERMINED if SIGMAS * std < abs(value) else Rule.VAGUE)


def _write(problem: _FreeRuns, found: Any, name: str) -> CommandedAxis:
    """Return the machine with what was found, and its errors as `predict` has them."""
    machine, units = problem.machine, problem.machine.plant.units
    at_limit = np.minimum(found.x - problem.bounds[0], problem.bounds[1] - found.x) < DIFFERENCE
    rows = zip(problem.names, found.x * problem.unit, problem.spread(found), at_limit, strict=True)
    numbers = tuple(_state(n, float(value), float(std), edge) for n, value, std, edge in rows)
    value = {n.name: round_number(n.value, n.std) for n in numbers}
    content = {**machine.content, "plant": {**machine.content["plant"], **plant_content(units.kind, value["mass"])}}
    if RADIUS in value:
        content["plant"][RADIUS] = value[RADIUS]
    content["friction"] = {**content["friction"], **{key: value[key] for key in ("coulomb", "viscous")}}
    drive = {key.removeprefix("drive."): number for key, number in value.items() if key.startswith("drive.")}
    content["drive"] = {**content["drive"], **drive}
    own = {LOAD: "ratio", ARM: "amplitude_Nm"}
    content["effects"] = [
        {**effect, **{key: value[n] for n, key in own.items() if n in value and n.startswith(f"{effect['name']}.")}}
        for effect in content["effects"]
    ]
    head = [
        f"{name}: identified by the motion that the command alone makes, over {len(problem.logs)} runs; beside "
        "numbers: intervals of two standard deviations by the spread between runs. supply is stated; play was not "
        "looked for."
    ]
    toml = machine_toml(units, content, numbers, head)
    machine = check_toml(toml, content, Path(f"{name}.toml"))
    errors = _FreeRuns(problem.logs, machine, is_known=False)
    errors.begin(errors.nominal / errors.unit)
    runs = errors.errors(errors.nominal / errors.unit)
    return CommandedAxis(
        machine,
        toml,
        numbers,
        tuple(float(np.mean(np.abs(run))) for run in runs),
        tuple(float(np.sqrt(np.mean(run**2))) for run in runs),
        tuple(log.source for log in problem.logs),
    )
