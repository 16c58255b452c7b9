"""The emitted model of a machine with effects added, every number in it a free parameter, compiled for this host."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import make_machine, override_machine
from sgms_mhe.diagnosis.groups import Column, Extra, Group
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.host.packages import SYMBOLIC, cached_package
from sgms_mhe.machine import CLOSED_FORMS, Machine
from sgms_mhe.model import FreeParameter, Model, build_model
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.parallel import in_parallel

Array = NDArray[np.float64]

CHUNK: Final = 200_000  # samples that are predicted at a time; bounds the memory of derivatives
SAME_STATE: Final = 1e-9  # of a state of about 1: two that differ by less go on alike
SAME_SLOPES: Final = 1e-6  # the same for its derivatives
KEPT: Final = 512  # compiled models; a diagnosis of a rich record asks for about a hundred
COARSE: Final = 4.0  # factor between nominal values that models are compiled for
STEP: Final = 1.0  # deflection scales of an effect's states per step, unless the effect says otherwise
SLOW_STEP: Final = 0.04  # deflection scales of a smooth element per step below the gate: off by 1e-5 of its level

Nominal = tuple[tuple[str, float], ...]
"""Nominal values of an effect's parameters, as a key."""


@dataclass(eq=False)
class _State:
    """State (n_x) at a sample and its derivatives (n_x, n_p); `moved`: whether it is not the one before the first."""

    x: Array
    d_x: Array
    moved: bool = False

    def copied(self) -> _State:
        """The same, whatever this one does next."""
        return _State(self.x.copy(), self.d_x.copy(), self.moved)

    def is_close(self, other: _State) -> bool:
        """Whether nothing that comes from here would differ by anything that matters."""
        return bool(
            np.max(np.abs(self.x - other.x)) < SAME_STATE
            and np.max(np.abs(self.d_x - other.d_x)) < SAME_SLOPES * (1.0 + np.max(np.abs(other.d_x)))
        )


