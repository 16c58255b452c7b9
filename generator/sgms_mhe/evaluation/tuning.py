"""Noise weights out of a log: those under which the innovations are as likely as they can be.

An estimator that predicts a measurement with the variance S and misses it by e finds that with the likelihood of a
normal number of that variance. Its mean over a record,

    L = mean( log(S) + min(e^2 / S, 25) ) / 2

is least for the weights that describe the axis: with too small a variance misses are punished, with too large a one the
variance is. A measurement five deviations off counts no more than that: it is a fault, and no reason to believe in
noise. The estimator that is asked is the filter without self-scaling, which carries the information of the window,
with one measurement per update: measurements that follow each other closely share their noise, and weights that
predict the next one best then believe too much. How many measurements an update may take is a matter of the signal
chain, not of likelihood.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from sgms_mhe.configuration import override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.recordings.output_error import Objective
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.signals.innovations import (
    LEAST_UPDATES,
    counted_innovations,
    innovation_loss,
    integrate_innovations,
    moving_updates,
)
from sgms_mhe.signals.logs import Log, align_velocity
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.notebooks import Presentation, Shown
from sgms_mhe.support.statements import Rule, Statement

Progress = Callable[[str], None]

STEPS: Final = (10.0, 10.0**0.5, 10.0**0.25)
"""Factors by which a weight is moved, one after the other, until neither way is better."""
ROUNDS: Final = 4
"""Over all weights, at the most."""
WORTH: Final = 2.0
"""Standard errors by which another weight has to be more likely than the file's."""
LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    "measurement": (1e-6, 1e6),
    "state": (1e-3, 1.0),
    "parameter_drift": (0.0, 0.1),
}
"""Weights that are tuned, in this order, within these limits: no friction law is right to less than a thousandth."""
DRIFT: Final = "parameter_drift"
HORIZONS: Final = (5, 10, 20, 40)


@dataclass(frozen=True)
class Trial:
    """One set of weights on the log.

    Attributes:
        changes: over the machine's [estimator.noise], and `horizon`.
        loss: L of each counted update (u).
        ratio: mean test ratio.
        force, motion: RMS of the innovations [N], and of the motion predicted over the machine's horizon [m].
    """

    changes: Mapping[str, float]
    loss: Array
    ratio: float
    force: float = math.nan
    motion: float = math.nan

    @property
    def mean(self) -> float:
        """L."""
        return float(self.loss.mean())

    def better_by(self, other: Self) -> float:
        """How much more likely than another, in standard errors of the difference over stretches of the log."""
        gain = np.array([part.mean() for part in np.array_split(other.loss - self.loss, 20)])
        error = float(gain.std(ddof=1)) / math.sqrt(len(gain))
        return float(gain.mean()) / max(error, 1e-300)


