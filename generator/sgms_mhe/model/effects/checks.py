"""Errors of a definition: the same for this package's effects, in tests, and for those of others, in use."""

import math
import re
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np

from sgms_mhe.machine.units import CATALOGUE_ENDS, OF_KIND, PURE_NUMBERS, is_pure_number, suffix_of
from sgms_mhe.model.axis import SETTABLE, SIGNAL_NAMES, SymbolicAxis
from sgms_mhe.model.effects.causes import MOVES
from sgms_mhe.model.effects.definition import STAGES, EffectDefinition
from sgms_mhe.model.effects.excitation import MEASURES
from sgms_mhe.model.effects.parameters import EffectParameter
from sgms_mhe.model.effects.search import Columns, Derivative, Harmonic, Periodic, Step

_NAME: Final = re.compile(r"[a-z][a-z0-9]*(_[a-zA-Z0-9]+)*")
_TRIALS: Final = 5  # random signals that an effect of default size is tried at
_NOTHING: Final = 1e-9  # change of a quantity of size one that rounding makes


@dataclass(frozen=True)
class DefinitionFault:
    """One thing that is wrong with a definition: where in it, the value found, the allowed ones."""

    where: str
    value: object
    allowed: str


def faults_of(definition: EffectDefinition, causes: Container[str]) -> Iterator[DefinitionFault]:
    """Everything that is wrong with a definition; `causes`: names it may refer to."""
    if not _NAME.fullmatch(definition.name):
        yield DefinitionFault("name", definition.name, "a name of lower-case words joined by underscores")
    if definition.stage not in STAGES:
        yield DefinitionFault("stage", definition.stage, f"one of {', '.join(STAGES)}")
    if not definition.kinds or not set(definition.kinds) <= set(OF_KIND):
        yield DefinitionFault("kinds", definition.kinds, f"at least one of {', '.join(OF_KIND)}")
    if definition.loads and (definition.stage != "force" or definition.states):
        yield DefinitionFault("loads", definition.loads, "False but for a force without states of its own")
    if not definition.moves or not set(definition.moves) <= set(MOVES):
        yield DefinitionFault("moves", definition.moves, f"at least one of {', '.join(MOVES)}")
    yield from _references(definition, causes)
    names = [parameter.name for parameter in definition.parameters]
    if not names or len(set(names)) < len(names):
        yield DefinitionFault("parameters", names, "at least one, each name once")
    for parameter in definition.parameters:
        yield from _parameter(parameter)
    if not any(parameter.is_size and parameter.default == parameter.none for parameter in definition.parameters):
        yield DefinitionFault("parameters", names, "a size whose default is `none`: an effect is nothing by default")
    yield from _search(definition)
    yield from _contribution(definition)


def _references(definition: EffectDefinition, causes: Container[str]) -> Iterator[DefinitionFault]:
    """Check the references to other causes, and the needed excitation."""
    for where, others in (
        ("confused_with", tuple(definition.confused_with)),
        ("excludes", definition.excludes),
        ("simpler", definition.simpler.causes),
    ):
        for other in others:
            if other == definition.name or other not in causes:
                yield DefinitionFault(where, other, "another cause of the catalogue")
    names = [parameter.name for parameter in definition.parameters]
    for need in definition.excitation.needs:
        if need.measure not in MEASURES:
            yield DefinitionFault("excitation", need.measure, f"one of {', '.join(MEASURES)}")
        if need.times is not None and need.times not in names:
            yield DefinitionFault("excitation", need.times, f"one of {', '.join(names)}")


