"""The JSON Schema of a machine file, with the effects that are installed."""

import math
from collections.abc import Mapping
from typing import Any

from sgms_mhe import __version__
from sgms_mhe.machine import OF_KIND, Units, json_schema
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, effect_definition, effect_names


def machine_schema() -> dict[str, Any]:
    """JSON Schema of a machine file: of its tables, and of every effect's name and parameters.

    An effect of both kinds of axis has its parameters under the names of both.
    """
    schema = json_schema()
    effect = schema["$defs"]["Effect"]
    definitions = [effect_definition(name) for name in effect_names()]
    effect["properties"]["name"]["enum"] = [definition.name for definition in definitions]
    effect["allOf"] = [_rule(definition) for definition in definitions]
    # A name, no address: an editor is told where the file is.
    return {"$id": f"urn:sgms-mhe:machine:{__version__}", **schema}


def _rule(definition: EffectDefinition) -> dict[str, Any]:
    """Return the rule for an entry of [[effects]] of this name."""
    parameters = {
        units.named(parameter.name): _value(parameter, units)
        for units in (OF_KIND[kind] for kind in definition.kinds)
        for parameter in definition.parameters
    }
    return {
        "if": {"properties": {"name": {"const": definition.name}}, "required": ["name"]},
        "then": {
            "description": definition.summary,
            "properties": parameters,
            "propertyNames": {"enum": ["name", *parameters]},
        },
    }


def _value(parameter: EffectParameter, units: Units) -> dict[str, Any]:
    limits = {"minimum": parameter.lower, "maximum": parameter.upper}
    number: Mapping[str, Any] = {
        "type": "integer" if parameter.whole else "number",
        **{key: limit for key, limit in limits.items() if math.isfinite(limit)},
    }
    unit = units.unit(parameter.name) or "1"
    described = {
        "description": f"{parameter.description} [{unit}]; {parameter.allowed}; default {parameter.default:g}",
        "default": parameter.default,
    }
    if parameter.array:
        return {"anyOf": [number, {"type": "array", "items": number}], **described}
    return {**number, **described}
