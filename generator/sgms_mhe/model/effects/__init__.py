"""The effects an axis may have beyond S-GMS, one module each, and the base parameters that may be wrong."""

from __future__ import annotations

from importlib import import_module

from sgms_mhe.model.effects.base import (
    BASE_CAUSES,
    BaseCause,
    BaseNumber,
    base_cause,
    base_number,
    reported_name,
)
from sgms_mhe.model.effects.causes import MOVES, CauseDefinition, Move, Simpler
from sgms_mhe.model.effects.definition import STAGES, EffectDefinition
from sgms_mhe.model.effects.excitation import Excitation, Measure, Need
from sgms_mhe.model.effects.motion import Extents, MotionRecord
from sgms_mhe.model.effects.parameters import EffectParameter
from sgms_mhe.model.effects.scales import Scales
from sgms_mhe.model.effects.states import EffectState

EFFECT_NAMES: tuple[str, ...] = (
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
    "dwell_dependence",
    "micro_viscous",
)
"""Names of shared DESIGN section 7; each is the module of the same name in this package."""

CAUSE_NAMES: tuple[str, ...] = (*EFFECT_NAMES, *BASE_CAUSES)
"""Everything that a diagnosis may name: effects, then wrong numbers of the base model."""


def effect_definition(name: str) -> EffectDefinition:
    """Return the definition of the effect called `name`.

    Raises:
        KeyError: no effect has that name.
    """
    if name not in EFFECT_NAMES:
        raise KeyError(name)
    definition = import_module(f"{__name__}.{name}").DEFINITION
    if not isinstance(definition, EffectDefinition):
        raise TypeError(f"{name}.DEFINITION is not an EffectDefinition")
    return definition


def cause(name: str) -> CauseDefinition:
    """What a diagnosis must know of anything that it may name; KeyError if there is no such cause."""
    return base_cause(name) if name in BASE_CAUSES else effect_definition(name)


def separating_moves(first: str, second: str) -> tuple[str, ...]:
    """The moves that tell two causes apart, as either of them states it; empty where neither names the other."""
    found = (cause(a).confused_with.get(b) for a, b in ((first, second), (second, first)))
    return tuple(dict.fromkeys(move for move in found if move is not None))


__all__ = [
    "BASE_CAUSES",
    "CAUSE_NAMES",
    "EFFECT_NAMES",
    "MOVES",
    "STAGES",
    "BaseCause",
    "BaseNumber",
    "CauseDefinition",
    "EffectDefinition",
    "EffectParameter",
    "EffectState",
    "Excitation",
    "Extents",
    "Measure",
    "MotionRecord",
    "Move",
    "Need",
    "Scales",
    "Simpler",
    "base_cause",
    "base_number",
    "cause",
    "effect_definition",
    "reported_name",
    "separating_moves",
]
