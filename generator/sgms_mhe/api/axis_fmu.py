"""The plant as an FMU: force in, motion out, every number a parameter with its unit."""

import hashlib
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Any, Final, Literal

from sgms_mhe import __version__
from sgms_mhe.emission.axis_forms import AxisNumber, WrittenAxis, axis_numbers
from sgms_mhe.emission.bindings import BINDINGS, Variable, fmu
from sgms_mhe.emission.rendering import dot_unit, render_c, render_text
from sgms_mhe.machine import Machine, Smoothing
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.plant.axis_config import MAX_SUBSTEPS, SUBSTEP_S, AxisConfig
from sgms_mhe.plant.native import SOURCES, Limits, NativeAxis, base_limits, effect_limits, loaded_library
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.paths import runtime_dir

_HEADERS: Final = ("axis.h", "axis_effects.h")
_DRIVEN: Final = 2
"""AXIS_CONTROL_FORCE of the C."""
_FARTHEST: Final = 1e6


@dataclass(frozen=True)
class _Tunable:
    """A variable that may change while the axis runs: its places in C, and its limits there."""

    variable: Variable
    places: tuple[str, ...]
    least: float
    most: float


def write_fmu(machine: Machine, version: Literal[2, 3]) -> WrittenAxis:
    """Make the FMU of a machine's plant, with a binary for this host where it has a compiler.

    Raises:
        InputError: an effect whose force for the plant is no C; numbers the plant cannot move with.
        BuildError: no compiler, or it refused.
    """
    name = f"{machine.name}_axis"
    effects = tuple(_effect_rows(machine))
    NativeAxis(machine, AxisConfig(), ()).place(0.0)  # refuses what the FMU could not start with
    variables, tunable = _variables(machine)
    texts = {file: (runtime_dir() / file).read_text(encoding="utf-8") for file in (*SOURCES, *_HEADERS)}
    digest = hashlib.sha256("".join(texts.values()).encode()).hexdigest()[:8]
    context: dict[str, Any] = {
        "name": name,
        "NAME": name.upper(),
        "package": {
            "name": name,
            "description": f"axis {machine.name}: {machine.plant.units.push} in, motion out",
            "machine_digest": machine.digest[:16],
            "header_digest": digest,
            "version": __version__,
            "command": "export",
        },
        "units": machine.plant.units,
        "machine": machine,
        "delivery": {"sources": SOURCES, "variables": variables},
        "piece": "axis/fmi_axis.jinja",
        "refusable": "a parameter",
        "settings": tuple(_settings(machine)),
        "effects": effects,
        "starts": [v for v in variables if v.variability == "fixed"],
        "tunable": tunable,
    }
    files = {f"sources/{file}": text for file, text in texts.items()}
    files[f"sources/{name}.h"] = f'#include "{_HEADERS[0]}"\n'
    files["documentation/licenses/license.txt"] = render_text("LICENSE", context)
    for file, template in BINDINGS[f"fmu{version}"].items():
        path = file.format(name=name).partition("/")[2]
        render = render_c if PurePath(path).suffix == ".c" else render_text
        files[path] = render(template, context)
    archive, missing = fmu(files, name, f"{name}_fmi{version}.fmu", ("m",))
    holds = ["the whole friction law, integrated as `sgms-mhe simulate` does"]
    if machine.effects:
        holds.append(f"the effects {', '.join(effect.label for effect in machine.effects)}")
    lost = (f"any step but the sample period, {machine.sampling.step:g} s",)
    return WrittenAxis(f"fmu{version}", archive, tuple(holds), lost, missing=missing)


def _settings(machine: Machine) -> Iterator[tuple[str, float]]:
    """Fields of `struct axis_settings` and their values."""
    friction, sampling = machine.friction, machine.sampling
    yield "law", float(friction.switches)
    yield "control", _DRIVEN
    yield "rate", sampling.rate
    yield "substeps", min(math.ceil(1.0 / (sampling.rate * SUBSTEP_S) - 1e-9), MAX_SUBSTEPS)
    yield "elements", friction.n_z
    yield "mass", machine.plant.moved
    for name in ("stiffness", "fraction", "micro_viscous"):
        for i, value in enumerate(getattr(friction, name)):
            yield f"{name}[{i}]", value
    for name in ("viscous", "coulomb", "stribeck_ratio", "stribeck_velocity"):
        yield name, getattr(friction, name)
    yield from (friction.smoothing or Smoothing()).model_dump(by_alias=True).items()


def _effect_rows(machine: Machine) -> Iterator[tuple[str, list[float], list[float]]]:
    """Effects of the C with their parameters, of lists one for each entry; and the list it takes whole."""
    for effect in machine.effects:
        entries = effect_definition(effect.name).entries(effect.parameters)
        for row in _rows(machine, effect.name, entries):
            table = [entries[name] for name in _table(effect.name, row, entries)]
            yield effect.name, [entries[name] for name in row], table


