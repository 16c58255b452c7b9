"""The stack of the committed packages' calls, in docs/results.md: what the compiler writes down, byte for byte.

python tests/test_stated_stack.py --update    measure again, and write the table
"""

import re
import sys
import tempfile
from pathlib import Path

import pytest

from package_variants import LOOP_WITH_ALL
from sgms_bench.target.stacks import call_paths
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package, write_package
from sgms_mhe.support.toolchain import tool_output

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results.md"
TITLE = "### Stack of the calls\n\n"
UPDATE = "python tests/test_stated_stack.py --update"
GCC, COMPILER = "arm-none-eabi-gcc", "arm-none-eabi-gcc 12.2"
CORE = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard")
LEVELS = ("-O2", "-O3")
CALLS = (
    "init", "init_with", "sample", "insert", "tick", "prepare", "feedback", "estimate",
    "reset", "set_mass", "set_parameter", "hold", "save", "load",
)  # fmt: skip
DRIVE_CALLS = ("drive_init", "drive_force", "drive_command")
"""Of the same machines with a position loop that has all keys, which the committed packages do not have."""
MACHINES = sorted(path.name for path in (ROOT / "generated").iterdir())


def measured(name: str, level: str, folder: Path) -> dict[str, int]:
    """Bytes of each public call's deepest path."""
    bare = load_machine(name)
    found = {}
    for machine, calls in ((bare, CALLS), (override_machine(bare, {"drive": LOOP_WITH_ALL}), DRIVE_CALLS)):
        write_package(emit_package(machine, selftest=False), folder / name)
        source, made = folder / name / f"{name}.c", folder / "package.o"
        tool_output([GCC, "-std=c99", level, *CORE, "-fcallgraph-info=su", "-c", str(source), "-o", str(made)], "gcc")
        paths = call_paths(made.with_suffix(".ci").read_text())
        found |= {call: paths[f"{name}_{call}"] for call in calls}
    return found


def stated() -> dict[str, list[int]]:
    """Bytes of each call as the page has them: of each machine, at each level."""
    section = PAGE.read_text(encoding="utf-8").partition(TITLE)[2].partition("\n#")[0]
    rows = re.findall(r"^\| `(\w+)` \| ([\d| ]+) \|$", section, re.MULTILINE)
    return {call: [int(number) for number in numbers.split(" | ")] for call, numbers in rows}


def version() -> str:
    """Of the compiler, as the page names it."""
    return ".".join(tool_output([GCC, "-dumpfullversion"], "gcc").strip().split(".")[:2])


@pytest.mark.needs_arm
@pytest.mark.parametrize("name", MACHINES)
def test_stated_stack_is_the_measured_one(name: str, tmp_path: Path) -> None:
    page = stated()
    assert list(page) == [*CALLS, *DRIVE_CALLS], UPDATE
    for k, level in enumerate(LEVELS):
        found = measured(name, level, tmp_path / level)
        said = {call: numbers[len(LEVELS) * MACHINES.index(name) + k] for call, numbers in page.items()}
        if f"{GCC} {version()}" == COMPILER:
            assert found == said, UPDATE
        else:  # another compiler's registers and places: of the same size, and no bug of ours
            assert all(0.7 * said[call] < found[call] < 1.3 * said[call] for call in said)


def test_page_of_a_package_says_how_to_measure() -> None:
    page = emit_package(load_machine("etel_xy"), selftest=False).files["README.md"]
    assert "sgms-mhe target" in page and "-fcallgraph-info=su" in page


def update() -> None:
    """Measure all committed machines and write the table."""
    columns = []
    for name in MACHINES:
        for level in LEVELS:
            with tempfile.TemporaryDirectory() as scratch:
                columns.append(measured(name, level, Path(scratch)))
    head = " | ".join(f"`{name}` {level}" if level == LEVELS[0] else level for name in MACHINES for level in LEVELS)
    lines = [
        f"Bytes of the deepest path, with {COMPILER} for a Cortex-M7 whose FPU has both precisions",
        "(`-mfpu=fpv5-d16`), 64 of them for the compiler's library; those of a drive with all keys of a",
        "position loop:",
        "",
        f"| call | {head} |",
        "|" + "---|" * (1 + len(columns)),
        *(f"| `{call}` | {' | '.join(str(column[call]) for column in columns)} |" for call in (*CALLS, *DRIVE_CALLS)),
        "",
    ]
    before, title, after = PAGE.read_text(encoding="utf-8").partition(TITLE)
    PAGE.write_text(before + title + "\n".join(lines) + "\n#" + after.partition("\n#")[2], encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:] != ["--update"]:
        sys.exit(__doc__)
    if f"{GCC} {version()}" != COMPILER:
        sys.exit(f"{GCC} {version()} is not {COMPILER}: name it here first")
    update()
