"""The emitted model of a machine with effects added, every number in it a free parameter, compiled for this host."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.forces import Force, force_of, plain_places
from sgms_mhe.diagnosis.freeing import Structure, extended_machine, nominal_values, typical_sizes, without_bounds
from sgms_mhe.diagnosis.groups import Column, Extra, Group
from sgms_mhe.diagnosis.shifting import Shift
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.host.packages import SYMBOLIC, cached_package
from sgms_mhe.machine import Machine
from sgms_mhe.model import FreeParameter, Model, build_model
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.recording import SPLIT, Recording
from sgms_mhe.recordings.rows import row_means
from sgms_mhe.support.parallel import in_parallel

Array = NDArray[np.float64]

CHUNK: Final = 200_000  # samples that are predicted at a time; bounds the memory of derivatives
SAME_STATE: Final = 1e-9  # of a state of about 1: two that differ by less go on alike
SAME_SLOPES: Final = 1e-6  # the same for its derivatives
KEPT: Final = 512  # compiled models; a diagnosis of a rich record asks for about a hundred
SHARP_SMOOTHING: Final = {"zeta": 0.985, "lambda": 233.0, "gamma": 233.0}
"""Elements that slip almost at once, for effects that do not stand with switching ones: lambda (1 - zeta) = 3.5, as in
the default smoothing; with zeta = 0.995 derivatives outgrow the steps of a fit."""


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
        code: the model, without what delays all of its force and without effects that are plain forces.
        columns: of its parameters, then the delay where there is one, then those of the forces.
        delayed: whether there is.
        forces: what stands beside the code.
    """

    code: CompiledModel
    columns: tuple[Column, ...]
    delayed: bool = False
    forces: tuple[Force, ...] = ()

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
        coded = self.model.n_p + int(self.delayed)
        own = theta[:coded]
        asked, run = own, self._run
        if self.delayed:  # models with the same code may scale their delays otherwise
            asked, run = np.append(own, (self._delay(own), self.columns[coded - 1].scale)), self._run_late
        friction, slopes = recording.runs.get(
            self.code, recording.signals, asked, derivatives, lambda: run(recording, own, derivatives)
        )
        # A code that has just run with the same numbers is not run again for other forces beside it.
        return self._with_forces(recording, theta, friction, slopes) if self.forces else (friction, slopes)

    def _with_forces(
        self, recording: Recording, theta: Array, friction: Array, slopes: Array | None
    ) -> tuple[Array, Array | None]:
        """What the code makes of theta (n_p), and the forces beside it."""
        m, coded = len(friction), self.model.n_p + int(self.delayed)
        total, wide = friction.copy(), None if slopes is None else np.empty((m, len(theta)))
        shift = Shift.of(self._delay(theta), recording.machine.sampling.rate) if self.delayed else None

        def put(rows: slice) -> None:
            if wide is not None and slopes is not None:
                wide[rows, :coded] = slopes[rows]
            first = coded
            for force in self.forces:
                columns = slice(first, first + len(force.parameters))
                first = columns.stop
                own = None if wide is None else wide[:, columns]
                by_shift = _add_force(force, recording, theta[columns], rows, shift, total, own)
                if wide is not None and by_shift is not None:
                    wide[:, coded - 1] += by_shift * self.columns[coded - 1].scale

        # What is shifted reads samples of other rows.
        parts = [slice(0, m)] if m < SPLIT or shift is not None else [slice(0, m // 2), slice(m // 2, m)]
        in_parallel([partial(put, rows) for rows in parts])
        return total, wide

    def _delay(self, theta: Array) -> float:
        """The delay [s] of a theta that begins with the code's and the delay's."""
        return self.columns[self.model.n_p].si(float(theta[self.model.n_p]))

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
                force[piece] = row_means(y, factor)
                if slopes is not None and d is not None:
                    slopes[piece] = row_means(d, factor)
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
        """The same, the drive's force as late as the last parameter says."""
        scale, m = self.columns[self.model.n_p].scale, len(recording.time)
        pieces = list(self._pieces(recording, theta[:-1], derivatives, slice(0, m), self._relaxed()))
        inertial = recording.machine.plant.moved * recording.signals.acceleration
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


def _add_force(
    force: Force,
    recording: Recording,
    theta: Array,
    rows: slice,
    shift: Shift | None,
    friction: Array,
    slopes: Array | None,
) -> Array | None:
    """Add a plain force with its parameters theta (n_p) to rows of the friction (m), and put its derivatives (m, n_p).

    In pieces of bounded memory, and all at once where something shifts it. Returns its derivative in the shift (m)
    [N/s], if it has one.
    """
    factor, by_shift = recording.factor, None
    at_a_time = rows.stop if shift is not None else max(1, CHUNK // factor)
    for first in range(rows.start, rows.stop, at_a_time):
        part = slice(first, min(rows.stop, first + at_a_time))
        y, d = force.at(recording.inputs(first * factor, part.stop * factor), theta, derivatives=slopes is not None)
        if shift is not None:
            by_shift = recording.reduce(shift.slope_of(y))
            y, d = shift.of_series(y), None if d is None else shift.of_series(d)
        friction[part] += row_means(y, factor)
        if slopes is not None and d is not None:
            slopes[part] = row_means(d, factor)
    return by_shift


def compiled_fit(machine: Machine, extras: Sequence[Extra]) -> CompiledFit:
    """The machine with effects added, everything in it a free parameter.

    Their values are where a fit starts; what is compiled is near them, so that few models serve all fits.
    """
    keys = [(e.name, nominal_values(machine, e)) for e in extras]
    machine = bearing(machine, extras)
    prompt = _prompt(machine)
    late = [i for i, extra in enumerate(extras) if effect_definition(extra.name).delays]
    others = [i for i in range(len(keys)) if i not in late]
    alone = {i: Structure(prompt, (keys[i],)) for i in others}
    # In the order of their names: what order effects were found in must neither cost another compilation nor change a
    # digit.
    plain = sorted((others[k] for k in plain_places(prompt, list(alone.values()))), key=lambda i: keys[i])
    places = sorted((i for i in others if i not in plain), key=lambda i: keys[i])
    compiled = compiled_structure(Structure(prompt, tuple(keys[i] for i in places)))
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
    forces = {i: force for i in plain if (force := force_of(alone[i])) is not None}
    beside = [
        _effect_column(Group.extra(extras[i].name, i), free.column.partition(".")[2], free)
        for i, force in forces.items()
        for free in force.parameters
    ]
    return replace(
        compiled,
        columns=(*compiled.columns, *delays, *beside),
        delayed=bool(delays),
        forces=tuple(forces.values()),
    )


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
    scale = abs(parameter.estimation_scale(scales_of(machine), value))
    lower, upper = ((edge - value) / scale + 1.0 for edge in (parameter.lower, parameter.upper))
    free = FreeParameter(f"{name}.{parameter.name}", f"{name}.{parameter.name}", value, scale, lower, upper)
    return _effect_column(group, parameter.name, free)


def bearing(machine: Machine, extras: Sequence[Extra]) -> Machine:
    """The machine with a law that effects can stand with: for elements that switch, ones that slip almost at once."""
    if not machine.friction.switches or not any(effect_definition(extra.name).smooth_only for extra in extras):
        return machine
    return override_machine(machine, {"friction": {"law": "sgms", "smoothing": SHARP_SMOOTHING}})


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
        extended = extended_machine(structure)
        model = build_model(extended)
        package = cached_package(extended, model)
    code = CompiledModel(extended, package, model)
    own, zero = len(machine.effects), typical_sizes(machine)
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
