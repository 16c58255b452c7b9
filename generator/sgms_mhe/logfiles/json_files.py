"""JSON: a line or an element for each sample, or an array for each signal; its samples as rows of a text."""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from sgms_mhe.logfiles.dialect import Dialect, lines_of
from sgms_mhe.logfiles.key_rows import Header
from sgms_mhe.support.errors import InputError

SUFFIXES: Final = (".json", ".jsonl", ".ndjson")
"""Suffixes of JSON, and of lines of it."""

RUN: Final = {"entries", "mass", "length", "kp", "vin"}
"""Members of a run of a servo with a weight on its arm, as better-actuator-models records it."""
RUN_UNITS: Final = {"timestamp": "s", "position": "rad", "goal_position": "rad"}
"""Of its entries, which state none."""

_ALLOWED: Final = "lines or a list of objects, one a sample, or an object with an array for each signal"


def find_samples(path: Path, text: str) -> Dialect:
    """Lay out samples as rows whose values tabs separate; members of objects and lists have a path, `a.b[0]`.

    Raises InputError for other text, and for JSON without samples.
    """
    try:
        samples, run = _samples(path, text)
        units = RUN_UNITS if run else {}
        flat = [(line, dict(_flatten("", sample))) for line, sample in samples]
    except RecursionError:
        raise InputError(path, "file", "objects within objects", _ALLOWED) from None
    names = tuple(dict.fromkeys(name for _, fields in flat for name in fields))
    if not names:
        raise InputError(path, "file", "no samples", _ALLOWED)
    rows = tuple((line, "\t".join(fields.get(name, "") for name in names)) for line, fields in flat)
    return Dialect("\t", ".", Header(0, names, tuple(units.get(name, "") for name in names)), rows, 0, (), 0, run=run)


def _samples(path: Path, text: str) -> tuple[list[tuple[int, Any]], Mapping[str, float]]:
    """(line, sample), the line 0 where samples are no lines; and the keys stated by a run."""
    try:
        whole = json.loads(text)
    except json.JSONDecodeError as error:
        if not error.msg.startswith("Extra data"):
            raise InputError(path, f"line {error.lineno}", error.msg, f"JSON: {_ALLOWED}") from None
    else:
        is_run = isinstance(whole, dict) and whole.keys() >= RUN
        return [(0, sample) for sample in _find(whole) or []], _describe_run(path, whole) if is_run else {}
    found = []
    for number, line in enumerate(lines_of(text), start=1):
        if line.strip():
            try:
                found.append((number, json.loads(line)))
            except json.JSONDecodeError as error:
                raise InputError(path, f"line {number}", error.msg, "an object of JSON in each line") from None
    return found, {}


def _describe_run(path: Path, whole: Mapping[str, Any]) -> Mapping[str, float]:
    """Return the numbers a run states of itself, as `Log.run` has them."""
    for key in RUN - {"entries"}:
        if type(whole[key]) not in (int, float) or not 0.0 <= whole[key] < math.inf:
            raise InputError(path, key, whole[key], "a number, 0 or more, of a run with a weight on an arm")
    names = {"mass": "mass", "length": "length", "kp": "gain", "vin": "supply"}
    return {name: float(whole[key]) for key, name in names.items()}


def _find(content: Any) -> list[Any] | None:
    """The samples: a list of objects, or arrays of one length, here or in the member that has most of them."""
    if isinstance(content, list):
        return content if content and all(isinstance(sample, dict) for sample in content) else None
    if not isinstance(content, dict):
        return None
    # A DataFrame of pandas writes each column as an object whose keys are rows.
    signals = {
        name: list(values.values()) if isinstance(values, dict) and all(map(str.isdigit, values)) else values
        for name, values in content.items()
    }
    signals = {
        name: values
        for name, values in signals.items()
        if isinstance(values, list) and values and not isinstance(values[0], dict)
    }
    if len(signals) > 1 and len(set(map(len, signals.values()))) == 1:
        return [dict(zip(signals, sample, strict=True)) for sample in zip(*signals.values(), strict=True)]
    members = [found for value in content.values() if (found := _find(value)) is not None]
    return max(members, key=len, default=None)


def _flatten(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Each value of a sample by its path, as a field of a text."""
    if isinstance(value, Mapping):
        for key, member in value.items():
            yield from _flatten(f"{name}.{key}" if name else str(key), member)
    elif isinstance(value, list):
        for k, member in enumerate(value):
            yield from _flatten(f"{name}[{k}]" if len(value) > 1 else name, member)
    elif value is None:
        yield name, ""
    else:
        yield name, " ".join(str(int(value) if isinstance(value, bool) else value).replace('"', "'").split())
