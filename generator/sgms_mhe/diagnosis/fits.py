"""Fits of an axis's model with candidate effects to one record, each made once."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from sgms_mhe.diagnosis.models import CompiledFit, FitError, LeastSquares, ModelPoint, Prior, diverges, make_model
from sgms_mhe.diagnosis.own_numbers import OwnNumbers
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, JacobianColumn, ParameterGroup, bounds, smooth_law
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition, reported_name
from sgms_mhe.recordings.evidence import FitLoss, Nuisance, cross_loss, find_nuisance
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array, Mask

FitKey = tuple[object, ...]
AT_BOUND: Final = 1e-9
ALIKE: Final = 0.1
"""Standard deviation of a change of friction, over its own, up to which alignment takes it out, or lets it be."""
SEARCH_STEP: Final = 10.0
"""What a step of a search must promise [rows' worth of noise]: less decides nothing."""
FINAL_STEP: Final = 0.01
"""What a step must promise where numbers are reported [rows' worth of noise]: a tenth of a standard deviation."""
ITERATIONS: Final = 12
"""Steps of a fit, at most [1]: it starts from a proposal, near its end."""
MACHINE_PRIOR: Final = 1.0
"""Prior of the machine's numbers, 1 sigma [nominal value]: holds what the record does not excite."""
EFFECT_PRIOR: Final = 10.0
"""Prior of an effect's numbers in a step, 1 sigma [nominal value]: it damps the step and says nothing of a size."""


class EffectsError(FitError):
    """A model with these effects under test that is not finite where its fit starts."""

    def __init__(self, message: str, effects: tuple[str, ...]) -> None:
        super().__init__(message)
        self.effects = effects


@dataclass(frozen=True, eq=False)
class Fit(FitLoss):
    """A model fitted to a recording.

    Attributes:
        model: its compiled code.
        effects: effects under test, with the numbers found.
        theta: (n_p).
        free: parameters that were fitted (n_p).
        interior: those of them that no bound holds (n_p): the directions the data may still move.
        jacobian: d(model)/d(theta) (m, n_p).
        own: numbers of each of several joined logs, taken out of residual and Jacobian; None: there is one.
    """

    model: CompiledFit
    effects: tuple[CandidateEffect, ...]
    theta: Array
    free: Mask
    interior: Mask
    jacobian: Array
    own: OwnNumbers | None = None

    def find_nuisance(self, used: Mask, held: Mask | None = None) -> Nuisance:
        """Return the part explained on rows (m) by free numbers but those `held` (n_p), and by each log's own."""
        X = self.jacobian[used][:, self.interior if held is None else self.interior & ~held]
        return find_nuisance(X if self.own is None else np.column_stack((X, self.own.columns[used])))

    @property
    def candidate_groups(self) -> tuple[ParameterGroup, ...]:
        """Groups of the effects under test."""
        return tuple(ParameterGroup("candidate", effect.name, index=i) for i, effect in enumerate(self.effects))

    def theta_without(self, groups: Collection[ParameterGroup]) -> Array:
        """The same numbers (n_p), the sizes of these effects set to none."""
        theta = self.theta.copy()
        for i, column in enumerate(self.model.columns):
            if column.group in groups and effect_definition(column.group.cause).parameter(column.name).is_size:
                theta[i] = column.theta(column.none)
        return theta

    def values(self, group: ParameterGroup) -> dict[str, float]:
        """SI values of a group's parameters."""
        return {
            c.name: c.si(t) for c, t in zip(self.model.columns, self.theta.tolist(), strict=True) if c.group == group
        }


@dataclass(frozen=True, eq=False)
class Alignment:
    """Part of a record that carries no information on friction; see `align`.

    Attributes:
        measured: friction before any of it was (m) [N].
        sampled: coefficients (2) of jerk and snap the sampling accounts for.
        later: error of the model's steps in its friction (m) [N]; None: not computed.
        at: that friction (m) [N].
    """

    measured: Array
    sampled: Array
    later: Array | None = None
    at: Array | None = None

    def find_later(self, friction: Array) -> Array | None:
        """Return the error of the steps' length in a friction (m) [N]; None where it has to be computed.

        It is a part in a thousand of it, and of one that differs by little the same.
        """
        if self.later is None or self.at is None:
            return None
        return self.later if float(np.std(friction - self.at)) < ALIKE * float(np.std(friction)) else None


@dataclass(frozen=True, eq=False)
class Subject:
    """An axis's model and the record it is fitted to.

    Attributes:
        machine: the axis.
        recording: the record, its measured friction in line with the model.
        alignment: of the record.
        noise: of the measured friction [N]; weight of the prior.
        encoder: force the encoder's steps leave in the residual (m) [N]; None: they do not show, or nobody asked.
        enough: least promised gain of a step of a fit [rows' worth of noise].
        starts: SI values of machine numbers that fits start from, where the file gives no good idea of them.
        fine: the same at the record's full rate, where this one is thinned.
        is_open: whether the machine's numbers are the record's own: then they are free in every fit, and no causes.
        known: fits by their request. A model is fitted once to an aligned record, wherever it would start;
            copies share them, an alignment begins anew.
    """

    machine: Machine
    recording: Recording
    alignment: Alignment
    noise: float = 1.0
    encoder: Array | None = None
    enough: float = 0.0
    starts: Mapping[str, float] = field(default_factory=dict)
    fine: Subject | None = None
    is_open: bool = False
    known: dict[FitKey, Fit] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, machine: Machine, recording: Recording) -> Subject:
        """A machine along a record as it was prepared."""
        alignment = Alignment(recording.friction, np.zeros(2))
        return cls(machine, recording, alignment, enough=SEARCH_STEP)

    @property
    def whole(self) -> Subject:
        """The one at the record's full rate."""
        return self if self.fine is None else self.fine

    def model(self, effects: Sequence[CandidateEffect]) -> CompiledFit:
        """The machine with effects added, everything in it a free parameter."""
        return make_model(self.machine, effects)

    def choose_rate(self, effects: Sequence[CandidateEffect]) -> Subject:
        """The one whose rate suits these effects: this one, or the full rate.

        States that elements which slip almost at once depend on need its steps too.
        """
        borne = smooth_law(self.machine, effects) is not self.machine
        known = [effect_definition(effect.name) for effect in effects]
        return self.whole if any(e.full_rate or (borne and e.drives_elements) for e in known) else self

    def start_from(self, starts: Mapping[str, float]) -> Subject:
        """The same with other values that fits start from."""
        fine = None if self.fine is None else replace(self.fine, starts=starts, known={})
        return replace(self, starts=starts, fine=fine, known={})

    def with_final_steps(self) -> Subject:
        """The same with fits that go on until their numbers can be reported."""
        fine = None if self.fine is None else replace(self.fine, enough=FINAL_STEP)
        return replace(self, enough=FINAL_STEP, fine=fine)

    def start(self, model: CompiledFit, effects: Sequence[CandidateEffect], warm: Fit | None = None) -> Array:
        """Theta (n_p) to start from: the machine's, a warm fit's where it has them, the proposals' otherwise."""
        known: dict[tuple[ParameterGroup, str], float] = {}
        if warm is not None:
            known = {
                (c.group, c.name): c.si(t)
                for c, t in zip(warm.model.columns, warm.theta, strict=True)
                if not c.group.is_candidate
            }
        wanted = {
            (ParameterGroup("candidate", effect.name, index=i), key): value
            for i, effect in enumerate(effects)
            for key, value in effect.parameters.items()
        }
        values = {**known, **wanted}
        theta = np.array(
            [
                c.theta(values[c.group, c.name])
                if (c.group, c.name) in values
                else c.theta(self.starts[c.name])
                if c.name in self.starts
                else c.machine_theta
                for c in model.columns
            ]
        )
        return np.asarray(np.clip(theta, [c.lower for c in model.columns], [c.upper for c in model.columns]))

    def friction(self, fit: Fit) -> Array:
        """Friction (m) [N] of this machine at this rate, with the numbers of a fit; NaN where it is no model there."""
        values = {(c.group, c.name): c.si(t) for c, t in zip(fit.model.columns, fit.theta, strict=True)}
        model = self.model(fit.effects)
        theta = np.array([c.theta(values[c.group, c.name]) for c in model.columns])
        friction = model.run(self.recording, theta, derivatives=False)[0]
        # At another rate than that of the fit a state may diverge, and stay finite.
        return np.full_like(friction, np.nan) if diverges(self.recording, friction) else friction


