"""The self-test that a package brings: 0 on every compiler and target, and not 0 where a number is another."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from c_packages import PRECISIONS, STRICT, build, package_of, run, symbols, written
from sgms_bench.target.firmware import double_arithmetic
from sgms_bench.target.stacks import call_paths
from sgms_bench.verification.faults import FAULTS
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package, write_package
from sgms_mhe.evaluation.acceptance import build_selftest
from sgms_mhe.host.targets import TARGETS, Target, emulate
from ways_out import spoil_outputs

GENERATED = Path(__file__).parents[1] / "generated"
Tool = Callable[[str], str]
MAIN = '#include "etel_xy.h"\nint main(void)\n{\n    return etel_xy_selftest();\n}\n'


@pytest.fixture(scope="module", params=PRECISIONS)
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package with its self-test, one per precision."""
    return written(package_of(selftest=True, code={"precision": request.param}), tmp_path_factory.mktemp(request.param))


def answer(tool: str, folder: Path, scratch: Path, *flags: str) -> int:
    """What etel_xy_selftest() returns."""
    main = scratch / "main.c"
    main.write_text(MAIN)
    program = build(tool, [main, *sorted(folder.glob("*.c"))], scratch / "program", flags, f"-I{folder}")
    return subprocess.run([program], check=False).returncode


@pytest.mark.parametrize(("compiler", "level"), [("gcc", "-O0"), ("gcc", "-O3"), ("clang", "-O2")])
def test_returns_0(compiler: str, level: str, folder: Path, require_tool: Tool, tmp_path: Path) -> None:
    assert answer(require_tool(compiler), folder, tmp_path, *STRICT, level) == 0


@pytest.mark.parametrize("processor", ["Prescott", "Haswell"])
def test_package_does_not_hang_on_the_processor(processor: str, tmp_path: Path) -> None:
    """Linear algebra rounds otherwise on another one, and the vectors are what it computed."""
    command = [sys.executable, "-m", "sgms_mhe", "generate", "etel_xy", "--out", str(tmp_path / "etel_xy")]
    subprocess.run(command, check=True, env=os.environ | {"OPENBLAS_CORETYPE": processor}, capture_output=True)
    for path in (GENERATED / "etel_xy").iterdir():
        assert (tmp_path / "etel_xy" / path.name).read_bytes() == path.read_bytes(), path.name


NUMBERS = ("friction", "measured", "innovation", "ratio", "scale", "deflection", "parameter", "deviation")
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


COMPARED = [(which, number) for which in ("first", "second") for number in NUMBERS]
FORCES = [("first_force", "force"), ("second_force", "force"), ("second_inserted", "force")]


@pytest.mark.parametrize(("which", "number"), COMPARED + FORCES)
def test_says_which_update_differs(which: str, number: str, folder: Path, require_tool: Tool, tmp_path: Path) -> None:
    """Every number of the vectors counts: one of the third update of a run that is off by a fifth."""
    header = (folder / "etel_xy_selftest.h").read_text()
    updates, second, width = (constant(header, f"SELFTEST_{name}") for name in ("UPDATES", "SECOND", "WIDTH"))

    def change(numbers: list[str]) -> list[str]:
        at = 2 if number == "force" else 2 * width + COLUMNS[number]
        found = re.search(r"-?\d[\d.e+-]*", numbers[at])
        assert found is not None
        numbers[at] = numbers[at].replace(found[0], f"{1.2 * float(found[0]) + 1e-6:.9e}")
        return numbers

    changed = changed_vectors(folder, tmp_path, f"selftest_{which}", change)
    runs_before = {"first": 0, "second": updates, "second_inserted": updates + second}
    before = runs_before.get(which, runs_before[which.split("_")[0]])
    assert answer(require_tool("gcc"), changed, tmp_path, "-std=c99", "-O1") == 3 + before


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


@pytest.mark.slow
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


def runs_of(header: str) -> int:
    """Updates of all runs, beyond which a self-test answers with the number of a sentence."""
    return constant(header, "SELFTEST_UPDATES") + 2 * constant(header, "SELFTEST_SECOND")


