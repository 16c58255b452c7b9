"""Machine files: find, merge `extends`, check each table, and describe errors in the user's own terms."""

import difflib
import hashlib
import json
import re
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from sgms_mhe.machine.fields import MachineTable, listing
from sgms_mhe.machine.file import Tables
from sgms_mhe.machine.log_mapping import LogMapping
from sgms_mhe.machine.sampling import CHOSEN_BY_LAW
from sgms_mhe.support.errors import InputError, MachineWarning
from sgms_mhe.support.paths import machines_dir

Key = str | int

BASE_DIGITS: Final = 16
DEEPEST: Final = 16
"""Nesting of tables and arrays that a machine file may have; its schema needs four."""


class Layer(NamedTuple):
    """One file of an `extends` chain, as written."""

    path: Path
    content: Mapping[str, Any]
    base_digest: object = None
    """Of what the file extends, when it was written."""


@dataclass(frozen=True)
class MachineFile:
    """A machine file as it is written: each table sound, nothing resolved that needs more than the file.

    Attributes:
        tables: its content.
        content: the same as it stands there, `extends` merged, defaults not filled in.
        layers: the file and everything it extends, the most specific first.
    """

    tables: Tables
    content: Mapping[str, Any]
    layers: tuple[Layer, ...]

    @property
    def source(self) -> Path:
        """The file itself."""
        return self.layers[0].path

    def refusal(self, loc: Sequence[Key], value: object, allowed: str) -> InputError:
        """The error of a key, entries of arrays counted from 0, in the terms of the layer that holds it."""
        return _refusal(self.layers, loc, value, allowed)

    def invalid(self, error: ValidationError, table: Sequence[Key]) -> InputError:
        """The error for a value pydantic refused in a table."""
        return _input_error(error, self.layers, table)


def read_machine_file(machine: str | Path) -> MachineFile:
    """Read a machine file, given by path or by its bare name in a `machines` folder.

    Raises InputError (file, dotted key, value, allowed values) for every error in its tables.
    """
    layers = _read_layers(_find(machine, Path(), str(machine), "machine"))
    content: dict[str, Any] = {}
    for layer in reversed(layers):
        _check_base(layer, content)
        content = merge_tables(content, layer.content)
    return machine_file(content, layers)


def machine_file(content: Mapping[str, Any], layers: Sequence[Layer]) -> MachineFile:
    """Check merged content as read_machine_file does; errors name the layer that holds the value, or the first."""
    try:
        return MachineFile(Tables.model_validate(content), content, tuple(layers))
    except ValidationError as error:
        raise _input_error(error, layers) from None


def digest_content(content: Mapping[str, Any]) -> str:
    """Return the digest (hex) of a file's merged content, without keys irrelevant to model and estimator."""
    counted = {key: entry for key, entry in content.items() if key not in ("name", "description", "log", "diagnosis")}
    return hashlib.sha256(json.dumps(counted, sort_keys=True, default=str).encode()).hexdigest()[:BASE_DIGITS]


def _check_base(layer: Layer, base: Mapping[str, Any]) -> None:
    """Warn of a file whose base is not the one that it was written over.

    Raises:
        InputError: a digest of nothing, or of no file.
    """
    stated = layer.base_digest
    if stated is None:
        return
    if not isinstance(stated, str) or not base:
        allowed = f"{BASE_DIGITS} hexadecimal digits, in a file that extends another one; or no such key"
        raise InputError(layer.path, "extends_digest", stated, allowed)
    if (present := digest_content(base)) != stated:
        warnings.warn(
            f"{layer.path}: extends_digest = {stated!r}, but the file that it extends has {present!r} now: it has "
            "changed since, and the numbers here may not fit it. Make the file again, or state the new digest",
            MachineWarning,
            stacklevel=2,
        )


def read_log_table(path: Path) -> dict[str, Any]:
    """The table [log] of a file that holds nothing else. Raises InputError for any other file."""
    content = _read_toml(path)
    table = content.get("log")
    if not isinstance(table, dict) or len(content) > 1:
        raise InputError(path, "tables", listing(content) or None, "the table [log] alone; --machine takes more")
    return table


def log_mapping(table: Mapping[str, Any], source: str | Path) -> LogMapping:
    """The table [log] of this content, checked; errors name `source`."""
    try:
        return LogMapping.model_validate(table)
    except ValidationError as error:
        raise _input_error(error, [Layer(Path(source), {"log": table})], ("log",)) from None


def log_table(own: Mapping[str, Any], stated: Mapping[str, Any]) -> dict[str, Any]:
    """Content of [log] with other stated keys laid over it; a variable that stands alone is still named."""
    return {
        **own,
        **{
            key: merge_tables({"variable": own[key]} if isinstance(own.get(key), str) else own.get(key), entry)
            if isinstance(entry, Mapping)
            else entry
            for key, entry in stated.items()
        },
    }


