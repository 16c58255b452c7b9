"""Consistency of machine files, the packages generated from them, and compilers.

For whoever keeps machine files and packages in a repository of their own: a changed file without its package, another
version of the generator, a compiler that breaks the arithmetic are found before they reach an axis.
"""

import hashlib
import json
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, TypeVar
from xml.etree import ElementTree

from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.bindings import bindings_among, strip_binaries
from sgms_mhe.emission.delivery import MANIFEST
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.evaluation.comparison import compare_signals
from sgms_mhe.host.targets import TARGET_FLAGS, TARGETS, Target, emulate, link_program
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.support.errors import BuildError, InputError
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, WARNING_FLAGS, compiler, tool_output

T = TypeVar("T")
Progress = Callable[[str], None]
"""Called with the check that begins."""

UPDATES: Final = 100
"""Of the comparison with the reference, at least; and long enough to fill the window twice."""


@dataclass(frozen=True)
class Check:
    """One check of one machine.

    Attributes:
        machine: name of the file, or the name given.
        name: of the check.
        seconds: that it took.
        failure: the error and its remedy; empty: none.
        skipped: why it was not made; empty: it was.
    """

    machine: str
    name: str
    seconds: float = 0.0
    failure: str = ""
    skipped: str = ""


class _FailedError(Exception):
    """Failure of a check."""


@dataclass
class _Course:
    """The checks of one machine as they are made."""

    machine: str
    progress: Progress
    checks: list[Check] = field(default_factory=list)

    def check(self, name: str, made: Callable[[], T]) -> T | None:
        """Make a check, and return its result; an error a user can mend is its failure, and None is returned."""
        self.progress(f"{self.machine}: {name}")
        started, failure, result = time.monotonic(), "", None
        try:
            result = made()
        except (_FailedError, InputError, BuildError) as error:
            failure = str(error)
        self.checks.append(Check(self.machine, name, time.monotonic() - started, failure))
        return result

    def skip(self, name: str, why: str) -> None:
        """Leave a check out."""
        self.checks.append(Check(self.machine, name, skipped=why))


def accept(source: str, generated: Path, targets: Sequence[str], progress: Progress) -> tuple[Check, ...]:
    """Check one machine.

    Args:
        source: its file, or its name in machines/.
        generated: folder of the packages that were generated, each in a folder of its machine's name.
        targets: names of emulated microcontrollers the self-test runs on.
        progress: told of each check.
    """
    course = _Course(Path(source).stem, progress)
    on_targets = {f"self-test, {name}": TARGETS[name] for name in targets}
    package = course.check("machine file", lambda: emit_package(load_machine(source), within_budget=True))
    if package is None:
        for name in ("package", "reference", "self-test", *on_targets):
            course.skip(name, "the machine file is refused")
        return tuple(course.checks)
    course.check("package", partial(_same_files, package, generated / package.machine.name))
    course.check("reference", partial(_agrees_with_reference, package))
    course.check("self-test", partial(_passes_on_host, package))
    for name, target in on_targets.items():
        course.check(name, partial(_passes_on_target, package, target))
    return tuple(course.checks)


def junit(checks: Sequence[Check]) -> str:
    """Checks as a JUnit XML file: a suite for each machine."""
    root = ElementTree.Element("testsuites", {"name": "sgms-mhe ci"} | _counts(checks))
    for machine in dict.fromkeys(check.machine for check in checks):
        own = [check for check in checks if check.machine == machine]
        suite = ElementTree.SubElement(root, "testsuite", {"name": machine} | _counts(own))
        for check in own:
            case = ElementTree.SubElement(
                suite, "testcase", classname=machine, name=check.name, time=f"{check.seconds:.3f}"
            )
            if check.failure:
                first = check.failure.splitlines()[0]
                ElementTree.SubElement(case, "failure", message=first).text = check.failure
            elif check.skipped:
                ElementTree.SubElement(case, "skipped", message=check.skipped)
    ElementTree.indent(root)
    return f"<?xml version='1.0' encoding='utf-8'?>\n{ElementTree.tostring(root, encoding='unicode')}\n"


def _counts(checks: Sequence[Check]) -> dict[str, str]:
    return {
        "tests": str(len(checks)),
        "failures": str(sum(bool(check.failure) for check in checks)),
        "skipped": str(sum(bool(check.skipped) for check in checks)),
        "time": f"{sum(check.seconds for check in checks):.3f}",
    }


