"""Pages of the machine file with every key, from its JSON Schema."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from markup import split, table
from sgms_mhe.configuration import machine_schema

HEAD = """# Machine file, every key

One page per table, made from the schema that `sgms-mhe schema` prints. A key that is left out has its default; an
unknown one is an error. How to write a file is in [your own axis](../docs/own_axis.md)."""
ELSEWHERE = {"Effect": "The parameters of each are on [their own page](../effects.md)."}
"""Definitions that another page continues."""
KEYS = ["key", "type", "meaning"]


def pages() -> dict[str, str]:
    """Return the Markdown of an overview and of every table of a machine file, those within it on its page."""
    schema = machine_schema()
    texts: dict[str, list[str]] = {}
    for path, text in list(_tables("", schema, schema["$defs"], set()))[1:]:
        own = texts.setdefault(path.strip("[]").partition(".")[0], [])
        own.append(f"{'##' if own else '#'} [{path}]\n\n{text}")
    keys = schema["properties"]
    plain = _rows({key: value for key, value in keys.items() if key not in texts})
    entries = [(name, "\n\n".join(own), keys[name]["description"]) for name, own in texts.items()]
    return split("reference/machine.md", f"{HEAD}\n\n{table(KEYS, plain)}", ["table", "meaning"], entries)


def _rows(keys: dict[str, Any]) -> list[list[str]]:
    return [[f"`{key}`", _type(value), value.get("description", "")] for key, value in keys.items()]


def _tables(path: str, definition: dict[str, Any], known: dict[str, Any], done: set[str]) -> Iterator[tuple[str, str]]:
    """Path and text of a table of the file, then of those within it; one that several keys share comes once."""
    keys: dict[str, list[str]] = {}  # by the definition that they share
    for key, value in definition["properties"].items():
        for own in _references(value):
            keys.setdefault(own, []).append(f"[{key}]" if value.get("type") == "array" else key)
    yield path, f"{definition['description']}\n\n{table(KEYS, _rows(definition['properties']))}"
    for own in [own for own in keys if own not in done]:
        done.add(own)
        first, *others = keys[own]
        name = f"[{first.strip('[]')}]" if first.startswith("[") else f"{path}.{first}".lstrip(".")
        (_, head), *rest = _tables(name, known[own], known, done)
        also = [f"So are {', '.join(f'`{other}`' for other in others)}."] if others else []
        yield name, "\n\n".join([head, *also, *([ELSEWHERE[own]] if own in ELSEWHERE else [])])
        yield from rest


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
