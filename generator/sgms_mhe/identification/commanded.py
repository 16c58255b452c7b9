"""Identification of a commanded axis: the motion its commands alone make, over several runs at once.

No force was recorded, so the fit is one of output error. Loads the runs state tell inertia and torque apart.
"""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from sgms_mhe.configuration import G_N, carry_load, make_machine
from sgms_mhe.identification.result import Identification, Number
from sgms_mhe.identification.search import Progress
from sgms_mhe.identification.writing import check_toml, machine_toml
from sgms_mhe.machine import Machine, merge_tables, plant_content
from sgms_mhe.model.effects import GEAR_FRICTION, PLAY
from sgms_mhe.recordings.free_run import COMMANDED_STEP_S, FreeRunRecord, ShotStart
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.numbers import SIGMAS, round_number
from sgms_mhe.support.parallel import run_parallel
from sgms_mhe.support.statements import Rule, Statement, list_open

FEW: Final = 16
"""Runs, spread over all, that the first fits take."""
INERTIAS: Final = (0.3, 1.0, 3.0)
"""Of the mean load's: inertias of the drive that are started from."""
CLAMPS: Final = (0.4, 0.7, 1.0)
"""Clamps that are started from where the torque constant is known: from one that is too high nothing leads down."""
PARTS: Final = 16
OUTLYING: Final = (0.05, 0.005)
"""Errors over the extent of the motion from which on they count by their size alone, of the first fits and the last."""
DIFFERENCE: Final = 2e-2
"""Of a number's unit: step of a difference; a delay moves the commands by whole steps of the integration."""
LEAST: Final = 1e-3
"""Of its unit: the least value of a number that has to be positive."""
STIFFNESS: Final = "stiffness_1"
PLAYS: Final = (0.5e-3, 1e-3, 2e-3, 4e-3)
"""Of the extent of the motion: widths of play that are tried."""
RADIUS: Final = "weight_radius"
"""Its square is the number that is fitted."""
LOAD: Final = f"{GEAR_FRICTION}.ratio"
SHARE: Final = f"{GEAR_FRICTION}.friction_ratio"
"""Share of inertial torque and friction that the teeth transmit, one number."""
GEAR: Final = {"name": GEAR_FRICTION, "ratio": 0.2, "inertia_ratio": 0.5, "friction_ratio": 0.5}
_MOTOR: Final = ("torque_constant", "resistance", "gain_unit", "speed_limit")
_POSITIVE: Final = ("mass", "coulomb", STIFFNESS, *(f"drive.{key}" for key in _MOTOR))


