"""Pages of a package's C interface, from its header and the comments in it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import dedent

from markup import split

HEAD = """# C interface

Made from `generated/{name}/{name}.h`. Every package has the same, with its own machine's name in front; numbers in
the text are those of `{name}`. How a controller calls it is in
[your own axis](../docs/own_axis.md#5-in-the-controller)."""


@dataclass(frozen=True)
class Entry:
    """A comment of the header and what it stands above."""

    comment: str
    declaration: str

    def functions(self, name: str) -> list[str]:
        """Functions that are declared."""
        return re.findall(rf"^\w[\w *]*\b({name}_\w+)\(", self.declaration, flags=re.MULTILINE)


def pages(header: str, name: str) -> dict[str, str]:
    """Markdown of the header of machine `name`: what it says of all, then functions, then types and constants."""
    banner, *entries = _entries(header)
    functions, types = ["# Functions in C"], ["# Types and constants in C"]
    for entry in entries:
        text = _paragraphs(entry.comment, name)
        named = entry.functions(name)
        if named:
            functions += ["## " + ", ".join(named), _code(_prototypes(entry.declaration)), *text]
        else:
            types += [*text, _code(_without_memory(entry.declaration, name))]
    head = [HEAD.format(name=name), *_banner(banner.comment, name)]
    parts = [
        ("functions", "\n\n".join(functions), "every call, from `init` to `estimate`"),
        ("types", "\n\n".join(types), "what they take and give, statuses"),
    ]
    return split("reference/c.md", "\n\n".join(head), ["part", "what it has"], parts)


def _entries(header: str) -> Iterator[Entry]:
    """Paragraphs of the header that declare something; first that of its banner."""
    for paragraph in header.split("\n\n"):
        found = re.match(r"/\* *(.*?) *\*/\n?(.*)", paragraph, flags=re.DOTALL)
        if found:
            yield Entry(re.sub(r"^ \* ?", "", found[1], flags=re.MULTILINE), found[2].strip())
        elif re.match(r"typedef|#define", paragraph):
            yield Entry("", paragraph.strip())


def _banner(comment: str, name: str) -> list[str]:
    """Its paragraphs but the first line, which names digests; tables of it as they stand."""
    return _paragraphs(comment.partition("\n")[2], name)


def _paragraphs(comment: str, name: str) -> list[str]:
    """Paragraphs of a comment as Markdown."""
    parts = [part.rstrip() for part in re.split(r"\n(?: *\n)+", comment.strip("\n")) if part.strip()]
    return [_paragraph(part, name) for part in parts]


def _paragraph(text: str, name: str) -> str:
    if all(line.startswith("  ") for line in text.splitlines()):
        return _block(dedent(text))
    return re.sub(rf"\b((?:{name}|{name.upper()})_\w+(?:\([^()]*\))?)", r"`\1`", text)


def _prototypes(declaration: str) -> str:
    """Functions with a body lose it."""
    return re.sub(r"\n\{\n.*?\n\}", ";", declaration, flags=re.DOTALL)


def _without_memory(declaration: str, name: str) -> str:
    """The axis's memory is not for the application."""
    whole = re.compile(rf"typedef struct \{{(?:(?!typedef).)*\n\}} {name}_t;", re.DOTALL)
    return whole.sub(f"typedef struct {{ /* ... */ }} {name}_t;", declaration)


def _code(text: str) -> str:
    return f"```c\n{text}\n```"


def _block(text: str) -> str:
    return f"```text\n{text}\n```"
