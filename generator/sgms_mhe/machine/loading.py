"""Machine files: find, merge `extends`, validate, and say what is wrong in the user's own terms."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from sgms_mhe.machine.schema import Machine, listing, merged
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.paths import machines_dir

DEEPEST: Final = 16
"""Nesting of tables and arrays that a machine file may have; its schema needs four."""


class _Layer(NamedTuple):
    """One file of an `extends` chain, as written."""

    path: Path
    content: dict[str, Any]


def load_machine(machine: str | Path) -> Machine:
    """Read a machine file, given by path or by its bare name in a `machines` folder.

    Raises InputError (file, dotted key, value, what is allowed) for everything that is wrong with it.
    """
    layers = _read_layers(_find(machine, Path(), str(machine), "machine"))
    content: dict[str, Any] = {}
    for layer in reversed(layers):
        content = merged(content, layer.content)
    return _validated(content, layers)


def override_machine(machine: Machine, changes: Mapping[str, Any]) -> Machine:
    """The machine that a file with `extends` and these changes would describe: tables merge, arrays are replaced.

    Defaults that depend on other keys follow the changes. Raises InputError as load_machine does.
    """
    return _validated(merged(machine.content, changes), [_Layer(machine.source, dict(changes))])


def _validated(content: dict[str, Any], layers: list[_Layer]) -> Machine:
    try:
        machine = Machine.model_validate(content)
    except ValidationError as error:
        raise _input_error(error, layers) from None
    machine._source = layers[0].path
    return machine


def json_schema() -> dict[str, Any]:
    """JSON Schema of a machine file, `extends` included."""
    schema = Machine.model_json_schema(by_alias=True)
    schema["title"] = "sgms-mhe machine file"
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "another machine file (same folder or machines/) whose keys this file overrides; "
        "tables merge, arrays are replaced; default none",
    }
    # A file that extends another one may leave everything to it.
    schema["if"], schema["else"] = {"required": ["extends"]}, {"required": schema.pop("required")}
    return schema


def _find(machine: str | Path, folder: Path, source: str | Path, where: str) -> Path:
    name = Path(machine)
    names = [name] if name.suffix == ".toml" else [name, name.with_name(f"{name.name}.toml")] if name.name else []
    folders = [folder]
    if len(name.parts) == 1:
        folders += [Path("machines"), machines_dir()]
    for place in folders:
        for candidate in names:
            if (place / candidate).is_file():
                return place / candidate
    known = sorted({path.stem for place in folders[1:] for path in place.glob("*.toml")})
    hint = f", or one of {listing(known)}" if known else ""
    raise InputError(source, where, str(machine), f"a machine file that exists{hint}")


def _read_layers(path: Path) -> list[_Layer]:
    """The file and everything it extends, the most specific first."""
    layers: list[_Layer] = []
    while True:
        if any(layer.path.resolve() == path.resolve() for layer in layers):
            raise InputError(layers[-1].path, "extends", path.name, "a file that does not lead back to this one")
        content = _read_toml(path)
        parent = content.pop("extends", None)
        layers.append(_Layer(path, content))
        if parent is None:
            return layers
        if not isinstance(parent, str) or not parent:
            raise InputError(path, "extends", parent, "the name of another machine file")
        path = _find(parent, path.parent, path, "extends")


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        content = tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise InputError(path, "file", None, f"a readable machine file ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(path, f"byte {error.start}", None, "UTF-8 text") from None
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError, a number with 5000 digits another
        place = re.search(r"\(at line (\d+), column \d+\)", str(error))
        where = f"line {place.group(1)}" if place else "last line" if "end of document" in str(error) else "file"
        raise InputError(path, where, None, f"TOML syntax: {error}") from None
    if key := _too_deep(content):
        raise InputError(path, key, None, f"tables and arrays nested at most {DEEPEST} deep")
    return content


def _too_deep(content: dict[str, Any]) -> str:
    """The outermost key below which tables and arrays are nested deeper than DEEPEST; empty where there is none."""
    # Without recursion: dotted keys nest tables to depths that neither validation nor repr can follow.
    for key, entry in content.items():
        level = [entry]
        for _ in range(DEEPEST):
            level = [inner for outer in level for inner in _inside(outer)]
        if level:
            return key
    return ""


def _inside(value: object) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


_MISSING = object()


def _look_up(content: Any, keys: Sequence[str | int]) -> Any:
    for key in keys:
        try:
            content = content[key]
        except (KeyError, IndexError, TypeError):
            return _MISSING
    return content


def _spelled(loc: Sequence[str | int]) -> str:
    """Dotted key as in the file; array entries count from 1 as everything a user sees does."""
    spelled = ""
    for key in loc:
        spelled += f"[{key + 1}]" if isinstance(key, int) else f".{key}" if spelled else key
    return spelled or "file"


def _fields(table: type[BaseModel] | None) -> dict[str | int, FieldInfo]:
    """Fields of a table by their keys in the file."""
    return {field.alias or name: field for name, field in table.model_fields.items()} if table else {}


def _field(model: type[BaseModel], keys: Sequence[str | int]) -> tuple[type[BaseModel] | None, str]:
    """The innermost table on the way to a key, and the description of the innermost field."""
    table: type[BaseModel] | None = model
    description = ""
    for key in keys:
        fields = _fields(table)
        if key not in fields:
            continue
        field = fields[key]
        description = field.description or ""
        inner = [field.annotation, *get_args(field.annotation)]
        table = next((kind for kind in inner if isinstance(kind, type) and issubclass(kind, BaseModel)), None)
    return table, description


def _input_error(error: ValidationError, layers: list[_Layer]) -> InputError:
    """The first violation, unknown keys before others, in the terms of the file that holds it."""
    details = [entry for entry in error.errors() if entry["type"] != "default_factory_not_called"]
    # A misspelt key is unknown and, where it is required, missing too: the first says more.
    detail: ErrorDetails = next((entry for entry in details if entry["type"] == "extra_forbidden"), details[0])
    loc: list[str | int] = list(detail["loc"])
    context = detail.get("ctx", {})
    value: object = detail["input"]
    described = _field(Machine, loc)[1]
    if detail["type"] == "rule":
        loc += [int(key) if key.isdigit() else key for key in _split(context["where"])]
        value, allowed = context["value"], context["allowed"]
    elif detail["type"] == "missing":
        value, allowed = None, f"required key is missing; {described}"
    elif detail["type"] == "extra_forbidden":
        known = [str(key) for key in _fields(_field(Machine, loc[:-1])[0])]
        if len(loc) == 1:
            known.append("extends")
        close = difflib.get_close_matches(str(loc[-1]), known, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        allowed = f"unknown key{hint}; allowed: {listing(known)}"
    elif detail["type"] == "model_type" or (detail["type"] == "dict_type"):
        allowed = f"a table; {described}"
    else:
        message = detail["msg"].removeprefix("Input should be ")
        allowed = f"{message}; {described}" if described else message
    holder = next((layer.path for layer in layers if _look_up(layer.content, loc) is not _MISSING), layers[0].path)
    if holder != layers[0].path:
        allowed += f" (in {layers[0].path}, which extends it)"
    return InputError(holder, _spelled(loc), value, allowed)


def _split(where: str) -> list[str]:
    # A bound of an effect's parameter has a dot inside its key.
    head, mark, name = where.partition("bounds.")
    return [*filter(None, head.split(".")), "bounds", name] if mark else where.split(".")