def identify_drive(logs: Sequence[Log], name: str, like: Machine | None, report: Progress) -> Identification:
    """Fit drive, inertia and friction of a commanded axis to the motion of its runs.

    Args:
        logs: without a force, each with the load it states, or the one of `like`.
        name: of the machine.
        like: machine with a [drive]; its torque_constant and resistance stay. Without one the logs are runs that state
            load, gain and supply, and the clamp is 1: without the torque constant nothing tells it apart.
        report: called with each step.

    Raises:
        InputError: neither a drive nor keys of one.
    """
    source = logs[0].source or "log"
    if like is None and not all(log.run and log.goal_m is not None and log.kind == "rotary" for log in logs):
        allowed = "a machine with a [drive] (--like), or runs that state load, gain and supply, as BAM's do"
        raise InputError(source, "column " + logs[0].units.named("force_N"), None, allowed)
    if like is not None and like.drive.kind == "force":
        raise InputError(source, "like", like.name, "a machine whose [drive] says what the command does")
    begin = _FreeRuns(logs, _begin(logs, name) if like is None else _extend(like, name), like is not None)
    spread = np.unique(np.linspace(0, len(logs) - 1, min(FEW, len(logs))).round().astype(int))
    few = begin.part(spread.tolist())
    inertias = [factor * begin.machine.plant.moved for factor in INERTIAS]
    starts = [{"mass": inertia} for inertia in inertias] if like is None else [{"drive.clamp": c} for c in CLAMPS]
    report(f"fits over {len(few.logs)} of {len(logs)} runs, from {len(starts)} starts")
    tried = [few.fit(few.fit(few.start(start), 20, OUTLYING[0]).x, 20, OUTLYING[1]) for start in starts]
    for start, fitted in zip(starts, tried, strict=True):
        found_at = {"cost": float(fitted.cost), "at": few.name_values(fitted.x)}
        log_decision("commanded", "least error from a start", start=start, **found_at)
    best = min(tried, key=lambda found: float(found.cost))
    report(f"fit over {len(logs)} runs")
    found = begin.fit(best.x, 40, OUTLYING[1])
    report("play")
    return _write(begin, found, name, _look_for_play(few, found.x))


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
    stiffness, most = (float(f"{number:.2g}") for number in (coulomb / (2e-4 * extent), 3.0 * speed))
    friction = {"law": "switching", "stiffness": [stiffness], "fraction": [1.0], "viscous": 0.0, "coulomb": coulomb}
    content = {
        "name": name,
        "description": "identified from commands and motion",
        "plant": {**plant_content("rotary", inertia), "weight_radius": 0.0},
        "friction": friction,
        "sampling": {"rate": rate, "update_rate": rate / 10.0, "velocity_cutoff": 0.2 * rate, "max_velocity": most},
        "drive": {
            "kind": "position_loop",
            "torque_constant": constant,
            "resistance": supply * constant / torque,
            "supply": supply,
            "gain": logs[0].run["gain"],
            "gain_unit": slope / torque,
            "start": 0.01,
            "clamp": 1.0,
            "delay": 2.0 / rate,
            "speed_limit": 0.9 * speed,
        },
        "effects": [GEAR],
    }
    return make_machine(content, Path(f"{name}.toml"))


def _extend(like: Machine, name: str) -> Machine:
    """Return a machine under another name, with friction that grows with the load of a gear."""
    effects = list(like.content.get("effects", ()))
    if like.plant.kind == "rotary" and all(effect["name"] != GEAR_FRICTION for effect in effects):
        effects.append(GEAR)
    return make_machine({**like.content, "name": name, "effects": effects}, like.source)


