"""The stack that packages of committed machines state: what the compiler writes down, byte for byte.

python tests/test_stated_stack.py --update    measure again, and write generator/sgms_mhe/emission/measured_stack.py
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from sgms_bench.target.stacks import call_paths
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission import measured_stack, stack
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.support.toolchain import tool_output

UPDATE = "python tests/test_stated_stack.py --update"
GCC = "arm-none-eabi-gcc"
CORE = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard")
CALLS = (
    "init", "init_with", "sample", "insert", "tick", "prepare", "feedback", "estimate",
    "reset", "set_mass", "set_parameter", "hold", "save", "load",
)  # fmt: skip
MACHINES = sorted(path.stem for path in (Path(__file__).parents[1] / "machines").glob("*.toml"))


def measured(package: Package, level: str, folder: Path) -> dict[str, int]:
    """Bytes of each public call's deepest path."""
    name = package.machine.name
    write_package(package, folder / name)
    source, made = folder / name / f"{name}.c", folder / "package.o"
    tool_output([GCC, "-std=c99", level, *CORE, "-fcallgraph-info=su", "-c", str(source), "-o", str(made)], "gcc")
    paths = call_paths(made.with_suffix(".ci").read_text())
    return {call: paths[f"{name}_{call}"] for call in CALLS}


def version() -> str:
    """Of the compiler, as the page names it."""
    return ".".join(tool_output([GCC, "-dumpfullversion"], "gcc").strip().split(".")[:2])


@pytest.mark.needs_arm
@pytest.mark.parametrize("name", MACHINES)
def test_stated_stack_is_the_measured_one(name: str, tmp_path: Path) -> None:
    machine = load_machine(name)
    package = emit_package(machine, selftest=False)
    stated = stack.measured_stack(machine.digest[:12])
    assert stated is not None, UPDATE
    assert [call for call, _ in stated.paths] == list(CALLS)
    for k, level in enumerate(stack.LEVELS):
        found = measured(package, level, tmp_path / level)
        said = {call: sizes[k] for call, sizes in stated.paths}
        if f"{GCC} {version()}" == stack.COMPILER:
            assert found == said, UPDATE
        else:  # another compiler's registers and places: of the same size, and no bug of ours
            assert all(0.7 * said[call] < found[call] < 1.3 * said[call] for call in CALLS)


@pytest.mark.parametrize("name", MACHINES)
def test_page_states_it(name: str, repo_root: Path) -> None:
    machine = load_machine(name)
    page = (repo_root / "generated" / name / "README.md").read_text()
    stated = stack.measured_stack(machine.digest[:12])
    assert stated is not None and f"{stack.COMPILER} for a Cortex-M7" in page
    for call, sizes in stated.paths:
        assert f"| {call}() | {' | '.join(map(str, sizes))} |" in page


def test_page_of_another_machine_says_how_to_measure(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text('name = "own"\nextends = "etel_xy"\n[plant]\nmass = 12.0\n')
    page = emit_package(load_machine(own), selftest=False).files["README.md"]
    assert "sgms-mhe target" in page and stack.COMPILER not in page


def test_no_machine_is_measured_that_is_not_committed() -> None:
    assert set(measured_stack.MEASURED) == {load_machine(name).digest[:12] for name in MACHINES}, UPDATE


def written_table(rows: dict[str, tuple[str, dict[str, tuple[int, ...]]]]) -> str:
    """The module, as ruff formats it."""
    lines = [
        '"""Bytes of stack of each call, by digest of the machine file; tests/test_stated_stack.py writes it."""',
        "",
    ]
    lines += ["from __future__ import annotations", "", "from collections.abc import Mapping"]
    lines += ["from types import MappingProxyType", "from typing import Final", ""]
    lines += ["MEASURED: Final[Mapping[str, Mapping[str, tuple[int, ...]]]] = MappingProxyType(", "    {"]
    for digest, (name, calls) in rows.items():
        lines += [f'        "{digest}": {{  # {name}']
        lines += [f'            "{call}": {sizes},' for call, sizes in calls.items()] + ["        },"]
    return "\n".join([*lines, "    }", ")", ""])


def update(report: Callable[[str], object]) -> None:
    """Measure all committed machines and write the table."""
    rows = {}
    for name in MACHINES:
        machine = load_machine(name)
        package = emit_package(machine, selftest=False)
        with tempfile.TemporaryDirectory() as scratch:
            found = [measured(package, level, Path(scratch) / level) for level in stack.LEVELS]
        rows[machine.digest[:12]] = (name, {call: tuple(sizes[call] for sizes in found) for call in CALLS})
        report(name)
    Path(measured_stack.__file__).write_text(written_table(rows))


if __name__ == "__main__":
    if sys.argv[1:] != ["--update"]:
        sys.exit(__doc__)
    if f"{GCC} {version()}" != stack.COMPILER:
        sys.exit(f"{GCC} {version()} is not {stack.COMPILER}: name it in emission/stack.py first")
    update(print)