def fit_model(
    subject: Subject,
    effects: Sequence[CandidateEffect],
    *,
    refitted: Sequence[ParameterGroup] | None = None,
    warm: Fit | None = None,
    rows: Mask | None = None,
    fixed: frozenset[str] = frozenset(),
    iterations: int | None = None,
    again: bool = False,
) -> Fit:
    """Fit a machine with effects added to a record.

    Args:
        subject: the machine and the record.
        effects: effects under test and their starting values.
        refitted: groups of the machine's own numbers that are free; None: all.
        warm: a fit whose machine numbers to start from.
        rows: rows the fit sees (m); None: all used ones.
        fixed: columns of the machine's own numbers that stay at its file's, whatever is refitted.
        iterations: at most; None: the usual ones.
        again: fit also known ones, from `warm`, and keep the better one.

    Raises:
        FitError: the model is not finite where its fit starts.
    """
    key: FitKey = (
        tuple((e.name, tuple(e.parameters.items())) for e in effects),
        None if refitted is None else frozenset(refitted),
        None if rows is None else rows.tobytes(),
        fixed,
    )
    known = subject.known.get(key)
    if known is None or again:
        wanted = _FitRequest(refitted, rows, fixed, iterations or ITERATIONS)
        fit = _fit(subject, effects, warm, wanted)
        subject.known[key] = fit if known is None or fit.rms < known.rms else known
    return subject.known[key]


@dataclass(frozen=True, eq=False)
class _FitRequest:
    """Freedom and data of a fit; as the arguments of `fit_model`."""

    refitted: Sequence[ParameterGroup] | None
    rows: Mask | None
    fixed: frozenset[str]
    iterations: int

    def frees(self, column: JacobianColumn) -> bool:
        """Return True if a column is fitted."""
        if column.group.is_candidate:
            return not column.frozen
        wanted = self.refitted is None or column.group in self.refitted
        return wanted and not column.frozen and column.name not in self.fixed