@dataclass(frozen=True, repr=False)
class Tuned(Shown):
    """Weights that suit a log.

    Attributes:
        machine: as it was.
        start: its own weights.
        best: the likeliest.
        horizon: that of the window with the likeliest weights; None: the machine's own will do, or it has no window.
        trials: everything that was tried, by weight: (value, trial).
        kept: weights that were moved, but by less than the log can tell: they stay as they are.
    """

    machine: Machine
    start: Trial
    best: Trial
    horizon: int | None
    trials: Mapping[str, tuple[tuple[float, Trial], ...]]
    kept: tuple[str, ...]

    @property
    def statements(self) -> tuple[Statement, ...]:
        """Return the statements on every weight that was moved, and on the log under them."""
        start, best, estimator = self.start, self.best, self.machine.estimator
        found = []
        for name in (name for name, tried in self.trials.items() if len(tried) > 1):
            own = float(estimator.horizon if name == "horizon" else getattr(estimator.noise, name))
            chosen = float(self.horizon or own) if name == "horizon" else best.changes.get(name, own)
            kept = Rule.EQUAL if name in self.kept else Rule.LIKELIEST
            found.append(Statement(kept if chosen == own else Rule.LIKELIER, name, chosen, numbers={"file": own}))
        numbers = {"before": start.ratio, "start": start.mean, "end": best.mean}
        found.append(Statement(Rule.RATIO, "mean test ratio", best.ratio, numbers=numbers))
        units, span_s = self.machine.plant.units, _updates(self.machine) / self.machine.sampling.update_rate
        found += [
            Statement(Rule.PREDICTED, about, after, None, unit, {"before": before})
            for about, before, after, unit in (
                ("error of the force, an update ahead", start.force, best.force, units.force),
                (f"error of the motion, {span_s:.2g} s ahead", start.motion, best.motion, units.position),
            )
        ]
        return (*found, Statement(Rule.CROWDED, "sampling.measurement_rate")) if self.crowded else tuple(found)

    def _shown(self) -> Presentation:
        rows = [(statement.line,) for statement in self.statements]
        return f"{self.machine.name}: {self.changes() or 'no other weights'}", ("statement",), rows

    @property
    def crowded(self) -> bool:
        """Return True if measurements follow each other more closely than the low-pass lets them differ."""
        sampling = self.machine.sampling
        return sampling.readings_per_update * sampling.update_rate > 2.0 * sampling.velocity_cutoff

    def changes(self) -> dict[str, Any]:
        """Return the changes in a machine file that extends the machine; empty where nothing is to be changed."""
        noise = {name: value for name, value in self.best.changes.items() if name in LIMITS}
        content: dict[str, Any] = {"estimator": {"noise": noise}} if noise else {}
        if self.horizon is not None:
            content.setdefault("estimator", {})["horizon"] = self.horizon
        return content


def tune(machine: Machine, log: Log, report: Progress = lambda _: None, objective: Objective = "force") -> Tuned:
    """Find the weights of a machine under which a log is likeliest, and the horizon that goes with them.

    One weight after the other is moved by falling factors until neither way is better, then all of them again. A weight
    not better by `WORTH` standard errors stays as it is.

    Raises:
        InputError: the log has too few updates in motion.
    """
    signals = signals_from_log(align_velocity(log), machine)
    search = _WeightSearch(machine, signals, log.source or "log", report, objective)
    start = best = search.trial({})
    for _ in range(ROUNDS):
        before = best
        for name in LIMITS:
            best = search.along(name, best)
        if best is before:
            break
    final = dict(best.changes)
    kept = []
    for name in list(final):  # what is worth nothing by itself goes back to the file's
        without = search.trial({key: value for key, value in final.items() if key != name})
        if search.trial(final).better_by(without) < WORTH:
            del final[name]
            kept.append(name)
    best = search.trial(final)
    horizon = search.horizon(best)
    return Tuned(machine, start, best, horizon, search.trials_by_weight(), tuple(kept))