def _table(effect: str, row: list[str], entries: dict[str, float]) -> list[str]:
    """Names of the entries of the list the C takes whole, which is its last parameter; none: it takes none so."""
    if not loaded_library().has_table(effect):
        return []
    whole = next(p for p in effect_definition(effect).parameters if p.holds(row[-1]))
    return [name for name in entries if whole.holds(name)]


def _rows(machine: Machine, effect: str, entries: dict[str, float]) -> list[list[str]]:
    """Names of the entries of each of the C's effects an effect makes."""
    names = loaded_library().effects.get(effect)
    if names is None:
        allowed = "effects of this package: the force that another distribution brings for the plant is no C"
        raise InputError(machine.source, "effects", effect, allowed)
    definition = effect_definition(effect)
    count = max(sum(definition.parameter(name).holds(entry) for entry in entries) for name in names)
    count = 1 if loaded_library().has_table(effect) else count
    return [[definition.parameter(name).entry(i) for name in names] for i in range(1, count + 1)]


def _variables(machine: Machine) -> tuple[tuple[Variable, ...], tuple[_Tunable, ...]]:
    """All variables in the order of their references, the input first; and those that may be tuned."""
    units = machine.plant.units
    signals = (
        ("position", units.position, "position of the axis"),
        ("velocity", units.velocity, "its velocity"),
        ("acceleration", units.acceleration, "its acceleration"),
        ("friction", units.force, "friction of the law, against the motion"),
        ("effect_force", units.force, f"{units.push} of the effects, likewise"),
        ("position_measured", units.position, "position as the encoder reads it"),
        (f"{units.push}_measured", units.force, f"{units.push} as the drive logs it"),
    )
    text = f"{units.push} of the drive, held through a step"
    rows = [Variable(1, units.push, "Real", "input", dot_unit(units.force), text, f"self->{units.push}", "0.0")]
    rows += [
        Variable(k, name, "Real", "output", dot_unit(unit), text, f"now->{name}")
        for k, (name, unit, text) in enumerate(signals, 2)
    ]

    def add_parameter(name: str, unit: str, text: str, code: str, start: str, *bounds: float | None) -> Variable:
        rows.append(Variable(len(rows) + 1, name, "Real", "parameter", unit, text, code, start, *bounds))
        return rows[-1]

    starts = [("position", units.position), ("velocity", units.velocity)]
    starts += [(f"deflection_{i}", units.position) for i in range(1, machine.friction.n_z + 1)]
    for k, (name, unit) in enumerate(starts):
        text, code = f"{name} at the start, before the first step", f"self->start[{k}]"
        row = add_parameter(f"start_{name}", dot_unit(unit), text, code, "0.0", -_FARTHEST, _FARTHEST)
        rows[-1] = replace(row, variability="fixed")
    tunable = []
    for number, places, limits in _places(machine):
        if not places:  # of a table, which is the C's own
            continue
        bounds = (limits.low, limits.high) if math.isfinite(limits.high - limits.low) else ()
        value, unit = repr(number.value), dot_unit(number.unit) or "1"
        variable = add_parameter(number.name, unit, number.text, places[0], value, *bounds)
        tunable.append(_Tunable(variable, places, *_edges(limits)))
    return tuple(rows), tuple(tunable)


def _edges(limits: Limits) -> tuple[float, float]:
    """The least and the most number within limits."""
    low = limits.low if limits.with_low else math.nextafter(limits.low, math.inf)
    high = limits.high if limits.with_high else math.nextafter(limits.high, -math.inf)
    return max(low, -sys.float_info.max), min(high, sys.float_info.max)


def _places(machine: Machine) -> Iterator[tuple[AxisNumber, tuple[str, ...], Limits]]:
    """Numbers of the plant, the places of each in C, and its limits."""
    numbers, friction = iter(axis_numbers(machine)), machine.friction
    plant, limits = "self->axis.plant", base_limits()
    yield next(numbers), (f"{plant}.set.mass",), limits["mass"]
    for name in ("stiffness", "fraction", "micro_viscous"):
        for i in range(friction.n_z):
            yield next(numbers), (f"{plant}.set.{name}[{i}]",), limits[name]
    scalars: Sequence[str] = ("coulomb", "viscous", "stribeck_ratio", "stribeck_velocity")
    smoothing = () if friction.smoothing is None else tuple(friction.smoothing.model_dump(by_alias=True))
    for name in (*scalars, *smoothing):
        yield next(numbers), (f"{plant}.set.{name}",), limits[name]
    first = 0
    for effect in machine.effects:
        definition = effect_definition(effect.name)
        entries = definition.entries(effect.parameters)
        rows = _rows(machine, effect.name, entries)
        fixed = _table(effect.name, rows[0], entries)
        for name in definition.names(entries):
            at = [(first + i, row.index(name)) for i, row in enumerate(rows) if name in row and name not in fixed]
            places = tuple(f"{plant}.effect[{i}].parameter[{j}]" for i, j in at)
            yield next(numbers), places, effect_limits(definition.parameter(name))
        first += len(rows)
