"""Faults of sensors, wires and clocks put into good logs, and what the emitted estimators make of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.records import Record, simulate_record
from sgms_bench.studies.cases import done_of
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledEstimator, RunningEstimator
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.status import FLAGS
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]
Inject = Callable[[Array, Array, slice, np.random.Generator], None]
"""Changes position [m] and force [N] in place, within the part of the log that is faulty."""

RATE: Final = 10_000
LOG_S: Final = 18.0
START_S: Final = (8.0, 9.0)
"""When a fault begins, drawn from here: the parameters have been learned."""
WATCHED_S: Final = 4.0
"""How long an estimate is watched once good data are back."""
SUM: Final = round(START_S[0] * RATE) + 1
"""Samples that every injection has in common: they are estimated once."""
AXES: Final = 10
STIFFNESS: Final = (0.75, 1.3)
"""True over nominal, drawn from here for every element of every axis."""
BLOCK: Final = 250
"""Injections of a task: what is lost where one is killed."""
BEYOND: Final = 5.0
"""Stated deviations by which a measurement departs that contradicts a good log."""
SHORT_S: Final = 0.5
RECOVERS_S: Final = (1.0, 3.0)
"""Within what an estimate has to recover from a fault up to `SHORT_S`, and from a longer one."""


@dataclass(frozen=True)
class Fault:
    """A class of faults, and how long it lasts [s]; what is wrong from then on has no end."""

    name: str
    duration_s: float
    inject: Inject


def _frozen(of: int) -> Inject:
    def inject(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
        signal = (position, force)[of]
        signal[part] = signal[part.start]

    return inject


def _missing(of: Sequence[int], value: float = np.nan) -> Inject:
    def inject(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
        for k in of:
            (position, force)[k][part] = value

    return inject


def _jump(size: float) -> Inject:
    def inject(position: Array, force: Array, part: slice, rng: np.random.Generator) -> None:
        position[part.start :] += size * rng.choice([-1.0, 1.0])

    return inject


def _scale(position_by: float, force_by: float) -> Inject:
    def inject(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
        position[part] *= position_by
        force[part] *= force_by

    return inject


def _offset(position_m: float, force_N: float) -> Inject:
    def inject(position: Array, force: Array, part: slice, rng: np.random.Generator) -> None:
        sign = rng.choice([-1.0, 1.0])
        position[part] += sign * position_m
        force[part] += sign * force_N

    return inject


def _noise(position_m: float, force_N: float, *, instead: bool = False) -> Inject:
    def inject(position: Array, force: Array, part: slice, rng: np.random.Generator) -> None:
        for signal, size in ((position, position_m), (force, force_N)):
            noise = size * rng.standard_normal(part.stop - part.start)
            signal[part] = noise + (0.0 if instead else signal[part])

    return inject


def _spikes(position: Array, force: Array, part: slice, rng: np.random.Generator) -> None:
    at = rng.integers(part.start, part.stop, 200)
    force[at] += 40.0 * rng.choice([-1.0, 1.0], 200)


def _quantise(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
    position[part] = np.round(position[part] / 1e-6) * 1e-6


def _clip(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
    np.clip(force[part], -10.0, 10.0, out=force[part])


def _resample(times: Callable[[Array, np.random.Generator], Array], of: Sequence[int] = (0, 1)) -> Inject:
    """The signals at other times than those that the samples say, in sample periods."""

    def inject(position: Array, force: Array, part: slice, rng: np.random.Generator) -> None:
        index = np.arange(part.start, part.stop, dtype=np.float64)
        for k in of:
            signal = (position, force)[k]
            signal[part] = np.interp(times(index, rng), np.arange(len(signal)), signal)

    return inject


def _drifting(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
    count = part.stop - part.start
    position[part] += 1e-3 * np.arange(count) / RATE
    position[part.stop :] += 1e-3 * count / RATE


def _nothing(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
    """No fault: what the same counts say of good data."""


FAULTS: Final = (
    Fault("force frozen", 0.3, _frozen(1)),
    Fault("force frozen", 2.0, _frozen(1)),
    Fault("position frozen", 0.3, _frozen(0)),
    Fault("position frozen", 2.0, _frozen(0)),
    Fault("encoder jumps by 10 um", 0.0, _jump(1e-5)),
    Fault("encoder jumps by 1 mm", 0.0, _jump(1e-3)),
    Fault("encoder wraps by 0.1 m", 0.5, _offset(0.1, 0.0)),
    Fault("encoder drifts by 1 mm/s", 1.0, _drifting),
    Fault("position's sign", 0.5, _scale(-1.0, 1.0)),
    Fault("force's sign", 0.2, _scale(1.0, -1.0)),
    Fault("force's gain 5 % off", 5.0, _scale(1.0, 1.05)),
    Fault("force off by 1 N", 5.0, _offset(0.0, 1.0)),
    Fault("push of 50 N", 0.3, _offset(0.0, 50.0)),
    Fault("push of 500 N", 2.0, _offset(0.0, 500.0)),
    Fault("200 spikes of 40 N", 2.0, _spikes),
    Fault("noise of 1.6 N", 2.0, _noise(0.0, 1.6)),
    Fault("small garbage", 2.0, _noise(1e-6, 1.0, instead=True)),
    Fault("large garbage", 2.0, _noise(1.0, 1e3, instead=True)),
    Fault("force saturates at 10 N", 2.0, _clip),
    Fault("force reads zero", 1.0, _scale(1.0, 0.0)),
    Fault("encoder's steps 1 um", 2.0, _quantise),
    Fault("jitter of 20 us", 2.0, _resample(lambda at, rng: at + 0.2 * rng.standard_normal(len(at)))),
    Fault("every sample twice", 1.0, _resample(lambda at, rng: at - at % 2.0)),
    Fault("force late by 20 samples", 1.0, _resample(lambda at, rng: at - 20.0, (1,))),
    Fault("one sample NaN", 1e-4, _missing((0, 1))),
    Fault("100 samples lost", 0.01, _missing((0, 1))),
    Fault("10000 samples lost", 1.0, _missing((0, 1))),
    Fault("position lost", 0.1, _missing((0,))),
    Fault("force infinite", 1e-3, _missing((1,), np.inf)),
)
"""What can happen to a log; each leaves numbers that an axis might have left, or none."""
TRIED: Final = (Fault("none", 0.0, _nothing), *FAULTS)

VARIANTS: Final[Mapping[str, Mapping[str, Any]]] = {
    f"{kind} {precision}": {"estimator": {"kind": kind, "relinearise": "auto"}, "code": {"precision": precision}}
    for kind, precision in product(("mhe", "ekf"), ("double", "single"))
}
"""Packages that are tried, as changes of etel_xy."""


@dataclass(frozen=True)
class FaultOutcome:
    """Effect of one fault on one estimator.

    Attributes:
        sigmas: largest error of a parameter over its stated deviation, from 1 s after good data are back.
        deviation: largest change of a parameter against the same log without fault, over nominal.
        recovery_s: from good data until the friction error stays within 1.5 times the largest of the log without fault.
        contradicts: whether a measurement departs from the good log's by `BEYOND` stated deviations, or is lost.
        said: updates from the first that does until DOUBT or MISSING, that one included; 0: it was never said.
    """

    sigmas: float
    deviation: float
    recovery_s: float
    contradicts: bool
    said: int

    @property
    def matters(self) -> bool:
        """Return True if the fault moved a parameter by 1 % of nominal, or more, and shows in the measurements."""
        return self.deviation > 0.01 and self.contradicts


@cache
def base_record(axis: int) -> Record:
    """One of the good logs."""
    machine, config = load_machine("etel_xy"), AxisConfig(seed=axis)
    stiffness = np.random.default_rng([axis, 3]).uniform(*STIFFNESS, machine.friction.n_z)
    return simulate_record(machine, list(stiffness), trajectory="mixed", duration_s=LOG_S, config=config)


def faulty(log: Log, fault: Fault, start: int, rng: np.random.Generator) -> Log:
    """The log with the fault from sample `start` on."""
    position, force = log.position_m.copy(), log.force_N.copy()
    fault.inject(position, force, slice(start, start + round(fault.duration_s * RATE)), rng)
    return replace(log, position_m=position, force_N=force)


def _part_of(log: Log, first: int, last: int) -> Log:
    """Samples `first` up to `last` of a log."""
    part = slice(first, last)
    return replace(log, time_s=log.time_s[part], position_m=log.position_m[part], force_N=log.force_N[part])


@dataclass(frozen=True)
class _Good:
    """A good log's estimate from `SUM` samples on.

    Attributes:
        estimator: that it was made with.
        learned: where that was after `SUM` samples.
        estimates: from then on.
        friction: true one, at its updates [N].
        normal: 1.5 times the largest friction error [N].
        doubted: share of all updates that say DOUBT.
    """

    estimator: RunningEstimator
    learned: tuple[bytes, int]
    estimates: Estimates
    friction: Array
    normal: float
    doubted: float


class FaultTrial:
    """One estimator over good logs, to be tried on faulty ones.

    Args:
        variant: of `VARIANTS`.
        axes: how many good logs there are.
    """

    def __init__(self, variant: str, axes: int = AXES) -> None:
        machine = override_machine(load_machine("etel_xy"), VARIANTS[variant])
        self._estimator = CompiledEstimator(machine)
        self._stated = machine.estimator.noise.measurement
        self._nominal = np.array([parameter.nominal for parameter in self._estimator.model.parameters])
        self._good = [self._estimate(base_record(axis)) for axis in range(axes)]

    def _estimate(self, record: Record) -> _Good:
        log, estimator = record.run.log, self._estimator.running()
        learning = estimator.take(_part_of(log, 0, SUM))
        learned = estimator.state()
        good = estimator.take(_part_of(log, SUM, len(log.time_s)))
        friction = record.friction[len(learning) :]
        doubted = np.concatenate([learning.status, good.status]) & FLAGS["doubt"] > 0
        normal = 1.5 * float(np.abs(good.friction_N - friction).max())
        return _Good(estimator, learned, good, friction, normal, float(doubted.mean()))

    def doubted_when_clean(self) -> float:
        """Share of the updates of good logs that say DOUBT."""
        return float(np.mean([good.doubted for good in self._good]))

    def run(self, fault: Fault, seed: int) -> FaultOutcome:
        """One injection."""
        rng = np.random.default_rng([seed, 7])
        axis, start_s = seed % len(self._good), float(rng.uniform(*START_S))
        record, good, back = base_record(axis), self._good[axis], start_s + fault.duration_s
        log = faulty(record.run.log, fault, round(start_s * RATE), rng)
        good.estimator.go_back(good.learned)
        found = good.estimator.take(_part_of(log, SUM, round((back + WATCHED_S) * RATE)))
        time, seen = found.time_s, slice(len(found))
        theta, std = found.parameters / self._nominal, found.std / self._nominal
        sigmas = np.max(np.abs(theta - record.theta) / std, axis=1)
        lost = (found.status < 0) | (found.status & FLAGS["missing"] > 0)
        measured = good.estimates.friction_measured_N[seen]
        departed = np.abs(found.friction_measured_N - measured) > BEYOND * self._stated
        wrong = np.flatnonzero((lost | departed) & (time >= start_s))
        first = int(wrong[0]) if len(wrong) else len(time)
        said = np.flatnonzero((found.status & FLAGS["doubt"] > 0) | lost)
        said = said[said >= np.searchsorted(time, start_s)]
        moved = np.abs(found.parameters - good.estimates.parameters[seen]) / self._nominal
        off = time[(np.abs(found.friction_N - good.friction[seen]) > good.normal) & (time > back)]
        return FaultOutcome(
            sigmas=float(sigmas[time > back + 1.0].max()),
            deviation=float(moved[time >= start_s].max()),
            recovery_s=float(off[-1] - back) if len(off) else 0.0,
            contradicts=len(wrong) > 0,
            said=max(1, int(said[0]) - first + 1) if len(said) else 0,
        )


@cache
def _trial(variant: str) -> FaultTrial:
    """An estimator over the good logs, made once per process."""
    return FaultTrial(variant)


def _part(index: int, seeds: range) -> list[tuple[str, FaultOutcome]]:
    """Injections of a fault, for every variant."""
    return [(name, _trial(name).run(TRIED[index], seed)) for name in VARIANTS for seed in seeds]


def _run_doubts(variant: str) -> float:
    return _trial(variant).doubted_when_clean()


def faults_study(runs: int, place: WorkerSlot = HERE) -> CsvTable:
    """The worst of `runs` injections of every class, for MHE and EKF in double and single precision."""
    blocks = [range(first, min(first + BLOCK, runs)) for first in range(0, runs, BLOCK)]
    parts = list(product(range(len(TRIED)), blocks))
    tasks = [Task(f"{TRIED[index].name}-{index}-{seeds.start}", _part, (index, seeds)) for index, seeds in parts]
    found: list[list[tuple[str, FaultOutcome]]] = [[] for _ in TRIED]
    for (index, _), outcomes in zip(parts, results(tasks, place, done_of("faults")), strict=True):
        found[index] += outcomes
    doubted = results([Task(name, _run_doubts, (name,)) for name in VARIANTS], place)
    rows = [_row(fault, outcomes) for fault, outcomes in zip(TRIED, found, strict=True)]
    clean = ", ".join(f"{name} {share:.2%}" for name, share in zip(VARIANTS, doubted, strict=True))
    return CsvTable(
        f"The worst of {runs} injections of each fault, for each of {', '.join(VARIANTS)}",
        {
            "fault": "",
            "s": "g",
            "sigmas": ".1f",
            "of": "",
            "beyond 3": ".2%",
            "deviation": ".3f",
            "recovery s": ".2f",
            "late": ".2%",
            "mattered": ".0%",
            "said in 2": ".0%",
        },
        rows,
        (
            "sigmas: largest error of a parameter over its stated deviation, 1 s after good data or later;",
            "beyond 3: share of the injections in which that is more than 3;",
            "deviation: of a parameter against the log without fault, over nominal;",
            "recovery: until the friction error is that of a good log;",
            f"late: share in which that takes longer than {RECOVERS_S[0]:g} s after a fault up to {SHORT_S:g} s, "
            f"{RECOVERS_S[1]:g} s after a longer one;",
            f"mattered: share that moved a parameter by 1 % of nominal, with readings that depart by {BEYOND:g} stated "
            "deviations;",
            "said in 2: those that said DOUBT, or MISSING, within two updates of the first such reading",
            f"updates of good logs that say DOUBT: {clean}",
        ),
    )


def _row(fault: Fault, found: Sequence[tuple[str, FaultOutcome]]) -> dict[str, Any]:
    outcomes = [outcome for _, outcome in found]
    mattered = [outcome for outcome in outcomes if outcome.matters]
    name, worst = max(found, key=lambda pair: pair[1].sigmas)
    allowed_s = RECOVERS_S[fault.duration_s > SHORT_S]
    return {
        "fault": fault.name,
        "s": fault.duration_s,
        "sigmas": worst.sigmas,
        "of": name,
        "beyond 3": np.mean([outcome.sigmas > 3.0 for outcome in outcomes]),
        "deviation": max(outcome.deviation for outcome in outcomes),
        "recovery s": max(outcome.recovery_s for outcome in outcomes),
        "late": np.mean([outcome.recovery_s > allowed_s for outcome in outcomes]),
        "mattered": len(mattered) / len(found),
        "said in 2": np.mean([0 < outcome.said <= 2 for outcome in mattered]) if mattered else None,
    }
