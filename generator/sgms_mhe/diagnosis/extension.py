"""The extended machine: a few lines of TOML over the machine that was diagnosed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sgms_mhe.configuration import override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.support.paths import machines_dir

NAME_LENGTH = 48


def extend_machine(
    machine: Machine,
    names: Sequence[str],
    friction: Mapping[str, Any],
    effects: Sequence[Mapping[str, Any]] | None,
) -> tuple[Machine, str]:
    """The machine with numbers corrected and effects added, and its file.

    Args:
        machine: the base.
        names: of the causes, for the file's name.
        friction: changed keys of [friction].
        effects: all entries of [[effects]]; None where they stay as they are.

    Returns:
        The machine, and TOML that `extends` the base.
    """
    name = machine.name
    for cause in names:
        if len(f"{name}_{cause}") > NAME_LENGTH:
            break
        name = f"{name}_{cause}"
    if name == machine.name:
        name = f"{machine.name[: NAME_LENGTH - 9]}_extended"
    description = f"{machine.description or machine.name}, extended by {', '.join(names)}"[:200]
    changes: dict[str, Any] = {"name": name, "description": description}
    if friction:
        changes["friction"] = dict(friction)
    if effects is not None:
        changes["effects"] = [dict(effect) for effect in effects]
        # Bounds are multiples of nominal values: those of an effect that the base has stay.
    extended = override_machine(machine, changes)
    return extended, _toml(machine, changes)


def _toml(machine: Machine, changes: Mapping[str, Any]) -> str:
    lines = [
        f"# Written by sgms-mhe diagnose over {machine.source.name or machine.name}.",
        f'extends = "{_reference(machine)}"',
        f'name = "{changes["name"]}"',
        f'description = "{changes["description"]}"'.replace("\\\\", "/"),
    ]
    if "friction" in changes:
        lines += ["", "[friction]"]
        lines += [f"{key} = {_value(value)}" for key, value in changes["friction"].items()]
    for effect in changes.get("effects", ()):
        lines += ["", "[[effects]]"]
        lines += [f"{key} = {_value(value)}" for key, value in effect.items()]
    return "\n".join(lines) + "\n"


def _reference(machine: Machine) -> str:
    """How the extended file finds its base: by name where everybody does, otherwise by path."""
    source = machine.source
    if source.name and (source.resolve().parent == machines_dir().resolve()):
        return source.stem
    return source.resolve().as_posix() if source.name else machine.name


def _value(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    return repr(float(value))
