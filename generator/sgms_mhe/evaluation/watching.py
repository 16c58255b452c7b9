"""Running summary of an estimator's updates, in memory that does not grow with them."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.model import Model
from sgms_mhe.model.effects import reported_name, shown_by
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.status import FLAGS, REFUSED, has_measurement, select_flags
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.statements import Rule, Statement

WORDS: Final[Mapping[str, str]] = {
    REFUSED: "refused: the last good estimate is kept",
    "doubt": "DOUBT: measurements contradict the model",
    "overrun": "samples were lost",
    "missing": "no valid reading",
    "speed": "faster than max_velocity",
    "bound": "a parameter is at its bound",
    "hold": "stands still, parameters hold",
    "filling": "the window is filling",
    "good": "good",
}
"""What the flags of a status say, the gravest first."""

FAULTS: Final = (REFUSED, "doubt", "overrun", "missing")
"""Flags of updates that something is wrong with, or was."""

TOLD: Final = 0.5
"""Deviation of a parameter over that of its prior from which on a run has told of it."""
TREND_POINTS: Final = 2048
"""Of a trend over the whole run at the most; an even number."""
RECENT_S: Final = 20.0
"""Seconds of which every update is kept."""
MERGED_S: Final = 1.0
"""Of two stretches with the same fault that are no further apart, one is made."""
EPISODES: Final = 100
"""Stretches that are kept, the first ones; all are counted."""


def flags_of(status: int) -> list[str]:
    """Names of the flags of a status, the gravest first."""
    if status < 0:
        return [REFUSED]
    return [name for name in WORDS if status & FLAGS.get(name, 0)] or ["good"]


def status_words(status: int) -> str:
    """Return the words of a status."""
    return "; ".join(WORDS[name] for name in flags_of(status))


class Trend:
    """Rows of numbers over a whole run, as points each stand for as many of them: for more and more of them.

    Args:
        greatest: which numbers a point has the greatest of (k,); of the others it has the last.

    Attributes:
        every: rows a point stands for.
    """

    def __init__(self, greatest: Mask) -> None:
        self._greatest = greatest
        self._points = np.empty((0, len(greatest)))
        self._waiting = np.empty((0, len(greatest)))
        self.every = 1

    @property
    def points(self) -> Array:
        """One row per point (p, k); the last one may stand for fewer rows."""
        return np.concatenate((self._points, self._merge(self._waiting, max(len(self._waiting), 1))))

    def add(self, rows: Array) -> None:
        """Take rows (n, k); the points do not depend on how many come at a time."""
        while len(rows):
            room = (TREND_POINTS - len(self._points)) * self.every - len(self._waiting)
            waiting, rows = np.concatenate((self._waiting, rows[:room])), rows[room:]
            full = len(waiting) // self.every * self.every
            self._points = np.concatenate((self._points, self._merge(waiting[:full], self.every)))
            self._waiting = waiting[full:]
            if len(self._points) == TREND_POINTS:
                self._points, self.every = self._merge(self._points, 2), 2 * self.every

    def _merge(self, rows: Array, count: int) -> Array:
        blocks = rows.reshape(-1, count, rows.shape[1])
        return np.where(self._greatest, np.fmax.reduce(blocks, axis=1), blocks[:, -1]) if len(rows) else rows


@dataclass
class Episode:
    """A stretch of updates with the same fault: the flag's name, its first and last update [s], how many there were."""

    fault: str
    start_s: float
    end_s: float
    updates: int


