"""Faults in emitted C, by hand and at random: how many self-test, replay and exercise notice."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Final

from sgms_bench import C_DIR
from sgms_bench.motions import timed_motion
from sgms_bench.verification.faults import FAULTS
from sgms_bench.verification.mutants import Mutant, draw_mutants, draw_statements
from sgms_bench.verification.outcome import AbsentError, CheckOutcome, Run, definitions, require, run
from sgms_bench.verification.specimens import specimens
from sgms_bench.verification.survivors import is_explained
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.signals.logs import Log, write_log

Progress = Callable[[str], None]

BY_HAND_NOTICED: Final = 0.95
AT_RANDOM_NOTICED: Final = {"operators": 0.8, "statements": 0.85}
"""Of mutants of each class by the self-test."""
ALL_NOTICED: Final = 0.98
"""Of mutants by one judge or another."""
SECONDS: Final = 20
"""Of the processor, of one run: one that does not come back is noticed by a watchdog."""
REPLAYED: Final = 300
"""Updates of the log that is replayed."""
CHECKED: Final = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-ftrivial-auto-var-init=pattern")
"""Accesses, and locals that have no value: they hold a number that no axis can have."""
FLAGS: Final = ("-std=c99", "-O1", "-ffp-contract=off", "-DSGMS_VECTORS=1", "-w")


def check_self_test(mutants: int, seed: int, progress: Progress) -> list[CheckOutcome]:
    """Check that the self-test notices faults by hand, and self-test, replay and exercise mutants, all but a few.

    The faults are of `etel_xy`; the mutants of it and of the specimens.

    Args:
        mutants: how many at random of each class, in all; of each package as many.
        seed: of them.
        progress: called after every tenth fault by hand, and with every mutant that the self-test does not notice.
    """
    by_hand_title = "self-test: faults by hand"
    classes = {"operators": draw_mutants, "statements": draw_statements}
    titles = {of: (f"self-test: {of} at random", f"self-test, replay, exercise: {of}") for of in classes}
    try:
        require("gcc", "prlimit")
    except AbsentError as absent:
        absents = by_hand_title, *(title for pair in titles.values() for title in pair)
        return [CheckOutcome(title, "", skipped=str(absent)) for title in absents]
    machines = [load_machine("etel_xy"), *specimens()]
    by_hand: list[tuple[str, Verdict]] = []
    at_random: dict[str, list[tuple[Mutant, Verdict]]] = {of: [] for of in classes}
    for k, machine in enumerate(machines):
        package = emit_package(machine)
        count = mutants // len(machines) + (k < mutants % len(machines))
        with tempfile.TemporaryDirectory() as scratch:
            campaign = Campaign(package, Path(scratch))
            for fault in FAULTS if k == 0 else ():
                by_hand.append((fault.what, campaign.judge(fault.spoil(dict(package.files), machine.name))))
                if len(by_hand) % 10 == 0:
                    progress(f"{by_hand_title}: {len(by_hand)}")
            for of, draw in classes.items():
                for mutant in draw(package, count, seed):
                    at_random[of].append((mutant, campaign.judge_mutant(mutant, package)))
                    if at_random[of][-1][1] is not Verdict.NOTICED:
                        progress(f"{machine.name}: {at_random[of][-1][1].name}: {mutant}")
        progress(f"{machine.name}: {sum(map(len, at_random.values()))} mutants in all")
    outcomes = [judge_faults(by_hand_title, by_hand)]
    for of, verdicts in at_random.items():
        outcomes += judge_mutants(titles[of], verdicts, AT_RANDOM_NOTICED[of])
    return outcomes


class Verdict(Enum):
    """Outcome of a fault in a package: what notices it."""

    NOTICED = "by the self-test"
    REPLAYED = "a log gives other estimates; the self-test does not fail"
    MISSED = "the exercise of all calls returns other numbers, or leaves an object; self-test and replay do not"
    UNCHANGED = "no number that they return is another one: equivalent, or beyond what they do"
    SAME = "compiled to the same bytes, or not at all"


def judge_faults(title: str, verdicts: Sequence[tuple[str, Verdict]]) -> CheckOutcome:
    """Outcome of faults that change what a package does; where too few are noticed all others are named.

    Args:
        title: of the check.
        verdicts: of each fault.
    """
    survivors = tuple(what for what, verdict in verdicts if verdict is not Verdict.NOTICED)
    tried = f"{len(verdicts)} faults, {len(verdicts) - len(survivors)} noticed"
    return CheckOutcome(title, tried, survivors if len(survivors) > (1.0 - BY_HAND_NOTICED) * len(verdicts) else ())


def judge_mutants(
    titles: Sequence[str], verdicts: Iterable[tuple[Mutant, Verdict]], wanted_of_one: float
) -> list[CheckOutcome]:
    """Outcomes of mutants: of the self-test alone, and of all judges together.

    A mutant that none of them notices counts as one that ought to be, unless the list of survivors has a reason why it
    is equivalent. One that the compiler makes nothing else of counts for nothing.

    Args:
        titles: of the two checks.
        verdicts: of each mutant.
        wanted_of_one: share that the self-test has to notice.
    """
    known = [(mutant, verdict) for mutant, verdict in verdicts if verdict is not Verdict.SAME]
    count = Counter(verdict for _, verdict in known)
    unseen = [mutant for mutant, verdict in known if verdict is Verdict.UNCHANGED]
    unexplained = tuple(f"{mutant}" for mutant in unseen if not is_explained(mutant))
    real = len(known) - len(unseen) + len(unexplained)
    missed = tuple(f"{m}" for m, verdict in known if verdict in (Verdict.REPLAYED, Verdict.MISSED)) + unexplained
    told = [
        f"{real} mutants that are not equivalent, {count[Verdict.NOTICED]} noticed",
        f"{real} mutants that are not equivalent, {real - len(unexplained)} noticed: {count[Verdict.NOTICED]} by the "
        f"self-test, {count[Verdict.REPLAYED]} more by the replay, {count[Verdict.MISSED]} by the exercise alone; "
        f"{len(unseen) - len(unexplained)} equivalent for reasons of the list",
    ]
    limits = (wanted_of_one, ALL_NOTICED)
    return [
        CheckOutcome(title, tried, left if len(left) > (1.0 - wanted) * real else ())
        for title, tried, left, wanted in zip(titles, told, (missed, unexplained), limits, strict=True)
    ]


def record_log(package: Package) -> Log:
    """A log of a package's machine in closed loop: loops, moves, standstill, and some readings that are missing."""
    machine = package.machine
    motion = timed_motion(machine, "mixed", REPLAYED)
    log = simulate_axis(machine, motion, AxisConfig(seed=1), scale={"coulomb": 1.1}, truth=False).log
    samples = machine.sampling.samples_per_update
    log.position_m[150 * samples + 3] = log.force_N[200 * samples + 5] = float("nan")
    return log


