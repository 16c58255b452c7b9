"""Markdown that the made pages share."""

from __future__ import annotations

import re
from collections.abc import Sequence


def split(address: str, head: str, columns: Sequence[str], entries: Sequence[tuple[str, str, str]]) -> dict[str, str]:
    """Divide a reference into an overview and a page per entry.

    The overview links every page, in a table whose rows are anchors of the entries' names.

    Args:
        address: of the overview, `FOLDER.md`; the pages are `FOLDER/NAME.md`.
        head: title and text of the overview.
        columns: heads of its table's two columns.
        entries: name, page and summary of each.
    """
    folder = address.removesuffix(".md")
    name_of_folder = folder.rpartition("/")[2]
    rows = [[f"[{name}]({name_of_folder}/{name}.md){{#{name}}}", summary] for name, _, summary in entries]
    return {address: f"{head}\n\n{table(columns, rows)}"} | {f"{folder}/{name}.md": text for name, text, _ in entries}


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; `|` within a cell does not end it, and what looks like a tag is text."""
    lines = ["| " + " | ".join(cell(text) for text in row) + " |" for row in rows]
    return "\n".join(["| " + " | ".join(head) + " |", "|---" * len(head) + "|", *lines])


def cell(text: str) -> str:
    """Text within a table."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    return "".join(part if part.startswith("`") else _escape(part) for part in parts)


def _escape(text: str) -> str:
    return text.replace("|", r"\|").replace("<", "&lt;").replace("*", r"\*")
