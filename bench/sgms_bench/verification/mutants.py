"""Mutants of emitted C, drawn at random: an operator or number of a function changed, or one of its statements."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from sgms_bench.verification.coverage import common_code
from sgms_mhe.emission.package import Package

_OPERATORS: Final = {
    " + ": (" - ",), " - ": (" + ",), " * ": (" / ",), " / ": (" * ",),
    " < ": (" <= ", " >= "), " > ": (" >= ", " <= "),
    " <= ": (" < ",), " >= ": (" > ",), " == ": (" != ",), " != ": (" == ",), " && ": (" || ",), " || ": (" && ",),
    " += ": (" -= ", " = "), " -= ": (" += ",), "++": ("--",), " ? ": (" == 0 ? ",),
}  # fmt: skip
_PLACE: Final = re.compile(
    "|".join(re.escape(old) for old in sorted(_OPERATORS, key=len, reverse=True))
    + r"|\b\d+\.\d+(?:e-?\d+)?f?\b|\b[01]\b"
)

_FUNCTION: Final = re.compile(
    r"^[^\s{}#][^{};]*?\b(?P<name>\w+)\([^{};]*\)\n\{\n(?P<body>.*?)^\}", re.DOTALL | re.MULTILINE
)

_STATEMENT: Final = re.compile(
    r"(?<=[;{}\n])\s*^(?P<indent> +)(?!(?:return|if|for|while|else|do|break|const|static)\b|[\w.]+ \**\w)"
    r"(?P<code>[\w*(][^;{}]*;)",
    re.MULTILINE,
)
"""Assignment or call, on lines of its own."""
_CONDITION: Final = re.compile(r"\bif (\((?:[^()]|\((?:[^()]|\((?:[^()]|\((?:[^()]|\([^()]*\))*\))*\))*\))*\)) \{")
_FIELD: Final = re.compile(r"\b(?P<self>self->)?(?P<group>[a-z]\w*)(?:\[[^\]]*\])?(?:->|\.)(?P<field>[a-z]\w*)\b")
_GROUP: Final = re.compile(r"\bself->(\w+)\.")
_STRUCTURE: Final = re.compile(r"\bstruct \{([^{}]*)\} (\w+);")
_DECLARED: Final = re.compile(r"^\s*(?:volatile |const )*(\w+) ([^;()]+);", re.MULTILINE)
_DECLARATOR: Final = re.compile(r"(\**)(\w+)((?:\[[^\]]*\])*)(?:, |$)")

STATEMENT_KINDS: Final = ("dropped", "forced", "sibling", "stale", "swapped")
"""A statement left out; a condition that always or never holds; a field beside the one that is meant; the field of that
name elsewhere; two statements in the other order."""


@dataclass(frozen=True)
class Mutant:
    """One operator or number of a file changed.

    Attributes:
        file: name. line: number of the line. at: offset in the file.
        function: in which; the machine's name in it is NAME.
        code: text of the line, likewise.
        old, new: text there.
    """

    file: str
    line: int
    at: int
    function: str
    code: str
    old: str
    new: str

    def __str__(self) -> str:
        """Return the place, and what has become of what."""
        return f"{self.file}:{self.line}: {self.function}: {self.change}"

    @property
    def change(self) -> str:
        """Line of it, and what has become of what, in one line."""
        return f"{self.code}: {' '.join(self.old.split())} -> {' '.join(self.new.split())}"

    def spoil(self, package: Package) -> Mapping[str, str]:
        """Return the package's files with it."""
        text = package.files[self.file]
        return {**package.files, self.file: text[: self.at] + self.new + text[self.at + len(self.old) :]}


def draw_mutants(package: Package, count: int, seed: int) -> list[Mutant]:
    """Draw mutants of the functions of a package; every place is as likely, comments and declarations aside."""
    random = np.random.default_rng(seed)
    places = [place for file in _mutated(package) for place in _places(file, package.files[file])]
    chosen = random.choice(len(places), size=min(count, len(places)), replace=False)
    return [_mutant(places[k], package, random) for k in chosen]


def draw_statements(package: Package, count: int, seed: int) -> list[Mutant]:
    """Draw mutants of statements, as many of each kind: dropped, forced, sibling, stale, swapped."""
    random = np.random.default_rng(seed)
    structures = structures_of(package)
    kinds: dict[str, list[Mutant]] = {kind: [] for kind in STATEMENT_KINDS}
    for file in _mutated(package):
        code = _code_of(package.files[file])
        for body in _FUNCTION.finditer(code):
            for kind, at, end, new in _changes(code, body.span("body"), structures):
                place = file, at, package.files[file][at:end], body["name"]
                kinds[kind].append(_mutant_at(place, package, new))
    drawn = []
    for k, mutants in enumerate(kinds.values()):
        wanted = min(len(mutants), count // len(kinds) + (k < count % len(kinds)))
        drawn += [mutants[i] for i in random.choice(len(mutants), size=wanted, replace=False)]
    return drawn


def _mutated(package: Package) -> list[str]:
    return [file for file in sorted(package.files) if file.endswith((".c", ".h")) and "_selftest" not in file]


def _code_of(text: str) -> str:
    """Text of the same length without comments, directives and strings."""
    blanks = re.compile(r'/\*.*?\*/|^#.*?$|"[^"\n]*"', re.DOTALL | re.MULTILINE)
    return blanks.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)


