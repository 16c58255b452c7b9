"""Errors of the model that stay in good logs: how often the truth is beyond what the emitted estimators state."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.records import Record, record_of
from sgms_bench.studies.cases import done_of, rms
from sgms_bench.studies.faults import STIFFNESS, VARIANTS
from sgms_bench.studies.lasting_errors import CLEAN, ERRORS, LastingError
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion, Trajectory, lasting, make_trajectory
from sgms_mhe.signals.status import FLAGS
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]

COUNTED_S: Final = 3.0
"""From here on updates count: parameters have been found on a good log."""
AFTER_S: Final = (5.0, 10.0, 20.0)
TRIED: Final = (*CLEAN, *ERRORS)
UNCERTAIN: Final = "mass and gain uncertain"
FOLLOWED: Final = "force of a place"
WITH_LEVEL: Final = "force of a place and level"
STATED: Final[Mapping[str, Mapping[str, Any]]] = {
    UNCERTAIN: {"disturbance": {"mass": 0.01, "gain": 0.01}},
    FOLLOWED: {"disturbance": {"force": 0.2}},
    WITH_LEVEL: {"disturbance": {"force": 0.2}, "parameters": ["stiffness", "coulomb"], "prior": {"coulomb": 0.1}},
}
"""Changes of [estimator] of the study: what a user states of the errors."""
_ESTIMATORS: Final[Mapping[str, Mapping[str, Any]]] = dict(VARIANTS) | {
    f"{name}, {title}": {**changes, "estimator": {**changes["estimator"], **stated}}
    for title, stated in STATED.items()
    for name, changes in VARIANTS.items()
}
"""Estimators of the study: the packages of `VARIANTS`, as the file is and with each of `STATED`."""


def crawl(rate: float) -> Trajectory:
    """Moves of some break-away distances at 20 to 200 um/s, there and back, and a longer one."""
    path = Motion(rate)
    path.wait(0.1)
    for distance, velocity in ((20e-6, 2e-5), (60e-6, 5e-5), (200e-6, 2e-4), (-120e-6, 1e-4), (800e-6, 2e-4)):
        limits = (velocity, 100.0 * velocity, 1e4 * velocity)
        path.move_by(distance, *limits)
        path.move_by(-0.5 * distance, *limits)
        path.wait(0.05)
    path.move_to(0.0, 1e-3, 0.1, 10.0)
    return path.trajectory("crawl")


MOTIONS: Final[Mapping[str, Callable[[float, float], Trajectory]]] = {
    "mixed": lambda rate, top: make_trajectory("mixed", rate, max_velocity=top),
    "paper": lambda rate, top: make_trajectory("paper", rate),
    "contour": lambda rate, top: make_trajectory("circle_x", rate),
    "crawl": lambda rate, top: crawl(rate),
}


@dataclass(frozen=True)
class LastingOutcome:
    """One estimator on one log.

    Attributes:
        motion: of `MOTIONS`.
        variant: of `VARIANTS`, or one of these with ", " and a title of `STATED`.
        covered: share of parameters within 2 stated deviations, of the updates from `COUNTED_S` on.
        beyond: share of these updates in which a parameter is off by more than 2 and 3 stated deviations.
        silent: share in which one is beyond 3 and the status does not say DOUBT.
        doubted: share that say DOUBT.
        after: largest relative error of a parameter at the times `AFTER_S`, or at the end.
        friction: RMS of estimated minus true force against the drive [N].
        sigma: mean stated deviation, over nominal.
    """

    motion: str
    variant: str
    covered: float
    beyond: tuple[float, float]
    silent: float
    doubted: float
    after: Array
    friction: float
    sigma: float


@cache
def _estimator(variant: str) -> CompiledEstimator:
    return CompiledEstimator(override_machine(load_machine("etel_xy"), _ESTIMATORS[variant]))


def erroneous_record(error: LastingError, motion: str, seed: int, duration_s: float) -> Record:
    """A log of an axis with this error; its true friction is all the force against the drive but inertia."""
    machine = load_machine("etel_xy")
    stiffness = np.random.default_rng([seed, 3]).uniform(*STIFFNESS, machine.friction.n_z)
    path = lasting(MOTIONS[motion](machine.sampling.rate, machine.sampling.max_velocity), duration_s)
    run = simulate_axis(
        machine,
        path,
        AxisConfig(law=error.law, encoder_noise_m=error.encoder_noise_m, force_noise_N=error.force_noise_N, seed=seed),
        scale={"stiffness": stiffness.tolist()} | dict(error.scale),
        drift=error.drift,
        hidden_effects=error.effects,
    )
    if run.truth is not None and not error.is_inertia:
        whole = replace(run.truth, friction_N=run.truth.friction_N + run.truth.effect_force_N)
        run = replace(run, truth=whole)
    return record_of(machine, run, stiffness.tolist())


def lasting_outcome(record: Record, motion: str, variant: str) -> LastingOutcome:
    """Compare what an emitted estimator states about a log with the truth."""
    estimator = _estimator(variant)
    estimates = estimator.estimate_log(record.run.log, mode="tasks")
    nominal = np.array(estimator.machine.friction.stiffness)
    theta, std = (array[:, : len(nominal)] / nominal for array in (estimates.parameters, estimates.std))
    error = np.abs(theta - record.theta)
    counted = estimates.time_s > COUNTED_S
    sigmas, doubts = (error / std)[counted], (estimates.status & FLAGS["doubt"] > 0)[counted]
    worst = np.max(sigmas, axis=1)
    at = np.searchsorted(estimates.time_s, np.minimum(AFTER_S, estimates.time_s[-1]))
    return LastingOutcome(
        motion=motion,
        variant=variant,
        covered=float(np.mean(sigmas <= 2.0)),
        beyond=(float(np.mean(worst > 2.0)), float(np.mean(worst > 3.0))),
        silent=float(np.mean((worst > 3.0) & ~doubts)),
        doubted=float(np.mean(doubts)),
        after=np.max(error[at] / record.theta, axis=1),
        friction=rms((estimates.friction_N - record.friction)[counted]),
        sigma=float(np.mean(std[counted])),
    )


def _part(index: int, motion: str, seed: int, duration_s: float) -> list[LastingOutcome]:
    """One log with every estimator."""
    record = erroneous_record(TRIED[index], motion, seed, duration_s)
    return [lasting_outcome(record, motion, variant) for variant in _ESTIMATORS]


def lasting_study(seeds: int, duration_s: float = 20.0, place: WorkerSlot = HERE) -> CsvTable:
    """Honesty of stated deviations under every lasting error, on four motions, by MHE and EKF, double and single.

    As the machine file is, and with each of `STATED`.
    """
    drawn = list(product(range(len(TRIED)), MOTIONS, range(seeds)))
    tasks = [
        Task(f"{index}-{motion}-{seed}", _part, (index, motion, seed, duration_s)) for index, motion, seed in drawn
    ]
    found: list[list[LastingOutcome]] = [[] for _ in TRIED]
    for (index, _, _), outcomes in zip(drawn, results(tasks, place, done_of("logs")), strict=True):
        found[index] += outcomes
    groups = _groups([[outcome for outcome in outcomes if outcome.variant in VARIANTS] for outcomes in found])
    for title in STATED:
        of_title = _groups([[o for o in outcomes if o.variant.endswith(f", {title}")] for outcomes in found])
        groups += [(f"{name}, {title}", outcomes) for name, outcomes in of_title]
    errors = {f"{seconds:g} s": ".3f" for seconds in AFTER_S}
    return CsvTable(
        f"Stated deviations under lasting errors of the model: {', '.join(MOTIONS)} motion, {seeds} seeds of "
        f"{duration_s:g} s, {', '.join(VARIANTS)}",
        {"error": "", "covered": ".1%", "beyond 2": ".1%", "beyond 3": ".1%", "silent": ".2%", "doubted": ".1%"}
        | errors
        | {"friction mN": ".1f", "sigma": ".4f"},
        [_row(name, outcomes) for name, outcomes in groups],
        (
            f"covered: share of stiffnesses within 2 stated deviations, of the updates from {COUNTED_S:g} s on;",
            "beyond 2, 3: share of these updates in which one is off by more;",
            "silent: beyond 3 in an update that does not say DOUBT; doubted: updates that say it;",
            "5 s, ...: largest relative error of a stiffness after so long, mean over logs;",
            "friction: RMS of estimated minus true force against the drive, that of the error included;",
            "sigma: mean stated deviation of a stiffness, over nominal",
        ),
    )


def _groups(found: Sequence[Sequence[LastingOutcome]]) -> list[tuple[str, Sequence[LastingOutcome]]]:
    """Rows of the table: each of `TRIED`, then all errors, and these by motion and by package."""
    erroneous = [outcome for outcomes in found[len(CLEAN) :] for outcome in outcomes]
    variants = dict.fromkeys(outcome.variant for outcome in erroneous)
    return [
        *((error.name, outcomes) for error, outcomes in zip(TRIED, found, strict=True)),
        ("all errors", erroneous),
        *((f"all errors, {m}", [outcome for outcome in erroneous if outcome.motion == m]) for m in MOTIONS),
        *((f"all errors, {v.partition(',')[0]}", [o for o in erroneous if o.variant == v]) for v in variants),
    ]


def _row(name: str, outcomes: Sequence[LastingOutcome]) -> dict[str, Any]:
    after = np.mean([outcome.after for outcome in outcomes], axis=0)
    return {
        "error": name,
        "covered": np.mean([outcome.covered for outcome in outcomes]),
        "beyond 2": np.mean([outcome.beyond[0] for outcome in outcomes]),
        "beyond 3": np.mean([outcome.beyond[1] for outcome in outcomes]),
        "silent": np.mean([outcome.silent for outcome in outcomes]),
        "doubted": np.mean([outcome.doubted for outcome in outcomes]),
        **{f"{seconds:g} s": error for seconds, error in zip(AFTER_S, after, strict=True)},
        "friction mN": 1e3 * np.mean([outcome.friction for outcome in outcomes]),
        "sigma": np.mean([outcome.sigma for outcome in outcomes]),
    }
