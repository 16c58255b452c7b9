"""A machine with effects added, every number in it a free parameter: what a fit's model is made from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from sgms_mhe.configuration import make_machine, override_machine
from sgms_mhe.diagnosis.groups import Extra
from sgms_mhe.machine import CLOSED_FORMS, Machine
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.model.scales import scales_of

COARSE: Final = 4.0  # factor between nominal values that models are compiled for
STEP: Final = 1.0  # deflection scales of an effect's states per step, unless the effect says otherwise
SLOW_STEP: Final = 0.02  # deflection scales of a smooth element per step below the gate: off by 1e-5 of its level

Nominal = tuple[tuple[str, float], ...]
"""Nominal values of an effect's parameters, as a key."""


@dataclass(frozen=True)
class Structure:
    """What a compiled model depends on; the machine by its content."""

    machine: Machine = field(compare=False, hash=False)
    extras: tuple[tuple[str, Nominal], ...]
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", self.machine.digest)


def extended_machine(structure: Structure) -> Machine:
    """The machine of a structure with its effects, all its numbers to be estimated."""
    machine = structure.machine
    return _with_everything_free(machine, structure.extras, typical_sizes(machine))


def typical_sizes(machine: Machine) -> dict[str, float]:
    """Typical values of the base model's numbers that the machine file says 0 of: zero has no scale of its own."""
    return {
        number.name: number.typical * scales_of(machine).of(number.unit)
        for cause in BASE_CAUSES.values()
        for number in cause.numbers
        if number.typical is not None and getattr(machine.friction, number.name) == 0.0
    }


def _with_everything_free(
    machine: Machine, extras: Sequence[tuple[str, Nominal]], friction: Mapping[str, float]
) -> Machine:
    """The machine with effects added and numbers of [friction] replaced, all its numbers to be estimated."""
    units = machine.plant.units
    effects = [e.entry(units) for e in machine.effects]
    effects += [{"name": name} | units.keyed(effect_definition(name).lists(dict(values))) for name, values in extras]
    axis = machine.friction.model_copy(update=dict(friction))
    names = [name for cause in BASE_CAUSES.values() for name in cause.frees if name in axis.estimable]
    changes: dict[str, Any] = {
        "name": "fit",
        "description": "",
        "friction": dict(friction),
        "effects": effects,
        "code": {"precision": "double"},
        "estimator": {"parameters": names, "bounds": {}},
        "sampling": _integrator(machine, [name for name, _ in extras]),
    }
    extended = override_machine(without_bounds(machine), changes)
    names += [units.named(f"{e.label}.{p}") for e in extended.effects for p in e.parameters]
    return override_machine(extended, {"estimator": {"parameters": names}})


def without_bounds(machine: Machine) -> Machine:
    """The same machine with an estimator that constrains nothing."""
    estimator = dict(machine.content.get("estimator", {}))
    kept = {key: value for key, value in estimator.items() if key not in ("bounds", "parameters")}
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


def nominal_values(machine: Machine, extra: Extra) -> Nominal:
    """Nominal values of an effect's compiled model: coarse, so that few are compiled, near where rates matter."""
    definition, scales = effect_definition(extra.name), scales_of(machine)
    values: list[tuple[str, float]] = []
    for name in definition.names(extra.parameters):
        parameter = definition.parameter(name)
        size = parameter.default if parameter.default != 0.0 else abs(parameter.size(scales))
        if parameter.whole:  # each once; which they are, a fit says
            size += sum(parameter.holds(known) for known, _ in values)
        wanted = extra.parameters.get(name, size)
        if definition.states and wanted > 0.0 and size > 0.0:
            size *= COARSE ** round(math.log(wanted / size, COARSE))
        values.append((name, float(min(max(size, parameter.lower), parameter.upper))))
    return tuple(values)
