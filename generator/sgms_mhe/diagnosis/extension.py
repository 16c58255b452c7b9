"""The extended machine: a few lines of TOML over the machine that was diagnosed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sgms_mhe.configuration import override_machine
from sgms_mhe.machine import Estimator, Machine, plant_content
from sgms_mhe.machine.writing import toml_extends, toml_line, toml_machine, toml_table, toml_tables, wrap_comment
from sgms_mhe.model.effects import effect_definition

NAME_LENGTH = 48
LEARNED_NOTE = "Learned, no cause; `learned = false` leaves it out. Place counts from the record's zero."


def extend_machine(
    machine: Machine,
    names: Sequence[str],
    friction: Mapping[str, Any],
    effects: Sequence[Mapping[str, Any]] | None,
    moved: float | None = None,
    followed: Mapping[str, float] = MappingProxyType({}),
) -> tuple[Machine, dict[str, Any]]:
    """Return the machine with numbers corrected and effects added, and the tables this changes.

    A number the record says is 0 is no scale for its own estimate: parameters of the base without one in the
    extended machine are left out of its `estimator.parameters` (where nothing is left, the default takes the place).

    Args:
        machine: the base.
        names: of the causes, for the file's name; none where numbers alone change.
        friction: changed keys of [friction].
        effects: all entries of [[effects]]; None where they stay as they are.
        moved: changed mass [kg], or inertia [kg m^2]; None where it stays.
        followed: numbers that differ between records, which the estimator follows: deviation before any data by name,
            as in [estimator.prior].

    Returns:
        The machine, and the changes as content of a machine file that `extends` the base.
    """
    name = machine.name
    for cause in names:
        if len(f"{name}_{cause}") > NAME_LENGTH:
            break
        name = f"{name}_{cause}"
    if name == machine.name:
        name = f"{machine.name[: NAME_LENGTH - 9]}_extended"
    by = f"extended by {', '.join(names)}" if names else "with the numbers of a record"
    description = f"{machine.description or machine.name}, {by}"[:200]
    units = machine.plant.units
    changes: dict[str, Any] = {"name": name, "description": description}
    if moved is not None and moved != machine.plant.moved:
        changes["plant"] = plant_content(machine.plant.kind, moved)
    if friction:
        changes["friction"] = dict(friction)
    if effects is not None:
        changes["effects"] = [units.keyed(_within(effect)) for effect in effects]
        # Bounds are multiples of nominal values: those of an effect that the base has stay.
    estimated = _estimable(machine, changes) or Estimator().parameters
    estimated = (*estimated, *(name for name in followed if name not in estimated))
    if estimated != machine.estimator.parameters:
        changes["estimator"] = {"parameters": [units.named(name) for name in estimated]}
    if followed:
        changes.setdefault("estimator", {})["prior"] = {units.named(key): value for key, value in followed.items()}
    extended = override_machine(machine, changes)
    return extended, changes


def add_tables(
    machine: Machine, base: Machine, changes: Mapping[str, Any] | None, tables: Sequence[Mapping[str, Any]]
) -> tuple[Machine, dict[str, Any]]:
    """Return the extended machine with learned tables behind its causes, and the changes of its file.

    Args:
        machine: of the file.
        base: the machine that gets the tables: the extended one, or that of the file.
        changes: of the file; None: none.
        tables: entries of [[effects]], names of a linear axis.
    """
    units, given = machine.plant.units, dict(changes or {})
    own = given.get("effects") or [effect.entry(units) for effect in base.effects]
    added = {
        **given,
        "name": base.name if changes else f"{base.name[: NAME_LENGTH - 9]}_extended",
        "description": f"{base.description or base.name}, with what was learned and has no name"[:200],
        "effects": [*own, *(units.keyed(table) for table in tables)],
    }
    return override_machine(machine, added), added


def _within(effect: Mapping[str, Any]) -> dict[str, Any]:
    """An effect's entry with its numbers within their limits, beyond which rounding takes one that a bound holds."""
    definition = effect_definition(effect["name"])
    numbers = definition.entries({key: value for key, value in effect.items() if key != "name"})
    for key, value in numbers.items():
        numbers[key] = min(max(value, definition.parameter(key).lower), definition.parameter(key).upper)
    return {"name": effect["name"], **definition.lists(numbers)}


def _estimable(machine: Machine, changes: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the machine's estimated names, without base numbers and bounded ones of effects that are 0 now."""
    zero = {key for key, value in changes.get("friction", {}).items() if value == 0.0}
    for effect, entry in zip(machine.effects, changes.get("effects", ()), strict=False):  # new ones come behind
        zero |= {
            f"{effect.label}.{key}" for key in effect.parameters if entry.get(machine.plant.units.named(key)) == 0.0
        }
    bounded = machine.estimator.bounds
    return tuple(
        name for name in machine.estimator.parameters if name not in zero or ("." in name and name not in bounded)
    )


def extension_toml(
    machine: Machine, extended: Machine, changes: Mapping[str, Any], folder: Path, said: Sequence[str], *, alone: bool
) -> str:
    """Return the file of an extended machine.

    Args:
        machine: the base.
        extended: the machine with the changes.
        changes: as `extend_machine` gives them.
        folder: in which the file is to lie.
        said: sentences that are its comments.
        alone: True for a file with every table; otherwise it has the changes alone and extends the file of the base.
            A base without a file leaves no choice.
    """
    head = [f"# Written by sgms-mhe diagnose over {machine.source.name or machine.name}."]
    head += [line for sentence in said for line in wrap_comment(sentence)]
    if alone or not machine.source.is_file():
        return "\n".join([*head, *toml_machine(extended.content)]) + "\n"
    lines = [*head, *toml_extends(machine, folder), *(toml_line(key, changes[key]) for key in ("name", "description"))]
    for key in ("plant", "friction"):
        if key in changes:
            lines += toml_table(f"[{key}]", changes[key])
    if "estimator" in changes:
        before = [machine.plant.units.named(name) for name in machine.estimator.parameters]
        left_out = [name for name in before if name not in changes["estimator"].get("parameters", before)]
        notes = [f"# Without {', '.join(left_out)}: 0 is no scale for an estimate."] if left_out else []
        if followed := changes["estimator"].get("prior"):
            notes.append(f"# Of each record its own: {', '.join(followed)}.")
        lines += ["", *notes, *toml_tables("estimator", changes["estimator"])[1:]]
    for effect in changes.get("effects", ()):
        lines += toml_table("[[effects]]", effect, LEARNED_NOTE if effect_definition(effect["name"]).learned else "")
    return "\n".join(lines) + "\n"
