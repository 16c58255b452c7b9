"""The self-test that a package brings: 0 on every compiler and target, and not 0 where a number is another."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from c_packages import PRECISIONS, STRICT, machine, run, symbols, written
from sgms_bench.target.firmware import double_arithmetic
from sgms_bench.target.stacks import call_paths
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import emit_package, write_package
from sgms_mhe.evaluation.acceptance import build_selftest
from sgms_mhe.host.targets import TARGETS, Target, emulate

GENERATED = Path(__file__).parents[1] / "generated"
Tool = Callable[[str], str]
MAIN = '#include "etel_xy.h"\nint main(void)\n{\n    return etel_xy_selftest();\n}\n'


@pytest.fixture(scope="module", params=PRECISIONS)
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package with its self-test, one per precision."""
    settings = machine(code={"precision": request.param})
    return written(emit_package(settings), tmp_path_factory.mktemp(request.param))


def answer(tool: str, folder: Path, scratch: Path, *flags: str) -> int:
    """What etel_xy_selftest() returns."""
    main, program = scratch / "main.c", scratch / "program"
    main.write_text(MAIN)
    run(tool, flags, f"-I{folder}", main, sorted(folder.glob("*.c")), "-o", program)
    return subprocess.run([program], check=False).returncode


@pytest.mark.parametrize(("compiler", "level"), [("gcc", "-O0"), ("gcc", "-O3"), ("clang", "-O2")])
def test_returns_0(compiler: str, level: str, folder: Path, require_tool: Tool, tmp_path: Path) -> None:
    assert answer(require_tool(compiler), folder, tmp_path, *STRICT, level) == 0


NUMBERS = ("friction", "force", "innovation", "ratio", "scale", "deflection", "parameter", "deviation")
COLUMNS = {"deflection": 5, "parameter": 9, "deviation": 13} | {name: k for k, name in enumerate(NUMBERS[:5])}


def constant(header: str, name: str) -> int:
    """An integer of the vectors' header."""
    found = re.search(rf"{name} = (\d+)", header)
    assert found is not None
    return int(found[1])


def changed_vectors(folder: Path, scratch: Path, name: str, change: Callable[[list[str]], list[str]]) -> Path:
    """The package with the numbers of one table of its vectors changed."""
    changed = scratch / "etel_xy"
    changed.mkdir()
    for path in folder.iterdir():
        text = path.read_text()
        if path.name == "etel_xy_selftest.h":
            table = re.search(rf"{name}\[[^=]*= {{(.*?)}};", text, re.DOTALL)
            assert table is not None
            text = text[: table.start(1)] + ",".join(change(table[1].split(","))) + text[table.end(1) :]
        (changed / path.name).write_text(text)
    return changed


COMPARED = [("first", number) for number in NUMBERS] + [("second", number) for number in NUMBERS if number != "force"]


@pytest.mark.parametrize(("which", "number"), COMPARED)
def test_says_which_update_differs(which: str, number: str, folder: Path, require_tool: Tool, tmp_path: Path) -> None:
    """Every number of the vectors counts: one of the third update of a run that is off by a fifth."""
    header = (folder / "etel_xy_selftest.h").read_text()
    updates, width = constant(header, "SELFTEST_UPDATES"), constant(header, "SELFTEST_WIDTH")

    def change(numbers: list[str]) -> list[str]:
        at = 2 * width + COLUMNS[number]
        found = re.search(r"-?\d[\d.e+-]*", numbers[at])
        assert found is not None
        numbers[at] = numbers[at].replace(found[0], f"{1.2 * float(found[0]) + 1e-6:.9e}")
        return numbers

    changed = changed_vectors(folder, tmp_path, f"selftest_{which}", change)
    assert answer(require_tool("gcc"), changed, tmp_path, "-std=c99", "-O1") == 3 + (
        updates if which == "second" else 0
    )


