"""Faults in emitted C, by hand and at random: how many the package's self-test notices."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final

import numpy as np

from sgms_bench import C_DIR
from sgms_bench.verification.faults import FAULTS
from sgms_bench.verification.outcome import AbsentError, CheckOutcome, Run, definitions, require, run
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import Package, emit_package

Progress = Callable[[str], None]

BY_HAND_NOTICED: Final = 0.95
AT_RANDOM_NOTICED: Final = 0.8
SECONDS: Final = 20.0
"""Of one run: one that does not come back is noticed by a watchdog."""
FLAGS: Final = ("-std=c99", "-O1", "-ffp-contract=off", "-w")


def check_self_test(mutants: int, seed: int, progress: Progress) -> list[CheckOutcome]:
    """Check that the self-test of `etel_xy` notices the faults by hand, and most mutants.

    Args:
        mutants: how many at random.
        seed: of them.
        progress: called after every tenth fault.
    """
    titles = "self-test: faults by hand", "self-test: mutants at random"
    try:
        require("gcc")
    except AbsentError as absent:
        return [CheckOutcome(title, "", skipped=str(absent)) for title in titles]
    package = emit_package(load_machine("etel_xy"))
    by_hand = [(fault.what, fault.spoil(dict(package.files), "etel_xy")) for fault in FAULTS]
    drawn = [(f"{mutant}", mutant.spoil(package)) for mutant in draw_mutants(package, mutants, seed)]
    with tempfile.TemporaryDirectory() as scratch:
        campaign = Campaign(package, Path(scratch))

        def outcome(title: str, faults: Sequence[tuple[str, Mapping[str, str]]], wanted: float) -> CheckOutcome:
            verdicts = []
            for k, (what, files) in enumerate(faults, 1):
                verdicts.append((what, campaign.judge(files)))
                if k % 10 == 0:
                    progress(f"{title}: {k}")
            return judge_campaign(title, verdicts, wanted)

        return [outcome(titles[0], by_hand, BY_HAND_NOTICED), outcome(titles[1], drawn, AT_RANDOM_NOTICED)]


class Verdict(Enum):
    """Outcome of a fault in a package: what notices it."""

    NOTICED = "by the self-test"
    MISSED = "the exercise of all calls returns other numbers; the self-test does not fail"
    UNCHANGED = "no number that the exercise returns is another one: equivalent, or beyond what it does"
    SAME = "compiled to the same bytes, or not at all"


def judge_campaign(title: str, verdicts: Sequence[tuple[str, Verdict]], wanted: float) -> CheckOutcome:
    """Outcome of a campaign: it fails where less than the wanted share is noticed; then every survivor is named.

    The share is of faults that self-test or exercise see; those that neither sees are counted beside it, as they may be
    equivalent and may not.

    Args:
        title: of the check.
        verdicts: of each fault.
        wanted: share to be noticed.
    """
    count = Counter(verdict for _, verdict in verdicts)
    survivors = tuple(what for what, verdict in verdicts if verdict is Verdict.MISSED)
    seen = count[Verdict.NOTICED] + len(survivors)
    tried = (
        f"{seen} faults, {count[Verdict.NOTICED]} noticed; {count[Verdict.UNCHANGED]} change no number of the "
        f"exercise, {count[Verdict.SAME]} no byte"
    )
    return CheckOutcome(title, tried, survivors if len(survivors) > (1.0 - wanted) * seen else ())


class Campaign:
    """Programs of the self-test of one package, whose other files may have a fault.

    Args:
        package: with its self-test.
        folder: for what is compiled.
    """

    def __init__(self, package: Package, folder: Path) -> None:
        self._name, self._folder = package.machine.name, folder
        self._good = folder / "good"
        good = self._object(self._good, package.files)
        if good is None:
            raise ValueError("the package does not compile")
        self._right = good.read_bytes()
        self._definitions = definitions(package)
        self._digest = self._exercise(self._good, good)
        self._main = folder / "main.c"
        name = self._name
        self._main.write_text(f'#include "{name}.h"\nint main(void)\n{{\n    return {name}_selftest() != 0;\n}}\n')

    def judge(self, files: Mapping[str, str]) -> Verdict:
        """Return what self-test and exercise say of other files."""
        with tempfile.TemporaryDirectory(dir=self._folder) as scratch:
            bad = Path(scratch) / "bad"
            spoilt = self._object(bad, files)
            if spoilt is None or spoilt.read_bytes() == self._right:
                return Verdict.SAME
            program, test = bad / "program", bad / f"{self._name}_selftest.c"
            made = run(["gcc", *FLAGS, f"-I{bad}", self._main, test, spoilt, "-o", program])
            if made.code != 0:
                return Verdict.SAME
            if run([program], seconds=SECONDS).code != 0:
                return Verdict.NOTICED
            return Verdict.UNCHANGED if self._exercise(bad, spoilt) == self._digest else Verdict.MISSED

    def _exercise(self, folder: Path, compiled: Path) -> Run:
        """Outcome of the exercise of all calls: a digest of the bits of what they return."""
        program = folder / "exercise"
        options = [*FLAGS, *self._definitions, f"-I{folder}"]
        made = run(["gcc", *options, C_DIR / "exercise.c", compiled, "-o", program])
        return run([program], seconds=SECONDS) if made.code == 0 else made

    def _object(self, folder: Path, texts: Mapping[str, str]) -> Path | None:
        """The estimator's object below a folder; None where it does not compile."""
        folder.mkdir()
        for file, text in texts.items():
            if file.endswith((".c", ".h")):
                (folder / file).write_text(text)
        made = run(["gcc", *FLAGS, "-c", f"{self._name}.c", "-o", "package.o"], folder=folder)
        return folder / "package.o" if made.code == 0 else None


