"""Pages of the Python interface, from its signatures and docstrings."""

from __future__ import annotations

import inspect
import re
from typing import Any

import sgms_mhe
from markup import cell, split, table

HEAD = """# Python interface

One page per name of `import sgms_mhe`, made from its docstring; `help(sgms_mhe.estimate)` says the same.
[Use it from Python](../docs/python.md) has examples."""


def pages() -> dict[str, str]:
    """Return the Markdown of an overview and of every public name, by address: functions, results, errors."""
    members = {name: getattr(sgms_mhe, name) for name in sgms_mhe.__all__}
    ordered = sorted(members, key=lambda name: (isinstance(members[name], type), _is_error(members[name])))
    rows = []
    for name in ordered:
        member = members[name]
        text = _class(name, member) if isinstance(member, type) else _function(name, member)
        rows.append((name, text, (inspect.getdoc(member) or "").partition("\n\n")[0]))
    return split("reference/python.md", HEAD, ["name", "summary"], rows)


def _is_error(member: Any) -> bool:
    return isinstance(member, type) and issubclass(member, Exception)


def _function(name: str, function: Any) -> str:
    return "\n\n".join([f"# {name}", _signature(name, function), _sections(inspect.getdoc(function) or "")])


def _class(name: str, kind: type) -> str:
    parts = [f"# {name}", _sections(inspect.getdoc(kind) or "")]
    rows = []
    for method, member in vars(kind).items():
        inner = member.fget if isinstance(member, property) else member
        if not method.startswith("_") and inspect.isfunction(inner):
            called = method if isinstance(member, property) else f"{method}()"
            rows.append([f"`{called}`", (inspect.getdoc(inner) or "").partition("\n\n")[0]])
    return "\n\n".join([*parts, table(["member", "meaning"], rows)] if rows else parts)


def _signature(name: str, function: Any) -> str:
    lines, starred = [], False
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not starred:
            lines, starred = [*lines, "    *,"], True
        given = "" if parameter.default is parameter.empty else f" = {parameter.default!r}"
        kind = re.sub(r"^Annotated\[(.*), Option\(.*\)\]$", r"\1", _text(parameter.annotation))  # the command line's
        lines.append(f"    {parameter.name}: {kind}{given},")
    returned = inspect.signature(function).return_annotation
    return "```python\n" + "\n".join([f"{name}(", *lines, f") -> {_text(returned)}"]) + "\n```"


def _text(annotation: Any) -> str:
    """An annotation as it is written, without the modules of its names."""
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    return re.sub(r"\b(?:[a-z_]\w*\.)+(?=[A-Za-z])", "", text)


def _sections(text: str) -> str:
    """A docstring's paragraphs; each of its sections (Args, Attributes, Raises) as a table."""
    parts = []
    for block in re.split(r"\n\n", text):
        head, _, rest = block.partition("\n")
        if head in ("Args:", "Attributes:", "Raises:"):
            entries = re.findall(r"^    (\S[^:\n]*):((?:.|\n(?!    \S))*)", rest, flags=re.MULTILINE)
            title = {"Args:": "argument", "Attributes:": "attribute", "Raises:": "raises"}[head]
            parts.append(table([title, "meaning"], [[f"`{name}`", " ".join(said.split())] for name, said in entries]))
        elif head == "Returns:":
            parts.append(f"Returns: {cell(rest)}")
        else:
            parts.append(cell(block))
    return "\n\n".join(parts)
