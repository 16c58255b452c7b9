"""Machine files written: values as TOML, and how a file names the one that it extends."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final

from sgms_mhe.machine.resolved import Machine
from sgms_mhe.support.paths import machines_dir

COMMENT_COLUMN: Final = 40
NO_NOTES: Final[Mapping[str, str]] = {}


def toml_value(value: Any) -> str:
    """A value of a machine file as TOML: inline where it is a table; floats by their shortest round trip."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(toml_line(key, entry) for key, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(entry) for entry in value) + "]"
    return repr(value) if isinstance(value, int) else repr(float(value))


def toml_line(key: str, value: Any, note: str = "", column: int = COMMENT_COLUMN) -> str:
    """Return a key, its value and a comment that begins in a column, or where the value ends."""
    plain = key.replace("_", "").replace("-", "").isalnum()
    line = f"{key if plain else json.dumps(key)} = {toml_value(value)}"
    return f"{line:<{column}} # {note}".rstrip() if note else line


def toml_table(
    header: str,
    entries: Mapping[str, Any],
    note: str = "",
    notes: Mapping[str, str] = NO_NOTES,
    column: int = COMMENT_COLUMN,
) -> list[str]:
    """Return the lines of a table behind an empty one.

    Args:
        header: with its brackets.
        entries: values by key.
        note: comment below the header; empty: none.
        notes: comments beside values, by key.
        column: at which these begin.
    """
    comment = [f"# {note}"] if note else []
    return [
        "",
        header,
        *comment,
        *(toml_line(key, value, notes.get(key, ""), column) for key, value in entries.items()),
    ]


def toml_extends(machine: Machine) -> str:
    """The line by which a file extends a machine: by name where everybody finds it, otherwise by path."""
    source = machine.source
    if not source.name:
        base = machine.name
    elif source.resolve().parent == machines_dir().resolve():
        base = source.stem
    else:
        base = source.resolve().as_posix()
    return toml_line("extends", base)
