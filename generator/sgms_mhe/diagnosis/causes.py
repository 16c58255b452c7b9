"""Causes as they are reported: sizes, how sure they are, what they explain; and the machine extended by them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import law_changes
from sgms_mhe.diagnosis.compiling import bearing
from sgms_mhe.diagnosis.covariance import covariance, standard_deviations
from sgms_mhe.diagnosis.extension import extend_machine
from sgms_mhe.diagnosis.groups import Group, without_extra, without_group
from sgms_mhe.diagnosis.result import BaseParameter, Cause, Rms
from sgms_mhe.diagnosis.selection import Selection
from sgms_mhe.diagnosis.settling import Settled, split_rms
from sgms_mhe.diagnosis.subject import Fit
from sgms_mhe.machine import Machine
from sgms_mhe.model import whole_shares
from sgms_mhe.model.effects import BASE_CAUSES, base_number, effect_definition, reported_name
from sgms_mhe.model.effects.base import LEVEL
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.evidence import gain_force, gain_interval

Array = NDArray[np.float64]

SIGMAS: Final = 2.0
"""Difference from none, or from the machine file, that a size must have [standard deviations]: 95 %, as the interval of
its gain."""
CERTAIN_SIGMAS: Final = 10.0
"""The same of a size that is certain, whatever the interval of its gain, where its cause leaves nothing [standard
deviations]: what acts in a few blocks alone may be in none of those that the interval draws."""
VAGUE: Final = 0.5
"""Interval from which a number of the machine that does not differ from the file is not determined [value]: half of it
may be chance: the file's stays."""
CERTAIN_P: Final = 1e-4
"""P value from which a cause that is the same all over the record is certain, whatever its gain's interval [1]: a short
record has few blocks to draw the interval from."""


def measured_causes(settled: Settled, selection: Selection, blind: Fit) -> dict[Group, Cause]:
    """Causes of a selection, with parameters of all data and gains of a fit `blind` to the held-out blocks."""
    recording, fit = settled.recording, selection.fit
    deviations = standard_deviations(covariance(settled.subject, fit, settled.other), fit)
    held = recording.held_out
    causes = {}
    for group in selection.causes:
        extras, refitted = without_extra(blind.extras, group), without_group(selection.refitted, group)
        without = settled.fit(extras, refitted=refitted, warm=blind, rows=settled.seen)
        before, held_before = split_rms(without, recording)
        after, held_after = split_rms(blind, recording)
        again = group.is_extra and any(e.name == group.cause for e in fit.extras[: group.index])
        causes[group] = Cause(
            name=group.cause,
            label=f"{group.cause}_2" if again else group.name,
            parameters=reported_values(fit, group),
            std={
                _reported(group, c.name): s
                for c, s in zip(fit.model.columns, deviations, strict=True)
                if c.group == group
            },
            nominal=_file_values(fit, group),
            rms=Rms(before, after, held_before, held_after),
            gain_N=gain_force(without.loss[held], blind.loss[held], fit.rows[held]),
            gain_interval_N=gain_interval(without.loss[held], blind.loss[held], fit.rows[held]),
            p_value=selection.p_values.get(group, math.nan),
        )
    return {group: replace(cause, vague=_vague(cause)) for group, cause in causes.items()}


def _vague(cause: Cause) -> tuple[str, ...]:
    """Parameters that the record does not determine: their intervals are as wide as they are, or there are none."""
    found = []
    for key, value in cause.parameters.items():
        margin = SIGMAS * cause.std[key]
        if cause.nominal:
            known = margin <= VAGUE * abs(value)
        else:
            parameter = effect_definition(cause.name).parameter(key)
            known = parameter.role == "place" or margin < abs(value - parameter.none)
        if not known:  # NaN included
            found.append(key)
    return tuple(found)


