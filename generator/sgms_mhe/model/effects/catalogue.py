"""The catalogue: the effects of this package, and those that other installed distributions bring.

A distribution offers an effect by an entry point of the group `sgms_mhe.effects`: its name is the effect's, its object
an `EffectDefinition`. It is imported when it is first asked for, and checked as the own effects are by their tests. One
that is broken is an error where it is used and left out where all effects are.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from sgms_mhe.machine.units import Kind
from sgms_mhe.model.effects.base import BASE_CAUSES, base_cause
from sgms_mhe.model.effects.causes import CauseDefinition
from sgms_mhe.model.effects.checks import faults_of
from sgms_mhe.model.effects.definition import EffectDefinition
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.names import name_distribution

GROUP: Final = "sgms_mhe.effects"
"""Entry points of effects."""

EFFECT_NAMES: Final[tuple[str, ...]] = (
    "force_ripple",
    "force_constant_ripple",
    "constant_offset",
    "position_spring",
    "hose_hysteresis",
    "asymmetric_coulomb",
    "asymmetric_viscous",
    "position_dependent_friction",
    "friction_drift",
    "viscous_drift",
    "mass_mismatch",
    "force_gain",
    "force_delay",
    "actuator_lag",
    "quadratic_drag",
    "eddy_current_damping",
    "encoder_periodic_error",
    "structural_resonance",
    "periodic_disturbance",
    "step_disturbance",
    "backlash",
    "frictional_lag",
    "viscous_lag",
    "dwell_dependence",
    "micro_viscous",
    "unbalance",
    "load_dependent_friction",
    "drive_efficiency",
    "position_map",
    "learned_residual",
    "friction_curve",
)
"""The effects of this package, each the module of the same name in this folder."""

LEARNED_NAMES: Final = ("learned_residual",)
"""Those whose numbers are learned: no causes."""

CAUSE_NAMES: Final[tuple[str, ...]] = (*(name for name in EFFECT_NAMES if name not in LEARNED_NAMES), *BASE_CAUSES)
"""What a diagnosis may name without other distributions: effects, then wrong numbers of the base model."""


@dataclass(frozen=True)
class _Offer:
    """An effect that another distribution brings."""

    distribution: str
    entry: EntryPoint


@cache
def _offers() -> Mapping[str, tuple[_Offer, ...]]:
    """Offers by name of the effect, in the order of names."""
    found: dict[str, list[_Offer]] = {}
    for entry in entry_points(group=GROUP):
        found.setdefault(entry.name, []).append(_Offer(name_distribution(entry), entry))
    return {name: tuple(sorted(offers, key=lambda o: o.distribution)) for name, offers in sorted(found.items())}


@cache
def _outcome(name: str) -> EffectDefinition | InputError:
    """The effect offered under a name, or the error of the offer."""
    first, *others = _offers()[name]
    where = f"entry point {GROUP}.{name}"
    if name in EFFECT_NAMES or name in BASE_CAUSES:
        return InputError(first.distribution, where, None, "a name that sgms-mhe does not use itself")
    if others:
        rest = ", ".join(offer.distribution for offer in others)
        return InputError(first.distribution, where, None, f"a name of its own; {rest} brings an effect of this name")
    try:
        definition = first.entry.load()
    except (Exception, SystemExit) as error:  # whatever the code of others raises must not end the program
        allowed = f"an object that can be imported; {_said(error)}"
        return InputError(first.distribution, where, first.entry.value, allowed)
    if not isinstance(definition, EffectDefinition):
        kind = type(definition).__name__
        return InputError(first.distribution, where, first.entry.value, f"an EffectDefinition; this is of type {kind}")
    if definition.name != name:
        return InputError(first.distribution, where, definition.name, f"a definition whose name is {name}")
    try:
        fault = next(iter(faults_of(definition, (*CAUSE_NAMES, *_offers()))), None)
    except Exception as error:  # what has the wrong type fails in the checks themselves
        return InputError(first.distribution, name, None, f"a definition with the types of its fields; {_said(error)}")
    if fault is not None:
        return InputError(first.distribution, f"{name}.{fault.where}", fault.value, fault.allowed)
    return definition


def forget_distributions() -> None:
    """Search installed packages again when an effect is next asked for."""
    _offers.cache_clear()
    _outcome.cache_clear()


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def effect_definition(name: str) -> EffectDefinition:
    """Return the definition of the effect called `name`.

    Raises:
        KeyError: no effect has that name.
        InputError: another distribution brings an effect of that name, and it is broken; names both.
    """
    if name in EFFECT_NAMES:
        definition: EffectDefinition = import_module(f"{__package__}.{name}").DEFINITION
        return definition
    if name not in _offers():
        raise KeyError(name)
    outcome = _outcome(name)
    if isinstance(outcome, InputError):
        raise outcome
    return outcome


def own_effects(kind: Kind) -> tuple[str, ...]:
    """This package's effects an axis of a kind may have."""
    return tuple(name for name in EFFECT_NAMES if kind in effect_definition(name).kinds)


