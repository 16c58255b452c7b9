"""Values of a machine file that depend on the catalogue of effects and on the schemes, checked and filled in.

Every default that depends on something else is filled in by the file's tables or here, so that no reader of a `Machine`
repeats one.
"""

import math
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field, TypeAdapter, ValidationError

from sgms_mhe.machine import (
    BASE_PARAMETERS,
    BY_COLUMN,
    Disturbance,
    Estimator,
    Integrator,
    Layer,
    Machine,
    MachineFile,
    Plant,
    ResolvedEffect,
    Sampling,
    estimable_names,
    kinds_of,
    listing,
    log_table,
    machine_file,
    merge_tables,
    read_machine_file,
)
from sgms_mhe.model import gate_saturates
from sgms_mhe.model.effects import WEIGHT, EffectParameter, Value, effect_definition, effect_names, mass_effect
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.names import did_you_mean

G_N: Final = 9.80665
"""Gravity [m/s^2]."""
_INTEGRATOR: Final = ("sampling", "integrator")
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_NUMBERS: Final = TypeAdapter(dict[str, _Number])
_LISTS: Final = TypeAdapter(dict[str, list[_Number]])
_NAMES: Final = frozenset(("variable", "member", "row"))
MOST_ENTRIES: Final = 268
"""Entries that the lists of an effect may have: a learned table of 64 cells over place in each direction has as many.
"""


def load_machine(machine: str | Path) -> Machine:
    """Read a machine file, given by path or by its bare name in a `machines` folder.

    Raises InputError (file, dotted key, value, allowed values) for everything that is wrong with it.
    """
    return _resolve(read_machine_file(machine))


def override_machine(machine: Machine, changes: Mapping[str, Any]) -> Machine:
    """The machine a file with `extends` and these changes would describe: tables merge, arrays are replaced.

    Defaults that depend on other keys follow the changes. Raises InputError as load_machine does.
    """
    return _resolve(machine_file(merge_tables(machine.content, changes), [Layer(machine.source, changes)]))


def carry_load(machine: Machine, run: Mapping[str, float]) -> Machine:
    """Return the machine with the load, the gain and the supply that a run states of itself, as `Log.run` has them."""
    if not run or machine.plant.kind != "rotary":
        return machine
    mass, length = run["mass"], run["length"]
    weight = {"name": WEIGHT, "amplitude_Nm": mass * G_N * length, "phase_rad": 0.0}
    inertia = mass * (length**2 + (machine.plant.weight_radius or 0.0) ** 2)
    changes: dict[str, Any] = {
        "plant": {"inertia": machine.plant.moved + inertia},
        "effects": [*machine.content.get("effects", ()), weight],
    }
    if machine.drive.kind == "position_loop":
        changes["drive"] = {key: run[key] for key in ("gain", "supply")}
    return override_machine(machine, changes)


def drop_disturbance(machine: Machine) -> Machine:
    """Return the machine whose errors are none: the estimator's correction of them is no number of the file."""
    if machine.estimator.disturbance == Disturbance():
        return machine
    estimator = {key: value for key, value in machine.content["estimator"].items() if key != "disturbance"}
    return make_machine({**machine.content, "estimator": estimator}, machine.source)


def step_every_sample(machine: Machine) -> Machine:
    """Return the machine with a step to each sample: longer ones have no state at the samples between."""
    samples = machine.sampling.samples_per_update
    if machine.sampling.integrator.substeps >= samples:
        return machine
    return override_machine(machine, {"sampling": {"integrator": {"substeps": samples}}})


def override_log(machine: Machine, stated: Mapping[str, Any]) -> Machine:
    """The machine with stated keys of its logs laid over its table [log]; bare columns of its own kind alone."""
    if not stated:
        return machine
    other = {key for key in set(BY_COLUMN) & set(stated) if machine.plant.kind not in kinds_of(key)}
    bare = {key for key in other if isinstance(stated[key], Mapping) and not _NAMES & set(stated[key])}
    kept = {key: entry for key, entry in stated.items() if key not in bare}
    return override_machine(machine, {"log": log_table(machine.content.get("log", {}), kept)})


def make_machine(content: Mapping[str, Any], source: Path) -> Machine:
    """The machine a file `source` of this content would describe. Raises InputError as load_machine does."""
    return _resolve(machine_file(content, [Layer(source, content)]))


