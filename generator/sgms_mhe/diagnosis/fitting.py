"""Models fitted to a recording: compiled code along the motion, damped Gauss-Newton, block-wise evidence."""

from __future__ import annotations

import copy
import ctypes
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from sgms_mhe.configuration import make_machine, override_machine
from sgms_mhe.diagnosis.evidence import nuisance
from sgms_mhe.diagnosis.residuals import Recording
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.emission.provenance import digest_of_sources
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.model.scales import scales_of
from sgms_mhe.signals.chain import Signals
from sgms_mhe.support import cache

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHUNK: Final = 200_000  # samples that are predicted at a time; bounds the memory of derivatives
ITERATIONS: Final = 12
COHERENT: Final = 16  # rows over which the model's own error keeps its sign: a reversal
TIMING: Final = 0.1  # of a sample: how far force and position may be apart without that being a delay
TIMED: Final = ("force_delay", "actuator_lag")
ALIGNABLE: Final = 0.1  # largest difference that a longer step may make, over the friction
UNSTABLE: Final = 1e6  # derivative over the largest friction: no step was short enough
LAGGING: Final = 0.2
"""Largest step of the states behind delays and lags: theirs are the derivatives of the force, and 1 makes a jerk half
as large again."""
ENOUGH: Final = 10.0  # rows' worth of noise that a step must promise in a search
SETTLED: Final = 0.01  # the same where numbers are reported: a tenth of a standard deviation
BASE_PRIOR: Final = 1.0  # relative; holds what the record does not excite
FROZEN: Final[Mapping[str, tuple[str, ...]]] = {"step_disturbance": ("time_s",)}
"""Parameters in which the force jumps: their search ends on the grid, not in a refit."""

FASTEST_STRIBECK: Final = 0.1  # largest Stribeck velocity, over the largest speed
LONGEST_LAG: Final = 0.05  # s; a current loop that is later does not hold an axis
FAST: Final = ("force_delay", "actuator_lag", "structural_resonance", "asymmetric_coulomb")
"""Effects about as fast as a sample of the record, or with a level that jumps: always fitted at its full rate."""

BASE_GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "stiffness": ("stiffness",),
    "coulomb": ("coulomb",),
    "viscous": ("viscous",),
    "stribeck": ("stribeck_ratio", "stribeck_velocity"),
}
"""Wrong numbers of the base model that can be named, and the parameters that each of them means."""


class FitError(RuntimeError):
    """A model that cannot be fitted to this record: it is not finite where its fit starts."""


@dataclass(frozen=True)
class Extra:
    """An effect under test and where its fit starts."""

    name: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Column:
    """One free parameter of the compiled model.

    Attributes:
        group: what it belongs to: a base group, `machine:<label>` of an effect that the machine has, or `+<index>` of
            an effect under test.
        effect: name of the effect, empty for the base model's.
        name: in SI results (`stiffness_1`, `coulomb`, `amplitude_N`).
        nominal, scale: p = nominal + scale (theta - 1).
        machine_theta: value that the machine file states (an effect under test: 1).
        lower, upper: of theta.
        frozen: not fitted.
    """

    group: str
    effect: str
    name: str
    nominal: float
    scale: float
    machine_theta: float
    lower: float
    upper: float
    frozen: bool

    def si(self, theta: float) -> float:
        """Value in SI units."""
        return self.nominal + self.scale * (theta - 1.0)

    def theta(self, si: float) -> float:
        """Scaled value."""
        return (si - self.nominal) / self.scale + 1.0


