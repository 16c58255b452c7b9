"""Kind of package of a machine: pieces of code that come or stay away, and the statuses it states."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.model import Model
from sgms_mhe.signals.status import FLAGS, STALE


@dataclass(frozen=True)
class Variant:
    """The choices of one package; templates ask for them by name.

    Attributes:
        single: single precision.
        horizon: intervals of the window; 0 for the filter.
        relinearise: which older intervals an update linearises anew; "newest" where there are none.
        fixed: the arrival cost keeps its weights.
        bounded: a parameter has a bound.
        resumes: the sweep begins where something has changed: the factor before an interval stays while
            linearisations are kept and the output is affine in the estimated numbers.
        rounding: share of a measurement's noise that velocities kept in single precision cost at most; 0: they are not.
        thins: every second factor of the sweep is kept; the one between is found again where it is needed.
        merges: a step of the series is a line through several samples.
        self_scaling: readings are weighed by how well they were predicted.
    """

    single: bool
    horizon: int
    relinearise: Literal["all", "auto", "newest"]
    fixed: bool
    bounded: bool
    resumes: bool
    rounding: float
    thins: bool
    merges: bool
    self_scaling: bool

    @property
    def has_series(self) -> bool:
        """Return True if the series of older intervals is stored, because they may be integrated again."""
        return self.relinearise != "newest"

    @property
    def most_condensed(self) -> int:
        """Intervals that a sweep condenses at most, the newest aside."""
        return max(0, self.horizon - 1) + self.thins

    @property
    def keeps_inner(self) -> bool:
        """Return True if the measurements inside an older interval stay as they were linearised."""
        return self.horizon > 0 and self.relinearise != "all"

    @property
    def drifts(self) -> bool:
        """Return True if the parameters' drift enters; with a fixed arrival cost there is nothing for it to enter."""
        return not (self.fixed and self.horizon)


def variant_of(model: Model) -> Variant:
    """The choices a machine and its model ask for."""
    machine = model.machine
    sampling, estimator = machine.sampling, machine.estimator
    horizon = estimator.horizon if estimator.kind == "mhe" else 0
    # The newest interval is integrated as it is sampled: only older ones need their series again, or lanes.
    relinearise = estimator.relinearise if horizon > 1 else "newest"
    fixed = estimator.arrival_cost.update == "fixed"
    resumes = horizon > 0 and relinearise != "all" and not fixed and model.output_is_affine
    bounds = [edge for p in model.parameters for edge in (p.lower, p.upper)]
    return Variant(
        single=machine.code.precision == "single",
        horizon=horizon,
        relinearise=relinearise,
        fixed=fixed,
        bounded=bool(np.any(np.isfinite(bounds))),
        resumes=resumes,
        rounding=model.rounding if relinearise == "auto" else 0.0,
        # The noise of an interval by its path is another's as soon as that has come to its end.
        thins=resumes and machine.code.accuracy > 0.0 and not np.any(model.noise_travel),
        merges=sampling.merged > 1,
        self_scaling=estimator.noise.self_scaling,
    )


REFUSALS: Final[Mapping[str, int]] = {
    "early": -1,
    "numeric": -2,
    "overlap": -3,
    "mismatch": -4,
    "refused": -5,
    "arithmetic": -6,
    "unstarted": -7,
}
"""Statuses by which a call is refused."""


@dataclass(frozen=True)
class Status:
    """One status.

    Attributes:
        name: of its constant, without the machine's prefix.
        value: a power of two, or negative where a call is refused.
        meaning: of the flag.
        remedy: action of the application.
    """

    name: str
    value: int
    meaning: str
    remedy: str


def statuses_of(machine: Machine, variant: Variant) -> tuple[Status, ...]:
    """All statuses but OK: flags first, then refusals."""
    limit, unit = machine.sampling.max_velocity, machine.plant.units.velocity
    said = {
        "filling": ("the window is not full yet", "Nothing: it is over by itself."),
        "missing": (
            "the newest measurement is missing, or bridged",
            "Nothing for single ones. Many: check encoder, drive and what the fast task hands over.",
        ),
        "hold": ("the axis hardly moved: parameters hold", "Nothing: friction goes on, parameters wait for motion."),
        "bound": (
            "a parameter is at its bound",
            "Do not trust that parameter. Where it stays: another axis's machine file, or bounds too narrow.",
        ),
        "speed": (
            f"faster than max_velocity, {limit} {unit}",
            "Do not learn from it. Where the axis may be so fast, raise `max_velocity` and generate again.",
        ),
        "overrun": (
            "samples were lost: feedback was not called in time, or a count of them is damaged",
            "Give the slow task more time: it has to be done once in an interval. The force ramps to zero meanwhile.",
        ),
        "doubt": (
            "measurements contradict the model beyond their stated noise"
            + (": they count less" if variant.self_scaling else ""),
            "Where it lasts: record a log and ask `sgms-mhe diagnose`; something on the axis is not in its model."
            + (" The force ramps to zero meanwhile." if machine.compensation.on_doubt == "ramp" else ""),
        ),
        "stale": (
            "of estimate(): no update for more than two intervals",
            "Do not use it. See that feedback, or tick, is called; until then the force ramps to zero.",
        ),
        "early": ("feedback before the interval was complete", "Call it only when due() says so."),
        "numeric": (
            "the solution was not finite or absurd: the window starts anew from the last good estimate",
            "Nothing for one. Often: the machine file does not describe this axis.",
        ),
        "overlap": (
            "calls of two tasks overlapped, as feedback while prepare was under way; see above",
            "Call feedback again once prepare has returned. Often: the slow task is too slow.",
        ),
        "mismatch": (
            "the application was compiled against another header than this package's",
            "Do not start. Compile all of the application against the header of this folder.",
        ),
        "refused": (
            "of a call that sets or loads: a number out of its range, or saved data damaged or another machine's; "
            "of an update: settings in memory are not those of init",
            "The header says at each call what it leaves behind. After load(): a fresh start, that has to learn again. "
            "Of an update: init, which sets them anew; until then the force ramps to zero.",
        ),
        "arithmetic": (
            "numbers are not those of IEEE 754 as the code needs them: NaN, subnormals, rounding",
            "Do not start. Compile without options that relax arithmetic; leave flush-to-zero off.",
        ),
        "unstarted": (
            "init() has not set this memory up: nothing is taken in, all numbers are 0",
            "Call init before any other call.",
        ),
    }
    values = {**FLAGS, "stale": STALE, **REFUSALS}
    return tuple(Status(name.upper(), values[name], *texts) for name, texts in said.items())