def _fit(subject: Subject, effects: Sequence[CandidateEffect], warm: Fit | None, wanted: _FitRequest) -> Fit:
    """At the rate that suits the effects, and where a thinned model is not finite at the full one."""
    if subject.choose_rate(effects) is subject:
        try:
            return _fit_here(subject, effects, warm, wanted)
        except FitError:
            if subject.fine is None:
                raise
    return fit_model(subject.whole, effects, warm=warm, **vars(wanted))


def _fit_here(subject: Subject, effects: Sequence[CandidateEffect], warm: Fit | None, wanted: _FitRequest) -> Fit:
    """At the subject's own rate."""
    recording, model = subject.recording, subject.model(effects)
    columns = model.columns
    theta = subject.start(model, effects, warm)
    free = np.array([wanted.frees(c) for c in columns], dtype=np.bool_)
    kept = ~free & np.array([not c.group.is_candidate for c in columns], dtype=np.bool_)
    theta[kept] = [c.machine_theta for c, k in zip(columns, kept, strict=True) if k]
    seen = recording.used if wanted.rows is None else wanted.rows
    problem = LeastSquares(model, recording, seen, free, _prior(subject, model, free))
    try:
        found = problem.descend(theta, wanted.iterations, subject.enough)
    except FitError as error:
        raise EffectsError(str(error), tuple(effect.name for effect in effects)) from None
    # A parameter that its bound holds moves neither with a candidate nor from fold to fold.
    descent = found.jacobian[seen].T @ found.residual[seen]
    interior = free & ~find_at_bounds(columns, found.theta, descent, recording)
    prior = prior_information(subject, model, interior)
    cross = cross_loss(recording, found.jacobian[:, interior], found.residual, prior)
    return make_fit(model, effects, recording, found, free, interior, cross)


def make_fit(
    model: CompiledFit,
    effects: Sequence[CandidateEffect],
    recording: Recording,
    found: ModelPoint,
    free: Mask,
    interior: Mask,
    cross: Array | None = None,
) -> Fit:
    """Return the fit that ended at a point; `cross`: its losses on unseen folds (blocks), None: those on all rows."""
    loss = recording.sum_blocks(found.residual**2)
    fit = Fit(
        model=model,
        effects=(),
        theta=found.theta,
        free=free,
        interior=interior,
        residual=found.residual,
        jacobian=found.jacobian,
        loss=loss,
        cross=loss if cross is None else cross,
        rows=recording.sum_blocks(np.ones(len(recording.time))),
        own=found.own,
    )
    values = [fit.values(ParameterGroup("candidate", effect.name, index=i)) for i, effect in enumerate(effects)]
    return replace(fit, effects=tuple(CandidateEffect(e.name, v) for e, v in zip(effects, values, strict=True)))


def prior_information(subject: Subject, model: CompiledFit, free: Mask) -> Array:
    """Information of the prior of the parameters `free` (n_p) in units of the sum of squares, (free)."""
    sd = np.array([EFFECT_PRIOR if c.group.is_candidate else MACHINE_PRIOR for c in model.columns])
    return np.asarray((subject.noise / sd[free]) ** 2)


def _prior(subject: Subject, model: CompiledFit, free: Mask) -> Prior:
    information = prior_information(subject, model, free)
    own = np.array([not c.group.is_candidate for c in model.columns])[free]
    centre = np.array(
        [c.theta(subject.starts[c.name]) if c.name in subject.starts else c.machine_theta for c in model.columns]
    )
    return Prior(information, np.where(own, information, 0.0), centre[free])


def report_values(fit: Fit, group: ParameterGroup) -> dict[str, float]:
    """A group's numbers as a report states them, with units at the ends of their names."""
    values = {report_name(group, name): value for name, value in fit.values(group).items()}
    return effect_definition(group.cause).tidy(values) if group.is_candidate else values


def report_name(group: ParameterGroup, column: str) -> str:
    """Return the name of a column in reports, its unit at the end."""
    return reported_name(column) if group.kind == "base" else column


def try_fit(
    subject: Subject,
    effects: Sequence[CandidateEffect],
    *,
    refitted: Sequence[ParameterGroup] | None = None,
    warm: Fit | None = None,
    again: bool = False,
) -> Fit | None:
    """A fit, or None where the model is not finite from its start on."""
    try:
        return fit_model(subject, effects, refitted=refitted, warm=warm, again=again)
    except FitError:
        return None


def find_at_bounds(columns: Sequence[JacobianColumn], theta: Array, descent: Array, recording: Recording) -> Mask:
    """Parameters at theta (n_p) at a bound a descent (n_p) of the cost pushes them against (n_p)."""
    lower, upper = bounds(columns, recording)
    near = AT_BOUND * np.maximum(1.0, np.abs(theta))
    return np.asarray(((theta <= lower + near) & (descent < 0.0)) | ((theta >= upper - near) & (descent > 0.0)))