class RunSummary:
    """Summary of a run.

    Args:
        machine: of the estimator.
        model: its model.

    Attributes:
        updates, measured: how many, and how many took a measurement in.
        samples, missing: of the log; those without a position or a force.
        latest: the newest update, as a row; None before the first.
        first_s: time of the first update [s].
        greatest: the greatest test ratio and its time [s].
        trend: parameters (n_p), their deviations (n_p), test ratio and whether measurements were doubted, over the run.
        episodes: stretches with a fault, the first ones; `faults` counts all of them.
    """

    def __init__(self, machine: Machine, model: Model) -> None:
        self.machine = machine
        self.interval_s = machine.sampling.samples_per_update * machine.sampling.step
        self.names = tuple(p.column for p in model.parameters)
        self.nominal = np.array([p.nominal for p in model.parameters])
        self._prior = model.prior_std
        self.updates = self.measured = self.samples = self.missing = self.faults = 0
        self.latest: Estimates | None = None
        self.first_s = np.nan
        self.greatest = (np.nan, np.nan)
        n_p = len(self.names)
        self.trend = Trend(np.arange(2 * n_p + 2) >= 2 * n_p)
        self.episodes: list[Episode] = []
        self._recent: deque[Array] = deque(maxlen=max(2, round(RECENT_S / self.interval_s)))
        self._counts = dict.fromkeys(("good", *select_flags(np.empty(0, dtype=np.int64))), 0)
        self._open: dict[str, Episode] = {}
        self._squares = 0.0

    def add(self, estimates: Estimates) -> None:
        """Take the updates that follow; nothing depends on how many come at a time."""
        if not len(estimates):
            return
        e, flags = estimates, select_flags(estimates.status)
        if self.latest is None:
            self.first_s = float(e.time_s[0])
        taken = has_measurement(e.status)
        residual = (e.friction_measured_N - e.friction_N)[taken]
        self._squares = float(np.add.accumulate(np.concatenate(([self._squares], residual**2)))[-1])
        for name, mask in flags.items():
            self._counts[name] += int(np.count_nonzero(mask))
        self._counts["good"] += int(np.count_nonzero(e.status == 0))
        ratio = np.where(np.isfinite(e.test_ratio), e.test_ratio, -1.0)
        top = int(np.argmax(ratio))
        if ratio[top] >= 0.0 and not ratio[top] <= self.greatest[0]:
            self.greatest = (float(ratio[top]), float(e.time_s[top]))
        self._find_episodes(e, flags, taken)
        self.trend.add(np.column_stack((e.parameters, e.std, e.test_ratio, flags["doubt"])))
        self._recent.extend(np.column_stack((e.time_s, e.friction_measured_N, e.friction_N, e.innovation_N, taken)))
        self.updates += len(e)
        self.measured += int(np.count_nonzero(taken))
        self.latest = _last(e)

    @property
    def recent(self) -> Array:
        """Newest updates (r, 4): time [s], friction measured, NaN where it was not, and estimated, innovation [N]."""
        rows = np.array(self._recent).reshape(-1, 5)
        rows[np.ix_(rows[:, 4] == 0.0, [1, 3])] = np.nan
        return rows[:, :4]

    @property
    def residual_rms_N(self) -> float | None:
        """RMS of measured minus estimated friction over the updates with a measurement; None without one."""
        return float(np.sqrt(self._squares / self.measured)) if self.measured else None

    @property
    def open_numbers(self) -> dict[str, str]:
        """Motion each parameter needs of which the run has told little beyond its prior, by their columns."""
        if self.latest is None:
            return {}
        told = self.latest.std[0] <= TOLD * self._prior
        return {name: shown_by(name) for name, enough in zip(self.names, told.tolist(), strict=True) if not enough}

    def state(self, remarks: Sequence[str] = ()) -> tuple[Statement, ...]:
        """Return the statements on the run: its faults, the numbers at its end, remarks on the log."""
        last, units = self.latest, self.machine.plant.units
        if last is None:
            return ()
        rule = Rule.IN_DOUBT if set(flags_of(int(last.status[0]))) & {REFUSED, "doubt"} else Rule.DETERMINED
        opened = self.open_numbers
        return (
            Statement(Rule.FAULTY, "run", self.faults) if self.faults else Statement(Rule.FAULTLESS, "run", 0.0),
            *(
                replace(
                    Statement.of_number(
                        Rule.UNSEEN if name in opened else rule,
                        units.named(name),
                        float(value),
                        float(std),
                        units.unit(reported_name(name)),
                    ),
                    next=opened.get(name),
                )
                for name, value, std in zip(self.names, last.parameters[0], last.std[0], strict=True)
            ),
            *(
                Statement(Rule.FAULT, WORDS[e.fault], numbers={k: v for k, v in vars(e).items() if k != "fault"})
                for e in self.episodes
            ),
            *(Statement(Rule.REMARK, remark) for remark in remarks),
        )

    def summary(self) -> dict[str, Any]:
        """All of it as plain data, but for the trends."""
        last = self.latest
        return {
            "machine": self.machine.name,
            "samples": self.samples,
            "missing_samples": self.missing,
            "updates": self.updates,
            "measured": self.measured,
            "start_s": self.first_s,
            "end_s": np.nan if last is None else float(last.time_s[0]),
            "residual_rms_N": self.residual_rms_N,
            "parameters": {}
            if last is None
            else {
                name: {"nominal": float(p), "estimate": float(value), "std": float(std)}
                for name, p, value, std in zip(self.names, self.nominal, last.parameters[0], last.std[0], strict=True)
            },
            "status": dict(self._counts),
            "status_s": {name: count * self.interval_s for name, count in self._counts.items()},
            "greatest_test_ratio": {"value": self.greatest[0], "time_s": self.greatest[1]},
            "faults": self.faults,
            "episodes": [vars(episode) for episode in self.episodes],
        }

    def _find_episodes(self, e: Estimates, flags: Mapping[str, Mask], taken: Mask) -> None:
        """Stretches with a fault. Measurements are not missed before the first one: the signal chain settles."""
        begun = int(np.argmax(taken)) if taken.any() else len(taken)
        seen: list[tuple[int, str]] = []
        for fault in FAULTS:
            at = np.flatnonzero(flags[fault])
            if fault == "missing" and self.measured == 0:
                at = at[at > begun]
            seen += [(k, fault) for k in at.tolist()]
        for k, fault in sorted(seen):
            self._extend(fault, float(e.time_s[k]))

    def _extend(self, fault: str, time: float) -> None:
        last = self._open.get(fault)
        if last is not None and time - last.end_s <= MERGED_S:
            last.end_s, last.updates = time, last.updates + 1
            return
        self._open[fault] = Episode(fault, time, time, 1)
        self.faults += 1
        if len(self.episodes) < EPISODES:
            self.episodes.append(self._open[fault])


def _last(e: Estimates) -> Estimates:
    """The newest update as a row."""
    rows: dict[str, Any] = {name: a[-1:] for name, a in vars(e).items() if isinstance(a, np.ndarray)}
    return Estimates(**rows, parameter_names=e.parameter_names, kind=e.kind)
