"""Parametrisation of a fit: an axis with candidate effects, every number of it a free parameter.

A candidate effect that is a plain force of the signals and its own numbers leaves the elements' motion as it is. It
stands beside a compiled model and needs no code of its own: one model serves all of them, however they are combined.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final, Literal

import casadi as ca
import numpy as np

from sgms_mhe.configuration import make_machine, override_machine, smooth_elements
from sgms_mhe.host.evaluation import Evaluation
from sgms_mhe.host.packages import SYMBOLIC
from sgms_mhe.identification.elements import Stribeck, least_distance
from sgms_mhe.machine import CLOSED_FORMS, Machine, ResolvedEffect
from sgms_mhe.model import SIGNAL_NAMES, FreeParameter
from sgms_mhe.model.building import find_read, plain_force
from sgms_mhe.model.effects import BASE_CAUSES, Stage, effect_definition
from sgms_mhe.model.effects.definition import ReadAs
from sgms_mhe.model.effects.parameters import RecordLimit, StepLimit, any_step
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array, Mask

COARSE: Final = 4.0  # factor between nominal values that models are compiled for
STEP: Final = 1.0  # deflection scales of an effect's states per step, unless the effect says otherwise
SLOW_STEP: Final = 0.02  # deflection scales of a smooth element per step below the gate: off by 1e-5 of its level
Nominal = tuple[tuple[str, float], ...]
"""Nominal values of an effect's parameters, as a key."""
AT_A_TIME: Final = 16_384  # samples whose intermediate values stay near the processor
FORCES_CACHED: Final = 512  # structures that were looked at
MIXING: Final[tuple[Stage, ...]] = ("signal", "motor", "log", "actuator")
"""Stages of effects that change what a force reads, or what becomes of it."""
TIMING: Final = 0.1
"""Time that force and position may be apart without that being a delay [sample]: no two signals are sampled at quite
the same instant."""
TIMING_MOST: Final = 0.6
"""Delay up to which it is the sampling's and not the axis's [sample]: a force that is held over a sample is half a
sample old on average; and a margin."""
SHARP_SMOOTHING: Final = {"zeta": 0.985, "lambda": 233.0, "gamma": 233.0}
"""Elements that slip almost at once, for effects that do not stand with switching ones: lambda (1 - zeta) = 3.5, as in
the default smoothing; with zeta = 0.995 derivatives outgrow the steps of a fit."""
STIFFER: Final = 10.0
"""Stiffness of those, over the one that their steps are chosen for, up to which the steps hold."""
MACHINE_STEP: Final = 0.5
"""Change of the machine's numbers in a step, at most [nominal or present value]: derivatives hold no farther."""


@dataclass(frozen=True)
class CandidateEffect:
    """An effect under test and where its fit starts."""

    name: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class ParameterGroup:
    """Parameters of one cause, wrong or present together.

    Attributes:
        kind: base: numbers of the base model; own: an effect the machine has; candidate: an effect under test.
        cause: its name in a diagnosis: the wrong number or the effect.
        label: of its effect in the machine (`force_ripple_2`); empty for the others.
        index: of an effect under test, its place among them.
    """

    kind: Literal["base", "own", "candidate"]
    cause: str
    label: str = ""
    index: int = 0

    @property
    def is_candidate(self) -> bool:
        """Return True if it is an effect under test; otherwise its numbers stand in the machine file."""
        return self.kind == "candidate"

    @property
    def name(self) -> str:
        """Return the name under which its numbers are listed: the machine's own label where there is one."""
        return self.label or self.cause


def machine_groups(machine: Machine) -> tuple[ParameterGroup, ...]:
    """All groups of the machine's own numbers: those of the base model, then its effects."""
    return (
        *(
            ParameterGroup("base", name)
            for name, cause in BASE_CAUSES.items()
            if machine.friction.n_z > 1 or not any(number.shares for number in cause.numbers)
        ),
        *(ParameterGroup("own", effect.name, effect.label) for effect in list_fitted(machine)),
    )