def test_estimator_that_is_wrong_is_found(folder: Path, require_tool: Tool, tmp_path: Path) -> None:
    """One constant of the estimator changed, and one that makes every estimate NaN."""
    priors = (r"prior_sd\[PARAMETERS\] = \{[^,]+", "prior_sd[PARAMETERS] = {0.0")
    for line, wrong in ((r"#define MASS \S+", "#define MASS 21.0"), priors):
        changed = tmp_path / str(len(wrong))
        changed.mkdir()
        for path in folder.iterdir():
            text = path.read_text()
            if path.name == "etel_xy_config.h":
                text, count = re.subn(line, wrong, text)
                assert count == 1
            (changed / path.name).write_text(text)
        assert answer(require_tool("gcc"), changed, tmp_path, "-std=c99", "-O1") > 0


def test_needs_the_estimator_and_nothing_else(folder: Path, require_tool: Tool, tmp_path: Path) -> None:
    """Another object's: without a call of it nothing of the self-test is linked."""
    made = tmp_path / "selftest.o"
    run(require_tool("gcc"), STRICT, "-O2", "-ffreestanding", "-c", folder / "etel_xy_selftest.c", "-o", made)
    found = symbols(made)
    calls = "init init_with settings tick sample insert ahead compensate share due feedback prepare estimate"
    calls += " save load set_mass hold set_parameter reset check status_text"
    needed = {f"etel_xy_{name}" for name in calls.split()}
    assert {name for kind, name in found if kind == "U"} <= needed | {"memcpy", "memset", "__stack_chk_fail"}
    exported = {name for kind, name in found if kind.isupper() and kind != "U"}
    assert exported == {"etel_xy_selftest", "etel_xy_selftest_with"}
    assert not [name for kind, name in found if kind in "BbDdCcGgSs"], "writable globals"


@pytest.mark.needs_arm
@pytest.mark.parametrize("name", ["etel_xy", "etel_xy_controller"])
def test_stays_within_4_kB_of_stack_and_40_kB_of_flash(name: str, tmp_path: Path) -> None:
    """Beside the axis, with all that it calls; and the object of its own, vectors included."""
    whole = tmp_path / name
    write_package(emit_package(load_machine(name), amalgamate=True), whole)
    options = ["-std=c99", "-O2", "-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"]
    made = tmp_path / "whole.o"
    run("arm-none-eabi-gcc", options, "-fcallgraph-info=su", "-c", whole / f"{name}.c", "-o", made)
    assert call_paths(made.with_suffix(".ci").read_text())[f"{name}_selftest_with"] <= 4096
    own = tmp_path / "own.o"
    run("arm-none-eabi-gcc", options, "-c", GENERATED / name / f"{name}_selftest.c", "-o", own)
    assert int(run("arm-none-eabi-size", own).splitlines()[1].split()[0]) <= 40_000


CORES = [
    pytest.param(TARGETS["cortex_m7"], marks=pytest.mark.needs_arm, id="cortex_m7"),
    pytest.param(TARGETS["riscv32"], marks=pytest.mark.needs_riscv, id="riscv32"),
]


@pytest.mark.parametrize("target", CORES)
def test_returns_0_on_the_target(target: Target, tmp_path: Path) -> None:
    """Linked without a library, run by the emulator, in single precision throughout; its exit code is the answer."""
    linked = build_selftest(emit_package(machine(code={"precision": "single"})), target, tmp_path)
    assert not double_arithmetic(target, tmp_path / "etel_xy_selftest.o")
    emulate(target, linked, tmp_path / "results.bin", lambda written: None)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_every_emitted_header_compiles_alone(compiler: str, precision: str, require_tool: Tool, tmp_path: Path) -> None:
    folder = written(emit_package(machine(code={"precision": precision})), tmp_path)
    for header in sorted(folder.glob("etel_xy*.h")):
        source = tmp_path / "alone.c"
        source.write_text(f'#include "{header.name}"\nint main(void) {{ return 0; }}\n')
        unused = "-Wno-unused-function"  # clang minds those of a header that the file itself includes first
        run(require_tool(compiler), STRICT, unused, f"-I{folder}", "-fsyntax-only", source)