def holds(cause: Cause, *, constant: bool = False, complete: bool = False) -> bool:
    """Whether a cause has a size, and a gain on data that its fit has not seen.

    The gain may be uncertain where it is certain that the cause is there: few blocks of a short record, not all of
    which it acts in. It is of a cause that is the same all over the record (`constant`), by its test; and where the fit
    leaves nothing that matters (`complete`), by its sizes.
    """
    sizes = _sizes(cause)
    apart = [abs(cause.parameters[key] - none) / cause.std[key] for key, none in sizes.items() if cause.std[key] > 0.0]
    known = complete and bool(apart) and min(apart) > CERTAIN_SIGMAS
    certain = cause.gain_N > 0.0 and (known or (constant and cause.p_value < CERTAIN_P))
    return (cause.gain_interval_N[0] > 0.0 or certain) and has_size(cause)


def has_size(cause: Cause) -> bool:
    """Whether one of its numbers that the record determines is not what it is where there is no such cause."""
    sizes = _sizes(cause)
    return not sizes or any(abs(cause.parameters[key] - none) > SIGMAS * cause.std[key] for key, none in sizes.items())


def is_possible(cause: Cause, settled: Settled) -> bool:
    """Whether an axis can have a cause of this size."""
    if cause.nominal:
        return True
    return effect_definition(cause.name).possible(cause.parameters, scales_of(settled.subject.machine))


def _sizes(cause: Cause) -> dict[str, float]:
    """Parameters that the record determines and that say how much of a cause there is, and where it is none."""
    known = [key for key, value in cause.parameters.items() if math.isfinite(cause.std[key]) and math.isfinite(value)]
    if cause.nominal:
        return {key: cause.nominal[key] for key in known}
    definition = effect_definition(cause.name)
    return {key: definition.parameter(key).none for key in known if definition.parameter(key).is_size}


def reported_values(fit: Fit, group: Group) -> dict[str, float]:
    """A group's numbers as a report states them, with units at the ends of their names."""
    values = {_reported(group, name): value for name, value in fit.values(group).items()}
    return effect_definition(group.cause).tidy(values) if group.is_extra else values


def _reported(group: Group, column: str) -> str:
    return reported_name(column) if group.kind == "base" else column


def _file_values(fit: Fit, group: Group) -> dict[str, float]:
    """What the machine file says of a group's numbers; nothing of an effect under test."""
    return {
        _reported(group, c.name): c.si(c.machine_theta)
        for c in fit.model.columns
        if c.group == group and not group.is_extra
    }


def base_parameters(settled: Settled, fit: Fit) -> tuple[BaseParameter, ...]:
    """The machine's own numbers, as the file has them and as a fit found them."""
    deviations = standard_deviations(covariance(settled.subject, fit, settled.other), fit)
    return tuple(
        BaseParameter(
            c.name if c.group.kind == "base" else f"{c.group.label}.{c.name}",
            c.si(c.machine_theta),
            c.si(float(theta)),
            std,
        )
        for c, theta, std in zip(fit.model.columns, fit.theta, deviations, strict=True)
        if not c.group.is_extra
    )


def extended_machine(
    machine: Machine, settled: Settled, selection: Selection, causes: Sequence[Cause]
) -> tuple[Machine, str]:
    """The machine with its wrong numbers corrected and the effects added, and its file."""
    fit = selection.fit
    friction: dict[str, Any] = {}
    for group in selection.refitted:
        if group.kind != "base":
            continue
        for name, value in fit.values(group).items():
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
    friction = {**law_changes(machine, bearing(settled.subject.machine, fit.extras)), **friction}
    effects: list[dict[str, Any]] = []
    for effect in machine.effects:
        group = Group.own(effect.name, effect.label)
        effects.append(
            {"name": effect.name, **(fit.values(group) if group in selection.refitted else effect.parameters)}
        )
    effects += [{"name": e.name, **effect_definition(e.name).tidy(e.parameters)} for e in fit.extras]
    changed = bool(fit.extras) or any(group.kind == "own" for group in selection.refitted)
    return extend_machine(machine, [cause.label for cause in causes], friction, effects if changed else None)