def list_fitted(machine: Machine) -> tuple[ResolvedEffect, ...]:
    """Return the machine's effects whose numbers a fit may move: all but learned tables."""
    return tuple(effect for effect in machine.effects if not effect_definition(effect.name).learned)


def drop_effect(effects: tuple[CandidateEffect, ...], group: ParameterGroup) -> tuple[CandidateEffect, ...]:
    """The effects under test but the one of a group; all of them where it is none."""
    return tuple(effect for i, effect in enumerate(effects) if not (group.is_candidate and i == group.index))


def drop_group(groups: tuple[ParameterGroup, ...], group: ParameterGroup) -> tuple[ParameterGroup, ...]:
    """The groups but one; all of them where it is not among them."""
    return tuple(other for other in groups if other != group)


@dataclass(frozen=True)
class JacobianColumn:
    """One free parameter of the compiled model.

    Attributes:
        group: it belongs to.
        name: in SI results (`stiffness_1`, `coulomb`, `amplitude_N`).
        nominal, scale: p = nominal + scale (theta - 1).
        machine_theta: value the machine file states (of an effect under test: 1).
        lower, upper: of theta.
        least, most: limits of its identifiability [SI]; None: the bounds.
        step: how far a step of a fit may move it, of an effect's; None: as a number of the base model.
        frozen: its search decides it, no fit moves it.
        timing: it is a time that force and position are apart.
        proportional: the force is proportional to it, from `none` on.
        none: value [SI] at which its effect is none.
        times: name of the size of its group it is multiplied with.
    """

    group: ParameterGroup
    name: str
    nominal: float
    scale: float
    machine_theta: float
    lower: float
    upper: float
    least: RecordLimit | None = None
    most: RecordLimit | None = None
    step: StepLimit | None = None
    frozen: bool = False
    timing: bool = False
    proportional: bool = False
    none: float = 0.0
    times: str = ""

    def si(self, theta: float) -> float:
        """Value in SI units."""
        return self.nominal + self.scale * (theta - 1.0)

    def theta(self, si: float) -> float:
        """Scaled value."""
        return (si - self.nominal) / self.scale + 1.0


@dataclass(frozen=True)
class ModelStructure:
    """Inputs of a compiled model; the machine by its content."""

    machine: Machine = field(compare=False, hash=False)
    effects: tuple[tuple[str, Nominal], ...]
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", self.machine.digest)


def extended_machine(structure: ModelStructure) -> Machine:
    """The machine of a structure with its effects, all its numbers to be estimated."""
    machine = structure.machine
    return _free_everything(machine, structure.effects, typical_sizes(machine))


def typical_sizes(machine: Machine) -> dict[str, float]:
    """Typical values of the base model's numbers the machine file says 0 of: zero has no scale of its own."""
    return {
        number.name: number.typical * scales_of(machine).of(number.unit)
        for cause in BASE_CAUSES.values()
        for number in cause.numbers
        if number.typical is not None and getattr(machine.friction, number.name) == 0.0
    }


def _free_everything(
    machine: Machine, effects: Sequence[tuple[str, Nominal]], friction: Mapping[str, float]
) -> Machine:
    """The machine with effects added and numbers of [friction] replaced, all its numbers to be estimated."""
    units = machine.plant.units
    entries = [e.entry(units) for e in machine.effects]
    entries += [{"name": name} | units.keyed(effect_definition(name).lists(dict(values))) for name, values in effects]
    axis = machine.friction.model_copy(update=dict(friction))
    names = [name for cause in BASE_CAUSES.values() for name in cause.frees if name in axis.estimable]
    changes: dict[str, Any] = {
        "name": "fit",
        "description": "",
        "friction": dict(friction),
        "effects": entries,
        "code": {"precision": "double"},
        "estimator": {"parameters": names, "bounds": {}},
        "sampling": _integrator(machine, [name for name, _ in effects]),
    }
    extended = override_machine(drop_bounds(machine), changes)
    names += [units.named(f"{e.label}.{p}") for e in list_fitted(extended) for p in e.parameters]
    return override_machine(extended, {"estimator": {"parameters": names}})


