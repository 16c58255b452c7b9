"""The effects an axis may have beyond S-GMS, one module each."""

from __future__ import annotations

from importlib import import_module

from sgms_mhe.model.effects.definition import EffectDefinition, EffectParameter, EffectState

EFFECT_NAMES: tuple[str, ...] = ("constant_offset", "force_ripple")
"""Names of DESIGN section 7 that are implemented; each is the module of the same name in this package."""


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


__all__ = ["EFFECT_NAMES", "EffectDefinition", "EffectParameter", "EffectState", "effect_definition"]
