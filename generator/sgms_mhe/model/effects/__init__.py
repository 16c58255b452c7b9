"""The effects an axis may have beyond S-GMS, one module each, and the base parameters that may be wrong."""

from __future__ import annotations

from sgms_mhe.model.effects.base import (
    BASE_CAUSES,
    BaseCause,
    BaseNumber,
    base_cause,
    base_number,
    reported_name,
)
from sgms_mhe.model.effects.catalogue import (
    CAUSE_NAMES,
    EFFECT_NAMES,
    broken_effects,
    cause,
    cause_names,
    effect_definition,
    effect_names,
    mass_effect,
    outside_sources,
    own_effects,
    separating_moves,
)
from sgms_mhe.model.effects.causes import MOVES, CauseDefinition, Move, Simpler
from sgms_mhe.model.effects.definition import STAGES, EffectDefinition, Stage, Value
from sgms_mhe.model.effects.excitation import Excitation, Measure, Need
from sgms_mhe.model.effects.motion import Extents, MotionRecord
from sgms_mhe.model.effects.parameters import EffectParameter
from sgms_mhe.model.effects.scales import Scales
from sgms_mhe.model.effects.states import EffectState

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
    "Stage",
    "Value",
    "base_cause",
    "base_number",
    "broken_effects",
    "cause",
    "cause_names",
    "effect_definition",
    "effect_names",
    "mass_effect",
    "outside_sources",
    "own_effects",
    "reported_name",
    "separating_moves",
]