def _resolve(file: MachineFile) -> Machine:
    tables = file.tables
    effects = _add_uncertain_mass(tables.estimator, _effects(file))
    names = {tables.plant.units.named(name): name for name in estimable_names(effects)}
    _check_names(file, names)
    return Machine(
        name=tables.name,
        description=tables.description,
        plant=tables.plant,
        friction=tables.friction,
        sampling=_sampling(file),
        drive=tables.drive,
        estimator=_estimate_mass(_estimator(tables.estimator, names), tables.plant),
        compensation=tables.compensation,
        code=tables.code,
        effects=effects,
        diagnosis=tables.diagnosis,
        log=tables.log,
        source=file.source,
        content=file.content,
    )


def _effects(file: MachineFile) -> tuple[ResolvedEffect, ...]:
    """Every effect that counts, with all of its parameters in the order of the catalogue's."""
    counts: Counter[str] = Counter()
    effects = []
    for index, entry in enumerate(file.tables.effects):
        _check_effect(file, index)
        if effect_definition(entry.name).learned and not file.tables.learned:
            continue
        counts[entry.name] += 1
        label = entry.name if counts[entry.name] == 1 else f"{entry.name}_{counts[entry.name]}"
        effects.append(ResolvedEffect(entry.name, label, _effect_parameters(file, index)))
    return tuple(effects)


def _add_uncertain_mass(estimator: Estimator, effects: tuple[ResolvedEffect, ...]) -> tuple[ResolvedEffect, ...]:
    """The effects, and a mass beside the machine file's where it is uncertain."""
    name, parameter = mass_effect()
    if estimator.disturbance.inertia == 0.0 or any(effect.label == name for effect in effects):
        return effects
    return (*effects, ResolvedEffect(name, name, {parameter: 0.0}))


def _estimate_mass(estimator: Estimator, plant: Plant) -> Estimator:
    """The estimator with the mass among its parameters, where it is uncertain; a stated prior stays."""
    if estimator.disturbance.inertia == 0.0:
        return estimator
    key = ".".join(mass_effect())
    prior = {key: estimator.disturbance.inertia * plant.moved} | dict(estimator.prior)
    parameters = tuple(dict.fromkeys((*estimator.parameters, key)))
    return estimator.model_copy(update={"parameters": parameters, "prior": prior})


def _check_effect(file: MachineFile, index: int) -> None:
    """Refuse an effect the catalogue does not have, or not for this axis, or that another distribution broke."""
    where, name = ("effects", index, "name"), file.tables.effects[index].name
    kind = file.tables.plant.kind
    try:
        definition = effect_definition(name)
    except KeyError:
        known = effect_names(kind)
        raise file.refusal(where, name, f"one of {listing(known)}{did_you_mean(name, known)}") from None
    except InputError as error:
        raise file.refusal(where, name, f"an effect that works; {error}") from None
    if kind not in definition.kinds:
        allowed = f"an effect of a {kind} axis; {name} is for [plant] kind = {' or '.join(definition.kinds)}"
        raise file.refusal(where, name, allowed)
    why = definition.smooth_only
    if why and file.tables.friction.switches:
        raise file.refusal(where, name, f"an effect that stands with [friction] law = switching; {why}")


def _effect_parameters(file: MachineFile, index: int) -> dict[str, Value]:
    entry = file.tables.effects[index]
    units = file.tables.plant.units
    definitions = {units.named(parameter.name): parameter for parameter in effect_definition(entry.name).parameters}
    for key, value in entry.written.items():
        if key not in definitions:
            allowed = f"unknown key; {entry.name} has {listing(definitions)}"
            raise file.refusal(("effects", index, key), value, allowed)
    count = max((1, *(len(value) for value in entry.written.values() if isinstance(value, list | tuple))))
    filled: dict[str, Any] = {}
    for key, parameter in definitions.items():
        value = entry.written.get(key, (parameter.default,) * count if parameter.array else parameter.default)
        values = list(value) if parameter.array and isinstance(value, list | tuple) else [value]
        for number in values:
            if type(number) in (int, float) and not _is_within(number, parameter):
                raise file.refusal(("effects", index, key), value, parameter.allowed)
        filled[key] = values if parameter.array else value
        if parameter.array and not len(values) == count <= MOST_ENTRIES:
            allowed = f"{count} entries, as many as its other lists have, at most {MOST_ENTRIES}"
            raise file.refusal(("effects", index, key), value, allowed)
    lists = {key for key, parameter in definitions.items() if parameter.array}
    try:
        numbers = _NUMBERS.validate_python({key: value for key, value in filled.items() if key not in lists})
        series = _LISTS.validate_python({key: filled[key] for key in lists})
    except ValidationError as error:
        raise file.invalid(error, ("effects", index)) from None
    found = {p.name: tuple(series[key]) if key in lists else numbers[key] for key, p in definitions.items()}
    if fault := effect_definition(entry.name).fault(found):
        key = units.named(fault.parameter)
        raise file.refusal(("effects", index, key), filled[key], fault.allowed)
    return found