class _FreeRuns:
    """Errors of free runs over the numbers of a machine, in units of each."""

    def __init__(self, logs: Sequence[Log], machine: Machine, is_known: bool) -> None:
        self.logs, self.machine, self.play = logs, machine, 0.0
        loaded = [carry_load(machine, log.run) for log in logs]
        self.records = [FreeRunRecord(m, log) for m, log in zip(loaded, logs, strict=True)]
        play = [(PLAY, {"gap_m": 0.0})]
        self.axes = [record.axis(m, hidden=play) for record, m in zip(self.records, loaded, strict=True)]
        self.starts: list[list[ShotStart]] = []
        axis, keys = self.axes[0], machine.drive.model_dump(exclude={"kind", "gain"}, exclude_none=True)
        fixed = {"supply", "torque_constant", "resistance"} if is_known else {"supply", "clamp"}
        own = [f"drive.{key}" for key in keys if key not in fixed]
        effects = [LOAD, SHARE] if machine.plant.kind == "rotary" else []
        radius = [RADIUS] if machine.plant.weight_radius is not None else []
        element = [STIFFNESS] if machine.friction.n_z == 1 else []
        self.names = numbers = ["mass", *radius, "coulomb", *element, "viscous", *own, *effects]
        plant = {"mass": machine.plant.moved, RADIUS: (machine.plant.weight_radius or 0.0) ** 2}
        self.nominal = np.array([plant[name] if name in plant else axis.number(name) for name in numbers])
        small = {"viscous": 0.1 * machine.friction.coulomb, LOAD: 0.1, SHARE: 0.5, RADIUS: 2e-3, "drive.start": 0.02}
        small["drive.delay"] = COMMANDED_STEP_S / DIFFERENCE
        self.unit = np.array([small.get(n, abs(v) or 1.0) for n, v in zip(numbers, self.nominal, strict=True)])
        limits = np.array([(0.0, 1.0) if name == RADIUS else axis.limits(name) for name in numbers]).T
        # Beyond the speeds that were seen, and within what the encoder resolves, they do nothing.
        for name, factor in (("drive.speed_limit", 2.0), (STIFFNESS, 1.0)):
            if name in numbers:
                limits[1, numbers.index(name)] = factor * self.nominal[numbers.index(name)]
        least = [LEAST * unit if n in _POSITIVE else -math.inf for n, unit in zip(numbers, self.unit, strict=True)]
        self.bounds = np.maximum(limits[0], least) / self.unit, limits[1] / self.unit
        self.extent = max(record.extent for record in self.records)

    def part(self, which: Sequence[int]) -> "_FreeRuns":
        """Return the problem of some runs."""
        other = copy(self)
        other.logs = [self.logs[k] for k in which]
        other.records, other.axes = [self.records[k] for k in which], [self.axes[k] for k in which]
        return other

    def start(self, values: Mapping[str, float]) -> Array:
        """Return the coordinates of the machine with other values."""
        named = zip(self.names, self.nominal, strict=True)
        return np.asarray(np.array([values.get(name, value) for name, value in named]) / self.unit)

    def name_values(self, x: Array) -> dict[str, float]:
        """Return numbers by name, SI, of coordinates."""
        return dict(zip(self.names, (self.unit * x).tolist(), strict=True))

    def _run(self, k: int, x: Array, starts: Sequence[ShotStart]) -> tuple[Array, list[ShotStart]]:
        record, axis = self.records[k], self.axes[k]
        values = self.name_values(x)
        square, run = values.pop(RADIUS, 0.0), self.logs[k].run
        if run:
            values["mass"] += run["mass"] * (run["length"] ** 2 + square)
        if SHARE in values:
            values[f"{GEAR_FRICTION}.inertia_ratio"] = values[SHARE]
        for name, value in {**values, f"{PLAY}.gap_m": self.play}.items():
            axis.replace(name, value)
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
        """Return the least squares from these coordinates, with the starts they say."""
        x = np.clip(x, self.bounds[0] + 1e-9, self.bounds[1] - 1e-9)
        self.begin(x)

        def residual(at: Array) -> Array:
            return np.concatenate(self.errors(at)) / self.extent

        def jacobian(at: Array) -> Array:
            here, upper = residual(at), self.bounds[1]
            steps = np.where(at + DIFFERENCE < upper, DIFFERENCE, -DIFFERENCE)
            return np.array([(residual(at + row) - here) / row.sum() for row in np.diag(steps)]).T

        fits = {"loss": "soft_l1", "f_scale": outlying, "ftol": 1e-5, "max_nfev": most, "x_scale": "jac"}
        return least_squares(residual, x, jacobian, bounds=self.bounds, **fits)

    def split_by_parts(self, values: Array) -> list[Array]:
        """Split values (n) of all samples by runs, few of them by parts of each: with or without repetition."""
        count = -(-PARTS // len(self.records))
        edges = np.cumsum([sum(b - a for a, b in record.stretches) for record in self.records])[:-1]
        return [part for run in np.split(values, edges) for part in np.array_split(run, count)]

    def spread(self, found: Any) -> Array:
        """Return the deviation of every number by the spread of its gradient between parts; a delay has steps."""
        weight = 1.0 / np.sqrt(1.0 + (found.fun / OUTLYING[1]) ** 2)
        parts = zip(self.split_by_parts(found.jac), self.split_by_parts(found.fun * np.sqrt(weight)), strict=True)
        gradients = np.array([jac.T @ rest for jac, rest in parts])
        spread = gradients @ np.linalg.pinv(found.jac.T @ found.jac)
        runs = len(gradients)
        step = np.where(np.array(self.names) == "drive.delay", COMMANDED_STEP_S / math.sqrt(12.0), 0.0)
        return np.asarray(np.hypot(step, self.unit * np.sqrt(np.sum(spread**2, axis=0) * runs / max(runs - 1, 1))))


def _look_for_play(problem: _FreeRuns, x: Array) -> Statement:
    """Fit once more with gaps of several widths, and compare the errors of every run with those without."""
    widths, costs = [0.0, *(share * problem.extent for share in PLAYS)], []
    for problem.play in widths:
        ratio = problem.fit(x, 4, OUTLYING[1]).fun / OUTLYING[1]
        costs.append([float(np.sum(np.sqrt(1.0 + run**2) - 1.0)) for run in problem.split_by_parts(ratio)])
    problem.play = 0.0
    floored = np.array(costs) + LEAST * np.mean(costs[0])
    gains = np.log(floored[0] / floored[1:])  # of each part alike: a few that fall freely cost most
    gain, spread = gains.mean(axis=1), SIGMAS * gains.std(axis=1) / math.sqrt(gains.shape[1])
    log_decision("commanded", "play", widths=widths[1:], gain=gain.tolist(), spread=spread.tolist())
    seen, refuted = np.flatnonzero(gain > spread), np.flatnonzero(gain < -spread)
    rule, at = Rule.PLAY_UNTOLD, len(PLAYS) - 1
    if len(seen):
        rule, at = Rule.PLAY, int(np.argmax(gain - spread))
    elif len(refuted) and len(refuted) == len(PLAYS) - refuted[0]:
        rule, at = Rule.NO_PLAY, int(refuted[0])
    said = {"percent": 100.0 * (math.exp(abs(gain[at])) - 1.0), "spread": 100.0 * spread[at]}
    return Statement(rule, PLAY, widths[1 + at], None, problem.machine.plant.units.position, said)


def _state(name: str, value: float, std: float, is_at_limit: bool) -> Number:
    if is_at_limit:
        return Number(name, math.sqrt(value) if name == RADIUS else value, math.nan, Rule.AT_LIMIT)
    if name == RADIUS:
        value, std = math.sqrt(value), std / (2.0 * math.sqrt(value))
    return Number(name, value, std, Rule.DETERMINED if SIGMAS * std < abs(value) else Rule.VAGUE)


def _write(problem: _FreeRuns, found: Any, name: str, play: Statement) -> Identification:
    """Return the machine with the identified numbers, and the error of its free runs."""
    machine, units = problem.machine, problem.machine.plant.units
    lower, upper = problem.bounds
    x = np.where(found.x - lower < DIFFERENCE, lower, np.where(upper - found.x < DIFFERENCE, upper, found.x))
    at_limit = (x == lower) | (x == upper)
    rows = zip(problem.names, x * problem.unit, problem.spread(found), at_limit, strict=True)
    numbers = tuple(_state(n, float(value), float(std), edge) for n, value, std, edge in rows)
    value = {n.name: round_number(n.value, n.std) for n in numbers}
    drive = {key.removeprefix("drive."): number for key, number in value.items() if key.startswith("drive.")}
    plant = plant_content(units.kind, value["mass"]) | ({RADIUS: value[RADIUS]} if RADIUS in value else {})
    friction: dict[str, Any] = {key: value[key] for key in ("coulomb", "viscous")}
    friction |= {"stiffness": [value[STIFFNESS]]} if STIFFNESS in value else {}
    content = merge_tables(machine.content, {"plant": plant, "friction": friction, "drive": drive})
    if LOAD in value:
        gear = {"ratio": value[LOAD], "inertia_ratio": value[SHARE], "friction_ratio": value[SHARE]}
        content["effects"] = [{**e, **(gear if e["name"] == GEAR_FRICTION else {})} for e in content["effects"]]
    at = problem.start({**value, RADIUS: value.get(RADIUS, 0.0) ** 2})
    problem.begin(at)
    errors = [float(np.mean(np.abs(run))) for run in problem.errors(at)]
    said = {"count": len(errors), "most": max(errors)}
    error = Statement(Rule.RAN, "free runs", float(np.mean(errors)), None, units.position, said)
    head = [
        f"Written by sgms-mhe identify over {len(errors)} runs by the motion that the command alone makes.",
        "Intervals are two standard deviations by the spread between runs; the supply is stated.",
        f"{error.sentence}.",
        *(s.advice for s in list_open([*(number.state(units) for number in numbers), play])),
    ]
    toml = machine_toml(units, content, numbers, head)
    machine = check_toml(toml, content, Path(f"{name}.toml"))
    return Identification(machine, toml, numbers, (play, error), tuple(log.source for log in problem.logs))
