"""Mutants of emitted C: one operator or number of a function changed, drawn at random."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
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
        """Line of it, and what has become of what."""
        return f"{self.code}: {self.old.strip()} -> {self.new.strip()}"

    def spoil(self, package: Package) -> Mapping[str, str]:
        """Return the package's files with it."""
        text = package.files[self.file]
        return {**package.files, self.file: text[: self.at] + self.new + text[self.at + len(self.old) :]}


def draw_mutants(package: Package, count: int, seed: int) -> list[Mutant]:
    """Draw mutants of the functions of a package; every place is as likely, comments and declarations aside."""
    random = np.random.default_rng(seed)
    places = [
        place for file in sorted(package.files) if _is_mutated(file) for place in _places(file, package.files[file])
    ]
    chosen = random.choice(len(places), size=min(count, len(places)), replace=False)
    return [_mutant(places[k], package, random) for k in chosen]


def _is_mutated(file: str) -> bool:
    return file.endswith((".c", ".h")) and "_selftest" not in file


def _places(file: str, text: str) -> Iterator[tuple[str, int, str, str]]:
    code = re.sub(r'/\*.*?\*/|^#.*?$|"[^"\n]*"', lambda m: " " * len(m[0]), text, flags=re.DOTALL | re.MULTILINE)
    for body in _FUNCTION.finditer(code):
        for place in _PLACE.finditer(code, body.start("body"), body.end("body")):
            yield file, place.start(), place[0], body["name"]


def _mutant(place: tuple[str, int, str, str], package: Package, random: np.random.Generator) -> Mutant:
    file, at, old, function = place
    text, name = package.files[file], package.machine.name
    if old in _OPERATORS:
        new = str(random.choice(_OPERATORS[old]))
    elif "." in old:
        end = "f" if old.endswith("f") else ""
        new = str(random.choice([f"({old} * 1.5{end})", f"0.0{end}" if float(old.rstrip("f")) else f"1.0{end}"]))
    else:
        new = str(1 - int(old))
    line = text[text.rfind("\n", 0, at) + 1 : text.find("\n", at)].strip()
    number = text.count("\n", 0, at) + 1
    return Mutant(file, number, at, common_code(function, name), common_code(line, name), old, new)
