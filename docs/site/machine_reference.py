"""The page of the machine file with every key, from its JSON Schema."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from markup import table
from sgms_mhe.configuration import machine_schema

HEAD = """# Machine file, every key

Made from the schema that `sgms-mhe schema` prints. A key that is left out has its default; an unknown one is an error.
How to write one is in [your own axis](../docs/own_axis.md)."""
ELSEWHERE = {"Effect": "The parameters of each are on [their own page](effects.md)."}
"""Definitions that another page continues."""


def pages() -> dict[str, str]:
    """Return the Markdown of all tables of a machine file, by address."""
    schema = machine_schema()
    return {"reference/machine.md": "\n\n".join([HEAD, *_tables("", schema, schema["$defs"], set())])}


def _tables(path: str, definition: dict[str, Any], known: dict[str, Any], done: set[str]) -> Iterator[str]:
    """A table of the file, then those within it; one that several keys share comes once."""
    rows: list[list[str]] = []
    keys: dict[str, list[str]] = {}  # by the definition that they share
    for key, value in definition["properties"].items():
        rows.append([f"`{key}`", _type(value), value.get("description", "")])
        for own in _references(value):
            keys.setdefault(own, []).append(f"[{key}]" if value.get("type") == "array" else key)
    parts = [f"## [{path}]" if path else "## Outside of tables", definition["description"]]
    yield "\n\n".join([*parts, table(["key", "type", "meaning"], rows)])
    for own in [own for own in keys if own not in done]:
        done.add(own)
        first, *others = keys[own]
        name = f"[{first.strip('[]')}]" if first.startswith("[") else f"{path}.{first}".lstrip(".")
        head, *rest = _tables(name, known[own], known, done)
        also = [f"So are {', '.join(f'`{other}`' for other in others)}."] if others else []
        yield "\n\n".join([head, *also, *([ELSEWHERE[own]] if own in ELSEWHERE else []), *rest])


def _references(value: dict[str, Any]) -> Iterator[str]:
    """Definitions that a key's value may be, or be a list of."""
    for part in (value, *value.get("anyOf", ()), value.get("items", {})):
        if "$ref" in part:
            yield part["$ref"].rpartition("/")[2]


def _type(value: dict[str, Any]) -> str:
    if "$ref" in value:
        return "table"
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(_type(part) for part in value["anyOf"] if part.get("type") != "null"))
    if value["type"] == "array":
        return f"list of {_type(value['items'])}s" if "items" in value else "list"
    return "table" if value["type"] == "object" else str(value["type"])