def _places(file: str, text: str) -> Iterator[tuple[str, int, str, str]]:
    code = _code_of(text)
    for body in _FUNCTION.finditer(code):
        for place in _PLACE.finditer(code, body.start("body"), body.end("body")):
            yield file, place.start(), place[0], body["name"]


def structures_of(package: Package) -> dict[str, dict[str, str]]:
    """Types of the fields of each structure, by its name and by that of a group of an axis's memory."""
    structures: dict[str, dict[str, str]] = {}
    for file in _mutated(package):
        code = _code_of(package.files[file])
        for body, name in _STRUCTURE.findall(code):
            for kind, names in _DECLARED.findall(body):
                for stars, field, size in _DECLARATOR.findall(names):
                    structures.setdefault(name, {})[field] = f"{kind} {stars}{size}"
        for kind, name in re.findall(r"^    (\w+) (\w+);", code, re.MULTILINE):
            if kind in structures:
                structures.setdefault(name, structures[kind])
    return structures


def _changes(
    code: str, span: tuple[int, int], structures: Mapping[str, Mapping[str, str]]
) -> Iterator[tuple[str, int, int, str]]:
    """Kind of each change of a function's body; what comes from where to where."""
    statements = list(_STATEMENT.finditer(code, *span))
    for found in statements:
        yield "dropped", *found.span("code"), ";"
    for one, two in pairwise(statements):
        between = code[one.end() : two.start("code")]
        if not between.strip() and one["indent"] == two["indent"] and _depend(one["code"], two["code"]):
            yield "swapped", one.start("code"), two.end("code"), two["code"] + between + one["code"]
    for found in _CONDITION.finditer(code, *span):
        for value in ("(1)", "(0)"):
            yield "forced", *found.span(1), value
    for found in _FIELD.finditer(code, *span):
        of = structures.get(found["group"], {})
        for other in sorted(other for other in of if other != found["field"] and of[other] == of.get(found["field"])):
            yield "sibling", *found.span("field"), other
        for group in sorted(set(_GROUP.findall(code)) - {found["group"]}) if found["self"] else ():
            if found["field"] in of and structures.get(group, {}).get(found["field"]) == of[found["field"]]:
                yield "stale", *found.span("group"), group


def _depend(one: str, two: str) -> bool:
    """Return True if it may matter which of two statements comes first."""
    targets = [re.match(r"(?P<written>[\w\->.\[\]*() +]+?) (?P<by>\S?)= ", statement) for statement in (one, two)]
    if targets[0] and targets[1] and targets[0]["written"] == targets[1]["written"]:
        terms = [re.match(r"(\w+) = (\w+\(\1, )", statement) for statement in (one, two)]  # sums by a call
        is_one_sum = terms[0] and terms[1] and terms[0][0] == terms[1][0]
        return not (targets[0]["by"] == targets[1]["by"] != "" or "&&" in one or is_one_sum)
    for target, own, other in zip(targets, (one, two), (two, one), strict=True):
        words = re.findall(r"[a-z]\w*(?:(?:->|\.)\w+)+", own)
        written = [target["written"]] if target else words[: 1 if own.startswith(("copy(", "fill(")) else None]
        if any(re.search(rf"(?<!\w){re.escape(word)}(?!\w)", other) for word in written):
            return True
    return False


def _mutant(place: tuple[str, int, str, str], package: Package, random: np.random.Generator) -> Mutant:
    old = place[2]
    if old in _OPERATORS:
        new = str(random.choice(_OPERATORS[old]))
    elif "." in old:
        end = "f" if old.endswith("f") else ""
        new = str(random.choice([f"({old} * 1.5{end})", f"0.0{end}" if float(old.rstrip("f")) else f"1.0{end}"]))
    else:
        new = str(1 - int(old))
    return _mutant_at(place, package, new)


def _mutant_at(place: tuple[str, int, str, str], package: Package, new: str) -> Mutant:
    file, at, old, function = place
    text, name = package.files[file], package.machine.name
    line = text[text.rfind("\n", 0, at) + 1 : text.find("\n", at)].strip()
    number = text.count("\n", 0, at) + 1
    return Mutant(file, number, at, common_code(function, name), common_code(line, name), old, new)