def merge_tables(base: Any, over: Any) -> Any:
    """Content `over` laid over `base`: tables merge key by key; everything else, arrays included, is replaced.

    A friction law takes away the smoothing and the integrator of another one.
    """
    if isinstance(base, Mapping) and isinstance(over, Mapping):
        kept = _strip_other_law(base, over)
        return {**kept, **{key: merge_tables(kept.get(key), value) for key, value in over.items()}}
    return over


def _strip_other_law(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of `base` that remains where `over` gives another friction law."""
    kept = dict(base)
    before, after = base.get("friction"), over.get("friction")
    if not isinstance(before, Mapping) or not isinstance(after, Mapping):
        return kept
    if after.get("law", law := before.get("law", "sgms")) == law:
        return kept
    kept["friction"] = {key: value for key, value in before.items() if key != "smoothing"}
    sampling = kept.get("sampling")
    if isinstance(sampling, Mapping) and isinstance(integrator := sampling.get("integrator"), Mapping):
        left = {key: value for key, value in integrator.items() if key not in CHOSEN_BY_LAW}
        kept["sampling"] = {**sampling, "integrator": left}
    return kept


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


def _read_layers(path: Path) -> list[Layer]:
    """The file and everything it extends, the most specific first."""
    layers: list[Layer] = []
    while True:
        if any(layer.path.resolve() == path.resolve() for layer in layers):
            raise InputError(layers[-1].path, "extends", path.name, "a file that does not lead back to this one")
        content = _read_toml(path)
        parent = content.pop("extends", None)
        layers.append(Layer(path, content, content.pop("extends_digest", None)))
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


def _look_up(content: Any, keys: Sequence[Key]) -> Any:
    for key in keys:
        try:
            content = content[key]
        except (KeyError, IndexError, TypeError):
            return _MISSING
    return content


def _spell_key(loc: Sequence[Key]) -> str:
    """Dotted key as in the file; array entries count from 1 as everything a user sees does."""
    spelled = ""
    for key in loc:
        spelled += f"[{key + 1}]" if isinstance(key, int) else f".{key}" if spelled else key
    return spelled or "file"


def _fields(table: type[BaseModel] | None) -> dict[Key, FieldInfo]:
    """Fields of a table by their keys in the file."""
    return {field.alias or name: field for name, field in table.model_fields.items()} if table else {}


def _field(model: type[BaseModel], keys: Sequence[Key]) -> tuple[type[BaseModel] | None, str]:
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


def _input_error(error: ValidationError, layers: Sequence[Layer], table: Sequence[Key] = ()) -> InputError:
    """The first violation, unknown keys before others, in the terms of the file that holds it."""
    details = [entry for entry in error.errors() if entry["type"] != "default_factory_not_called"]
    # A misspelt key is unknown and, where it is required, missing too: the first says more.
    detail: ErrorDetails = next((entry for entry in details if entry["type"] == "extra_forbidden"), details[0])
    loc: list[Key] = [*table, *detail["loc"]]
    context = detail.get("ctx", {})
    value: object = detail["input"]
    described = _field(Tables, loc)[1]
    if detail["type"] == "rule":
        loc += [int(key) if key.isdigit() else key for key in _split(context["where"])]
        value, allowed = context["value"], context["allowed"]
    elif detail["type"] == "missing":
        value, allowed = None, f"required key is missing; {described}"
    elif detail["type"] == "extra_forbidden":
        holder = _field(Tables, loc[:-1])[0]
        known = [str(key) for key in _fields(holder)]
        if len(loc) == 1:
            known += ["extends", "extends_digest"]
        close = difflib.get_close_matches(str(loc[-1]), known, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        said = holder.unknown if holder is not None and issubclass(holder, MachineTable) else MachineTable.unknown
        allowed = f"{said}{hint}; allowed: {listing(known)}"
    elif detail["type"] == "model_type" or (detail["type"] == "dict_type"):
        allowed = f"a table; {described}"
    else:
        message = detail["msg"].removeprefix("Input should be ")
        allowed = f"{message}; {described}" if described else message
    return _refusal(layers, loc, value, allowed)


def _refusal(layers: Sequence[Layer], loc: Sequence[Key], value: object, allowed: str) -> InputError:
    holder = next((layer.path for layer in layers if _look_up(layer.content, loc) is not _MISSING), layers[0].path)
    if holder != layers[0].path:
        allowed += f" (in {layers[0].path}, which extends it)"
    return InputError(holder, _spell_key(loc), value, allowed)


def _split(where: str) -> list[str]:
    # A prior or bound of an effect's parameter has a dot inside its key.
    for table in ("prior", "bounds"):
        head, mark, name = where.partition(f"{table}.")
        if mark:
            return [*filter(None, head.split(".")), table, name]
    return where.split(".")
