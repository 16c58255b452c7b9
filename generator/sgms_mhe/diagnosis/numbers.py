"""Numbers of a machine beside those of its file, and the machine extended by the causes."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sgms_mhe.configuration import law_changes
from sgms_mhe.diagnosis.extension import extend_machine
from sgms_mhe.diagnosis.final_fit import FinalFit
from sgms_mhe.diagnosis.fits import Fit
from sgms_mhe.diagnosis.parametrisation import JacobianColumn, ParameterGroup, smooth_law
from sgms_mhe.diagnosis.parts import BaseParameter, Cause
from sgms_mhe.diagnosis.rivals import Selection
from sgms_mhe.diagnosis.uncertainty import covariance, standard_deviations
from sgms_mhe.machine import Machine
from sgms_mhe.model import whole_shares
from sgms_mhe.model.effects import BASE_CAUSES, base_number, effect_definition
from sgms_mhe.model.effects.base import LEVEL


def base_parameters(final: FinalFit, fit: Fit, file: Machine) -> tuple[BaseParameter, ...]:
    """The machine's own numbers, as the file has them and as a fit found them.

    Where the fit has another number of elements, the file has none of theirs.
    """
    labels, elements = {effect.label for effect in file.effects}, final.subject.machine.friction.n_z
    deviations = standard_deviations(covariance(final.subject, fit, final.other), fit)
    return tuple(
        BaseParameter(
            c.name if c.group.kind == "base" else f"{c.group.label}.{c.name}",
            state_number(file, c, elements),
            c.si(float(theta)),
            std,
        )
        for c, theta, std in zip(fit.model.columns, fit.theta, deviations, strict=True)
        if c.group.kind == "base" or c.group.label in labels
    )


def state_number(file: Machine, column: JacobianColumn, elements: int | None = None) -> float:
    """Return a number as a machine file states it [SI]; NaN: it does not, or has not so many elements."""
    if column.group.kind == "own":
        effects = {effect.label: effect_definition(effect.name).entries(effect.parameters) for effect in file.effects}
        return effects.get(column.group.label, {}).get(column.name, math.nan)
    if column.group.kind == "base":
        number = base_number(column.name)
        if number is None or not number.array:
            return float(getattr(file.friction, column.name))
        stated, place = getattr(file.friction, number.name), number.element(column.name)
        return float(stated[place]) if place < len(stated) and elements in (None, len(stated)) else math.nan
    return math.nan


def friction_changes(machine: Machine, values: Mapping[str, float]) -> dict[str, Any]:
    """Return keys of [friction] with numbers by their columns' names [SI]; shares made to sum to 1."""
    friction: dict[str, Any] = {}
    for name, value in values.items():
        number = base_number(name)
        if number is not None and number.array:
            friction.setdefault(number.name, list(getattr(machine.friction, number.name)))
            friction[number.name][number.element(name)] = value
        else:
            friction[name] = value
    for cause in BASE_CAUSES.values():
        for number in cause.numbers:
            if number.shares and number.name in friction:
                nominal = getattr(machine.friction, number.name)
                friction[number.name], total = whole_shares(friction[number.name], nominal)
                if total != 1.0:
                    friction[LEVEL] = total * friction.get(LEVEL, getattr(machine.friction, LEVEL))
    return friction


def extended_machine(
    machine: Machine, final: FinalFit, selection: Selection, causes: Sequence[Cause], file: Machine
) -> tuple[Machine, dict[str, Any]]:
    """Return the machine with its wrong numbers corrected and the effects added, and the tables this changes.

    `file`: whose tables change; the machine itself, or the one whose numbers gave way to the record's.
    """
    fit = selection.fit
    friction: dict[str, Any] = {
        key: value for key in type(file.friction).model_fields if (value := _plain(machine, key)) != _plain(file, key)
    }
    values = [fit.values(group) for group in selection.refitted if group.kind == "base"]
    fitted = smooth_law(final.subject.machine, fit.effects)
    friction |= law_changes(machine, fitted)
    friction |= friction_changes(fitted, {name: value for found in values for name, value in found.items()})
    effects: list[dict[str, Any]] = []
    moved, stated = machine.plant.moved, {effect.label for effect in file.effects}
    for effect in machine.effects:
        group = ParameterGroup("own", effect.name, effect.label)
        if effect.label not in stated:
            moved += fit.values(group)[effect_definition(effect.name).adds_mass]
            continue
        effects.append(
            {"name": effect.name, **(fit.values(group) if group in selection.refitted else effect.parameters)}
        )
    effects += [{"name": e.name, **effect_definition(e.name).tidy(e.parameters)} for e in fit.effects]
    changed = bool(fit.effects) or any(group.label in stated for group in selection.refitted)
    labels = [cause.label for cause in causes]
    return extend_machine(file, labels, friction, effects if changed else None, moved)


def _plain(machine: Machine, key: str) -> Any:
    """Return an entry of [friction], an array as the list of it."""
    value = getattr(machine.friction, key)
    return list(value) if isinstance(value, tuple) else value