def drop_bounds(machine: Machine) -> Machine:
    """The same machine with an estimator that constrains nothing."""
    estimator = dict(machine.content.get("estimator", {}))
    kept = {key: value for key, value in estimator.items() if key not in ("bounds", "parameters", "prior")}
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


def nominal_values(machine: Machine, effect: CandidateEffect) -> Nominal:
    """Nominal values of an effect's compiled model: coarse, so that few are compiled, near where rates matter."""
    definition, scales = effect_definition(effect.name), scales_of(machine)
    values: list[tuple[str, float]] = []
    for name in definition.names(effect.parameters):
        parameter = definition.parameter(name)
        size = parameter.default if parameter.default != 0.0 else abs(parameter.size(scales))
        if parameter.is_choice:  # each once; which they are, a fit says
            size *= 1 + sum(parameter.holds(known) for known, _ in values)
        wanted = effect.parameters.get(name, size)
        if definition.states and wanted > 0.0 and size > 0.0:
            size *= COARSE ** round(math.log(wanted / size, COARSE))
        values.append((name, float(min(max(size, parameter.lower), parameter.upper))))
    return tuple(values)


@dataclass(frozen=True, eq=False)
class Force:
    """A plain force.

    Attributes:
        parameters: its free ones, in their order.
        fitted: those of them that a fit moves (n_p); derivatives in the others are zero.
        is_linear: whether the force is, in these.
        read_as: quantity as which other effects may use it.
    """

    parameters: tuple[FreeParameter, ...]
    fitted: Mask
    is_linear: bool
    read_as: ReadAs | None
    _evaluation: Evaluation

    def at(self, w: Array, theta: Array, *, derivatives: bool) -> tuple[Array, Array | None]:
        """Force (n) [N] at signals w (n, 5) with its theta (n_p), and its derivatives (n, n_p) where asked for."""
        n, n_p = len(w), len(self.parameters)
        force, jacobian = np.empty(n), np.zeros((n, n_p)) if derivatives else None
        numbers = {free.column: float(value) for free, value in zip(self.parameters, theta, strict=True)}
        for first in range(0, n, AT_A_TIME):
            part = slice(first, first + AT_A_TIME)
            signals = {name: w[part, i] for i, name in enumerate(SIGNAL_NAMES)}
            found = self._evaluation.at({**signals, **numbers})
            force[part] = found[0]
            if jacobian is not None:
                for i, slope in zip(np.flatnonzero(self.fitted), found[1:], strict=True):
                    jacobian[part, i] = slope
        return force, jacobian


@lru_cache(maxsize=FORCES_CACHED)
def make_force(structure: ModelStructure) -> Force | None:
    """The last effect of a structure, if it is a plain force."""
    with SYMBOLIC:
        machine = extended_machine(structure)
        effect = machine.effects[-1]
        plain = plain_force(machine, effect.label)
        if plain is None:
            return None
        names = [free.column for free in plain.parameters]
        fitted = np.array([not effect_definition(effect.name).parameter(n.partition(".")[2]).frozen for n in names])
        theta = plain.theta[np.flatnonzero(fitted).tolist()]
        slopes = ca.jacobian(plain.force, theta).T
        inputs = {"w": plain.w, "theta": plain.theta}
        evaluation = Evaluation(ca.vertcat(plain.force, slopes), inputs, {"w": SIGNAL_NAMES, "theta": names})
    return Force(plain.parameters, fitted, not ca.depends_on(slopes, theta), plain.read_as, evaluation)


@lru_cache(maxsize=FORCES_CACHED)
def _find_read(structure: ModelStructure) -> frozenset[ReadAs]:
    with SYMBOLIC:
        return find_read(extended_machine(structure))


