"""`sgms-mhe effects`."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Any, Final

from sgms_mhe.commands.common import json_text, note_broken_effects, show
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.names import did_you_mean
from sgms_mhe.support.tables import align_columns

if TYPE_CHECKING:
    from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Need

COLUMNS: Final = 100
"""Of the text; tables may be wider."""


@make_command("effects", "effects backlash", "effects --json")
def command(name: str | None = None, *, json: bool = False) -> None:
    """List the effects of an axis beyond friction.

    Of the one called NAME: its parameters, the excitation needed in a log, the causes that look alike with the move
    that distinguishes each, and the entry of a machine file, ready to be pasted.
    """
    from sgms_mhe.model.effects import effect_definition, effect_names

    note_broken_effects()
    known = effect_names()
    if name is None:
        definitions = [effect_definition(each) for each in known]
        show(json_text([_summary(definition) for definition in definitions]) if json else _list(definitions))
        return
    if name not in known:
        raise InputError("effects", "name", name, f"one of {', '.join(known)}{did_you_mean(name, known)}")
    content = _content(effect_definition(name))
    show(json_text(content) if json else _text(content))


def _summary(definition: EffectDefinition) -> dict[str, Any]:
    return {"name": definition.name, "kinds": list(definition.kinds), "summary": definition.summary}


def _list(definitions: list[EffectDefinition]) -> str:
    rows = [{"effect": d.name, "axis": " or ".join(d.kinds), "what it is": d.summary} for d in definitions]
    return _table(rows)


def _content(definition: EffectDefinition) -> dict[str, Any]:
    """Everything about an effect; of both kinds of axis, parameters have the names of a linear one first."""
    from sgms_mhe.model.effects import MOVES, cause_names, separating_moves

    rivals = {other: separating_moves(definition.name, other) for other in cause_names() if other != definition.name}
    return _summary(definition) | {
        "stage": definition.stage,
        "parameters": [_parameter(definition, parameter) for parameter in definition.parameters],
        "excitation": {
            "text": definition.excitation.text,
            "needs": [_describe_need(need) for need in definition.excitation.needs],
            "moves": [MOVES[move] for move in definition.moves],
        },
        "confused_with": {other: list(moves) for other, moves in rivals.items() if moves},
        "excludes": list(definition.excludes),
        "not_with_switching": definition.smooth_only or None,
        "toml": _toml(definition),
    }


def _parameter(definition: EffectDefinition, parameter: EffectParameter) -> dict[str, Any]:
    from sgms_mhe.machine import OF_KIND

    units = [OF_KIND[kind] for kind in definition.kinds]
    return {
        "names": {own.kind: own.named(parameter.name) for own in units},
        "units": {own.kind: own.unit(parameter.name) or "1" for own in units},
        "default": parameter.default,
        "lower": parameter.lower if math.isfinite(parameter.lower) else None,
        "upper": parameter.upper if math.isfinite(parameter.upper) else None,
        "allowed": parameter.allowed,
        "list": parameter.array,
        "meaning": parameter.description,
    }


def _describe_need(need: Need) -> str:
    """A need in words: `range of position: at least 1.5 times pitch_m`."""
    from sgms_mhe.machine import LINEAR
    from sgms_mhe.model.effects.excitation import MEASURES

    unit = f"times {need.times}" if need.times else LINEAR.unit(need.measure)
    return f"{MEASURES[need.measure]}: at least {need.at_least:g} {unit}".rstrip()


def _toml(definition: EffectDefinition) -> str:
    """The entry of a machine file with every parameter at its default, by which it changes nothing yet."""
    from sgms_mhe.machine import OF_KIND
    from sgms_mhe.machine.writing import toml_table

    named = OF_KIND[definition.kinds[0]].named
    defaults = {named(p.name): [p.default] if p.array else p.default for p in definition.parameters}
    return "\n".join(toml_table("[[effects]]", {"name": definition.name, **defaults})).lstrip()


def _text(content: dict[str, Any]) -> str:
    first, *others = content["kinds"]
    parameters = [
        {
            "parameter": p["names"][first],
            "unit": p["units"][first],
            "default": f"{p['default']:g}",
            "allowed": f"a list, each {p['allowed']}" if p["list"] else p["allowed"],
            "meaning": p["meaning"],
        }
        for p in content["parameters"]
    ]
    lines = [f"{content['name']}: {content['summary']}", f"axis: {' or '.join(content['kinds'])}", ""]
    lines.append(_table(parameters))
    for kind in others:
        named = ", ".join(f"{p['names'][kind]} [{p['units'][kind]}]" for p in content["parameters"])
        lines += _wrap(f"of a {kind} axis: {named}")
    seen = content["excitation"]
    lines += ["", "To be seen", *_wrap(seen["text"], "  "), *_items(seen["needs"])]
    lines += [*_items([f"moves: {move}" for move in seen["moves"]])]
    rivals = [f"{other}: {'; '.join(moves)}" for other, moves in content["confused_with"].items()]
    lines += ["", "Confused with, and the move that separates them (sgms-mhe plan makes the motion)", *_items(rivals)]
    refusals = [f"{other}: together they cancel" for other in content["excludes"]]
    if content["not_with_switching"]:
        refusals.append(f"[friction] law = switching: {content['not_with_switching']}")
    if refusals:
        lines += ["", "Not beside", *_items(refusals)]
    return "\n".join([*lines, "", "Machine file, at defaults that change nothing", "", content["toml"]])


def _table(rows: list[dict[str, str]]) -> str:
    """Rows of text below their names."""
    return "\n".join(align_columns([list(rows[0]), *([*row.values()] for row in rows)], [True] * len(rows[0])))


def _items(sentences: list[str]) -> list[str]:
    return [line for sentence in sentences for line in _wrap(sentence, "  - ")]


def _wrap(text: str, begin: str = "") -> list[str]:
    return textwrap.wrap(text, COLUMNS, initial_indent=begin, subsequent_indent=" " * len(begin))