def promised_functions(header: str) -> dict[int, set[str]]:
    """Functions that the header of a self-test names, by the number of its sentence."""
    promise = header[header.index("number of a sentence:") : header.index("*/")]
    sentences = re.split(r"\n \* +(?=\d+ +[A-Za-z])", promise)[1:]
    numbers = {int(text.split()[0]): set(re.findall(r"(\w+)\(\)", text.rpartition(":")[2])) for text in sentences}
    assert sorted(numbers) == list(range(12))
    return numbers


def called_functions(source: str) -> dict[int, set[str]]:
    """Functions that a self-test calls, by the number with which it answers where one fails."""
    body = source[source.index("static int failed_check(") :]
    checks = re.findall(r"if \(([^{}]*?)\) \{\s+return (?:RUNS \+ )?(\d+);|return ([^;]*?) \? 0\s*: (\d+);", body)
    numbers: dict[int, set[str]] = {0: {"run_along"}}
    for first, one, second, two in checks:
        called = set(re.findall(r"(?<![\w])([a-z]\w+)\(", first or second))
        numbers.setdefault(int(one or two), set()).update(f for f in called if f"static int {f}(" in source)
    return numbers


BY_HAND = {3: "force on without a position", 6: "limit of one side alone", 11: "a number of another sign than itself"}
"""Faults of sentences that no output breaks alone, of those written by hand."""


@pytest.mark.parametrize(("number", "what"), BY_HAND.items())
def test_fault_gets_the_number_of_its_sentence(number: int, what: str, require_tool: Tool, tmp_path: Path) -> None:
    package = emit_package(load_machine("etel_xy"))
    fault = next(fault for fault in FAULTS if fault.what == what)
    folder = written(replace(package, files=fault.spoil(dict(package.files), "etel_xy")), tmp_path)
    runs = runs_of(package.files["etel_xy_selftest.h"])
    assert answer(require_tool("gcc"), folder, tmp_path, "-std=c99", "-O1") == runs + number


@pytest.mark.slow
@pytest.mark.parametrize("name", ["etel_xy", "etel_xy_controller", "etel_xy_switching"])
def test_every_output_of_every_call_counts(name: str, require_tool: Tool, tmp_path: Path) -> None:
    """On every way to call an axis: its sign, zero, half of it, or the one before, in place of what is handed out.

    Each sentence of the promise names the functions that answer with its number, and some fault gets that answer.
    """
    require_tool("gcc")
    package = emit_package(load_machine(name))
    found = spoil_outputs(package, tmp_path)
    assert [spoilt.title for spoilt in found if spoilt.is_missed] == []
    calls = "tick sample insert share due feedback check status_text init_with hold set_parameter set_mass save load"
    assert {spoilt.title.split()[0] for spoilt in found} == {*calls.split(), "estimate", "settings"}
    header = package.files[f"{name}_selftest.h"]
    promised = promised_functions(header)
    assert promised == called_functions(package.files[f"{name}_selftest.c"])
    answers = {max(0, spoilt.code - runs_of(header)) for spoilt in found if spoilt.code > 0}
    assert answers | set(BY_HAND) == set(promised)


CORES = [
    pytest.param(TARGETS["cortex_m7"], marks=pytest.mark.needs_arm, id="cortex_m7"),
    pytest.param(TARGETS["riscv32"], marks=pytest.mark.needs_riscv, id="riscv32"),
]


@pytest.mark.slow
def test_returns_0_where_a_share_grows_as_fast_as_it_fades(require_tool: Tool, tmp_path: Path) -> None:
    """A share that was still growing at the damage is what it was before it, one sample later."""
    changes = {"name": "etel_xy", "estimator": {"relinearise": "all"}, "code": {"tick_budget": 1e6}}
    machine = override_machine(load_machine("etel_xy_compensation"), changes)
    folder = written(emit_package(machine), tmp_path)
    assert answer(require_tool("gcc"), folder, tmp_path, "-O1") == 0


