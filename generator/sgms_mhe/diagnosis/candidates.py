"""The search: for every effect of the catalogue the force that it would add, and the sizes that fit it best.

How an effect is looked for stands in its definition; here are the engines. Everything that the free parameters of the
model explain is projected out first. The result is the start of a refit of the effect's own definition; nothing is
decided on these columns alone.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from sgms_mhe.diagnosis.fits import Fit, Subject
from sgms_mhe.diagnosis.harmonics import search_harmonic
from sgms_mhe.diagnosis.maps import search_periodic
from sgms_mhe.diagnosis.models import CompiledFit
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, ParameterGroup
from sgms_mhe.diagnosis.proposals import Proposal, Residual, energy, propose
from sgms_mhe.model.effects import BASE_CAUSES, EffectDefinition, MotionRecord, effect_definition
from sgms_mhe.model.effects.base import DAMPING, LEVEL
from sgms_mhe.model.effects.search import Columns, Derivative, Harmonic, Periodic, Search, Step, Trials, Unsearched
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.evidence import Nuisance, score_test
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.parallel import run_parallel

EDGE_SHARE: Final = 0.05
"""Rows between a step in time and an end of the record, at least [rows that count]: what is only there at an end is a
drift as well."""
STEP_RESIDUAL: Final = 1e-3
"""What must be left of a step's column beside the free numbers [rows after a step]: of less there is nothing to fit."""


def make_motion(recording: Recording, fit: Fit) -> MotionRecord:
    """Signals and the model's sensitivities at a fit."""
    columns, scales = fit.model.columns, scales_of(recording.machine)
    coulomb = next(i for i, c in enumerate(columns) if c.name == LEVEL)
    viscous = next(i for i, c in enumerate(columns) if c.name == DAMPING)
    return MotionRecord(
        time=recording.time,
        position=recording.position,
        velocity=recording.velocity,
        acceleration=recording.acceleration,
        force=recording.force,
        friction=recording.friction - fit.residual,
        level=fit.jacobian[:, coulomb] * fit.theta[coulomb],
        damping=columns[viscous].si(fit.theta[viscous]) or columns[viscous].nominal,
        mass=scales.mass,
        deflection=scales.deflection,
        extents=recording.extents,
    )


def search(subject: Subject, fit: Fit, names: Sequence[str], free: Nuisance) -> list[Proposal]:
    """Search every named effect in the residual of a fit; `free`: directions of its parameters on used rows."""
    recording = subject.recording
    e = free.project(fit.residual[recording.used])
    seen = Residual(recording, make_motion(recording, fit), free, e)
    # Begun last, what takes longest would have one core search and the others wait.
    order = sorted(names, key=lambda name: _place_by_duration(effect_definition(name).search))
    found = run_parallel([partial(_search_effect, effect_definition(name), subject, fit, seen) for name in order])
    by_name = dict(zip(order, found, strict=True))
    return [proposal for name in names for proposal in by_name[name]]


def _place_by_duration(kind: Search) -> int:
    """Place of a search in an order that begins with the longest: maps, then candidates with a compiled model."""
    if isinstance(kind, Periodic):
        return 0
    compiles = isinstance(kind, Derivative | Trials) or (isinstance(kind, Columns) and kind.exact is not None)
    return 1 if compiles else 2


def _search_effect(definition: EffectDefinition, subject: Subject, fit: Fit, seen: Residual) -> list[Proposal]:
    kind = definition.search
    proposal: Proposal | None
    match kind:
        case Harmonic():
            return search_harmonic(definition, kind, seen)
        case Periodic():
            proposal = search_periodic(definition, kind, seen)
        case Columns():
            proposal = _search_columns(definition, kind, seen)
            if proposal is not None:
                proposal = _refine_exactly(definition, kind, proposal, subject, fit, seen)
        case Step():
            proposal = _search_step(definition, kind, seen)
        case Derivative():
            proposal = _search_derivative(definition, kind, subject, fit, seen)
        case Trials():
            proposal = _search_trials(definition, kind, subject, fit, seen)
        case Unsearched():
            proposal = None
    return [] if proposal is None else [proposal]


# --- effects that are linear given a few numbers ----------------------------------------------------------------


def _search_columns(definition: EffectDefinition, kind: Columns, seen: Residual) -> Proposal | None:
    best = _BestTrial()
    for given in kind.grid(seen.motion):
        Z = seen.columns(kind.columns(seen.motion, given))
        found = energy(Z, seen.e)
        if kind.own_size is not None and found > 0.0:
            found *= _agreement(_coefficient(Z, seen.e), given[kind.own_size])
        best.offer(found, given, Z)
    if best.Z is None:
        return None
    return propose(definition, seen, best.Z, kind.tests, partial(kind.parameters, best.given))


class _BestTrial:
    """The trial that explains most, of those that explain anything, and its columns (rows, k)."""

    def __init__(self) -> None:
        self.given: Mapping[str, float] = {}
        self.Z: Array | None = None
        self._energy = 0.0

    def offer(self, energy: float, given: Mapping[str, float], Z: Array) -> None:
        """Keep a trial that explains more than all before it."""
        if energy > self._energy:
            self.given, self.Z, self._energy = given, Z, energy