class Campaign:
    """Programs of the judges of one package, whose other files may have a fault.

    Args:
        package: with its self-test.
        folder: for what is compiled.
    """

    def __init__(self, package: Package, folder: Path) -> None:
        self._name, self._folder, self._files = package.machine.name, folder, package.files
        self._definitions = definitions(package)
        self._log = folder / "log.csv"
        write_log(self._log, record_log(package))
        self._parts: dict[Path, tuple[Path, set[str]]] = {}
        self._good = folder / "good"
        good = self._object(self._good, package.files)
        if good is None:
            raise ValueError("the package does not compile")
        self._right = good.read_bytes()
        for source in (C_DIR / "harness.c", C_DIR / "exercise.c", self._good / f"{self._name}_selftest.c"):
            self._keep_part(source)
        self._digest = self._exercise(self._good, good)
        self._estimates = self._replay(self._good, good)
        found = self._self_test(self._good, good), self._digest, self._estimates
        if any(of.code != 0 for of in found) or not self.is_within_objects(package.files):
            raise ValueError(f"the package fails: {[of.output[:300] for of in found]}")

    def judge(self, files: Mapping[str, str]) -> Verdict:
        """Return what self-test, replay and exercise say of other files."""
        with tempfile.TemporaryDirectory(dir=self._folder) as scratch:
            bad = Path(scratch) / "bad"
            spoilt = self._object(bad, files)
            if spoilt is None or spoilt.read_bytes() == self._right:
                return Verdict.SAME
            if self._self_test(bad, spoilt).code != 0:
                return Verdict.NOTICED
            if self._replay(bad, spoilt) != self._estimates:
                return Verdict.REPLAYED
            return Verdict.UNCHANGED if self._exercise(bad, spoilt) == self._digest else Verdict.MISSED

    def judge_mutant(self, mutant: Mutant, package: Package) -> Verdict:
        """Return what they say of a mutant, once more with every access checked where they say nothing."""
        files = mutant.spoil(package)
        verdict = self.judge(files)
        is_open = verdict is Verdict.UNCHANGED and not is_explained(mutant)
        return Verdict.MISSED if is_open and not self.is_within_objects(files) else verdict

    def is_within_objects(self, files: Mapping[str, str]) -> bool:
        """Return whether the exercise of other files comes to the same with every access checked."""
        with tempfile.TemporaryDirectory(dir=self._folder) as scratch:
            folder = Path(scratch) / "checked"
            self._object(folder, files)
            program, sources = folder / "program", [C_DIR / "exercise.c", folder / f"{self._name}.c"]
            run(["gcc", *FLAGS, *CHECKED, *self._definitions, f"-I{folder}", *sources, "-o", program, "-lm"])
            return run(["prlimit", f"--cpu={5 * SECONDS}", program]) == self._digest

    def _self_test(self, folder: Path, compiled: Path) -> Run:
        """Outcome of the package's self-test."""
        parts = [C_DIR / "harness.c", self._good / f"{self._name}_selftest.c"]
        return self._run(folder, compiled, parts, ["--selftest"])

    def _replay(self, folder: Path, compiled: Path) -> Run:
        """Estimates of the log."""
        parts = [C_DIR / "harness.c", self._good / f"{self._name}_selftest.c"]
        return self._run(folder, compiled, parts, ["--log", self._log])

    def _exercise(self, folder: Path, compiled: Path) -> Run:
        """Outcome of the exercise of all calls: a digest of the bits of what they return."""
        return self._run(folder, compiled, [C_DIR / "exercise.c"], [])

    def _run(self, folder: Path, compiled: Path, parts: Sequence[Path], arguments: Sequence[str | Path]) -> Run:
        program = folder / "program"
        objects = [self._part(folder, part) for part in parts]
        made = run(["gcc", *objects, compiled, "-o", program, "-lm"])
        return run(["prlimit", f"--cpu={SECONDS}", program, *arguments]) if made.code == 0 else made

    def _keep_part(self, source: Path) -> None:
        """Compile a part of the programs with the package as it is, and note which of its files it reads."""
        read = run(["gcc", "-MM", *self._definitions, f"-I{self._good}", source]).output
        self._parts[source] = self._compile(self._good, source), {Path(word).name for word in read.split()}

    def _part(self, folder: Path, source: Path) -> Path:
        """A part of the programs compiled with the package in a folder; once where its files are as they are."""
        compiled, read = self._parts[source]
        for file in read & self._files.keys():
            if (folder / file).read_text() != self._files[file]:
                return self._compile(folder, folder / source.name if source.parent == self._good else source)
        return compiled

    def _compile(self, folder: Path, source: Path) -> Path:
        compiled = folder / f"{source.stem}.o"
        options = [*FLAGS, "-DSGMS_SELFTEST", *self._definitions, f"-I{folder}"]
        run(["gcc", *options, "-c", source, "-o", compiled])
        return compiled

    def _object(self, folder: Path, texts: Mapping[str, str]) -> Path | None:
        """The estimator's object below a folder; None where it does not compile."""
        folder.mkdir()
        for file, text in texts.items():
            if file.endswith((".c", ".h")):
                (folder / file).write_text(text)
        made = run(["gcc", *FLAGS, "-c", f"{self._name}.c", "-o", "package.o"], folder=folder)
        return folder / "package.o" if made.code == 0 else None