def test_returns_0_for_an_axis_of_known_colour(require_tool: Tool, tmp_path: Path) -> None:
    """Factors that are last stated hold the colour: with it in them again, damaged means would state them twice."""
    noise = {"colour": 4.0}
    folder = written(package_of(selftest=True, estimator={"kind": "ekf", "noise": noise}), tmp_path)
    assert answer(require_tool("gcc"), folder, tmp_path, "-O1") == 0


def test_returns_0_where_velocities_are_rounded(require_tool: Tool, tmp_path: Path) -> None:
    changes = {"estimator": {"relinearise": "auto", "horizon": 4}, "code": {"accuracy": 1e-3}}
    folder = written(package_of(selftest=True, **changes), tmp_path)
    assert answer(require_tool("gcc"), folder, tmp_path, *STRICT, "-O1") == 0


def test_returns_0_where_the_force_stays_at_standstill(require_tool: Tool, tmp_path: Path) -> None:
    """A window so short that forces held over from standstill are still dying away where they are compared."""
    changes = {"name": "etel_xy", "estimator": {"horizon": 3, "relinearise": "all"}}
    folder = written(emit_package(override_machine(load_machine("etel_xy_compensation"), changes)), tmp_path)
    assert answer(require_tool("gcc"), folder, tmp_path, *STRICT, "-O1") == 0
    header = folder / "etel_xy_compensation.h"
    header.write_text(header.read_text().replace("friction + self->compensation.carry;", "friction;"))
    assert answer(require_tool("gcc"), folder, tmp_path, "-O1") > 0


@pytest.mark.parametrize("precision", PRECISIONS)
def test_returns_0_where_doubt_ramps_the_force(precision: str, require_tool: Tool, tmp_path: Path) -> None:
    changes = {"estimator": {"kind": "ekf"}, "compensation": {"on_doubt": "ramp"}, "code": {"precision": precision}}
    folder = written(package_of(selftest=True, **changes), tmp_path)
    assert answer(require_tool("gcc"), folder, tmp_path, *STRICT, "-O1") == 0
    header = folder / "etel_xy_compensation.h"
    header.write_text(header.read_text().replace("(self->estimate.status & ETEL_XY_DOUBT) ||", ""))
    assert answer(require_tool("gcc"), folder, tmp_path, "-O1") > 0


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("zeta", "lambda_"), [(0.9, 150.0), (0.985, 233.0), (0.999, 300.0)])
def test_returns_0_for_any_smoothing(
    zeta: float, lambda_: float, precision: str, require_tool: Tool, tmp_path: Path
) -> None:
    """Its polynomials are as exact as the smoothing lets them be, and all is in the numbers of its precision."""
    changes = {"friction": {"smoothing": {"zeta": zeta, "lambda": lambda_}}, "estimator": {"horizon": 3}}
    folder = written(package_of(selftest=True, code={"precision": precision}, **changes), tmp_path)
    assert answer(require_tool("gcc"), folder, tmp_path, *STRICT, "-O1") == 0


@pytest.mark.parametrize("target", CORES)
def test_returns_0_on_the_target(target: Target, tmp_path: Path) -> None:
    """Linked without a library, run by the emulator, in single precision throughout; its exit code is the answer."""
    linked = build_selftest(package_of(selftest=True, code={"precision": "single"}), target, tmp_path)
    assert not double_arithmetic(target, tmp_path / "etel_xy_selftest.o")
    emulate(target, linked, tmp_path / "results.bin", lambda written: None)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_every_emitted_header_compiles_alone(compiler: str, precision: str, require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(selftest=True, code={"precision": precision}), tmp_path)
    for header in sorted(folder.glob("etel_xy*.h")):
        source = tmp_path / "alone.c"
        source.write_text(f'#include "{header.name}"\nint main(void) {{ return 0; }}\n')
        unused = "-Wno-unused-function"  # clang minds those of a header that the file itself includes first
        run(require_tool(compiler), STRICT, unused, f"-I{folder}", "-fsyntax-only", source)
