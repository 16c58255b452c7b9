"""The self-test that a package brings: 0 on every compiler and target, and not 0 where a number is another."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from c_packages import PRECISIONS, STRICT, machine, run, symbols, written
from sgms_bench.target.firmware import double_arithmetic
from sgms_mhe.emission.package import emit_package
from sgms_mhe.evaluation.acceptance import build_selftest
from sgms_mhe.host.targets import TARGETS, Target, emulate

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


@pytest.mark.parametrize(
    ("number", "update"),
    [(r"(selftest_friction\[.*?\] = .*?\n    )", 1), (r"(selftest_parameter\[.*\n.*\n.*\n    \{)", 3)],
    ids=["friction", "parameter"],
)
def test_says_which_update_differs(number: str, update: int, folder: Path, require_tool: Tool, tmp_path: Path) -> None:
    """A number of the vectors that is off by a thousandth."""
    changed = tmp_path / "etel_xy"
    changed.mkdir()
    for path in folder.iterdir():
        text = path.read_text()
        if path.name == "etel_xy_selftest.h":
            text, count = re.subn(number + r"(-?[\d.]+)", lambda m: f"{m[1]}{float(m[2]) * 1.001:.9g}", text, count=1)
            assert count == 1
        (changed / path.name).write_text(text)
    assert answer(require_tool("gcc"), changed, tmp_path, "-std=c99", "-O1") == update


def test_estimator_that_is_wrong_is_found(folder: Path, require_tool: Tool, tmp_path: Path) -> None:
    """One constant of the estimator changed, and one that makes every estimate NaN."""
    for line, wrong in ((r"#define MASS \S+", "#define MASS 21.0"), (r"#define PRIOR_SD \S+", "#define PRIOR_SD 0.0")):
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
    needed = {f"etel_xy_{name}" for name in "init sample feedback prepare estimate save load set_mass".split()}
    assert {name for kind, name in found if kind == "U"} <= needed | {"memcpy", "memset", "__stack_chk_fail"}
    exported = {name for kind, name in found if kind.isupper() and kind != "U"}
    assert exported == {"etel_xy_selftest", "etel_xy_selftest_with"}
    assert not [name for kind, name in found if kind in "BbDdCcGgSs"], "writable globals"


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