def _is_within(number: float, parameter: EffectParameter) -> bool:
    """Return True if the parameter may have this number."""
    whole = not parameter.whole or (math.isfinite(number) and number == round(number))
    return whole and parameter.lower <= number <= parameter.upper


def _estimator(written: Estimator, names: Mapping[str, str]) -> Estimator:
    """The estimator with its parameters under the catalogue's names."""
    prior = {names[name]: deviation for name, deviation in written.prior.items()}
    bounds = {names[name]: pair for name, pair in written.bounds.items()}
    parameters = tuple(names[name] for name in written.parameters)
    return written.model_copy(update={"parameters": parameters, "prior": prior, "bounds": bounds})


def _check_names(file: MachineFile, names: Collection[str]) -> None:
    """Refuse parameters, priors and bounds of numbers outside the estimable ones."""
    estimator = file.tables.estimator
    for index, name in enumerate(estimator.parameters):
        where = ("estimator", "parameters", index)
        if name not in names:
            raise file.refusal(where, name, f"one of {listing(names)}")
        if name in BASE_PARAMETERS and name not in file.tables.friction.estimable:
            if name == "fraction":
                raise file.refusal(where, name, "another parameter: with one element there is nothing to share")
            raise file.refusal(where, name, f"a parameter that is not 0 (friction.{name} is its scale)")
    for name, deviation in estimator.prior.items():
        if name not in names:
            raise file.refusal(("estimator", "prior", name), deviation, f"a key out of {listing(names)}")
    for name, bounds in estimator.bounds.items():
        if name not in names:
            raise file.refusal(("estimator", "bounds", name), list(bounds), f"a key out of {listing(names)}")


def _sampling(file: MachineFile) -> Sampling:
    """The rates, with the integrator the friction law asks for."""
    sampling = file.tables.sampling
    if file.tables.friction.switches:
        return sampling.model_copy(update={"integrator": _clipping(file)})
    if sampling.integrator.scheme == "clip":
        allowed = "another scheme, or [friction] law = switching: no other element is clipped"
        raise file.refusal((*_INTEGRATOR, "scheme"), "clip", allowed)
    return sampling if sampling.integrator.scheme != "flow" else _flowing(file)


def _clipping(file: MachineFile) -> Integrator:
    """The integrator of elements that switch: exact, so that the merged samples are the only choice."""
    integrator = file.tables.sampling.integrator
    given = {key: getattr(integrator, key) for key in integrator.model_fields_set}
    if given.get("scheme", "clip") != "clip":
        allowed = "clip, or nothing, where [friction] law is switching"
        raise file.refusal((*_INTEGRATOR, "scheme"), given["scheme"], allowed)
    return Integrator.model_validate({**given, "scheme": "clip"})


def _flowing(file: MachineFile) -> Sampling:
    """The rates with the displacement flow, or by default with rk4 where it would never be taken.

    Where the direction gate saturates at no speed the flow holds at none. Raises InputError where the file asks for it.
    """
    sampling, smoothing = file.tables.sampling, file.tables.friction.smoothed
    if gate_saturates(smoothing.zeta, smoothing.lambda_, smoothing.gamma):
        return sampling
    integrator = sampling.integrator
    if "scheme" in integrator.model_fields_set:
        allowed = "rk4: with a smoothing as soft as [friction] smoothing has, the flow holds at no speed"
        raise file.refusal((*_INTEGRATOR, "scheme"), "flow", allowed)
    given = {key: getattr(integrator, key) for key in integrator.model_fields_set}
    return sampling.model_copy(update={"integrator": Integrator.model_validate({**given, "scheme": "rk4"})})
