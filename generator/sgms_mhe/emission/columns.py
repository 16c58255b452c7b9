"""Lines of emitted C within a width: comments are filled anew, statements break where a reader expects it.

A template cannot know how long a line gets: names of machines and parameters stand in it. A line that fits stays as it
is.
"""

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

COLUMNS: Final = 100
INDENT: Final = 4

_TRAILING: Final = re.compile(r"^(?P<indent> *)(?P<code>\S.*?) *(?P<comment>/\*(?:(?!\*/).)*\*/)$")
_TABLE: Final = re.compile(r"^[ -]|\S {2,}\S")
"""The start of an item or a row, or the gap between two columns."""
_NUMBERS: Final = re.compile(r"^[-+\d.,efxu{}; ]+$")
_PIECE: Final = re.compile(
    r"""(?P<literal>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*'|/\*.*?\*/)
    | (?P<open>[(\[{]) | (?P<close>[)\]}])
    | (?P<after>[,;][ ]|[ ]=[ ]|[ ](?:&&|\|\||[-+*/%&|<>]|<=|>=|==|!=)[ ])
    | (?P<before>[ ](?=[?:][ ]))""",
    re.VERBOSE,
)
_LAST: Final = "\0*/"
"""The end of a comment, which stays on the line of its last word."""

_BINDING: Final = (", ;", "=", "?", "||", "&&", "|", "&", "== != < > <= >=", "+ -", "* / %")
"""Punctuation and operators behind which a line may end, the loosest first; a question mark and its colon begin one."""


class _Break(NamedTuple):
    """A place where a line may end.

    Attributes:
        at: position of the next line's first character.
        level: brackets around it, and the binding strength of the operator there.
        opens: an assignment, or the bracket of a call.
    """

    at: int
    level: tuple[int, int]
    opens: bool


def wrap_columns(text: str) -> str:
    """Return C with no line longer than COLUMNS, but where a single word is."""
    return "".join(f"{line}\n" for line in _lines(text.splitlines()))


def _lines(lines: list[str]) -> Iterator[str]:
    place, before = 0, ""
    while place < len(lines):
        end = place + 1
        if lines[place].lstrip().startswith("/*"):
            while "*/" not in lines[end - 1]:
                end += 1
        block = lines[place:end]
        place = end
        if all(len(line) <= COLUMNS for line in block):
            yield from block
        elif block[0].lstrip().startswith("/*") and block[-1].endswith("*/"):
            yield from _comment(block)
        else:
            for line in block:
                yield from _code(line, before)
        before = block[-1]


# --- comments --------------------------------------------------------------------------------------------------------


def _comment(block: list[str]) -> Iterator[str]:
    """Yield a comment, its paragraphs with a line too long filled anew; tables keep their columns."""
    indent = " " * (len(block[0]) - len(block[0].lstrip()))
    closes_alone = block[-1].strip() == "*/"
    texts = [re.sub(r"^\s*(?:/\*| \*(?!/)|\*(?!/)) ?", "", line) for line in block]
    texts[-1] = texts[-1].strip().removesuffix("*/").rstrip() + ("" if closes_alone else _LAST)
    if closes_alone:
        del texts[-1]
    width = COLUMNS - len(indent) - 3
    filled = [line for part in _parts(texts) for line in _fill(part, width)]
    for k, text in enumerate(filled):
        start = "/*" if k == 0 else " *"
        yield (indent + start + (f" {text}" if text else "")).replace(_LAST, " */")
    if closes_alone:
        yield f"{indent} */"


def _parts(texts: list[str]) -> Iterator[list[str]]:
    """Paragraphs, items of lists and rows of tables: lines that may be filled together."""
    part: list[str] = []
    for text in texts:
        hanging = _hanging(part[0]) if part else ""
        rest = text.removeprefix(hanging)
        if part and part[0] and rest and text.startswith(hanging) and not _TABLE.search(rest):
            part.append(text)
        else:
            yield part
            part = [text]
    yield part