class CompiledFit(CompiledModel):
    """The emitted model along a recording, in pieces of bounded memory, reduced to the fit's rate."""

    def __init__(self, machine: Machine, columns: tuple[Column, ...]) -> None:
        super().__init__(machine, cached_package(machine))
        self.columns = columns

    def ordered(self, places: Sequence[int]) -> CompiledFit:
        """The same code for effects under test in another order: `places[i]` is where number i stands in the order."""
        other = copy.copy(self)
        other.columns = tuple(
            replace(c, group=f"+{places[int(c.group[1:])]}") if c.group.startswith("+") else c for c in self.columns
        )
        return other

    def run(self, recording: Recording, theta: Array, *, derivatives: bool = True) -> tuple[Array, Array | None]:
        """Friction (m) [N] and its derivatives in theta (m, n_p)."""
        signals, factor = recording.signals, recording.factor
        n, n_x, n_p = len(signals), self.model.n_x, self.model.n_p
        m = len(recording.time)
        state, sensitivity = np.zeros(n_x), np.zeros((n_x, n_p))
        values = np.ascontiguousarray(theta, dtype=np.float64)
        force, slopes = np.empty(m), np.empty((m, n_p)) if derivatives else None
        rows = max(1, CHUNK // factor)
        for first in range(0, m, rows):
            last = min(m, first + rows)
            start, end = first * factor, min(n, last * factor)
            back = min(start, 1)  # the piece begins with the sample that its state belongs to
            part = slice(start - back, end)
            w = np.column_stack(
                [
                    signals.position[part],
                    signals.velocity[part],
                    signals.acceleration[part],
                    signals.force[part],
                    recording.clock[part],
                ]
            )
            y = np.empty(len(w))
            d = np.empty((len(w), n_p)) if derivatives else None
            self._library.sgms_predict(
                ctypes.c_long(len(w)),
                ctypes.c_void_p(w.ctypes.data),
                ctypes.c_void_p(values.ctypes.data),
                ctypes.c_void_p(state.ctypes.data),
                ctypes.c_void_p(sensitivity.ctypes.data),
                ctypes.c_void_p(y.ctypes.data),
                None if d is None else ctypes.c_void_p(d.ctypes.data),
            )
            force[first:last] = y[back:].reshape(last - first, factor).mean(axis=1)
            if slopes is not None and d is not None:
                slopes[first:last] = d[back:].reshape(last - first, factor, n_p).mean(axis=1)
        return force, slopes


@dataclass(frozen=True)
class Fit:
    """A model fitted to the recording.

    Attributes:
        model: its compiled code.
        theta: (n_p).
        free: parameters that were fitted (n_p).
        loose: those of them that no bound holds (n_p): the directions that the data may still move.
        residual: measured minus model (m) [N].
        slopes: d(model)/d(theta) (m, n_p).
        loss: sum of squared residuals per block (blocks).
        cross: the same, each block predicted by a fit without its fold (blocks).
        rows: used rows per block (blocks).
    """

    model: CompiledFit
    extras: tuple[Extra, ...]
    theta: Array
    free: Mask
    loose: Mask
    residual: Array
    slopes: Array
    loss: Array
    cross: Array
    rows: Array

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the effects under test."""
        return tuple(dict.fromkeys(c.group for c in self.model.columns if c.group.startswith("+")))

    @property
    def rms(self) -> float:
        """RMS of the residual on used rows [N]."""
        return math.sqrt(float(self.loss.sum() / self.rows.sum()))

    @property
    def cross_rms(self) -> float:
        """RMS by cross-validation [N]."""
        return math.sqrt(max(0.0, float(self.cross.sum() / self.rows.sum())))

    @property
    def numbers(self) -> int:
        """How many numbers it has beyond the machine file's; a searched one counts like a fitted one."""
        return sum(
            bool(f) or (c.frozen and c.group.startswith("+"))
            for c, f in zip(self.model.columns, self.free, strict=True)
        )

    def values(self, group: str) -> dict[str, float]:
        """SI values of a group's parameters."""
        return {c.name: c.si(t) for c, t in zip(self.model.columns, self.theta, strict=True) if c.group == group}

    def groups(self) -> tuple[str, ...]:
        """Groups with a fitted parameter."""
        return tuple(dict.fromkeys(c.group for c, f in zip(self.model.columns, self.free, strict=True) if f))


class Workshop:
    """Compiles models and fits them to one recording; remembers what it compiled."""

    def __init__(self, machine: Machine, recording: Recording) -> None:
        self.machine = machine
        self.recording = recording
        self.measured = recording.friction  # (m) [N], before any alignment
        self.rows = recording.sum_blocks(np.ones(len(recording.time)))
        self.noise = 1.0  # N, weight of the prior
        self.enough = ENOUGH
        self.sampled = np.zeros(2)  # coefficients of jerk and snap that `align` took out
        self.fits = 0
        self.starts: dict[str, float] = {}  # SI, for base numbers that the machine file gives no idea of
        self.fine: Workshop | None = None  # what this one was thinned from
        self.other: Workshop | None = None  # the same axis with the other transition from sticking to slipping
        self._known: dict[object, Fit] = {}

    def thinned(self, factor: int) -> Workshop:
        """The same record with the mean signals of `factor` samples, a divisor of the recording's own factor.

        Means keep displacements exact. What else a longer step changes, `align` takes out.
        """
        recording = self.recording
        if factor == 1:
            return self
        rate = self.machine.sampling.rate / factor
        n = len(recording.time) * recording.factor

        def mean(series: Array) -> Array:
            return np.asarray(series[:n].reshape(-1, factor).mean(axis=1))

        changes = {
            "sampling": {
                "rate": rate,
                "update_rate": rate,
                "velocity_cutoff": min(self.machine.sampling.velocity_cutoff, 0.4 * rate),
                "integrator": {"substeps": 1},
            }
        }
        machine = override_machine(_without_bounds(self.machine), changes)
        signals = recording.signals
        thin = Signals(
            time=mean(signals.time),
            position=mean(signals.position),
            velocity=mean(signals.velocity),
            acceleration=mean(signals.acceleration),
            force=mean(signals.force),
            friction=mean(signals.friction),
            valid=np.asarray(signals.valid[:n].reshape(-1, factor).all(axis=1)),
            missing=np.asarray(signals.missing[:n].reshape(-1, factor).any(axis=1)),
            late=signals.late,
        )
        clock = mean(recording.clock)
        less = replace(recording, machine=machine, signals=thin, clock=clock, factor=recording.factor // factor)
        other = Workshop(machine, less)
        other.noise, other.starts, other.fine = self.noise, self.starts, self
        return other

    def align(self, fit: Fit) -> None:
        """Bring measured friction into line with the model at a fit, where the difference says nothing about friction.

        Three things are taken out of it: half a step of viscous force (`_since_mean_velocity`). What is of the sampling
        (`_sampling`), unless a delay or lag is under test. And where this workshop is a thinned one, the difference of
        its model's friction to that of the one it was thinned from: residuals here are then those of the full rate, but
        for the change of that difference away from the fit.
        """
        whole = self.fine or self
        exact = whole.friction(fit)
        used = self.recording.used
        if not np.all(np.isfinite(exact)):
            return
        measured = whole.measured - self._since_mean_velocity(fit)
        names = {e.name for e in fit.extras} | {e.name for e in self.machine.effects}
        self.sampled = self._sampling(fit, measured - exact) if not names & set(TIMED) else np.zeros(2)
        measured = measured - self._jerk_and_snap @ self.sampled
        whole.recording = replace(whole.recording, friction=measured)
        whole._known.clear()
        if whole is self:
            return
        thin = self.friction(fit)
        self._known.clear()
        # What is no small difference is a model that the longer steps do not suit: it is fitted at the full rate.
        if float(np.std((exact - thin)[used])) < ALIGNABLE * float(np.std(exact[used])):
            self.recording = replace(self.recording, friction=measured - (exact - thin))

    def friction(self, fit: Fit) -> Array:
        """Friction (m) [N] of this workshop's machine, at its rate, with the numbers of a fit."""
        values = {(c.group, c.name): c.si(t) for c, t in zip(fit.model.columns, fit.theta, strict=True)}
        model = self.model(fit.extras)
        theta = np.array([c.theta(values[c.group, c.name]) for c in model.columns])
        return model.run(self.recording, theta, derivatives=False)[0]

    def _since_mean_velocity(self, fit: Fit) -> Array:
        """What friction has changed by since the mean velocity of the sample that ends with it (m) [N].

        The chain's velocity is a mean over a sample: that is what displacements need, but as a speed it is half a
        sample old. A force is sampled in a point, so viscous friction shows an acceleration h / 2 more of it, which
        looks like a mass of sigma_v h / 2. Sliding elements are taken for it: no other state knows so fast a change.
        """
        recording, model = self.recording, fit.model.model
        v = recording.velocity
        chi = np.zeros((model.n_x, len(v)))
        chi[: model.n_z] = np.sign(v)
        theta = np.tile(fit.theta[:, None], len(v))
        later = v + 0.5 * (self.fine or self).machine.sampling.step * recording.acceleration
        output = model.function("output")

        def force(velocity: Array) -> Array:
            w = np.stack((recording.position, velocity, recording.acceleration, recording.force, recording.time))
            return np.asarray(output(chi, w, theta)).ravel()

        return np.asarray(force(later) - force(v))

    def _sampling(self, fit: Fit, residual: Array) -> Array:
        """Coefficients of `_jerk_and_snap` (2) in what a residual (m) owes to the sampling of force and position alone.

        Proportional to the jerk: force and position up to `TIMING` of a sample apart. Proportional to the second
        derivative of the acceleration: its second difference over a sample h is low by h^2 / 12 of that, against a
        force that is sampled in a point.
        """
        used = self.recording.used
        step, mass = (self.fine or self).machine.sampling.step, self.machine.plant.mass
        free = nuisance(fit.slopes[used][:, fit.loose])
        scale = mass * np.array([TIMING * step, step**2 / 12.0])
        Z = free.project(self._jerk_and_snap[used] * scale)
        e = free.project(residual[used])
        bounded = lsq_linear(Z, e, ([-1.0, -1.0], [1.0, 0.0])).x
        if abs(bounded[0]) > 1.0 - 1e-6:  # more than sampling: all of it is for a delay or lag to explain
            bounded = np.array([0.0, *lsq_linear(Z[:, 1:], e, ([-1.0], [0.0])).x])
        return np.asarray(scale * bounded)

    @cached_property
    def _jerk_and_snap(self) -> Array:
        """First and second derivative of the acceleration (m, 2), as the log's samples have them."""
        whole = self.fine or self
        step = whole.machine.sampling.step
        jerk = np.gradient(whole.recording.signals.acceleration) / step
        return whole.recording.reduce(np.column_stack((jerk, np.gradient(jerk) / step)))

    def residual_along(self, fit: Fit, sampled: Array) -> Array:
        """Measured minus simulated friction (m) [N] of a fit to another part of this record.

        `sampled`: what its alignment found of the sampling.
        """
        measured = self.measured - self._since_mean_velocity(fit) - self._jerk_and_snap @ sampled
        return np.asarray(measured - self.friction(fit))

    def model(self, extras: Sequence[Extra]) -> CompiledFit:
        """The machine with effects added, everything in it a free parameter."""
        keys = [(e.name, _snapped(self.machine, e)) for e in extras]
        # Compiled in the order of their names: what order effects were found in must not cost another compilation.
        places = sorted(range(len(keys)), key=lambda i: keys[i])
        compiled = compiled_fit(_Key(self.machine, tuple(keys[i] for i in places)))
        return compiled if places == list(range(len(keys))) else compiled.ordered(places)

    def suited(self, extras: Sequence[Extra]) -> Workshop:
        """The workshop whose rate suits these effects: this one, or the one that it was thinned from."""
        return self.fine if self.fine is not None and any(e.name in FAST for e in extras) else self

    def start(self, model: CompiledFit, extras: Sequence[Extra], warm: Fit | None = None) -> Array:
        """Parameters to start from: the machine's, a warm fit's where it has them, the proposals' otherwise."""
        known = {}
        if warm is not None:
            known = {(c.group, c.name): c.si(t) for c, t in zip(warm.model.columns, warm.theta, strict=True)}
        wanted = {(f"+{i}", key): value for i, extra in enumerate(extras) for key, value in extra.parameters.items()}
        theta = np.array(
            [
                c.theta(wanted[c.group, c.name])
                if (c.group, c.name) in wanted
                else c.theta(known[c.group, c.name])
                if (c.group, c.name) in known and not c.group.startswith("+")
                else c.theta(self.starts[c.name])
                if c.name in self.starts
                else c.machine_theta
                for c in model.columns
            ]
        )
        return np.asarray(np.clip(theta, [c.lower for c in model.columns], [c.upper for c in model.columns]))

    def fit(
        self,
        extras: Sequence[Extra],
        *,
        base: Sequence[str] | None = None,
        warm: Fit | None = None,
        rows: Mask | None = None,
        iterations: int = ITERATIONS,
        again: bool = False,
    ) -> Fit:
        """Fit the machine with effects added.

        Args:
            extras: effects and their starting values.
            base: groups of the machine's own numbers that are free; None: all.
            warm: a fit whose base parameters to start from.
            rows: rows that the fit sees (m); None: all used ones.
            iterations: at most.
            again: fit even what is known, from `warm`, and keep the better one.
        """
        key = (
            tuple((e.name, tuple(e.parameters.items())) for e in extras),
            None if base is None else tuple(sorted(base)),
            None if rows is None else rows.tobytes(),
        )
        known = self._known.get(key)
        if known is None or again:
            fit = self._fit(extras, base, warm, rows, iterations)
            self._known[key] = fit if known is None or fit.rms < known.rms else known
        return self._known[key]

    def _fit(
        self, extras: Sequence[Extra], base: Sequence[str] | None, warm: Fit | None, rows: Mask | None, iterations: int
    ) -> Fit:
        self.fits += 1
        shop = self.suited(extras)
        if shop is not self:
            return shop.fit(extras, base=base, warm=warm, rows=rows, iterations=iterations)
        try:
            return self._fit_here(extras, base, warm, rows, iterations)
        except FitError:
            if self.fine is None:
                raise
        return self.fine.fit(extras, base=base, warm=warm, rows=rows, iterations=iterations)

    def _fit_here(
        self, extras: Sequence[Extra], base: Sequence[str] | None, warm: Fit | None, rows: Mask | None, iterations: int
    ) -> Fit:
        """Fit at this workshop's own rate."""
        model = self.model(extras)
        columns = model.columns
        theta = self.start(model, extras, warm)
        free = np.array(
            [not c.frozen and (c.group.startswith("+") or base is None or c.group in base) for c in columns],
            dtype=np.bool_,
        )
        held = ~free & np.array([not c.group.startswith("+") for c in columns], dtype=np.bool_)
        theta[held] = [c.machine_theta for c, h in zip(columns, held, strict=True) if h]
        seen = self.recording.used if rows is None else rows
        theta, residual, slopes = self._descend(model, theta, free, seen, iterations)
        # A parameter that its bound holds moves neither with a candidate nor from fold to fold.
        loose = free & ~_held(columns, theta, slopes[seen].T @ residual[seen], self.recording)
        recording = self.recording
        loss = recording.sum_blocks(residual**2)
        cross = cross_loss(recording, slopes[:, loose], residual, self._prior(model, loose))
        extras = tuple(
            Extra(e.name, {c.name: c.si(t) for c, t in zip(model.columns, theta, strict=True) if c.group == f"+{i}"})
            for i, e in enumerate(extras)
        )
        return Fit(model, extras, theta, free, loose, residual, slopes, loss, cross, self.rows)

    def _prior(self, model: CompiledFit, free: Mask) -> Array:
        """Information of the prior in units of the sum of squares, (free)."""
        sd = np.array([BASE_PRIOR if not c.group.startswith("+") else 10.0 for c in model.columns])
        return np.asarray((self.noise / sd[free]) ** 2)

    def _descend(
        self, model: CompiledFit, theta: Array, free: Mask, seen: Mask, iterations: int
    ) -> tuple[Array, Array, Array]:
        """Levenberg-Marquardt on the rows seen; returns theta, residual (m), slopes (m, n_p)."""
        recording, columns = self.recording, model.columns
        prior = self._prior(model, free)
        centre = np.array(
            [c.theta(self.starts[c.name]) if c.name in self.starts else c.machine_theta for c in columns]
        )[free]
        is_base = np.array([not c.group.startswith("+") for c in columns])[free]
        prior_rows = np.where(is_base, prior, 0.0)
        lower, upper = _bounds(columns, recording)
        lower, upper = lower[free], upper[free]
        limit = np.array([_step_limit(c, t, recording) for c, t in zip(columns, theta, strict=True)])[free]
        theta = theta.copy()
        theta[free] = np.clip(theta[free], lower, upper)
        largest = UNSTABLE * max(float(np.max(np.abs(recording.friction))), self.machine.friction.coulomb)

        def evaluate(at: Array) -> tuple[Array, Array, float]:
            y, slopes = model.run(recording, at)
            residual = recording.friction - y
            if not float(np.max(np.abs(residual))) < largest:
                return residual, np.empty((0, 0)), math.inf
            cost = float(residual[seen] @ residual[seen]) + float(prior_rows @ (at[free] - centre) ** 2)
            # A state that its steps are too long for shows in its derivatives first.
            if slopes is None or not math.isfinite(cost) or not float(np.max(np.abs(slopes))) < largest:
                return residual, np.empty((0, 0)), math.inf
            return residual, slopes, cost

        residual, slopes, cost = evaluate(theta)
        damping = 1e-4
        if not math.isfinite(cost):
            raise FitError("the model is not finite where its fit starts")
        if not free.any():
            return theta, residual, slopes
        for _ in range(iterations):
            X = slopes[seen][:, free]
            H = X.T @ X
            g = X.T @ residual[seen] - prior_rows * (theta[free] - centre)
            diagonal = np.diag(H) + prior
            # A step that promises less than the noise of a few rows is not worth an evaluation.
            enough = self.enough * cost / len(X)
            improved, promised = False, 0.0
            for _ in range(3):
                A = H + np.diag(prior_rows + damping * diagonal + 1e-12 * max(1e-30, float(diagonal.max())))
                step = _bounded_step(
                    A, g, np.maximum(-limit, lower - theta[free]), np.minimum(limit, upper - theta[free])
                )
                trial = theta.copy()
                trial[free] = theta[free] + step
                promised = float(2.0 * g @ step - step @ (H @ step) - prior_rows @ step**2)
                if not promised >= enough:
                    break
                new_residual, new_slopes, new_cost = evaluate(trial)
                if new_cost < cost:
                    improved = True
                    break
                damping = max(damping, 1e-3) * 30.0
            if not improved:
                break
            gain = cost - new_cost
            theta, residual, slopes, cost = trial, new_residual, new_slopes, new_cost
            damping = max(1e-8, damping * 0.1) if gain > 0.25 * promised else damping * 3.0
            if gain < enough:
                break
        return theta, residual, slopes

    def covariance(self, fit: Fit) -> Array:
        """Covariance of theta (n_p, n_p), 0 where not free.

        Four parts: noise, robust to colour within a block (sandwich); what the model gets wrong anywhere, which does
        not average out as noise does: its RMS beyond the noise floor, taken as coherent over `COHERENT` rows; what the
        law gets wrong, the same way at every reversal (`_law`); and of a delay or lag, the timing of force against
        position that no log is sure of.
        """
        recording = self.recording
        X = fit.slopes[:, fit.free]
        H = X[recording.used].T @ X[recording.used] + np.diag(self._prior(fit.model, fit.free))
        scores = np.column_stack([recording.sum_blocks(X[:, j] * fit.residual) for j in range(X.shape[1])])
        inverse = np.asarray(np.linalg.pinv(H, hermitian=True), dtype=np.float64)
        blocks = recording.blocks
        inner = inverse @ (scores.T @ scores) @ inverse * blocks / max(1, blocks - X.shape[1])
        # Blocks that happen to balance must not promise more than white noise would allow.
        white = inverse * fit.rms**2
        inner = np.where(np.eye(len(inner), dtype=bool), np.maximum(inner, white), inner)
        wrong = math.sqrt(max(0.0, fit.cross_rms**2 - self.noise**2))
        inner += inverse * COHERENT * wrong**2
        change = self._law(fit, inverse, wrong)
        inner += np.outer(change, change)
        timing = TIMING * (self.fine or self).machine.sampling.step / math.sqrt(3.0)
        late = [c.effect in TIMED and c.name.endswith("_s") for c in fit.model.columns]
        scale = np.array([timing / abs(c.scale) if at else 0.0 for c, at in zip(fit.model.columns, late, strict=True)])
        inner += np.diag(scale[fit.free] ** 2)
        result = np.zeros((len(fit.theta), len(fit.theta)))
        result[np.ix_(fit.free, fit.free)] = inner
        return result

    def _law(self, fit: Fit, inverse: Array, wrong: float) -> Array:
        """What the free parameters may be off by because the axis does not slip as the law says (free).

        An axis switches, a law is smooth, and the difference comes back at every reversal: no average over blocks sees
        it. How it acts on each number is what a change of the law does: the other transition's friction minus this
        one's is split into what the free parameters make up for, which moves them, and what they cannot. As much of the
        latter as the residual has beyond noise (`wrong` [N]), so much of the former is in the numbers.
        """
        nothing = np.zeros(len(inverse))
        if self.other is None:
            return nothing
        used = self.recording.used
        change = (self.other.fine or self.other).friction(fit)[used] - (self.fine or self).friction(fit)[used]
        if not np.all(np.isfinite(change)):
            return nothing
        X = fit.slopes[used][:, fit.free]
        moved = inverse @ (X.T @ change)
        left = float(np.sqrt(np.mean((change - X @ moved) ** 2)))
        return np.asarray(moved * min(1.0, wrong / left)) if left > 0.0 else nothing


def cross_loss(recording: Recording, X: Array, residual: Array, prior: Array) -> Array:
    """Sum of squares per block as predicted by a fit without the block's fold.

    That fit is one Gauss-Newton step from the whole one, which counts as the optimum of all rows, where it stopped
    short of it too: a step that was promised and not found is no merit. X (m, p): derivatives of the model; `prior`
    (p): information that is always there.
    """
    if X.shape[1] == 0:
        return recording.sum_blocks(residual**2)
    H, g, s = block_moments(recording, X, residual)
    result = np.empty(recording.blocks)
    total_H = H.sum(axis=0) + np.diag(prior)
    for fold in np.unique(recording.fold):
        inside = recording.fold == fold
        step = np.linalg.lstsq(total_H - H[inside].sum(axis=0), -g[inside].sum(axis=0), rcond=1e-12)[0]
        result[inside] = s[inside] - 2.0 * g[inside] @ step + np.einsum("bij,i,j->b", H[inside], step, step)
    return result


def block_moments(recording: Recording, X: Array, residual: Array) -> tuple[Array, Array, Array]:
    """Per block: X'X (blocks, p, p), X'e (blocks, p), e'e (blocks)."""
    used, p = recording.used, X.shape[1]
    order = recording.block[used]
    rows, e = X[used], residual[used]
    edges = np.searchsorted(order, np.arange(recording.blocks + 1))
    H, g, s = np.empty((recording.blocks, p, p)), np.empty((recording.blocks, p)), np.empty(recording.blocks)
    for b, (start, end) in enumerate(pairwise(edges)):
        part, rest = rows[start:end], e[start:end]
        H[b], g[b], s[b] = part.T @ part, part.T @ rest, rest @ rest
    return H, g, s


# --- compiled models ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Key:
    """What a compiled model depends on; the machine by its content."""

    machine: Machine = field(compare=False, hash=False)
    extras: tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
    digest: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", self.machine.digest)


def cached_package(machine: Machine) -> Package:
    """The machine's package, from the cache of compiled libraries where it was emitted before.

    Every log of an axis asks for the same few dozen models; to derive and print one takes longer than to run it.
    """
    key = hashlib.sha256(f"{machine.digest} {digest_of_sources(e.name for e in machine.effects)}".encode()).hexdigest()
    kept = cache.read("package", key, ".json")
    if kept is not None:
        return Package(machine, json.loads(kept))
    package = emit_package(machine, selftest=False)
    cache.keep("package", key, ".json", json.dumps(dict(package.files)).encode())
    return package


@lru_cache(maxsize=512)
def compiled_fit(key: _Key) -> CompiledFit:
    """Compile a machine with effects added and every parameter free."""
    machine = key.machine
    friction = machine.friction
    base: dict[str, float] = {}
    # A parameter that is zero has no scale of its own: it gets a typical nominal value and starts at theta = 0.
    if friction.viscous == 0.0:
        base["viscous"] = 0.1 * friction.coulomb / machine.sampling.max_velocity
    if friction.stribeck_ratio == 0.0:
        base["stribeck_ratio"] = 0.1
    effects = [{"name": e.name, **e.parameters} for e in machine.effects]
    effects += [{"name": name, **dict(values)} for name, values in key.extras]
    names = [*(p for group in BASE_GROUPS.values() for p in group)]
    changes: dict[str, Any] = {
        "name": "fit",
        "description": "",
        "friction": base,
        "effects": effects,
        "code": {"precision": "double"},
        "estimator": {"parameters": names, "bounds": {}},
        "sampling": _integrator(machine, [name for name, _ in key.extras]),
    }
    bare = _without_bounds(machine)
    extended = override_machine(bare, changes)
    own = len(machine.effects)
    names += [f"{e.label}.{p}" for e in extended.effects for p in e.parameters]
    extended = override_machine(extended, {"estimator": {"parameters": names}})
    groups = {e.label: f"machine:{e.label}" if i < own else f"+{i - own}" for i, e in enumerate(extended.effects)}
    compiled = CompiledFit(extended, ())
    columns = []
    for free in compiled.model.parameters:
        label, _, parameter = free.name.partition(".")
        if parameter:
            effect = next(e for e in extended.effects if e.label == label)
            frozen = parameter in FROZEN.get(effect.name, ())
            columns.append(
                Column(
                    groups[label], effect.name, parameter, free.nominal, free.scale, 1.0, free.lower, free.upper, frozen
                )
            )
        else:
            group = next(g for g, members in BASE_GROUPS.items() if free.name in members)
            zero = free.name in base
            high = 1e4 if free.name == "stribeck_velocity" else 20.0
            low = 0.0 if free.name in ("viscous", "stribeck_ratio") else 0.05
            columns.append(
                Column(group, "", free.column, free.nominal, free.scale, 0.0 if zero else 1.0, low, high, False)
            )
    compiled.columns = tuple(columns)
    return compiled


def _without_bounds(machine: Machine) -> Machine:
    """The same machine with an estimator that constrains nothing."""
    content = dict(machine.content)
    estimator = {k: v for k, v in dict(content.get("estimator", {})).items() if k not in ("bounds", "parameters")}
    content["estimator"] = {**estimator, "parameters": ["stiffness"]}
    return make_machine(content, machine.source)


def _integrator(machine: Machine, names: Sequence[str]) -> dict[str, Any]:
    """Integration for fits: at least one step per sample.

    Where the elements are integrated exactly, steps are coarser for the rest: effects' states settle within them, and a
    search runs them a hundred times.
    """
    sampling = machine.sampling
    # By name, so that what a tolerance chose stays chosen.
    integrator: dict[str, Any] = {"scheme": sampling.integrator.scheme}
    if sampling.integrator.substeps < sampling.samples_per_update:
        integrator["substeps"] = sampling.samples_per_update
    if sampling.integrator.scheme == "flow":
        integrator["displacement"] = 2.0 if "backlash" in names else LAGGING if set(names) & set(TIMED) else 1.0
    return {"integrator": integrator}


def _snapped(machine: Machine, extra: Extra) -> tuple[tuple[str, float], ...]:
    """Nominal values of an effect's compiled model: coarse, so that few are compiled, near where rates matter."""
    definition, scales = effect_definition(extra.name), scales_of(machine)
    values = []
    for parameter in definition.parameters:
        size = parameter.default if parameter.default != 0.0 else abs(parameter.size(scales))
        wanted = extra.parameters.get(parameter.name, size)
        if definition.states and wanted > 0.0 and size > 0.0:
            size *= 4.0 ** round(math.log(wanted / size, 4.0))
        values.append((parameter.name, float(min(max(size, parameter.lower), parameter.upper))))
    return tuple(values)


def _bounded_step(A: Array, g: Array, lower: Array, upper: Array) -> Array:
    """Minimise s'As/2 - g's over a box, approximately: what leaves it is held at its edge, the rest solved again."""
    step, held = np.zeros(len(g)), np.zeros(len(g), dtype=np.bool_)
    for _ in range(len(g)):
        loose = ~held
        if not loose.any():
            break
        step[loose] = np.linalg.solve(A[np.ix_(loose, loose)], g[loose] - A[np.ix_(loose, held)] @ step[held])
        outside = loose & ((step < lower) | (step > upper))
        if not outside.any():
            break
        step = np.clip(step, lower, upper)
        held |= outside
    return step


def _step_limit(column: Column, theta: float, recording: Recording) -> float:
    """Largest change of a parameter in one step.

    Less than a quarter of a period over the record for pitches and frequencies, a factor for other non-linear ones,
    free for amplitudes.
    """
    value = column.si(theta)
    if not column.group.startswith("+"):
        return max(0.5, 0.5 * abs(theta))
    if column.name == "pitch_m":
        travel = max(float(np.ptp(recording.position[recording.used])), 1e-9)
        return min(0.3 * abs(value), 0.2 * value**2 / travel) / abs(column.scale)
    if column.name == "frequency_Hz":
        return (
            0.2 / float(np.ptp(recording.time)) / abs(column.scale)
            if column.effect == "periodic_disturbance"
            else 0.2 * value / abs(column.scale)
        )
    if column.name == "phase_rad":
        return 0.5 / abs(column.scale)
    if column.name.startswith(("time_constant", "corner", "gap", "length", "delay", "centre", "damping_ratio")):
        return max(abs(value), abs(column.scale) * 0.1) / abs(column.scale)
    return math.inf


def _bounds(columns: Sequence[Column], recording: Recording) -> tuple[Array, Array]:
    """Bounds of theta: those of the definitions, and no period that the record does not hold once."""
    lower, upper = np.array([c.lower for c in columns]), np.array([c.upper for c in columns])
    for i, column in enumerate(columns):
        if column.name == "pitch_m":
            upper[i] = min(upper[i], column.theta(longest_pitch(recording)))
        if column.name == "stribeck_velocity":
            fastest = float(np.max(np.abs(recording.velocity[recording.used])))
            # A rise of friction over the whole range of speed is a curve that effects have names for.
            upper[i] = max(lower[i], column.machine_theta, min(upper[i], column.theta(FASTEST_STRIBECK * fastest)))
        if (column.effect, column.name) in (("actuator_lag", "time_constant_s"), ("force_delay", "delay_s")):
            upper[i] = min(upper[i], column.theta(LONGEST_LAG))
        if column.name == "frequency_Hz" and column.effect == "periodic_disturbance":
            lower[i] = max(lower[i], column.theta(lowest_frequency(recording)))
    return lower, upper


def _held(columns: Sequence[Column], theta: Array, descent: Array, recording: Recording) -> Mask:
    """Parameters at a bound that the data push them against; `descent` (n_p): against the gradient of the cost."""
    lower, upper = _bounds(columns, recording)
    near = 1e-9 * np.maximum(1.0, np.abs(theta))
    return np.asarray(((theta <= lower + near) & (descent < 0.0)) | ((theta >= upper - near) & (descent > 0.0)))


def longest_pitch(recording: Recording) -> float:
    """The longest period in position [m] that a record can tell from a slope: it covers one and a half."""
    return max(1e-9, float(np.ptp(recording.position[recording.used])) / 1.5)


def lowest_frequency(recording: Recording) -> float:
    """The lowest frequency [Hz] that a record can tell from a drift: one and a half periods."""
    return 1.5 / float(np.ptp(recording.time))