# --- mutants at random -----------------------------------------------------------------------------------------------

_OPERATORS: Final = {
    " + ": (" - ",), " - ": (" + ",), " * ": (" / ",), " / ": (" * ",),
    " < ": (" <= ", " >= "), " > ": (" >= ", " <= "),
    " <= ": (" < ",), " >= ": (" > ",), " == ": (" != ",), " != ": (" == ",), " && ": (" || ",), " || ": (" && ",),
    " += ": (" -= ", " = "), " -= ": (" += ",), "++": ("--",), " ? ": (" == 0 ? ",),
}  # fmt: skip
_PLACE: Final = re.compile(
    "|".join(re.escape(old) for old in sorted(_OPERATORS, key=len, reverse=True)) + r"|\b\d+\.\d+\b|\b[01]\b"
)


@dataclass(frozen=True)
class Mutant:
    """One operator or number of a file changed.

    Attributes:
        file: name. line: number of the line. at: offset in the file.
        old, new: text there.
    """

    file: str
    line: int
    at: int
    old: str
    new: str

    def __str__(self) -> str:
        """Return the place, and what has become of what."""
        return f"{self.file}:{self.line}: {self.old.strip()} -> {self.new.strip()}"

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
    return [_mutant(places[k], package.files[places[k][0]], random) for k in chosen]


def _is_mutated(file: str) -> bool:
    return file.endswith((".c", ".h")) and "_selftest" not in file


def _places(file: str, text: str) -> Iterator[tuple[str, int, str]]:
    code = re.sub(r'/\*.*?\*/|^#.*?$|"[^"\n]*"', lambda m: " " * len(m[0]), text, flags=re.DOTALL | re.MULTILINE)
    for body in re.finditer(r"^\{\n(.*?)^\}", code, re.DOTALL | re.MULTILINE):
        for place in _PLACE.finditer(code, body.start(1), body.end(1)):
            yield file, place.start(), place[0]


def _mutant(place: tuple[str, int, str], text: str, random: np.random.Generator) -> Mutant:
    file, at, old = place
    if old in _OPERATORS:
        new = str(random.choice(_OPERATORS[old]))
    elif "." in old:
        new = str(random.choice([f"({old} * 1.5)", "0.0" if float(old) else "1.0"]))
    else:
        new = str(1 - int(old))
    return Mutant(file, text.count("\n", 0, at) + 1, at, old, new)