def _coefficient(Z: Array, e: Array) -> float:
    """Least-squares coefficient of the first column."""
    return float((Z.T @ e)[0] / (Z.T @ Z)[0, 0])


def _agreement(found: float, wanted: float) -> float:
    """Share of the energy that counts where a size should have come out as another: 1 where it did."""
    return 1.0 / (1.0 + math.log(max(found, 1e-9) / wanted) ** 2)


def _search_step(definition: EffectDefinition, kind: Step, seen: Residual) -> Proposal | None:
    """All instants at once: sums over the rows after each of them."""
    e = seen.e
    time = seen.motion.time[seen.recording.used]
    after = np.arange(len(time), 0, -1.0)
    numerator = np.cumsum(e[::-1])[::-1]
    inside = np.cumsum(seen.free.basis[::-1], axis=0)[::-1]
    denominator = after - np.sum(inside**2, axis=1)
    edge = edge_rows(len(time))
    found = np.where(denominator > STEP_RESIDUAL * after, numerator**2 / np.maximum(denominator, 1e-9), 0.0)
    found[:edge] = found[-edge:] = 0.0
    best = int(np.argmax(found))
    if found[best] <= 0.0:
        return None
    # The mean over a row changes in its middle: the step is at the row's beginning.
    at = float(time[best]) - 0.5 / seen.motion.extents.rate
    Z = seen.free.project((time >= time[best]).astype(np.float64)[:, None])
    return propose(definition, seen, Z, kind.tests, lambda size: {kind.size: float(size[0]), kind.time: at})


def edge_rows(rows: int) -> int:
    """Rows next to the beginning, and to the end, of so many that no step is looked for in."""
    return int(EDGE_SHARE * rows)


# --- effects whose force only their own equations give ----------------------------------------------------------


def _slope(
    definition: EffectDefinition, size: str, trial: Mapping[str, float], subject: Subject, model: CompiledFit, fit: Fit
) -> Array | None:
    """Force per unit of a size (m, 1) [N], from the compiled model at a trial; None where it is not finite."""
    effects = (*fit.effects, CandidateEffect(definition.name, trial))
    _, jacobian = model.run(subject.recording, subject.start(model, effects, fit))
    index = model.index(ParameterGroup("candidate", definition.name, index=len(fit.effects)), size)
    if jacobian is None or not np.all(np.isfinite(jacobian[:, index])):
        return None
    return np.asarray(jacobian[:, [index]] / model.columns[index].scale)


def _refine_exactly(
    definition: EffectDefinition, kind: Columns, proposal: Proposal, subject: Subject, fit: Fit, seen: Residual
) -> Proposal:
    """The proposal with its column from the compiled model's derivative where the effect is none, if that is wanted."""
    size = kind.exact
    if size is None:
        return proposal
    trial = {**proposal.parameters, size: definition.parameter(size).none}
    effects = (*fit.effects, CandidateEffect(definition.name, trial))
    choose_rate = subject.choose_rate(effects)
    slope = _slope(definition, size, trial, choose_rate, choose_rate.model(effects), fit)
    if slope is None:
        return proposal
    here = replace(seen, recording=choose_rate.recording)
    return propose(
        definition, here, here.columns(slope), proposal.tests, lambda found: kind.parameters(proposal.parameters, found)
    )


def _search_derivative(
    definition: EffectDefinition, kind: Derivative, subject: Subject, fit: Fit, seen: Residual
) -> Proposal | None:
    """Derivatives in a size where the effect is none, at every trial, from one compiled model."""
    size = kind.size or next(p.name for p in definition.parameters if p.is_size)
    none = definition.parameter(size).none
    choose_rate = subject.choose_rate(fit.effects)
    here = replace(seen, recording=choose_rate.recording)
    grid = kind.grid(seen.motion)
    model = choose_rate.model((*fit.effects, CandidateEffect(definition.name, grid[0])))
    best = _BestTrial()
    trials = [partial(_slope, definition, size, {size: none, **given}, choose_rate, model, fit) for given in grid]
    for given, slope in zip(grid, run_parallel(trials), strict=True):
        if slope is None:
            continue
        Z = here.columns(slope)
        best.offer(energy(Z, seen.e), given, Z)
    if best.Z is None:
        return None
    # From `none` on, as the derivative is.
    return propose(definition, here, best.Z, kind.tests, lambda found: {**best.given, size: none + float(found[0])})