def _hanging(text: str) -> str:
    """Return the blanks below the start of an item or of a row's last column; none below a paragraph."""
    gaps = [gap.end() for gap in re.finditer(r"^[ -]+|(?<=\S) {2,}(?=\S)", text)]
    return " " * (gaps[-1] if gaps else 0)


def _fill(part: list[str], width: int) -> list[str]:
    """Lines of a width; those that fit stay as they are."""
    if all(len(line) <= width for line in part):
        return part
    hanging = _hanging(part[0])
    start = len(hanging)
    filled = [part[0][:start]]
    for word in " ".join([part[0][start:], *(line[start:] for line in part[1:])]).split(" "):
        if len(filled[-1]) == start:
            filled[-1] += word
        elif len(filled[-1]) + 1 + len(word) <= width:
            filled[-1] += f" {word}"
        else:
            filled.append(hanging + word)
    return filled


# --- statements ------------------------------------------------------------------------------------------------------


def _code(line: str, before: str = "") -> Iterator[str]:
    """Yield a line of code in lines that fit; a comment behind it stands before it then.

    Args:
        line: of code.
        before: the line above it: where that ends within a list, this one goes on at its own indentation.
    """
    if len(line) <= COLUMNS:
        yield line
        return
    trailing = _TRAILING.match(line)
    if trailing:
        comment = trailing["indent"] + trailing["comment"]
        yield from _comment([comment]) if len(comment) > COLUMNS else [comment]
        yield from _code(trailing["indent"] + trailing["code"], before)
        return
    indent = len(line) - len(line.lstrip())
    is_macro = line.startswith("#")
    goes_on = before.endswith(("(", ",")) or _NUMBERS.match(line) is not None
    deeper = indent if goes_on else indent + INDENT
    limit = COLUMNS - 2 * is_macro
    while len(line) > limit:
        at = _break_of(line, limit, deeper)
        if at is None:
            break
        head = line[:at].rstrip()
        yield f"{head} \\" if is_macro else head
        line = " " * deeper + line[at:].lstrip()
    yield line


def _break_of(line: str, limit: int, deeper: int) -> int | None:
    """Return the position to break a line at; None where it has none.

    Behind an assignment or the bracket of a call, where nothing outside of them can be broken and the rest then fits;
    else in its second half in the fewest brackets, at the weakest operator, as late as possible. Before the name of a
    function where there is no such place.
    """
    breaks = [b for b in _breaks(line) if deeper < b.at <= limit]
    if not breaks:
        function = re.match(r"(?:\w+ )+\*?(?=\w+\()", line)
        return function.end() if function and deeper < function.end() <= limit else None
    for b in breaks:
        is_outermost = all(b.level < other.level for other in breaks if not other.opens)
        if b.opens and is_outermost and deeper + len(line[b.at :].lstrip()) <= limit:
            return b.at
    late = [b for b in breaks if not b.opens and b.at >= limit // 2]
    chosen = min(late or breaks, key=lambda b: (b.level, -b.at), default=None)
    return None if chosen is None else chosen.at


def _breaks(line: str) -> Iterator[_Break]:
    """Places where a line may end, from left to right."""
    depth = 0
    start = re.match(r" *return (?=\S)", line)
    if start is not None:
        yield _Break(start.end(), (0, _BINDING.index("=")), True)
    for piece in _PIECE.finditer(line):
        if piece["open"]:
            depth += 1
            if line[piece.start() - 1].isidentifier():
                yield _Break(piece.end(), (depth - 1, len(_BINDING)), True)
        elif piece["close"]:
            depth -= 1
        elif piece["after"]:
            operator = piece["after"].strip()
            yield _Break(piece.end(), (depth, _binding(operator)), operator == "=")
        elif piece["before"]:
            yield _Break(piece.start(), (depth, _binding("?")), False)


def _binding(operator: str) -> int:
    return next(k for k, level in enumerate(_BINDING) if operator in level.split())