def find_plain_forces(machine: Machine, structures: Sequence[ModelStructure]) -> tuple[int, ...]:
    """Return the effects under test, each a structure with the machine, that may stand beside a compiled model.

    None where one of them, or of the machine's, changes the inputs of forces or their transmission.
    """
    names = [name for structure in structures for name, _ in structure.effects]
    stages = {effect_definition(name).stage for name in (*names, *(effect.name for effect in machine.effects))}
    if not stages.isdisjoint(MIXING):
        return ()
    forces = [make_force(structure) for structure in structures]
    compiled = tuple(s.effects[0] for s, force in zip(structures, forces, strict=True) if force is None)
    read = _find_read(ModelStructure(machine, tuple(sorted(compiled))))
    return tuple(i for i, force in enumerate(forces) if force is not None and force.read_as not in read)


def smooth_law(machine: Machine, effects: Sequence[CandidateEffect]) -> Machine:
    """The machine with a law that effects can stand with: for elements that switch, ones that slip almost at once.

    They are no stiffer than a sample tells (`least_smooth_distance`).
    """
    if not machine.friction.switches or not any(effect_definition(effect.name).smooth_only for effect in effects):
        return machine
    return smooth_elements(machine, least_smooth_distance(machine), smoothing=SHARP_SMOOTHING)


def least_smooth_distance(machine: Machine) -> float:
    """Return the distance [m] below which elements that switch do not break away as smooth ones.

    As those that switch they may within any. Smooth ones would take for ever below the gate.
    """
    friction = machine.friction
    rise = Stribeck(friction.stribeck_ratio, friction.stribeck_velocity)
    return least_distance("sgms", rise, machine.sampling.rate)


def delay_column(machine: Machine, name: str, group: ParameterGroup, nominal: Mapping[str, float]) -> JacobianColumn:
    """The column of an effect that delays all of the force."""
    definition = effect_definition(name)
    parameter = definition.parameter(definition.delays)
    value = nominal[parameter.name]
    scale = abs(parameter.estimation_scale(scales_of(machine), value))
    lower, upper = ((edge - value) / scale + 1.0 for edge in (parameter.lower, parameter.upper))
    free = FreeParameter(f"{name}.{parameter.name}", f"{name}.{parameter.name}", value, scale, lower, upper)
    return effect_column(group, parameter.name, free)


def effect_column(group: ParameterGroup, parameter: str, free: FreeParameter) -> JacobianColumn:
    """Return the column of an effect's parameter."""
    known = effect_definition(group.cause).parameter(parameter)
    return JacobianColumn(
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


def base_column(free: FreeParameter, zero: Mapping[str, float], machine: Machine) -> JacobianColumn:
    """Return the column of a number of the base model; `zero`: names of those that the machine's file states as 0."""
    cause, number = next((c, n) for c in BASE_CAUSES.values() for n in c.numbers if n.name == free.name)
    is_sharp = not machine.friction.switches and machine.friction.smoothed.lambda_ >= SHARP_SMOOTHING["lambda"]
    return JacobianColumn(
        group=ParameterGroup("base", cause.name),
        name=free.column,
        nominal=free.nominal,
        scale=free.scale,
        machine_theta=0.0 if free.name in zero else 1.0,
        lower=number.lower,
        upper=STIFFER if is_sharp and number.array and not number.shares else number.upper,
        most=number.most,
    )


def step_limit(column: JacobianColumn, theta: float, recording: Recording) -> float:
    """Largest change of theta in one step, beyond which derivatives do not hold."""
    if column.step is None or not (column.group.is_candidate or column.step is any_step):
        return MACHINE_STEP * max(1.0, abs(theta))
    scale = abs(column.scale)
    return column.step(column.si(theta), scale, recording.extents) / scale


def bounds(columns: Sequence[JacobianColumn], recording: Recording) -> tuple[Array, Array]:
    """Bounds of theta: those of the definitions, and nothing that the record cannot tell from something simpler."""
    lower, upper = np.array([c.lower for c in columns]), np.array([c.upper for c in columns])
    for i, column in enumerate(columns):
        if column.least is not None:
            lower[i] = max(lower[i], column.theta(column.least(recording.extents)))
        if column.most is not None:
            upper[i] = min(upper[i], column.theta(column.most(recording.extents)))
            if column.group.kind == "base":  # the machine file's own value stays allowed
                upper[i] = max(lower[i], column.machine_theta, upper[i])
    return lower, upper