class _WeightSearch:
    """Trials on one log, each made once."""

    def __init__(self, machine: Machine, signals: Signals, source: str, report: Progress, objective: Objective) -> None:
        self._machine, self._signals, self._source, self._report = machine, signals, source, report
        self._objective = objective
        self._trials: dict[tuple[tuple[str, float], ...], Trial] = {}
        self._counted: Mask | None = None
        self._estimators: dict[float | None, CompiledEstimator] = {}  # by horizon; None: the filter

    def value(self, name: str, changes: Mapping[str, float]) -> float:
        """A weight as it is under these changes."""
        return changes[name] if name in changes else float(getattr(self._machine.estimator.noise, name))

    def trial(self, changes: Mapping[str, float]) -> Trial:
        """Run the estimator with these weights."""
        key = tuple(sorted(changes.items()))
        if key not in self._trials:
            said = ", ".join(f"{name} {value:.3g}" for name, value in key) or "the file's weights"
            self._trials[key] = self._run(changes)
            self._report(f"{said}: {self._trials[key].mean:.4f}")
        return self._trials[key]

    def along(self, name: str, best: Trial) -> Trial:
        """The best trial along one weight."""
        low, high = LIMITS[name]
        if name == DRIFT:  # no log is long enough to say that nothing will ever drift
            low = self.value(name, {})
        for step in STEPS:
            for factor in (step, 1.0 / step):
                while True:
                    value = float(f"{self.value(name, best.changes) * factor:.3g}")
                    if not low <= value <= high:
                        break
                    tried = self.trial({**best.changes, name: value})
                    if not tried.mean < best.mean:
                        break
                    best = tried
        return best

    def horizon(self, best: Trial) -> int | None:
        """The shortest window than which none is likelier, of a machine that has one; None: its own."""
        own = self._machine.estimator.horizon
        if self._machine.estimator.kind != "mhe":
            return None
        trials = {n: self.trial({**best.changes, "horizon": float(n)}) for n in sorted({*HORIZONS, own})}
        likeliest = min(trials.values(), key=lambda trial: trial.mean)
        shortest = next(n for n, trial in trials.items() if likeliest.better_by(trial) < WORTH)
        return None if shortest == own else shortest

    def trials_by_weight(self) -> dict[str, tuple[tuple[float, Trial], ...]]:
        """The likeliest trial at each value of each weight, whatever the others were in it."""
        found: dict[str, tuple[tuple[float, Trial], ...]] = {}
        for name in (*LIMITS, "horizon"):
            # Weights are moved without a window: its loss is another one.
            own = [t for t in self._trials.values() if ("horizon" in t.changes) == (name == "horizon")]
            by_likelihood = sorted(own, key=lambda trial: trial.mean, reverse=True)  # of one value the last one stays
            found[name] = tuple(sorted({self.value(name, trial.changes): trial for trial in by_likelihood}.items()))
        return found

    def _run(self, changes: Mapping[str, float]) -> Trial:
        window = {"horizon": int(changes["horizon"])} if "horizon" in changes else {"kind": "ekf"}
        noise = {name: value for name, value in changes.items() if name in LIMITS}
        content = {
            "estimator": {"noise": {**noise, "self_scaling": False}, **window},
            "code": {"precision": "double"},
            "sampling": {"measurement_rate": self._machine.sampling.update_rate},
        }
        machine = override_machine(self._machine, content)
        horizon = changes.get("horizon")
        if horizon not in self._estimators:  # one for all weights
            self._estimators[horizon] = CompiledEstimator(machine)
        estimates = self._estimators[horizon].estimate(self._signals, weights=build_model(machine))
        if self._counted is None:  # by the file's own weights, the same for all
            self._counted = moving_updates(estimates)
            if int(self._counted.sum()) < LEAST_UPDATES:
                allowed = f"at least {LEAST_UPDATES}: a log in which the axis moves for longer"
                raise InputError(self._source, "updates with a reading in motion", int(self._counted.sum()), allowed)
        pushed = counted_innovations(estimates, self._counted)
        updates, sampling, plant = _updates(self._machine), self._machine.sampling, self._machine.plant
        moved = integrate_innovations(*pushed, updates)
        by_force, by_motion = innovation_loss(*pushed), innovation_loss(*moved)
        both = by_force[updates - 1 :] + by_motion
        loss = {"force": by_force, "motion": by_motion, "both": both}[self._objective]
        force, motion = (float(np.sqrt(np.mean(error**2))) for error, _ in (pushed, moved))
        ratio = float(np.mean(pushed[0] ** 2 / pushed[1]))
        return Trial(dict(changes), loss, ratio, force, motion / sampling.update_rate**2 / plant.moved)


def _updates(machine: Machine) -> int:
    """Return the number of updates that motion is predicted over: the machine's horizon, where a log has as many."""
    return min(machine.estimator.horizon, LEAST_UPDATES)
