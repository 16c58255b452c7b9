"""The clock of a log: its rate, its jitter, and whether the same step stands between all samples."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sgms_mhe.signals.logs import JITTER
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError

GAP = 2.5
"""Of the usual step: a longer one is a gap."""


@dataclass(frozen=True)
class Timing:
    """Time stamps of a log, summarised.

    Attributes:
        samples: how many there are.
        start: of the first [s].
        duration: from first to last [s].
        rate: mean samples per second, gaps left out [Hz].
        step: the usual time between two, their median [s].
        shortest: the shortest one [s]; `longest` the longest.
        jitter: standard deviation of the steps, gaps left out, over `step`.
        gaps: steps beyond GAP of the usual one.
    """

    samples: int
    start: float
    duration: float
    rate: float
    step: float
    shortest: float
    longest: float
    jitter: float
    gaps: int

    @property
    def uniform(self) -> bool:
        """Return True if every step is the usual one within the tolerance of a log."""
        return max(self.longest - self.step, self.step - self.shortest) <= JITTER * self.step


def measure_time(path: Path, time: Array, row: Callable[[int], str]) -> Timing:
    """Measure the clock. Raises InputError for fewer than two samples, and where time is absent, stands or falls."""
    if len(time) < 2:
        raise InputError(path, "rows", len(time), "at least 2 rows, better some seconds of motion")
    check_rising(path, time, row)
    steps = np.diff(time)
    usual = float(np.median(steps))
    within, gaps = steps[steps <= GAP * usual], steps[steps > GAP * usual]
    duration = float(time[-1] - time[0])
    return Timing(
        len(time),
        float(time[0]),
        duration,
        len(within) / (duration - float(gaps.sum())),
        usual,
        float(steps.min()),
        float(steps.max()),
        float(np.std(within) / usual),
        len(gaps),
    )


def check_rising(path: Path, time: Array, row: Callable[[int], str]) -> None:
    """Refuse a time that is absent, stands or falls, with the first row where it does."""
    steps = np.diff(time)
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(time[1:]) & (steps > 0)
    if not np.isfinite(time[0]):
        raise InputError(path, f"{row(0)}, column time_s", float(time[0]), "a finite time in every row")
    if not sound.all():
        first = int(np.argmin(sound)) + 1
        value = float(time[first])
        if not np.isfinite(value):
            allowed = "a finite time in every row"
        elif steps[first - 1] == 0.0:
            allowed = "a time after the previous row's (duplicate time: are the time stamps coarser than the samples?)"
        else:
            allowed = f"a time after the previous row's {time[first - 1]:.9g} s (time decreases)"
        raise InputError(path, f"{row(first)}, column time_s", value, allowed)


def check_steps(path: Path, time: Array, step: float, row: Callable[[int], str]) -> None:
    """Refuse time whose steps are not `step` [s] within a log's tolerance, with the first row that is off."""
    steps = np.diff(time)
    uneven = np.abs(steps - step) > JITTER * step
    if not uneven.any():
        return
    first = int(np.argmax(uneven))
    allowed = (
        f"uniform time within 1 %: a step of {step:.9g} s, not {steps[first]:.9g} s "
        "(a missing sample keeps its row, with NaN; [log] (machine file, --log) has resample = true for uneven time)"
    )
    raise InputError(path, f"{row(first + 1)}, column time_s", float(time[first + 1]), allowed)