def _search_trials(
    definition: EffectDefinition, kind: Trials, subject: Subject, fit: Fit, seen: Residual
) -> Proposal | None:
    """Run the effect's own model at a few sizes; its column is the change of the force.

    A number of the machine the fit drove to its bound may be the one the effect acts on: no lag shows in a
    Stribeck effect of none. In the trials it has the file's value.
    """
    choose_rate = subject.choose_rate(fit.effects)
    here = replace(seen, recording=choose_rate.recording)
    at_rest = choose_rate.model(fit.effects)
    theta = choose_rate.start(at_rest, fit.effects, fit)
    without, _ = at_rest.run(choose_rate.recording, theta, derivatives=False)
    trials = kind.grid(seen.motion)
    driven = {c.name for c, held in zip(fit.model.columns, fit.free & ~fit.interior, strict=True) if held}

    # One compiled model serves all: that of the first, which asks for the shortest steps.
    own = (
        choose_rate.model((*fit.effects, CandidateEffect(definition.name, trials[0])))
        if kind.through is None
        else at_rest
    )

    def make_force(values: Mapping[str, float]) -> Array:
        if kind.through is not None:
            return _run_through(kind, values, choose_rate.recording, at_rest, theta, seen.motion)
        effects = (*fit.effects, CandidateEffect(definition.name, values))
        start = choose_rate.start(own, effects, fit)
        back = np.array([c.group.kind == "base" and c.name in driven for c in own.columns], dtype=np.bool_)
        start[back] = [c.machine_theta for c, is_back in zip(own.columns, back, strict=True) if is_back]
        return own.run(choose_rate.recording, start, derivatives=False)[0]

    best = _BestTrial()
    forces = run_parallel([partial(make_force, values) for values in trials])
    for values, force in zip(trials, forces, strict=True):
        if not np.all(np.isfinite(force)):
            continue
        Z = here.columns((force - without)[:, None])
        found = energy(Z, seen.e)
        if found > 0.0:
            # The trial's own size is the right one where its coefficient is 1.
            found *= _agreement(_coefficient(Z, seen.e), 1.0)
        best.offer(found, values, Z)
    if best.Z is None:
        return None
    key, value = next(iter(best.given.items()))

    def parameters(size: Array) -> Mapping[str, float]:
        # Between the trial and what a linear force would ask for.
        factor = float(size[0])
        return {key: value * (math.copysign(math.sqrt(abs(factor)), factor) if factor != 0.0 else 0.0)}

    return propose(definition, here, best.Z, float(len(trials)), parameters)


def _run_through(
    kind: Trials,
    values: Mapping[str, float],
    recording: Recording,
    model: CompiledFit,
    theta: Array,
    motion: MotionRecord,
) -> Array:
    """Friction (m) [N] of the model along the motion its elements see by the effect's short cut.

    Cheaper than the effect's own equations; good enough to start a refit from.
    """
    if kind.through is None:
        raise ValueError("an effect without a short cut")
    signals, sampling = recording.signals, recording.machine.sampling
    push = np.repeat(motion.friction - motion.damping * motion.velocity, recording.factor)
    engaged = kind.through(signals.velocity[: len(push)] * sampling.step, push, values)
    velocity = signals.velocity.copy()
    velocity[: len(engaged)] = engaged * sampling.rate
    shifted = replace(recording, signals=replace(signals, velocity=velocity))
    return model.run(shifted, theta, derivatives=False)[0]


# --- where fits of the machine's own numbers start --------------------------------------------------------------


def stribeck_start(recording: Recording, fit: Fit, free: Nuisance) -> dict[str, float]:
    """Numbers to start from where the machine file says nothing of them; empty where the record shows none."""
    motion = make_motion(recording, fit)
    e = free.project(fit.residual[recording.used])
    best: tuple[float, dict[str, float]] = (0.0, {})
    for cause in BASE_CAUSES.values():
        kind = cause.start_search
        if kind is None:
            continue
        for given in kind.grid(motion):
            Z = free.project(kind.columns(motion, given)[recording.used])
            p, size = score_test(recording, Z, e)
            found = energy(Z, e)
            if p * kind.tests < recording.machine.diagnosis.significance and size[0] > 0.0 and found > best[0]:
                best = found, dict(kind.parameters(given, size))
    return best[1]


def stiffness_start(subject: Subject, effects: Sequence[CandidateEffect], material: float) -> dict[str, float]:
    """Numbers to start from, all of a cause by one factor off the machine's.

    Empty where none leaves `material` [N] less.
    """
    subject = subject.choose_rate(effects)
    recording, model = subject.recording, subject.model(effects)
    theta = subject.start(model, effects)
    start: dict[str, float] = {}
    for cause in BASE_CAUSES.values():
        if not cause.start_factors:
            continue
        common = np.array([c.group == ParameterGroup("base", cause.name) for c in model.columns])
        starts = {factor: np.where(common, factor * theta, theta) for factor in cause.start_factors}
        runs = run_parallel([partial(model.run, recording, at, derivatives=False) for at in starts.values()])
        left = {
            factor: float(np.mean((recording.friction - friction)[recording.used] ** 2))
            for factor, (friction, _) in zip(starts, runs, strict=True)
        }
        best = min(left, key=lambda factor: left[factor])
        if left[best] < left[1.0] - material**2:
            start |= {
                c.name: c.si(best * float(t)) for c, t, own in zip(model.columns, theta, common, strict=True) if own
            }
    return start
