"""Axes behind coarse encoders, identified from their logs alone: are the stated numbers within their intervals.

Linear and rotary axes, some with gravity, read 5 to 500 encoder steps per presliding distance, on a test's motion or on
short production moves alone, some with readings off their stamps.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from sgms_bench.studies.cases import done_of
from sgms_bench.studies.identification import between, nested_distances
from sgms_mhe.configuration import make_machine
from sgms_mhe.identification import Identification, Wanted, identify
from sgms_mhe.machine import Kind, Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion, Trajectory
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]

RATES: Final = (1000.0, 2000.0, 4000.0)
FAR: Final = 3.0
"""Deviations beyond which a stated number is wrong."""
NONE_THERE: Final = (
    "constant_offset.force_N",
    "position_spring.stiffness_N_m",
    "unbalance.amplitude_N",
    "load_dependent_friction.ratio",
    "asymmetric_viscous.ratio",
)
"""Sizes of effects that are 0 unless they were drawn."""


@dataclass(frozen=True)
class CoarseAxis:
    """A drawn truth, its log, and what it is like in words.

    Attributes:
        machine: true one, with the signal chain of a diagnosis.
        effects: true ones, each with its parameters.
        log: what is recorded.
        mass_given: whether an identification is told the mass.
        traits: motion, gravity, stamps.
        steps: of the encoder per presliding distance.
    """

    machine: Machine
    effects: tuple[tuple[str, Mapping[str, float]], ...]
    log: Log
    mass_given: bool
    traits: tuple[str, ...]
    steps: float


def draw_coarse_axis(
    seed: int, seconds: float = 12.0, hidden: Sequence[tuple[str, Mapping[str, float]]] = ()
) -> CoarseAxis:
    """Draw an axis and its log: 1 to 4 elements of either law, 5 to 500 encoder steps per presliding distance.

    `hidden`: effects that it has beside those drawn.
    """
    random = np.random.default_rng([35, seed])
    kind: Kind = "rotary" if random.random() < 0.5 else "linear"
    size = 50.0 if kind == "rotary" else 1.0  # radians for metres
    rate, count = float(random.choice(RATES)), int(random.integers(1, 5))
    coulomb, fastest = between(random, 1.0, 60.0), size * between(random, 0.05, 0.4)
    distances = size * nested_distances(random, count, 2e-6, 8e-5)
    shares = random.dirichlet(np.full(count, 4.0)) * 0.8 + 0.2 / count
    law = "sgms" if random.random() < 0.5 else "switching"
    inert = coulomb * between(random, 0.1, 1.0) / size
    friction = {
        "law": law,
        "stiffness": (shares * coulomb / distances).tolist(),
        "fraction": (shares / shares.sum()).tolist(),
        "coulomb": coulomb,
        "viscous": coulomb / fastest * between(random, 0.2, 2.0),
        "stribeck_ratio": float(random.uniform(0.1, 0.4)) if random.random() < 0.6 else 0.0,
        "stribeck_velocity": size * between(random, 1e-3, 1e-2),
    }
    sampling: dict[str, Any] = {
        "rate": rate,
        "update_rate": 100.0,
        "velocity_cutoff": rate * between(random, 0.015, 0.08),
        "max_velocity": 1.2 * fastest,
    }
    if law == "sgms":
        sampling["integrator"] = {"scheme": "flow"}
    plant = {"kind": kind, "inertia" if kind == "rotary" else "mass": inert}
    content = {"name": "truth", "plant": plant, "friction": friction, "sampling": sampling}
    effects, traits = [*hidden], []
    if kind == "rotary" and random.random() < 0.6:
        traits.append("gravity")
        phase = float(random.uniform(-math.pi, math.pi))
        effects.append(("unbalance", {"amplitude_N": coulomb * between(random, 0.3, 3.0), "phase_rad": phase}))
        if random.random() < 0.4:
            traits.append("load")
            effects.append(("load_dependent_friction", {"ratio": float(random.uniform(0.05, 0.2)), "rise_ratio": 0.0}))
    if random.random() < 0.35:
        traits.append("production")
        motion = production_moves(random, rate, fastest, seconds)
    else:
        motion = _test_motion(random, rate, distances, fastest, seconds)
    steps = between(random, 5.0, 500.0)
    step = float(distances[-1]) / steps
    config = AxisConfig(
        bandwidth_Hz=min(25.0, rate / 60.0),
        encoder_resolution_m=step,
        force_noise_N=coulomb * between(random, 3e-4, 1e-2),
        seed=seed,
    )
    machine = make_machine(content, Path("truth.toml"))
    run = simulate_axis(machine, motion, config, hidden_effects=tuple(effects))
    log = run.log
    if random.random() < 0.25 and run.truth is not None:
        traits.append("jitter")
        off = random.uniform(0.0, random.uniform(0.05, 0.5), len(log)) / rate
        position = CubicSpline(log.time_s, run.truth.position_m)(log.time_s - off)
        log = replace(log, position_m=np.round(position / step) * step)
    return CoarseAxis(machine, tuple(effects), log, bool(random.random() < 0.3), tuple(traits), steps)


def production_moves(random: Generator, rate: float, fastest: float, seconds: float) -> Trajectory:
    """Short moves between a few places, at one speed and acceleration, with a wait after each."""
    path, acceleration = Motion(rate), fastest * between(random, 8.0, 25.0)
    reach = fastest * between(random, 0.1, 1.0)
    path.wait(0.4)
    while path.duration_s < seconds:
        path.move_to(float(random.uniform(-0.5, 0.5)) * reach, fastest, acceleration, 40.0 * acceleration)
        path.wait(float(random.uniform(0.15, 0.5)))
    return path.trajectory("production")


def _test_motion(random: Generator, rate: float, distances: Array, fastest: float, seconds: float) -> Trajectory:
    """Strokes at rising speeds and loops about every break-away distance, in turn."""
    path = Motion(rate)
    path.wait(0.3)
    while path.duration_s < seconds:
        for speed in np.geomspace(0.01 * fastest, fastest, 4).tolist():
            way = speed * float(random.uniform(0.3, 0.6)) + 8.0 * float(distances[-1])
            limits = (speed, 10.0 * fastest, 400.0 * fastest)
            path.move_by(way, *limits)
            path.wait(0.05)
            path.move_by(-way * float(random.uniform(0.8, 1.0)), *limits)
        for distance in distances.tolist():
            speed = 8.0 * distance
            path.loops(tuple(distance * share for share in (3.0, 1.6, 0.8)), speed, 20.0 * speed, 800.0 * speed)
        path.move_to(0.0, 0.3 * fastest, 10.0 * fastest, 400.0 * fastest)
        path.wait(0.2)
    return path.trajectory("test")


def true_numbers(axis: CoarseAxis, found: Identification) -> dict[str, float]:
    """Return the truth of every number that has one: those of elements where their count is right."""
    friction = axis.machine.friction
    truth = {"coulomb": friction.coulomb, "viscous": friction.viscous, "mass": axis.machine.plant.moved}
    truth["stribeck_ratio"] = friction.stribeck_ratio
    if friction.stribeck_ratio:
        truth["stribeck_velocity"] = friction.stribeck_velocity
    if found.machine.friction.n_z == friction.n_z:
        for k in range(friction.n_z):
            truth |= {f"stiffness_{k + 1}": friction.stiffness[k], f"fraction_{k + 1}": friction.fraction[k]}
    truth |= dict.fromkeys(NONE_THERE, 0.0)
    return truth | {f"{name}.{key}": value for name, values in axis.effects for key, value in values.items()}


def deviations(axis: CoarseAxis, found: Identification) -> tuple[dict[str, float], list[str]]:
    """Return finding minus truth, over the stated deviation, of every stated number, and the names of the open ones."""
    truth, errors, open_numbers = true_numbers(axis, found), {}, []
    if has_curve(found):  # they are parts of one sum with it
        truth = {name: value for name, value in truth.items() if name not in ("coulomb", "viscous")}
    for number in found.numbers:
        if number.name not in truth:
            continue
        if not number.determined:
            open_numbers.append(number.name)
        elif math.isfinite(number.std) and number.std > 0.0:
            error = number.value - truth[number.name]
            if number.name.endswith("phase_rad"):
                error = math.remainder(error, 2.0 * math.pi)
            errors[number.name] = error / number.std
    return errors, open_numbers


def has_curve(found: Identification) -> bool:
    """Return True if a curve over speed stands beside level and viscous friction; no drawn axis has one."""
    return any(
        effect_definition(number.name.partition(".")[0]).any_curve for number in found.numbers if "." in number.name
    )


def identified_coarse_axis(seed: int, seconds: float) -> dict[str, Any]:
    """One row of the study: what was drawn and what was found."""
    axis = draw_coarse_axis(seed, seconds)
    friction = axis.machine.friction
    row: dict[str, Any] = {
        "axis": seed,
        "kind": axis.machine.plant.kind,
        "with": " ".join(axis.traits),
        "law": friction.law,
        "elements": friction.n_z,
        "rate": axis.machine.sampling.rate,
        "steps": axis.steps,
    }
    try:
        found = identify([axis.log], Wanted("axis", axis.machine.plant.moved if axis.mass_given else None))
    except InputError as error:
        return row | {"found": f"refused: {error.where}", "errors": {}, "open": 0}
    errors, left_open = deviations(axis, found)
    worst = max(errors, key=lambda name: abs(errors[name]), default="")
    return row | {
        "found": f"{found.law} {found.machine.friction.n_z}" + (" curve" if has_curve(found) else ""),
        "left": found.held_out_rms_N / found.noise_floor_N,
        "stated": len(errors),
        "open": len(left_open),
        "inside": sum(abs(error) <= 2.0 for error in errors.values()),
        "worst": f"{worst} {errors[worst]:+.1f}" if worst else "",
        "errors": errors,
    }


def coarse_study(axes: int, seconds: float = 12.0, first: int = 0, place: WorkerSlot = HERE) -> CsvTable:
    """Random axes behind coarse encoders: stated numbers within their intervals, and far beyond."""
    tasks = [Task(str(seed), identified_coarse_axis, (seed, seconds)) for seed in range(first, first + axes)]
    return _table(results(tasks, place, done_of("axes")))


def _table(rows: Sequence[Mapping[str, Any]]) -> CsvTable:
    errors = np.abs([error for row in rows for error in row["errors"].values()])
    formats = {"axis": "d", "kind": "", "with": "", "law": "", "elements": "d", "rate": "g", "steps": ".0f"}
    formats |= {"found": "", "left": ".2f", "stated": "d", "open": "d", "inside": "d", "worst": ""}
    refused, curves = (sum(word in row["found"] for row in rows) for word in ("refused", "curve"))
    covered = float(np.mean(errors <= 2.0)) if len(errors) else math.nan
    return CsvTable(
        "axes drawn at random behind coarse encoders, identified from their logs alone",
        formats,
        rows,
        (
            "steps: of the encoder per presliding distance; left: held-out residual over the noise floor;",
            "stated, open: numbers with a truth; inside: stated ones within two of their deviations;",
            f"{covered:.1%} of {len(errors)} stated numbers are inside, {int(np.sum(errors > FAR))} beyond {FAR:g} "
            f"deviations, {int(np.sum(errors > FAR + 1.0))} beyond {FAR + 1.0:g}; {sum(row['open'] for row in rows)} "
            f"are open, {refused} of {len(rows)} logs refused, {curves} have a curve over speed that is none.",
        ),
    )