def _parameter(parameter: EffectParameter) -> Iterator[DefinitionFault]:
    where = f"parameters.{parameter.name}"
    if not _NAME.fullmatch(parameter.name) or parameter.name == "name":
        yield DefinitionFault("parameters", parameter.name, "a name of words joined by underscores, other than `name`")
    elif suffix_of(parameter.name) not in CATALOGUE_ENDS and not is_pure_number(parameter.name):
        units, pure = ", ".join(CATALOGUE_ENDS), " or ".join(PURE_NUMBERS)
        allowed = f"a name that ends in its unit ({units}); of a pure number in {pure}"
        yield DefinitionFault("parameters", parameter.name, allowed)
    if not (math.isfinite(parameter.default) and parameter.lower <= parameter.default <= parameter.upper):
        yield DefinitionFault(f"{where}.default", parameter.default, parameter.allowed)
    if not (math.isfinite(parameter.scale) and parameter.scale > 0.0):
        yield DefinitionFault(f"{where}.scale", parameter.scale, "a positive number")


def _search(definition: EffectDefinition) -> Iterator[DefinitionFault]:
    """Names the search refers to."""
    own = {parameter.name: parameter for parameter in definition.parameters}
    sizes: tuple[str | None, ...] = ()
    others: tuple[str | None, ...] = ()
    match definition.search:
        case Columns() as kind:
            sizes, others = (kind.exact,), (kind.own_size,)
        case Harmonic() as kind:
            sizes, others = (kind.size,), (kind.period, kind.phase)
        case Periodic() as kind:
            sizes, others = (kind.sine.size, kind.cosine), (kind.sine.period, kind.order.name)
        case Step() as kind:
            sizes, others = (kind.size,), (kind.time,)
        case Derivative() as kind:
            sizes = (kind.size,)
        case _:
            pass
    for name in sizes:
        if name is not None and not (name in own and own[name].is_proportional):
            yield DefinitionFault("search", name, "a size that the force is proportional to")
    for name in others:
        if name is not None and name not in own:
            yield DefinitionFault("search", name, f"one of {', '.join(own)}")


def _contribution(definition: EffectDefinition) -> Iterator[DefinitionFault]:
    """Check the contribution to an axis: its states, and that it is nothing by default."""
    axis = SymbolicAxis(1.0, 1.0, step=1e-4, gate_per_velocity=3.5e4)
    axis.scope = definition.name
    before = _quantities(axis)
    nominal = definition.entries({parameter.name: parameter.default for parameter in definition.parameters})
    symbols = {name: ca.SX.sym(name) for name in nominal}
    try:
        definition.contribute(axis, symbols, nominal)
    except Exception as error:  # whatever the code of others raises must not end the program
        yield DefinitionFault("contribute", None, f"a contribution to an axis; {type(error).__name__}: {error}")
        return
    states = tuple(state.spec.name.removeprefix(f"{definition.name}_") for state in axis.states)
    if states != definition.states and not (definition.learned and not states):  # a table over nothing yet
        yield DefinitionFault("states", definition.states, f"the states that it contributes, {states}")
    if any(state.rate is None for state in axis.states):
        yield DefinitionFault("contribute", None, "a rate for every state")
        return
    changed = _largest_change(axis, before, symbols, nominal)
    if not changed <= _NOTHING:
        yield DefinitionFault("contribute", None, "nothing where all parameters have their defaults")


def _quantities(axis: SymbolicAxis) -> ca.SX:
    """All that an effect may change of an axis."""
    signals = axis.position, axis.velocity, axis.acceleration, axis.force
    return ca.vertcat(*signals, *(getattr(axis, name) for name in SETTABLE))


def _largest_change(
    axis: SymbolicAxis, before: ca.SX, symbols: Mapping[str, ca.SX], nominal: Mapping[str, float]
) -> float:
    """Return the largest change by a contribution of default parameters, states at rest, at signals of size one."""
    states = ca.vertcat(*(state.chi for state in axis.states)) if axis.states else ca.SX(0, 1)
    changed = ca.Function(
        "changed", [axis.measured, ca.vertcat(*symbols.values()), states], [ca.fabs(_quantities(axis) - before)]
    )
    random = np.random.default_rng(1)
    defaults, rest = list(nominal.values()), np.zeros(len(axis.states))
    found = [changed(random.uniform(-1.0, 1.0, len(SIGNAL_NAMES)), defaults, rest) for _ in range(_TRIALS)]
    return float(max(np.max(np.abs(np.asarray(values, dtype=np.float64))) for values in found))
