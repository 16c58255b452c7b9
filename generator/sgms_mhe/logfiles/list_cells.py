"""Cells of a text that hold a list, as tables of messages have them: a column for each of its elements."""

import re
from typing import Final

from sgms_mhe.logfiles.decimals import is_missing, is_number
from sgms_mhe.logfiles.dialect import lines_of

_LIST: Final = re.compile(r"""(["]?)(?:array\('\w+',\s?)?[\[(]([^\[\]()"]*)[\])]\)?\1""")
_ELEMENT: Final = re.compile(r"[^\s,;]+")
_BEGINNING: Final = 100_000
"""Characters in which the first row with lists is looked for."""


def spread_lists(text: str) -> str:
    """Give each element of a list a field of its own, `name[0]`, `name[1]`, ..., in header and rows.

    A text whose first rows hold no lists of several numbers, below a header with as many fields, is left as it is.
    """
    lines = lines_of(text[:_BEGINNING])
    number = next((k for k, line in enumerate(lines) if any(len(_elements(m)) > 1 for m in _LIST.finditer(line))), 0)
    if number == 0:
        return text
    marks = {
        lines[number][i : i + 1] for m in _LIST.finditer(lines[number]) for i in (m.start() - 1, m.end()) if i >= 0
    }
    separators = marks - {""}
    header = _spread_header(lines[number - 1], lines[number], separators.pop()) if len(separators) == 1 else None
    if header is None:
        return text
    names, separator = header
    lines = lines_of(text)
    rows = [_LIST.sub(lambda m: separator.join(_elements(m)) or m[0], line) for line in lines[number:]]
    return "\n".join([*lines[: number - 1], names, *rows])


def _elements(found: re.Match[str]) -> list[str]:
    """The numbers of a list, of one where spaces are groups of its digits; none where it holds something else."""
    elements: list[str] = [found[2]] if is_number(found[2].strip()) else _ELEMENT.findall(found[2])
    return elements if all(is_number(element) or is_missing(element) for element in elements) else []


def _spread_header(header: str, first: str, separator: str) -> tuple[str, str] | None:
    """(header with a name for each element, separator); None where it is none, or the first row has other fields."""
    counts = [len(_elements(m)) for m in _LIST.finditer(first)]
    cells, names = _LIST.sub("[]", first).split(separator), header.split(separator)
    if len(cells) != len(names) or cells.count("[]") != len(counts) or any(is_number(name.strip()) for name in names):
        return None
    lists, spread = iter(counts), []
    for name, cell in zip(names, cells, strict=True):
        count = next(lists) if cell == "[]" else 1
        bare = name.strip().strip('"')
        spread += [f"{bare}[{k}]" for k in range(count)] if count > 1 else [name]
    return separator.join(spread), separator
