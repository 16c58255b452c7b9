"""Tables of results: the same numbers to read and to compute with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class CsvTable:
    """Rows of named values under a title.

    Attributes:
        title: one line.
        formats: format specification of each column, in the order of the columns; "" for text.
        rows: one mapping per row; a column a row lacks stays empty.
        notes: lines below it.
    """

    title: str
    formats: Mapping[str, str]
    rows: Sequence[Mapping[str, Any]]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        lines = [list(self.formats), *([self._cell(row, name) for name in self.formats] for row in self.rows)]
        body = align_columns(lines, [spec == "" for spec in self.formats.values()])
        return "\n".join([self.title, *(f"  {line}" for line in body), *(f"  {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, Any]:
        """The same as plain data."""
        return {"title": self.title, "rows": [dict(row) for row in self.rows], "notes": list(self.notes)}

    def _cell(self, row: Mapping[str, Any], name: str) -> str:
        value = row.get(name)
        return "" if value is None else format(value, self.formats[name])


def align_columns(lines: Sequence[Sequence[str]], is_text: Sequence[bool]) -> list[str]:
    """Lines of cells below each other: columns of text to the left, others to the right."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    kinds = list(zip(widths, is_text, strict=True))
    return [
        "  ".join(
            cell.ljust(width) if text else cell.rjust(width) for cell, (width, text) in zip(line, kinds, strict=True)
        ).rstrip()
        for line in lines
    ]
