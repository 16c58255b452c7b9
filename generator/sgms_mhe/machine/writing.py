"""Machine files written: values as TOML, and how a file names the one that it extends."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from textwrap import fill, wrap
from typing import Any, Final

from sgms_mhe.machine.log_mapping import kinds_of
from sgms_mhe.machine.log_units import BY_COLUMN
from sgms_mhe.machine.reading import digest_content
from sgms_mhe.machine.resolved import Machine
from sgms_mhe.machine.units import Kind
from sgms_mhe.support.paths import machines_dir

COMMENT_COLUMN: Final = 40
WIDEST: Final = 110
"""Columns from which on a list goes on in another line."""
COMMENT_WIDTH: Final = 100
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
    if len(line) > WIDEST and isinstance(value, list | tuple) and not note:
        return fill(line, WIDEST, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
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


def toml_tables(name: str, table: Mapping[str, Any], notes: Mapping[str, str] = NO_NOTES) -> list[str]:
    """Return the lines of a table of a machine file and of the tables below it.

    Args:
        name: dotted, without brackets.
        table: values by key.
        notes: comments beside values, by dotted key.
    """
    is_inline = name != "estimator"  # tables within it stand on one line
    plain = {key: entry for key, entry in table.items() if not isinstance(entry, Mapping) or is_inline}
    lines = toml_table(f"[{name}]", plain, notes=notes_of_table(notes, name)) if plain else []
    for key, entry in table.items():
        if key not in plain and entry:
            lines += toml_tables(f"{name}.{key}", entry, notes)
    return lines


def notes_of_table(notes: Mapping[str, str], table: str) -> dict[str, str]:
    """Return the comments of a table by its own keys."""
    return {key.removeprefix(f"{table}."): note for key, note in notes.items() if key.startswith(f"{table}.")}


def toml_machine(content: Mapping[str, Any]) -> list[str]:
    """Return the lines of a whole machine file that extends no other."""
    lines = [toml_line(key, entry) for key, entry in content.items() if not isinstance(entry, Mapping | list | tuple)]
    for key, entry in content.items():
        if isinstance(entry, Mapping):
            lines += toml_tables(key, entry)
        elif isinstance(entry, list | tuple):
            lines += [line for table in entry for line in toml_table(f"[[{key}]]", table)]
    return lines


def toml_log(table: Mapping[str, Any], kind: Kind) -> str:
    """Return the table [log] of a machine file of this kind of axis; empty where it would say nothing."""
    own = {key: entry for key, entry in table.items() if key not in BY_COLUMN or kind in kinds_of(key)}
    return "\n".join([*toml_table("[log]", own), ""]) if own else ""


def toml_extends(machine: Machine, folder: Path) -> list[str]:
    """Return the lines by which a file in `folder` extends a machine, and knows it again.

    By name where every installation finds it; otherwise by the path from the folder: both can be moved together.
    """
    source = machine.source.resolve()
    if source.parent == machines_dir().resolve():
        base = source.stem
    else:
        try:
            base = Path(os.path.relpath(source, folder.resolve())).as_posix()
        except ValueError:  # on another drive, to which no relative path leads
            base = source.as_posix()
    return [toml_line("extends", base), toml_line("extends_digest", digest_content(machine.content))]


def wrap_comment(text: str) -> list[str]:
    """A comment in lines of the file's width."""
    return wrap(text, COMMENT_WIDTH, initial_indent="# ", subsequent_indent="#   ")
