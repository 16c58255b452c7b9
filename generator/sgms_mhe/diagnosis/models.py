"""The emitted model of a machine with effects added, every number in it a free parameter, compiled for this host."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.own_numbers import OwnNumbers
from sgms_mhe.diagnosis.parametrisation import (
    CandidateEffect,
    Force,
    JacobianColumn,
    ModelStructure,
    ParameterGroup,
    base_column,
    bounds,
    delay_column,
    drop_bounds,
    effect_column,
    extended_machine,
    find_plain_forces,
    make_force,
    nominal_values,
    smooth_law,
    step_limit,
    typical_sizes,
)
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.host.packages import SYMBOLIC
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.least_squares import Box, Quadratic, minimise
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.recordings.series import Shift, row_means
from sgms_mhe.support.arrays import Array, Mask

CHUNK: Final = 200_000  # samples that are predicted at a time; bounds the memory of derivatives
MODELS_CACHED: Final = 512  # compiled models; a diagnosis of a rich record asks for about a hundred

UNSTABLE: Final = 1e6
"""Derivative from which no integration step was short enough [largest friction]: a state that diverges shows in its
derivatives first."""


@dataclass(frozen=True, eq=False)
class CompiledFit:
    """The emitted model along a recording, in pieces of bounded memory, reduced to the fit's rate.

    Attributes:
        code: the model, without delays of all its force and without effects that are plain forces.
        columns: of its parameters, then the delay where there is one, then those of the forces.
        delayed: whether there is.
        forces: added beside the code.
    """

    code: CompiledModel
    columns: tuple[JacobianColumn, ...]
    delayed: bool = False
    forces: tuple[Force, ...] = ()

    @property
    def model(self) -> Model:
        """The symbolic model that was compiled."""
        return self.code.model

    def index(self, group: ParameterGroup, name: str) -> int:
        """Place of a group's parameter among the columns."""
        return next(i for i, c in enumerate(self.columns) if c.group == group and c.name == name)

    def ordered(self, places: Sequence[int]) -> CompiledFit:
        """The same code for effects under test in another order: `places[i]` is where number i stands in the order."""
        groups = {c.group: c.group for c in self.columns}
        groups |= {g: replace(g, index=places[g.index]) for g in groups if g.is_candidate}
        return replace(self, columns=tuple(replace(c, group=groups[c.group]) for c in self.columns))

    def run(self, recording: Recording, theta: Array, *, derivatives: bool = True) -> tuple[Array, Array | None]:
        """Friction (m) [N] and its derivatives in theta (m, n_p), not to be written to: it may be asked for again."""
        coded = self.model.n_p + int(self.delayed)
        own = theta[:coded]
        asked, run = own, self._run
        if self.delayed:  # models with the same code may scale their delays otherwise
            asked, run = np.append(own, (self._delay(own), self.columns[coded - 1].scale)), self._run_late
        friction, jacobian = recording.runs.get(
            self.code, recording.signals, asked, derivatives, lambda: run(recording, own, derivatives)
        )
        # A code that has just run with the same numbers is not run again for other forces beside it.
        return self._add_forces(recording, theta, friction, jacobian) if self.forces else (friction, jacobian)

    def _add_forces(
        self, recording: Recording, theta: Array, friction: Array, jacobian: Array | None
    ) -> tuple[Array, Array | None]:
        """Return the output of the code at theta (n_p), with the forces beside it."""
        m, coded = len(friction), self.model.n_p + int(self.delayed)
        total, wide = friction.copy(), None if jacobian is None else np.empty((m, len(theta)))
        shift = Shift.of(self._delay(theta), recording.machine.sampling.rate) if self.delayed else None

        if wide is not None and jacobian is not None:
            wide[:, :coded] = jacobian
        first = coded
        for force in self.forces:
            columns = slice(first, first + len(force.parameters))
            first = columns.stop
            if force.is_linear and shift is None:
                known = _run_linear(force, recording, theta[columns])
                total += known @ np.append(1.0, theta[columns])
                if wide is not None:
                    wide[:, columns] = known[:, 1:]
                continue
            by_shift = _add_force(
                force, recording, theta[columns], shift, total, None if wide is None else wide[:, columns]
            )
            if wide is not None and by_shift is not None:
                wide[:, coded - 1] += by_shift * self.columns[coded - 1].scale
        return total, wide

    def _delay(self, theta: Array) -> float:
        """The delay [s] of a theta that begins with the code's and the delay's."""
        return self.columns[self.model.n_p].si(float(theta[self.model.n_p]))

    def _run(self, recording: Recording, theta: Array, derivatives: bool) -> tuple[Array, Array | None]:
        m, factor, n_p = len(recording.time), recording.factor, self.model.n_p
        force, jacobian = np.empty(m), np.empty((m, n_p)) if derivatives else None
        for piece, y, d in self._pieces(recording, theta, derivatives):
            force[piece] = row_means(y, factor)
            if jacobian is not None and d is not None:
                jacobian[piece] = row_means(d, factor)
        return force, jacobian

    def _run_late(self, recording: Recording, theta: Array, derivatives: bool) -> tuple[Array, Array | None]:
        """The same, the drive's force as late as the last parameter says."""
        scale = self.columns[self.model.n_p].scale
        pieces = list(self._pieces(recording, theta[:-1], derivatives))
        inertial = recording.inertia * recording.signals.acceleration
        drive = np.concatenate([y for _, y, _ in pieces])
        inertial = inertial[: len(drive)]
        drive += inertial
        shift = Shift.of(self._delay(theta), recording.machine.sampling.rate)
        force = recording.reduce(shift.of_series(drive) - inertial)
        if not derivatives:
            return force, None
        own = shift.of_series(np.concatenate([d for _, _, d in pieces if d is not None]))
        return force, recording.reduce(np.column_stack((own, shift.slope_of(drive) * scale)))

    def _pieces(
        self, recording: Recording, theta: Array, derivatives: bool
    ) -> Iterator[tuple[slice, Array, Array | None]]:
        """Rows, and at their samples the friction (k) [N] and its derivatives in the code's parameters (k, n_p)."""
        factor, m, n_x, n_p = recording.factor, len(recording.time), self.model.n_x, self.model.n_p
        values, state, sensitivity = np.ascontiguousarray(theta, dtype=np.float64), np.zeros(n_x), np.zeros((n_x, n_p))
        rows = max(1, CHUNK // factor)
        for first in range(0, m, rows):
            last, back = min(m, first + rows), int(first > 0)  # a piece begins with the sample that its state is of
            w = recording.inputs(first * factor - back, last * factor)
            y = np.empty(len(w))
            d = np.empty((len(w), n_p)) if derivatives else None
            self.code.advance(w, values, state, sensitivity, y, d)
            yield slice(first, last), y[back:], None if d is None else d[back:]


def _run_linear(force: Force, recording: Recording, theta: Array) -> Array:
    """Return a force that is linear in what is fitted: [N] where that is 0, and its derivatives (m, 1 + n_p).

    A fit asks for it time and again, and those of a curve of many knots were most of its work.
    """
    at_zero, m = np.where(force.fitted, 0.0, theta), len(recording.time)

    def run() -> tuple[Array, None]:
        known = np.zeros((m, 1 + len(theta)))
        _add_force(force, recording, at_zero, None, known[:, 0], known[:, 1:])
        return known, None

    return recording.runs.get(force, recording.signals, at_zero, False, run)[0]


def _add_force(
    force: Force, recording: Recording, theta: Array, shift: Shift | None, friction: Array, jacobian: Array | None
) -> Array | None:
    """Add a plain force with its parameters theta (n_p) to the friction (m), and put its derivatives (m, n_p).

    In pieces of bounded memory, and all at once where something shifts it. Returns its derivative in the shift (m)
    [N/s], if it has one.
    """
    factor, rows, by_shift = recording.factor, len(friction), None
    at_a_time = rows if shift is not None else max(1, CHUNK // factor)
    for first in range(0, rows, at_a_time):
        part = slice(first, min(rows, first + at_a_time))
        y, d = force.at(recording.inputs(first * factor, part.stop * factor), theta, derivatives=jacobian is not None)
        if shift is not None:
            by_shift = recording.reduce(shift.slope_of(y))
            y, d = shift.of_series(y), None if d is None else shift.of_series(d)
        friction[part] += row_means(y, factor)
        if jacobian is not None and d is not None:
            jacobian[part] = row_means(d, factor)
    return by_shift


def make_model(machine: Machine, effects: Sequence[CandidateEffect]) -> CompiledFit:
    """The machine with effects added, everything in it a free parameter.

    Their values are where a fit starts; compiled models are near them, so that few models serve all fits.
    """
    keys = [(e.name, nominal_values(machine, e)) for e in effects]
    machine = smooth_law(machine, effects)
    prompt = _drop_delays(machine)
    late = [i for i, effect in enumerate(effects) if effect_definition(effect.name).delays]
    others = [i for i in range(len(keys)) if i not in late]
    alone = {i: ModelStructure(prompt, (keys[i],)) for i in others}
    # In the order of their names: what order effects were found in must neither cost another compilation nor change a
    # digit.
    plain = sorted((others[k] for k in find_plain_forces(prompt, list(alone.values()))), key=lambda i: keys[i])
    places = sorted((i for i in others if i not in plain), key=lambda i: keys[i])
    compiled = compile_structure(ModelStructure(prompt, tuple(keys[i] for i in places)))
    if places != list(range(len(places))):
        compiled = compiled.ordered(places)
    delays = [
        delay_column(machine, effects[i].name, ParameterGroup("candidate", effects[i].name, index=i), dict(keys[i][1]))
        for i in late
    ]
    delays += [
        delay_column(
            machine,
            effect.name,
            ParameterGroup("own", effect.name, effect.label),
            effect_definition(effect.name).entries(effect.parameters),
        )
        for effect in machine.effects
        if effect_definition(effect.name).delays
    ]
    forces = {i: force for i in plain if (force := make_force(alone[i])) is not None}
    beside = [
        effect_column(ParameterGroup("candidate", effects[i].name, index=i), free.column.partition(".")[2], free)
        for i, force in forces.items()
        for free in force.parameters
    ]
    return replace(
        compiled, columns=(*compiled.columns, *delays, *beside), delayed=bool(delays), forces=tuple(forces.values())
    )


def _drop_delays(machine: Machine) -> Machine:
    """The machine without effects that delay all of its force."""
    kept = [effect for effect in machine.effects if not effect_definition(effect.name).delays]
    if len(kept) == len(machine.effects):
        return machine
    units = machine.plant.units
    return override_machine(drop_bounds(machine), {"effects": [effect.entry(units) for effect in kept]})


_compiling: Final[dict[ModelStructure, threading.Lock]] = {}
"""Locks of structures: a thread that asks for one while another thread compiles it waits."""


def compile_structure(structure: ModelStructure) -> CompiledFit:
    """The compiled model of a structure, emitted and loaded once, by whichever threads it is asked for."""
    with _compiling.setdefault(structure, threading.Lock()):  # of a dictionary one operation each: no thread between
        compiled = compile_once(structure)
    _compiling.pop(structure, None)
    return compiled


@lru_cache(maxsize=MODELS_CACHED)
def compile_once(structure: ModelStructure) -> CompiledFit:
    """Return the cached value of `compile_structure`, for one thread at a time."""
    machine = structure.machine
    with SYMBOLIC:
        extended = extended_machine(structure)
    code = CompiledModel(extended)
    own, zero = len(machine.effects), typical_sizes(machine)
    groups = {
        e.label: ParameterGroup("own", e.name, e.label)
        if i < own
        else ParameterGroup("candidate", e.name, index=i - own)
        for i, e in enumerate(extended.effects)
    }
    columns = []
    for free in code.model.parameters:
        label, _, parameter = free.column.partition(".")
        column = effect_column(groups[label], parameter, free) if parameter else base_column(free, zero, machine)
        columns.append(column)
    return CompiledFit(code, tuple(columns))


class FitError(RuntimeError):
    """A model that cannot be fitted to this record: it is not finite where its fit starts."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior of the free parameters (free).

    Attributes:
        information: in units of the sum of squares; damps a step.
        binding: the same of the machine's own numbers, 0 of effects under test; part of the cost.
        centre: theta it holds to.
    """

    information: Array
    binding: Array
    centre: Array


@dataclass(frozen=True, eq=False)
class ModelPoint:
    """A model at theta (n_p): residual (m) [N], slopes d(model)/d(theta) (m, n_p), cost (inf: not finite there).

    Where several logs are joined both are without each one's own part (`own`).
    """

    theta: Array
    residual: Array
    jacobian: Array
    cost: float
    own: OwnNumbers | None = None


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Sum of squared residuals on the rows seen, and the prior.

    Attributes:
        model: its compiled code.
        recording: measured friction, in line with the model.
        seen: rows that count (m).
        free: parameters that are fitted (n_p).
        prior: of those.
    """

    model: CompiledFit
    recording: Recording
    seen: Mask
    free: Mask
    prior: Prior

    def at(self, theta: Array) -> ModelPoint:
        """The model at theta (n_p)."""
        recording, free, prior = self.recording, self.free, self.prior
        y, jacobian = self.model.run(recording, theta)
        residual = recording.friction - y
        if diverges(recording, residual):
            return ModelPoint(theta, residual, np.empty((0, 0)), math.inf)
        own = None if jacobian is None else OwnNumbers.of(recording, self.model.columns, jacobian, residual, self.seen)
        if own is not None and jacobian is not None:
            residual, jacobian = residual - own.force, own.project(jacobian, self.seen)
        seen = residual[self.seen]
        cost = float(seen @ seen) + float(prior.binding @ (theta[free] - prior.centre) ** 2)
        # A state that its steps are too long for shows in its derivatives first.
        if jacobian is None or not math.isfinite(cost) or diverges(recording, jacobian):
            return ModelPoint(theta, residual, np.empty((0, 0)), math.inf)
        return ModelPoint(theta, residual, jacobian, cost, own)

    @property
    def count(self) -> int:
        """Residual rows."""
        return int(self.seen.sum())

    def descend(self, theta: Array, iterations: int, enough: float) -> ModelPoint:
        """Minimise from theta (n_p), see `minimise`.

        Raises:
            FitError: not finite at theta.
        """
        free, columns, recording = self.free, self.model.columns, self.recording
        lower, upper = (bound[free] for bound in bounds(columns, recording))
        limit = np.array([step_limit(c, t, recording) for c, t in zip(columns, theta, strict=True)])[free]
        theta = theta.copy()
        theta[free] = np.clip(theta[free], lower, upper)
        here = self.at(theta)
        if not math.isfinite(here.cost):
            raise FitError("the model is not finite where its fit starts")
        if not free.any():
            return here

        def box(here: ModelPoint) -> Box:
            present = here.theta[free]
            return np.maximum(-limit, lower - present), np.minimum(limit, upper - present)

        return minimise(self, here, box, iterations, enough)

    def quadratic(self, here: ModelPoint) -> Quadratic:
        """Return the quadratic model of the cost about a point, in the free numbers."""
        free, prior = self.free, self.prior
        X = here.jacobian.compress(self.seen, axis=0).compress(free, axis=1)  # a third of what masks take
        H = X.T @ X
        g = X.T @ here.residual[self.seen] - prior.binding * (here.theta[free] - prior.centre)
        return Quadratic(H, g, prior.binding, np.diag(H) + prior.information)

    def after(self, here: ModelPoint, step: Array) -> ModelPoint:
        """Return the model after a step of the free numbers."""
        return self.at(self.move(here.theta, step))

    def move(self, theta: Array, step: Array) -> Array:
        """Return theta (n_p) after a step of the free numbers (free).

        Where the force is linear in s and s p, the step is one of s and s p: p + dp s / (s + ds). One along p alone
        would follow a curved valley to a place far outside the travel.
        """
        columns = self.model.columns
        moved = theta.copy()
        moved[self.free] += step
        for i in np.flatnonzero(self.free):
            column = columns[i]
            if not column.times:
                continue
            size = self.model.index(column.group, column.times)
            before, after = (columns[size].si(float(t[size])) for t in (theta, moved))
            if after != 0.0:
                moved[i] = min(max(theta[i] + (moved[i] - theta[i]) * before / after, column.lower), column.upper)
        return moved


def diverges(recording: Recording, values: Array) -> bool:
    """Return True if friction [N] along a recording, or its derivatives, have the size of a state that diverged."""
    # NaN where there is one; without an array of all magnitudes, which takes longer to fill.
    largest = max(float(values.max()), -float(values.min()))
    return not largest < UNSTABLE * max(recording.largest_friction, recording.machine.friction.coulomb)