def _same_files(package: Package, folder: Path) -> None:
    """The folder equals the package of the file, byte for byte; with the bindings it has files of."""
    name = package.machine.name
    remedy = f"sgms-mhe generate {package.machine.source} --out {folder}"
    if not folder.is_dir():
        raise _FailedError(f"{folder}: no package; {remedy}")
    present = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    amalgamate = f"{name}_config.h" not in present and f"{name}.c" in present
    bindings = bindings_among(present, name)
    remedy += (" --amalgamate" if amalgamate else "") + (f" --bindings {','.join(bindings)}" if bindings else "")
    if amalgamate or bindings:
        package = emit_package(package.machine, amalgamate=amalgamate, bindings=bindings)
    wanted = {file: text.encode() for file, text in package.files.items()} | _archives(package, present)
    differing = sorted(file for file in wanted.keys() | present.keys() if wanted.get(file) != present.get(file))
    if differing:
        listed = ", ".join(differing[:3]) + (", ..." if len(differing) > 3 else "")
        raise _FailedError(f"{folder}: {len(differing)} files are not what the machine file gives ({listed}); {remedy}")


def _archives(package: Package, present: Mapping[str, bytes]) -> dict[str, bytes]:
    """Archives the package is to have, and the manifest with their digests.

    A binary inside of one is another compiler's where another host has made it: an archive that is the same but for its
    binaries is taken as it is present.
    """
    taken = {}
    for file, archive in package.archives.items():
        there = present.get(file)
        same = there is not None and strip_binaries(there) == strip_binaries(archive)
        taken[file] = there if there is not None and same else archive
    manifest = json.loads(package.files[MANIFEST])
    manifest["sha256"] |= {file: hashlib.sha256(archive).hexdigest() for file, archive in taken.items()}
    return taken | {MANIFEST: (json.dumps(manifest, indent=2) + "\n").encode()}


def _agrees_with_reference(package: Package) -> None:
    machine = package.machine
    updates = max(UPDATES, 2 * machine.estimator.horizon)
    sampling = machine.sampling
    # No faster than the estimate is right at: substeps are made for that.
    path = make_trajectory(
        "mixed", sampling.rate, duration_s=updates / sampling.update_rate, max_velocity=sampling.max_velocity
    )
    log = simulate_axis(machine, path, AxisConfig(seed=1), truth=False).log
    found = compare_signals(machine, signals_from_log(log, machine))
    if not found.agrees:
        beyond = [f"{q.name} by {q.relative:.1e} ({q.tolerance:.0e} allowed)" for q in found.quantities if not q.agrees]
        raise _FailedError(f"compiled C and reference differ: {', '.join(beyond) or 'in the status'}")


def _passes_on_host(package: Package) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        folder, program = Path(scratch), Path(scratch) / "selftest"
        sources = _selftest_sources(package, folder, "main")
        flags = [*DEFAULT_FLAGS, *WARNING_FLAGS, f"-I{folder / package.machine.name}"]
        tool_output([*compiler(), *flags, *map(str, sources), "-o", str(program)])
        code = subprocess.run([program], check=False, timeout=600).returncode
    if code != 0:
        raise _FailedError(
            f"{package.machine.name}_selftest() returned {code}: from that update on a number is another"
        )


def _passes_on_target(package: Package, target: Target) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        emulate(target, build_selftest(package, target, folder), folder / "results.bin", lambda written: None)


def build_selftest(package: Package, target: Target, folder: Path) -> Path:
    """Link a package's self-test for a target, without a library; the program's exit code is its answer.

    Raises:
        BuildError: the compiler is not there, or it refused.
    """
    sources = _selftest_sources(package, folder, "target_main")
    (folder / "count.c").write_text("extern unsigned target_loop_count;\nunsigned target_loop_count;\n")
    options: list[str | Path] = [*TARGET_FLAGS, *target.flags, "-ffreestanding"]
    own = f"-I{folder / package.machine.name}"
    parts = {f"{source.stem}.o": [*options, own, source] for source in (*sources, folder / "count.c")}
    return link_program(target, parts, options, folder / "selftest.elf")


def _selftest_sources(package: Package, folder: Path, entry: str) -> list[Path]:
    """Write a package and a program that returns the result of its self-test; the C files of both."""
    name = package.machine.name
    write_package(package, folder / name)
    main = folder / "main.c"
    main.write_text(
        f'#include "{name}.h"\n\nint {entry}(void);\n\nint {entry}(void)\n{{\n    return {name}_selftest();\n}}\n'
    )
    return [*sorted((folder / name).glob("*.c")), main]


def machines_below(folder: Path) -> list[str]:
    """Machine files of a folder, by name.

    Raises:
        InputError: there is none.
    """
    found = sorted(str(path) for path in folder.glob("*.toml"))
    if not found:
        raise InputError("ci", "MACHINES", str(folder), "a folder with machine files (*.toml), or machines by name")
    return found
