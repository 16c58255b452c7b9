"""Axes drawn at random, identified from their logs alone: is what they leave that of the truth, are intervals true."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sgms_bench.studies.cases import done_of
from sgms_mhe.configuration import make_machine
from sgms_mhe.identification.elements import NO_RISE, Stribeck, run_elements
from sgms_mhe.identification.fits import NumberEstimate
from sgms_mhe.identification.identify import Explored, Wanted, explore
from sgms_mhe.identification.terms import sampling_terms
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion, Trajectory
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]
Law = Literal["sgms", "switching"]

RATES: Final = (500.0, 1000.0, 2000.0, 5000.0, 10000.0)
GRAVITY: Final = 9.81
COARSER: Final = 5.0
"""Distances per decade of the grid that the second start has."""
STARTED_AGAIN: Final = 8
"""One axis of so many is identified once more from the other grid."""


@dataclass(frozen=True)
class StudyAxis:
    """A drawn truth and its log."""

    machine: Machine
    log: Log
    mass_given: bool


def draw_axis(seed: int, seconds: float = 25.0) -> StudyAxis:
    """An axis of 1 to 6 elements, either law, 0.1 to 500 kg, 500 Hz to 10 kHz, and what it logs of a test."""
    random = np.random.default_rng([12, seed])
    rate = float(random.choice(RATES))
    mass = between(random, 0.1, 500.0)
    coulomb = mass * GRAVITY * between(random, 0.005, 0.1)
    fastest = between(random, 0.05, 1.0)
    distances = nested_distances(random, int(random.integers(1, 7)), 1e-6, 1e-3)
    shares = random.dirichlet(np.full(len(distances), 4.0)) * 0.8 + 0.2 / len(distances)
    law: Law = "sgms" if random.random() < 0.5 else "switching"
    rises = random.random() < 0.6
    friction = {
        "law": law,
        "stiffness": (shares * coulomb / distances).tolist(),
        "fraction": (shares / shares.sum()).tolist(),
        "coulomb": coulomb,
        "viscous": coulomb / fastest * between(random, 0.2, 2.0),
        "stribeck_ratio": float(random.uniform(0.1, 0.5)) if rises else 0.0,
        "stribeck_velocity": between(random, 5e-4, 5e-3),
    }
    sampling: dict[str, Any] = {
        "rate": rate,
        "update_rate": rate / round(rate / 100.0),
        "velocity_cutoff": 0.1 * rate,
        "max_velocity": 1.2 * fastest,
    }
    if law == "sgms":
        sampling["integrator"] = {"scheme": "flow"}
    content = {"name": "truth", "plant": {"mass": mass}, "friction": friction, "sampling": sampling}
    machine = make_machine(content, Path("truth.toml"))
    motion = _motion(random, rate, distances, fastest, seconds)
    noise = coulomb * between(random, 0.005, 0.05)
    config = AxisConfig(encoder_resolution_m=1e-9, force_noise_N=noise, seed=seed)
    log = simulate_axis(machine, motion, config, truth=False).log
    return StudyAxis(machine, log, bool(random.random() < 0.5))


def between(random: Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(random.uniform(math.log(low), math.log(high))))


def nested_distances(random: Generator, count: int, low: float, high: float) -> Array:
    """Draw break-away distances [m] between two, neighbours at least a factor of 2.5 apart."""
    while True:
        found = np.sort([between(random, low, high) for _ in range(count)])
        if np.all(found[1:] >= 2.5 * found[:-1]):
            return np.asarray(found)


def _motion(random: Generator, rate: float, distances: Array, fastest: float, seconds: float) -> Trajectory:
    """Loops nested into each other about every break-away distance, and strokes at rising speeds, in turn."""
    path = Motion(rate)
    path.wait(0.3)
    spent = 0.0
    while spent < seconds:
        for speed in np.geomspace(0.004, fastest, 4).tolist():
            way = speed * float(random.uniform(0.2, 0.4)) + 8.0 * float(distances[-1])
            limits = (speed, 10.0 * fastest, 400.0 * fastest)
            path.move_by(way, *limits)
            path.wait(0.05)
            path.move_by(-way * float(random.uniform(0.8, 1.0)), *limits)
        for distance in distances.tolist():
            speed = min(8.0 * distance, 0.01)
            sizes = tuple(distance * share for share in (3.0, 1.6, 0.8))
            path.loops(sizes, speed, 20.0 * speed, 800.0 * speed)
        for frequency in (3.0, 7.0):
            path.swing(float(distances[-1]) * float(random.uniform(0.5, 2.0)), frequency, cycles=3)
        path.move_to(0.0, 0.3 * fastest, 10.0 * fastest, 400.0 * fastest)
        path.wait(0.2)
        spent = path.trajectory("").duration_s
    return path.trajectory("identification")


def true_residual(axis: StudyAxis, explored: Explored) -> Array:
    """Measured minus true friction on the held-out rows [N]: what the best of models leaves."""
    friction, view = axis.machine.friction, explored.final.view
    levels = np.array(friction.fraction) * friction.coulomb
    rise = Stribeck(friction.stribeck_ratio, friction.stribeck_velocity) if friction.stribeck_ratio else NO_RISE
    rise = Stribeck(rise.ratio, friction.stribeck_velocity)
    runs = run_elements(view.motions, friction.law, levels / np.array(friction.stiffness), rise, jacobian=False)
    rows = view.rows
    model = runs.chi @ levels
    model += friction.viscous * (rows.velocity + 0.5 * rows.machine.sampling.step * rows.acceleration)
    model += (axis.machine.plant.moved - rows.machine.plant.moved) * rows.acceleration
    residual = rows.friction - model
    # What sampling leaves is no number of an axis: the truth is spared it as the fit is.
    sampling = np.column_stack([term.columns for term in sampling_terms(rows)])
    size = np.abs(sampling).max(axis=0)
    residual -= sampling / size @ np.linalg.lstsq((sampling / size)[rows.used], residual[rows.used])[0]
    return np.asarray(residual[rows.rows_held_out()])


def score_axis(axis: StudyAxis, explored: Explored) -> dict[str, tuple[float, NumberEstimate]]:
    """Truth and finding of every number that has a truth: those of elements where their count is right."""
    friction, settled = axis.machine.friction, explored.final
    truth: dict[str, float] = {"coulomb": friction.coulomb, "viscous": friction.viscous}
    if friction.stribeck_ratio:
        truth |= {name: getattr(friction, name) for name in ("stribeck_ratio", "stribeck_velocity")}
    if len(settled.fit.levels) == friction.n_z:
        for k in range(friction.n_z):
            truth |= {f"stiffness_{k + 1}": friction.stiffness[k], f"fraction_{k + 1}": friction.fraction[k]}
    found = {name: (truth[name], settled.numbers[name]) for name in truth if name in settled.numbers}
    if settled.mass is not None:
        found["mass"] = axis.machine.plant.moved, settled.mass
    return {name: pair for name, pair in found.items() if pair[1].std > 1e-12 * abs(pair[1].value)}


def identification_study(axes: int, seconds: float = 25.0, first: int = 0, place: WorkerSlot = HERE) -> CsvTable:
    """Random axes from nothing: law, elements, held-out residual over that of the truth, coverage, another start."""
    tasks = [Task(str(seed), identified_axis, (seed, seconds)) for seed in range(first, first + axes)]
    return _table(results(tasks, place, done_of("axes")))


def identified_axis(seed: int, seconds: float) -> dict[str, Any]:
    """One row of the study: what was drawn and what was found."""
    axis = draw_axis(seed, seconds)
    friction, mass = axis.machine.friction, axis.machine.plant.moved
    row: dict[str, Any] = {
        "axis": seed,
        "law": friction.law,
        "elements": friction.n_z,
        "mass": mass,
        "rate": axis.machine.sampling.rate,
    }
    given = mass if axis.mass_given else None
    try:
        explored = explore([axis.log], Wanted("axis", given))
    except InputError as error:
        return row | {"found": f"refused: {error.where}", "hits": {}}
    settled, fit = explored.final, explored.final.fit
    best = math.sqrt(float(np.mean(true_residual(axis, explored) ** 2)))
    compared = score_axis(axis, explored)
    again = math.nan
    if seed % STARTED_AGAIN == 0:
        other = explore([axis.log], Wanted("axis", given, per_decade=COARSER)).final
        again = _apart(settled.numbers, other.numbers)
    hits = {name: (found.value - truth) / found.std for name, (truth, found) in compared.items()}
    return row | {
        "found": f"{fit.shape.law} {len(fit.levels)}",
        "left": settled.held_out_rms / friction.coulomb,
        "ratio": settled.held_out_rms / best,
        "inside": f"{sum(abs(error) <= 2.0 for error in hits.values())}/{len(hits)}",
        "hits": hits,
        "again": again,
    }


def _apart(first: dict[str, NumberEstimate], second: dict[str, NumberEstimate]) -> float:
    """Largest difference of two sets of numbers over its standard deviation; inf where they are not the same ones."""
    if set(first) != set(second):
        return math.inf
    return max(abs(first[n].value - second[n].value) / max(first[n].std, 1e-9 * abs(first[n].value)) for n in first)


def _table(rows: list[dict[str, Any]]) -> CsvTable:
    inside = [abs(error) <= 2.0 for row in rows for error in row["hits"].values()]
    ratios = np.array([row["ratio"] for row in rows if "ratio" in row])
    right = sum(row["found"] == f"{row['law']} {row['elements']}" for row in rows)
    starts = [row["again"] for row in rows if not math.isnan(row.get("again", math.nan))]
    formats = {"axis": "d", "law": "", "elements": "d", "mass": ".3g", "rate": "g", "found": "", "left": ".4f"}
    formats |= {"ratio": ".3f", "inside": "", "again": ".2g"}
    share = float(np.mean(ratios <= 1.2)) if len(ratios) else math.nan
    covered = float(np.mean(inside)) if inside else math.nan
    return CsvTable(
        "axes drawn at random, identified from their logs alone",
        formats,
        rows,
        (
            "left: held-out residual over the Coulomb level; ratio: over what the true numbers leave on the same rows;",
            "inside: numbers within two of their standard deviations of the truth;",
            "again: largest change from another grid, in standard deviations;",
            f"{share:.0%} of {len(rows)} axes have a ratio up to 1.2; {right} have law and number of elements right;",
            f"{covered:.1%} of {len(inside)} numbers are inside; "
            f"{sum(a <= 0.1 for a in starts)} of {len(starts)} starts change less than 0.1 deviations.",
        ),
    )