@dataclass(frozen=True, eq=False)
class CompiledFit:
    """The emitted model along a recording, in pieces of bounded memory, reduced to the fit's rate.

    Attributes:
        code: the model, without what delays all of its force.
        columns: of its parameters, and last the delay where there is one.
        delayed: whether there is.
    """

    code: CompiledModel
    columns: tuple[Column, ...]
    delayed: bool = False

    @property
    def model(self) -> Model:
        """The symbolic model that was compiled."""
        return self.code.model

    def index(self, group: Group, name: str) -> int:
        """Place of a group's parameter among the columns."""
        return next(i for i, c in enumerate(self.columns) if c.group == group and c.name == name)

    def ordered(self, places: Sequence[int]) -> CompiledFit:
        """The same code for effects under test in another order: `places[i]` is where number i stands in the order."""
        groups = {c.group: c.group for c in self.columns}
        groups |= {g: replace(g, index=places[g.index]) for g in groups if g.is_extra}
        return replace(self, columns=tuple(replace(c, group=groups[c.group]) for c in self.columns))

    def run(self, recording: Recording, theta: Array, *, derivatives: bool = True) -> tuple[Array, Array | None]:
        """Friction (m) [N] and its derivatives in theta (m, n_p), not to be written to: it may be asked for again."""
        asked, run = theta, self._run
        if self.delayed:  # models with the same code may scale their delays otherwise
            late, run = self.columns[-1], self._run_late
            asked = np.append(theta, (late.si(float(theta[-1])), late.scale))
        return recording.runs.get(
            self.code, recording.signals, asked, derivatives, lambda: run(recording, theta, derivatives)
        )

    def _run(self, recording: Recording, theta: Array, derivatives: bool) -> tuple[Array, Array | None]:
        m, factor, n_p = len(recording.time), recording.factor, self.model.n_p
        # What effects' states there may be forget by time, not by motion.
        begin = recording.second_half_begins if self.model.n_x == recording.machine.friction.n_z else None
        if factor == 1 and m <= CHUNK and begin is None:  # one piece, whose samples are the rows
            _, y, d = next(self._pieces(recording, theta, derivatives, slice(0, m), self._relaxed()))
            return y, d
        force, slopes = np.empty(m), np.empty((m, n_p)) if derivatives else None

        def run(rows: slice, at: _State) -> _State:
            for piece, y, d in self._pieces(recording, theta, derivatives, rows, at):
                force[piece] = y.reshape(-1, factor).mean(axis=1)
                if slopes is not None and d is not None:
                    slopes[piece] = d.reshape(-1, factor, n_p).mean(axis=1)
            return at

        if begin is None:
            run(slice(0, m), self._relaxed())
            return force, slopes
        # Whether there is a core for the second half has no say in this: it must not change a result.
        middle = m // 2

        def run_second(lead: slice) -> _State:
            at = self._relaxed()
            for _ in self._pieces(recording, theta, False, lead, at):
                pass
            guessed = at.copied()
            run(slice(middle, m), at)
            return guessed

        halves: list[Callable[[], _State]] = [
            partial(run, slice(0, middle), self._relaxed()),
            partial(run_second, slice(begin, middle)),
        ]
        reached, guessed = in_parallel(halves)
        if not guessed.is_close(reached):
            run(slice(middle, m), reached)
        return force, slopes

    def _relaxed(self) -> _State:
        return _State(np.zeros(self.model.n_x), np.zeros((self.model.n_x, self.model.n_p)))

    def _run_late(self, recording: Recording, theta: Array, derivatives: bool) -> tuple[Array, Array | None]:
        """The same, the drive's force as late as the last parameter says; between samples by cubics.

        Lines would lose half of what is near half the rate, which looks like a resonance.
        """
        late, rate, m = self.columns[-1], recording.machine.sampling.rate, len(recording.time)
        pieces = list(self._pieces(recording, theta[:-1], derivatives, slice(0, m), self._relaxed()))
        inertial = recording.machine.plant.moved * recording.signals.acceleration
        drive = np.concatenate([y for _, y, _ in pieces])
        inertial = inertial[: len(drive)]
        drive += inertial
        last = len(drive) - 1
        at = np.clip(np.arange(last + 1) - late.si(float(theta[-1])) * rate, 0.0, float(last))
        places = np.clip(np.floor(at).astype(np.int64) + np.arange(-1, 3)[:, None], 0, last)
        weights, slopes = _cubic(at - np.floor(at))

        def shifted(series: Array, by: Array = weights) -> Array:
            return np.asarray(
                sum((w if series.ndim == 1 else w[:, None]) * series[k] for w, k in zip(by, places, strict=True))
            )

        force = recording.reduce(shifted(drive) - inertial)
        if not derivatives:
            return force, None
        own = shifted(np.concatenate([d for _, _, d in pieces if d is not None]))
        change = -shifted(drive, slopes) * rate * late.scale
        return force, recording.reduce(np.column_stack((own, change)))

    def _pieces(
        self, recording: Recording, theta: Array, derivatives: bool, wanted: slice, at: _State
    ) -> Iterator[tuple[slice, Array, Array | None]]:
        """Rows, and at their samples the friction (k) [N] and its derivatives in the code's parameters (k, n_p).

        Of the rows wanted, from a state on, which goes with them.
        """
        factor, n_p = recording.factor, self.model.n_p
        values = np.ascontiguousarray(theta, dtype=np.float64)
        rows = max(1, CHUNK // factor)
        for first in range(wanted.start, wanted.stop, rows):
            last = min(wanted.stop, first + rows)
            start, end = first * factor, last * factor
            back = int(at.moved)  # the piece begins with the sample that its state belongs to
            w = recording.inputs(start - back, end)
            y = np.empty(len(w))
            d = np.empty((len(w), n_p)) if derivatives else None
            self.code.advance(w, values, at.x, at.d_x, y, d)
            at.moved = True
            yield slice(first, last), y[back:], None if d is None else d[back:]


def _cubic(u: Array) -> tuple[Array, Array]:
    """Weights (4, n) of samples -1, 0, 1, 2 at places u (n) between 0 and 1, and their derivatives in u (Lagrange)."""
    weights = (
        -u * (u - 1.0) * (u - 2.0) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        -(u + 1.0) * u * (u - 2.0) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    )
    slopes = (
        -(3.0 * u**2 - 6.0 * u + 2.0) / 6.0,
        (3.0 * u**2 - 4.0 * u - 1.0) / 2.0,
        -(3.0 * u**2 - 2.0 * u - 2.0) / 2.0,
        (3.0 * u**2 - 1.0) / 6.0,
    )
    return np.stack(weights), np.stack(slopes)


def compiled_fit(machine: Machine, extras: Sequence[Extra]) -> CompiledFit:
    """The machine with effects added, everything in it a free parameter.

    Their values are where a fit starts; what is compiled is near them, so that few models serve all fits.
    """
    keys = [(e.name, _nominal(machine, e)) for e in extras]
    machine = bearing(machine, extras)
    late = [i for i, extra in enumerate(extras) if effect_definition(extra.name).delays]
    # Compiled in the order of their names: what order effects were found in must not cost another compilation.
    places = sorted((i for i in range(len(keys)) if i not in late), key=lambda i: keys[i])
    compiled = compiled_structure(Structure(_prompt(machine), tuple(keys[i] for i in places)))
    if places != list(range(len(places))):
        compiled = compiled.ordered(places)
    delays = [_delay(machine, extras[i].name, Group.extra(extras[i].name, i), dict(keys[i][1])) for i in late]
    delays += [
        _delay(
            machine,
            effect.name,
            Group.own(effect.name, effect.label),
            effect_definition(effect.name).entries(effect.parameters),
        )
        for effect in machine.effects
        if effect_definition(effect.name).delays
    ]
    return replace(compiled, columns=(*compiled.columns, *delays), delayed=True) if delays else compiled


def _prompt(machine: Machine) -> Machine:
    """The machine without effects that delay all of its force."""
    kept = [effect for effect in machine.effects if not effect_definition(effect.name).delays]
    if len(kept) == len(machine.effects):
        return machine
    units = machine.plant.units
    return override_machine(without_bounds(machine), {"effects": [effect.entry(units) for effect in kept]})


def _delay(machine: Machine, name: str, group: Group, nominal: Mapping[str, float]) -> Column:
    """The column of an effect that delays all of the force."""
    definition = effect_definition(name)
    parameter = definition.parameter(definition.delays)
    value = nominal[parameter.name]
    scale = parameter.estimation_scale(scales_of(machine), value)
    lower, upper = ((edge - value) / scale + 1.0 for edge in (parameter.lower, parameter.upper))
    free = FreeParameter(f"{name}.{parameter.name}", f"{name}.{parameter.name}", value, scale, lower, upper)
    return _effect_column(group, parameter.name, free)


def bearing(machine: Machine, extras: Sequence[Extra]) -> Machine:
    """The machine with a law that effects can stand with: for elements that switch, ones that slip almost at once."""
    if not machine.friction.switches or not any(effect_definition(extra.name).smooth_only for extra in extras):
        return machine
    thresholds = machine.diagnosis
    smoothing = {
        "zeta": thresholds.sharp_zeta,
        "lambda": thresholds.sharp_lambda,
        "gamma": thresholds.sharp_gamma,
    }
    return override_machine(machine, {"friction": {"law": "sgms", "smoothing": smoothing}})


@dataclass(frozen=True)
class Structure:
    """What a compiled model depends on; the machine by its content."""

    machine: Machine = field(compare=False, hash=False)
    extras: tuple[tuple[str, Nominal], ...]
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", self.machine.digest)


class _Waiting:
    """Who asks for a structure while another thread compiles it waits for that one."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._locks: dict[Structure, threading.Lock] = {}

    def of(self, structure: Structure) -> threading.Lock:
        """What to hold while asking for it."""
        with self._guard:
            return self._locks.setdefault(structure, threading.Lock())

    def done(self, structure: Structure) -> None:
        """It is compiled, and whoever asks from now on finds it."""
        with self._guard:
            self._locks.pop(structure, None)


_waiting = _Waiting()


def compiled_structure(structure: Structure) -> CompiledFit:
    """The compiled model of a structure, emitted and loaded once, by whichever threads it is asked for."""
    with _waiting.of(structure):
        compiled = compiled_once(structure)
    _waiting.done(structure)
    return compiled


@lru_cache(maxsize=KEPT)
def compiled_once(structure: Structure) -> CompiledFit:
    """What `compiled_structure` keeps, for one thread at a time."""
    machine = structure.machine
    with SYMBOLIC:
        zero = _typical_sizes(machine)
        extended = _with_everything_free(machine, structure.extras, zero)
        model = build_model(extended)
        package = cached_package(extended, model)
    code = CompiledModel(extended, package, model)
    own = len(machine.effects)
    groups = {
        e.label: Group.own(e.name, e.label) if i < own else Group.extra(e.name, i - own)
        for i, e in enumerate(extended.effects)
    }
    columns = []
    for free in code.model.parameters:
        label, _, parameter = free.column.partition(".")
        column = _effect_column(groups[label], parameter, free) if parameter else _base_column(free, zero)
        columns.append(column)
    return CompiledFit(code, tuple(columns))


def _typical_sizes(machine: Machine) -> dict[str, float]:
    """Typical values of the base model's numbers that the machine file says 0 of: zero has no scale of its own."""
    return {
        number.name: number.typical * scales_of(machine).of(number.unit)
        for cause in BASE_CAUSES.values()
        for number in cause.numbers
        if number.typical is not None and getattr(machine.friction, number.name) == 0.0
    }


def _with_everything_free(
    machine: Machine, extras: Sequence[tuple[str, Nominal]], friction: Mapping[str, float]
) -> Machine:
    """The machine with effects added and numbers of [friction] replaced, all its numbers to be estimated."""
    units = machine.plant.units
    effects = [e.entry(units) for e in machine.effects]
    effects += [{"name": name} | units.keyed(effect_definition(name).lists(dict(values))) for name, values in extras]
    axis = machine.friction.model_copy(update=dict(friction))
    names = [name for cause in BASE_CAUSES.values() for name in cause.frees if name in axis.estimable]
    changes: dict[str, Any] = {
        "name": "fit",
        "description": "",
        "friction": dict(friction),
        "effects": effects,
        "code": {"precision": "double"},
        "estimator": {"parameters": names, "bounds": {}},
        "sampling": _integrator(machine, [name for name, _ in extras]),
    }
    extended = override_machine(without_bounds(machine), changes)
    names += [units.named(f"{e.label}.{p}") for e in extended.effects for p in e.parameters]
    return override_machine(extended, {"estimator": {"parameters": names}})


def without_bounds(machine: Machine) -> Machine:
    """The same machine with an estimator that constrains nothing."""
    estimator = dict(machine.content.get("estimator", {}))
    kept = {key: value for key, value in estimator.items() if key not in ("bounds", "parameters")}
    return make_machine({**machine.content, "estimator": kept}, machine.source)


def _integrator(machine: Machine, names: Sequence[str]) -> dict[str, Any]:
    """Integration for fits: at least one step per sample.

    Where the elements are integrated exactly, steps are coarser for the rest: effects' states settle within them, and a
    search runs them a hundred times. Below the gate they hold up to ten times the stiffness of the file.
    """
    sampling = machine.sampling
    # By name, so that what a tolerance chose stays chosen.
    integrator: dict[str, Any] = {"scheme": sampling.integrator.scheme}
    if sampling.integrator.substeps < sampling.samples_per_update:
        integrator["substeps"] = sampling.samples_per_update
    if sampling.integrator.scheme in CLOSED_FORMS:
        steps = [effect_definition(name).fit_displacement or STEP for name in names]
        # Long steps of one effect are a matter of cost, which short ones of another would undo.
        long = max(steps, default=STEP)
        integrator["displacement"] = long if long > STEP else min(steps, default=STEP)
    if sampling.integrator.scheme == "flow":
        integrator["slow_displacement"] = max(SLOW_STEP, sampling.integrator.slow_displacement)
    return {"integrator": integrator}


def _nominal(machine: Machine, extra: Extra) -> Nominal:
    """Nominal values of an effect's compiled model: coarse, so that few are compiled, near where rates matter."""
    definition, scales = effect_definition(extra.name), scales_of(machine)
    values: list[tuple[str, float]] = []
    for name in definition.names(extra.parameters):
        parameter = definition.parameter(name)
        size = parameter.default if parameter.default != 0.0 else abs(parameter.size(scales))
        if parameter.whole:  # each once; which they are, a fit says
            size += sum(parameter.holds(known) for known, _ in values)
        wanted = extra.parameters.get(name, size)
        if definition.states and wanted > 0.0 and size > 0.0:
            size *= COARSE ** round(math.log(wanted / size, COARSE))
        values.append((name, float(min(max(size, parameter.lower), parameter.upper))))
    return tuple(values)


def _effect_column(group: Group, parameter: str, free: FreeParameter) -> Column:
    known = effect_definition(group.cause).parameter(parameter)
    return Column(
        group=group,
        name=parameter,
        nominal=free.nominal,
        scale=free.scale,
        machine_theta=1.0,
        lower=free.lower,
        upper=free.upper,
        least=known.least,
        most=known.most,
        step=known.step,
        frozen=known.frozen,
        timing=known.timing,
        proportional=known.is_proportional,
        none=known.none,
        times=known.times,
    )


def _base_column(free: FreeParameter, zero: Mapping[str, float]) -> Column:
    """`zero`: numbers that the machine file says 0 of."""
    cause, number = next((c, n) for c in BASE_CAUSES.values() for n in c.numbers if n.name == free.name)
    return Column(
        group=Group.base(cause.name),
        name=free.column,
        nominal=free.nominal,
        scale=free.scale,
        machine_theta=0.0 if free.name in zero else 1.0,
        lower=number.lower,
        upper=number.upper,
        most=number.most,
    )