def effect_names(kind: Kind | None = None) -> tuple[str, ...]:
    """All effects that can be used, or that an axis of a kind may have: this package's, then other distributions'."""
    usable = (*EFFECT_NAMES, *(name for name in _offers() if isinstance(_outcome(name), EffectDefinition)))
    return tuple(name for name in usable if kind is None or kind in effect_definition(name).kinds)


WEIGHT: Final = "unbalance"
"""Effect that is the weight of an arm, on a rotary axis that rests at 0."""
GEAR_FRICTION: Final = "load_dependent_friction"
"""Effect that is the friction of a gear under its load."""
PLAY: Final = "backlash"
"""Effect that is the play of a gear."""


def mass_effect() -> tuple[str, str]:
    """Effect that is a mass beside the machine file's, and its parameter."""
    definitions = ((name, effect_definition(name).adds_mass) for name in EFFECT_NAMES)
    return next((name, parameter) for name, parameter in definitions if parameter)


def cause_names(kind: Kind | None = None) -> tuple[str, ...]:
    """All that a diagnosis may name, or name of an axis of a kind: effects, then wrong numbers of the base model."""
    return (*(name for name in effect_names(kind) if not effect_definition(name).learned), *BASE_CAUSES)


def broken_effects() -> tuple[InputError, ...]:
    """Return the errors of other distributions' effects that cannot be used."""
    return tuple(outcome for name in _offers() if isinstance(outcome := _outcome(name), InputError))


def outside_sources(names: Iterable[str]) -> dict[str, bytes]:
    """Files of the effects among `names` that other distributions bring, by distribution with version and path.

    An effect's module counts with all that lies in its top-level package.
    """
    files: dict[str, bytes] = {}
    for name in sorted({name for name in names if name not in EFFECT_NAMES}):
        for offer in _offers().get(name, ()):
            spec = find_spec(offer.entry.module.partition(".")[0])
            if spec is None:
                continue
            if spec.submodule_search_locations:
                inside = [(Path(folder), path) for folder in spec.submodule_search_locations for path in _files(folder)]
            else:
                inside = [(Path(spec.origin).parent, Path(spec.origin))] if spec.origin else []
            for folder, path in inside:
                files[f"{offer.distribution}/{spec.name}/{path.relative_to(folder).as_posix()}"] = path.read_bytes()
    return files


def _files(folder: str) -> list[Path]:
    return [path for path in Path(folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts]


def cause(name: str) -> CauseDefinition:
    """Return the definition of a cause for a diagnosis; KeyError if there is no such cause."""
    return base_cause(name) if name in BASE_CAUSES else effect_definition(name)


def find_causes(text: str) -> tuple[str, ...]:
    """Return the causes a text names, or whose motion shows another subject it names, each once."""
    others = {"element": "stiffness", "law": "stiffness", "mass": "mass_mismatch", "inertia": "mass_mismatch"}
    names = dict.fromkeys(others.get(name, name) for name in re.findall(r"[a-z_]+", text))
    return tuple(name for name in names if name in cause_names())


def shown_by(column: str) -> str:
    """Return the motion that shows the number of a column of results (`stiffness_2`, `force_ripple.amplitude_N`)."""
    base = (name for name, known in BASE_CAUSES.items() if any(number.holds(column) for number in known.numbers))
    label = re.sub(r"_\d+$", "", column.partition(".")[0])  # the second effect of a name has its number behind it
    return cause(next(base, label)).excitation.text


def separating_moves(first: str, second: str) -> tuple[str, ...]:
    """The moves that tell two causes apart, as either of them states it; empty where neither names the other."""
    found = (cause(a).confused_with.get(b) for a, b in ((first, second), (second, first)))
    return tuple(dict.fromkeys(move for move in found if move is not None))
