"""The machine file: every number with its interval beside it, and whatever stands at a default marked as such."""

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sgms_mhe.configuration import make_machine
from sgms_mhe.identification.elements import Law
from sgms_mhe.identification.result import Number
from sgms_mhe.machine import Machine, Units, plant_content
from sgms_mhe.machine.estimator import Noise
from sgms_mhe.machine.writing import notes_of_table, toml_line, toml_table, toml_tables, wrap_comment
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.support.numbers import round_number

ELEMENTS: Final = ("stiffness_", "fraction_")
SHARE_DIGITS: Final = 9
ESTIMATED: Final = ("coulomb", "viscous")
"""What changes on an axis with temperature and wear; of these the ones that the records determine are estimated."""
BOUNDS: Final = {"coulomb": [0.3, 3.0], "viscous": [0.1, 5.0]}
"""Of nominal."""
OFFSET: Final = "constant_offset.force_N"
KEPT_ESTIMATOR: Final = ("kind", "horizon", "relinearise", "arrival_cost")


def machine_content(
    base: Machine,
    law: Law,
    numbers: Sequence[Number],
    noise: Mapping[str, float],
    followed: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Any]:
    """Content of the machine file.

    Args:
        base: name, rates and keys taken over from another file.
        law: of the elements.
        numbers: as described.
        noise: known keys of [estimator.noise].
        followed: numbers that differ between records, which the estimator follows: deviation from the file's by name,
            as in [estimator.prior].
    """
    by_name = {number.name: number for number in numbers}
    units = base.plant.units
    value = {name: round_number(number.value, number.std) for name, number in by_name.items()}
    count = sum(name.startswith("stiffness_") for name in value)
    friction: dict[str, Any] = {
        "law": law,
        "stiffness": [value[f"stiffness_{k}"] for k in range(1, count + 1)],
        "fraction": _shares([by_name[f"fraction_{k}"].value for k in range(1, count + 1)]),
        **{name: value[name] for name in ("viscous", "coulomb", "stribeck_ratio", "stribeck_velocity")},
    }
    kept = ("rate", "update_rate", "velocity_cutoff", "max_velocity", "position_step")
    sampling = {key: getattr(base.sampling, key) for key in kept if getattr(base.sampling, key)}
    if law == "sgms":
        sampling["integrator"] = {"scheme": "flow"}
    estimated = [name for name in ESTIMATED if by_name[name].determined or name in followed] or ["coulomb"]
    estimator = {key: entry for key, entry in base.content.get("estimator", {}).items() if key in KEPT_ESTIMATOR}
    estimator["parameters"] = [*estimated, *(units.named(name) for name in followed if name == OFFSET)]
    estimator["noise"] = dict(base.content.get("estimator", {}).get("noise", {}))
    estimator["noise"] |= {name: float(f"{value:.3g}") for name, value in noise.items()}
    estimator["bounds"] = {name: BOUNDS[name] for name in estimated}
    wide = {units.named(n): size for n, size in followed.items() if n == OFFSET or size > Noise().parameter}
    estimator |= {"prior": wide} if wide else {}
    if OFFSET in followed:
        value.setdefault(OFFSET, 0.0)
    effects: dict[str, dict[str, Any]] = {}
    for name, number in value.items():
        effect, dot, parameter = name.partition(".")
        if dot:
            effects.setdefault(effect, {})[parameter] = number
    content: dict[str, Any] = {
        "name": base.name,
        "description": base.description or "identified from measurements",
        "plant": plant_content(units.kind, value["mass"]),
        "friction": friction,
        "sampling": sampling,
        "estimator": estimator,
    }
    content |= {key: base.content[key] for key in ("compensation", "code", "diagnosis", "log") if key in base.content}
    if effects:
        lists = {name: effect_definition(name).lists(numbers) for name, numbers in effects.items()}
        content["effects"] = [{"name": name} | units.keyed(values) for name, values in lists.items()]
    return content


def _shares(values: Sequence[float]) -> list[float]:
    """Fractions of so many digits that sum to 1: the largest makes up for rounding."""
    shares = [float(f"{value:.{SHARE_DIGITS}f}") for value in values]
    k = shares.index(max(shares))
    shares[k] = round(1.0 - math.fsum(shares[:k] + shares[k + 1 :]), SHARE_DIGITS)
    return shares


def machine_toml(units: Units, content: Mapping[str, Any], numbers: Sequence[Number], head: Sequence[str]) -> str:
    """The file: `head` as comments, then the content, numbers with their intervals."""
    notes = _notes(units, numbers)
    lines = [line for text in head for line in wrap_comment(text)]
    lines += [toml_line(key, content[key]) for key in ("name", "description") if key in content]
    for table in ("plant", "friction", "sampling", "drive", "estimator", "compensation", "code", "diagnosis", "log"):
        if table in content:
            lines += toml_tables(table, content[table], notes)
        if table == "friction":
            lines += _entries(units, numbers)
    for effect in content.get("effects", ()):
        lines += toml_table("[[effects]]", effect, notes=notes_of_table(notes, effect["name"]))
        lines += _entries(units, numbers, effect["name"])
    return "\n".join(lines) + "\n"


def check_toml(toml: str, content: Mapping[str, Any], path: Path) -> Machine:
    """The machine the text describes, which has to be that of the content."""
    read = tomllib.loads(toml)
    if read != json.loads(json.dumps(content)):
        raise ValueError("a machine file that does not say what it should")
    return make_machine(read, path)


def _notes(units: Units, numbers: Sequence[Number]) -> dict[str, str]:
    """Comments by key of the file: intervals of two standard deviations, or why there is none."""
    notes: dict[str, str] = {}
    for number in numbers:
        said = number.note if not math.isfinite(number.std) else number.interval
        if math.isfinite(number.std) and number.note:
            said += f", {number.note}"
        if "." in number.name:
            notes[units.named(number.name)] = said
        elif not number.name.startswith(ELEMENTS):
            table = "plant" if number.name in ("mass", "weight_radius") else "friction"
            unit = number.state(units).unit
            notes[f"{table}.{units.named(number.name)}"] = f"{unit}: {said}" if unit else said
    notes["friction.stiffness"] = units.stiffness
    notes["sampling.position_step"] = f"{units.position}, of the encoder: readings so near to the axis are no motion"
    notes["estimator.noise.measurement"] = (
        f"{units.force}, 1 sigma: what the model leaves of the logs, sample by sample"
    )
    notes["estimator.noise.colour"] = (
        "of it: 1 where samples are independent; the estimator doubts beyond twice as much"
    )
    return notes


def _entries(units: Units, numbers: Sequence[Number], owner: str = "") -> list[str]:
    """Return a comment on the entries of each list: of the elements, or of an effect."""
    lists = [parameter for parameter in effect_definition(owner).parameters if parameter.array] if owner else []
    entries = {units.named(one.name): [n for n in numbers if one.holds(_key(n, owner))] for one in lists}
    if not owner:
        entries = {name.rstrip("_"): [n for n in numbers if n.name.startswith(name)] for name in ELEMENTS}
    lines = []
    for name, found in entries.items():
        if any(math.isfinite(number.std) or number.note for number in found):
            said = [number.interval + (f" ({number.note})" if number.note else "") for number in found]
            lines += wrap_comment(f"{name}: {', '.join(said)}")
    return lines


def _key(number: Number, effect: str) -> str:
    """Return the parameter of an effect a number is; empty where it is none."""
    name, _, key = number.name.rpartition(".")
    return key if name == effect else ""
