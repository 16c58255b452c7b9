"""Faults of sensors, wires and clocks put into good logs, and what the emitted estimators make of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.evaluation.records import Record, simulate_record
from sgms_mhe.evaluation.studies.cases import done_of
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.status import FLAGS
from sgms_mhe.support.processes import HERE, Place, Task, results
from sgms_mhe.support.tables import Table

Array = NDArray[np.float64]
Inject = Callable[[Array, Array, slice, np.random.Generator], None]
"""Changes position [m] and force [N] in place, within the part of the log that is faulty."""

RATE: Final = 10_000
LOG_S: Final = 18.0
START_S: Final = (8.0, 9.0)
"""When a fault begins, drawn from here: the parameters have been learned."""
AXES: Final = 3
TRUE_STIFFNESS: Final = (1.2, 0.85, 1.1, 0.95)
BEYOND: Final = 5.0
"""Stated deviations by which a reading departs that contradicts a good log."""


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


def _scaled(position_by: float, force_by: float) -> Inject:
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


def _quantised(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
    position[part] = np.round(position[part] / 1e-6) * 1e-6


def _clipped(position: Array, force: Array, part: slice, _: np.random.Generator) -> None:
    np.clip(force[part], -10.0, 10.0, out=force[part])


def _resampled(times: Callable[[Array, np.random.Generator], Array], of: Sequence[int] = (0, 1)) -> Inject:
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


FAULTS: Final = (
    Fault("force frozen", 0.3, _frozen(1)),
    Fault("force frozen", 2.0, _frozen(1)),
    Fault("position frozen", 0.3, _frozen(0)),
    Fault("position frozen", 2.0, _frozen(0)),
    Fault("encoder jumps by 10 um", 0.0, _jump(1e-5)),
    Fault("encoder jumps by 1 mm", 0.0, _jump(1e-3)),
    Fault("encoder wraps by 0.1 m", 0.5, _offset(0.1, 0.0)),
    Fault("encoder drifts by 1 mm/s", 1.0, _drifting),
    Fault("position's sign", 0.5, _scaled(-1.0, 1.0)),
    Fault("force's sign", 0.2, _scaled(1.0, -1.0)),
    Fault("force's gain 5 % off", 5.0, _scaled(1.0, 1.05)),
    Fault("force off by 1 N", 5.0, _offset(0.0, 1.0)),
    Fault("push of 50 N", 0.3, _offset(0.0, 50.0)),
    Fault("push of 500 N", 2.0, _offset(0.0, 500.0)),
    Fault("200 spikes of 40 N", 2.0, _spikes),
    Fault("noise of 1.6 N", 2.0, _noise(0.0, 1.6)),
    Fault("small garbage", 2.0, _noise(1e-6, 1.0, instead=True)),
    Fault("large garbage", 2.0, _noise(1.0, 1e3, instead=True)),
    Fault("force saturates at 10 N", 2.0, _clipped),
    Fault("force reads zero", 1.0, _scaled(1.0, 0.0)),
    Fault("encoder's steps 1 um", 2.0, _quantised),
    Fault("jitter of 20 us", 2.0, _resampled(lambda at, rng: at + 0.2 * rng.standard_normal(len(at)))),
    Fault("every sample twice", 1.0, _resampled(lambda at, rng: at - at % 2.0)),
    Fault("force late by 20 samples", 1.0, _resampled(lambda at, rng: at - 20.0, (1,))),
    Fault("one sample NaN", 1e-4, _missing((0, 1))),
    Fault("100 samples lost", 0.01, _missing((0, 1))),
    Fault("10000 samples lost", 1.0, _missing((0, 1))),
    Fault("position lost", 0.1, _missing((0,))),
    Fault("force infinite", 1e-3, _missing((1,), np.inf)),
)
"""What can happen to a log; each leaves numbers that an axis might have left, or none."""

VARIANTS: Final[Mapping[str, Mapping[str, Any]]] = {
    f"{kind} {precision}": {"estimator": {"kind": kind, "relinearise": "auto"}, "code": {"precision": precision}}
    for kind, precision in product(("mhe", "ekf"), ("double", "single"))
}
"""Packages that are tried, as changes of etel_xy."""


@dataclass(frozen=True)
class Outcome:
    """What one fault did to one estimator.

    Attributes:
        sigmas: largest error of a parameter over its stated deviation, from 1 s after good data are back.
        deviation: largest change of a parameter against the same log without fault, over nominal.
        recovery_s: from good data until the friction error stays within 1.5 times the largest of the log without fault.
        contradicts: whether a reading departs from the good log's by `BEYOND` stated deviations, or is lost.
        said: updates from the first that does until DOUBT or MISSING, that one included; 0: it was never said.
    """

    sigmas: float
    deviation: float
    recovery_s: float
    contradicts: bool
    said: int

    @property
    def matters(self) -> bool:
        """Whether the fault moved a parameter by a hundredth of nominal, or more, and shows in the readings."""
        return self.deviation > 0.01 and self.contradicts


@cache
def base_record(axis: int) -> Record:
    """One of the good logs."""
    config = AxisConfig(seed=axis)
    return simulate_record(load_machine("etel_xy"), TRUE_STIFFNESS, trajectory="mixed", duration_s=LOG_S, config=config)


def faulty(log: Log, fault: Fault, start: int, rng: np.random.Generator) -> Log:
    """The log with the fault from sample `start` on."""
    position, force = log.position_m.copy(), log.force_N.copy()
    fault.inject(position, force, slice(start, start + round(fault.duration_s * RATE)), rng)
    return replace(log, position_m=position, force_N=force)


class Trial:
    """One estimator over all good logs, to be tried on faulty ones."""

    def __init__(self, variant: str) -> None:
        self._machine = override_machine(load_machine("etel_xy"), VARIANTS[variant])
        self._estimator = CompiledEstimator(self._machine)
        self._stated = self._machine.estimator.noise.measurement
        self._nominal = np.array([parameter.nominal for parameter in self._estimator.model.parameters])
        self._good = [self._estimator.estimate_log(base_record(axis).run.log) for axis in range(AXES)]

    def doubted_when_clean(self) -> float:
        """Share of the updates of good logs that say DOUBT."""
        return float(np.mean([np.mean((good.status & FLAGS["doubt"]) > 0) for good in self._good]))

    def run(self, fault: Fault, seed: int) -> Outcome:
        """One injection."""
        rng = np.random.default_rng([seed, 7])
        axis, start_s = seed % AXES, float(rng.uniform(*START_S))
        record, good = base_record(axis), self._good[axis]
        found = self._estimator.estimate_log(faulty(record.run.log, fault, round(start_s * RATE), rng))
        time, back = found.time_s, start_s + fault.duration_s
        theta, std = found.parameters / self._nominal, found.std / self._nominal
        sigmas = np.max(np.abs(theta - record.theta) / std, axis=1)
        lost = (found.status < 0) | (found.status & FLAGS["missing"] > 0)
        departed = np.abs(found.friction_measured_N - good.friction_measured_N) > BEYOND * self._stated
        wrong = np.flatnonzero((lost | departed) & (time >= start_s))
        first = int(wrong[0]) if len(wrong) else len(time)
        said = np.flatnonzero((found.status & FLAGS["doubt"] > 0) | lost)
        said = said[said >= np.searchsorted(time, start_s)]
        return Outcome(
            sigmas=float(sigmas[time > back + 1.0].max()),
            deviation=float(np.max(np.abs(found.parameters - good.parameters)[time >= start_s] / self._nominal)),
            recovery_s=self._recovery(found, good, record, back),
            contradicts=len(wrong) > 0,
            said=max(1, int(said[0]) - first + 1) if len(said) else 0,
        )

    @staticmethod
    def _recovery(found: Estimates, good: Estimates, record: Record, back: float) -> float:
        normal = 1.5 * np.abs(good.friction_N - record.friction)[good.time_s > START_S[0]].max()
        wrong = found.time_s[(np.abs(found.friction_N - record.friction) > normal) & (found.time_s > back)]
        return float(max(0.0, wrong[-1] - back)) if len(wrong) else 0.0


@cache
def _trial(variant: str) -> Trial:
    """An estimator over the good logs, made once per process."""
    return Trial(variant)


def _part(index: int, runs: int) -> list[tuple[str, Outcome]]:
    """Every injection of a fault, for every variant."""
    return [(name, _trial(name).run(FAULTS[index], seed)) for name in VARIANTS for seed in range(runs)]


def _doubted(variant: str) -> float:
    return _trial(variant).doubted_when_clean()


def faults_study(runs: int, place: Place = HERE) -> Table:
    """The worst of `runs` injections of every class, for MHE and EKF in double and single precision."""
    tasks = [Task(f"{fault.name}-{index}", _part, (index, runs)) for index, fault in enumerate(FAULTS)]
    of_faults = results(tasks, place, done_of("faults"))
    doubted = results([Task(name, _doubted, (name,)) for name in VARIANTS], place)
    rows: list[dict[str, Any]] = []
    for fault, found in zip(FAULTS, of_faults, strict=True):
        mattered = [outcome for _, outcome in found if outcome.matters]
        name, worst = max(found, key=lambda pair: pair[1].sigmas)
        rows.append(
            {
                "fault": fault.name,
                "s": fault.duration_s,
                "sigmas": worst.sigmas,
                "of": name,
                "deviation": max(outcome.deviation for _, outcome in found),
                "recovery s": max(outcome.recovery_s for _, outcome in found),
                "mattered": len(mattered) / len(found),
                "said in 2": np.mean([0 < outcome.said <= 2 for outcome in mattered]) if mattered else None,
            }
        )
    clean = ", ".join(f"{name} {share:.2%}" for name, share in zip(VARIANTS, doubted, strict=True))
    return Table(
        f"The worst of {runs} injections of each fault, for each of {', '.join(VARIANTS)}",
        {
            "fault": "",
            "s": "g",
            "sigmas": ".1f",
            "of": "",
            "deviation": ".3f",
            "recovery s": ".2f",
            "mattered": ".0%",
            "said in 2": ".0%",
        },
        rows,
        (
            "sigmas: largest error of a parameter over its stated deviation, 1 s after good data or later;",
            "deviation: of a parameter against the log without fault, over nominal;",
            "recovery: until the friction error is that of a good log;",
            f"mattered: share that moved a parameter by 1 % of nominal, with readings that depart by {BEYOND:g} stated "
            "deviations;",
            "said in 2: those that said DOUBT, or MISSING, within two updates of the first such reading",
            f"updates of good logs that say DOUBT: {clean}",
        ),
    )
