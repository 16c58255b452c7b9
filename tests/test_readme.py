"""C examples of the documents compile against the committed package, with every warning an error."""

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from c_packages import run
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package, write_package
from sgms_mhe.support.toolchain import WARNING_FLAGS, compiler

Tool = Callable[[str], str]

# The examples' functions are called by a firmware; a prototype is all they lack here.
PROTOTYPES = {
    "README.md": "void start(void);\netel_xy_real control_tick(int64_t, etel_xy_real);\n"
    "int first_stiffness(etel_xy_real *, etel_xy_real *);\n",
    "docs/own_axis.md": "etel_xy_real fast_task(int64_t, etel_xy_real);\nvoid slow_task(void);\n",
}


# What a firmware would do with each: a motion through the examples' functions, prints what they say.
FIRMWARE = {
    "README.md": """
        start();
        for (long k = 0; k <= 3000; k++) {
            printf("%.9g\\n", (double)control_tick(COUNT(k), FORCE(k)));
        }
        status = first_stiffness(&value, &deviation);
        printf("%.9g %.9g %d\\n", (double)value, (double)deviation, status);""",
    "docs/own_axis.md": """
        etel_xy_init(&axis);
        for (long k = 0; k <= 3000; k++) {
            printf("%.9g\\n", (double)fast_task(COUNT(k), FORCE(k)));
            slow_task();
        }""",
}
MOTION = """
#include <stdio.h>
#define COUNT(k) (300000000 + 1000000 * ((k) < 1500 ? (k) : 3000 - (k)) / 1500)
#define FORCE(k) ((k) < 1500 ? 4 : -4)
"""


def example_of(repo_root: Path, page: str) -> str:
    """All C on a page, as one source."""
    blocks = re.findall(r"```c\n(.*?)```", (repo_root / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks, f"{page} has no C example"
    return '#include "etel_xy.h"\n' + PROTOTYPES[page] + "\n".join(blocks)


@pytest.mark.parametrize("page", PROTOTYPES)
def test_c_example_says_the_same_in_both_precisions(page: str, repo_root: Path, tmp_path: Path) -> None:
    """Word for word, every warning an error, linked to the package in double and in single precision, and run."""
    program = f"int main(void)\n{{\netel_xy_real value = 0, deviation = 0; int status = 0;{FIRMWARE[page]}\n"
    program += "(void)value; (void)deviation; (void)status; return 0;\n}\n"
    said = []
    for precision in ("double", "single"):
        changes = {"code": {"precision": precision}, "compensation": {"enabled": True}}
        settings = override_machine(load_machine("etel_xy"), changes)
        folder = tmp_path / precision / "etel_xy"
        write_package(emit_package(settings, selftest=False), folder)
        source = tmp_path / f"{precision}.c"
        source.write_text(example_of(repo_root, page) + MOTION + program, encoding="utf-8")
        files = [f"-I{folder}", str(source), str(folder / "etel_xy.c"), "-o", str(tmp_path / precision / "program")]
        subprocess.run([*compiler(), "-std=c99", *WARNING_FLAGS, "-O1", *files], check=True)
        done = subprocess.run([files[-1]], capture_output=True, text=True, check=True)
        said.append([[float(word) for word in line.split()] for line in done.stdout.splitlines()])
    double, single = (np.array([row[0] for row in rows[:3001]]) for rows in said)
    assert np.abs(double).max() > 1.0
    np.testing.assert_allclose(single, double, atol=2e-3 * np.abs(double).max())
    for a, b in zip(said[0][3001:], said[1][3001:], strict=True):
        assert a == pytest.approx(b, rel=1e-2)


@pytest.mark.needs_arm
@pytest.mark.parametrize("page", PROTOTYPES)
def test_c_example_computes_nothing_in_double(page: str, repo_root: Path, require_tool: Tool, tmp_path: Path) -> None:
    """On a core whose hardware has single precision alone, the package in single precision."""
    settings = override_machine(load_machine("etel_xy"), {"code": {"precision": "single"}})
    write_package(emit_package(settings, selftest=False), tmp_path / "etel_xy")
    source, target = tmp_path / "example.c", tmp_path / "example.o"
    source.write_text(example_of(repo_root, page), encoding="utf-8")
    flags = [*WARNING_FLAGS, "-std=c99", "-O2", "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"]
    run(require_tool("arm-none-eabi-gcc"), flags, f"-I{tmp_path}/etel_xy", "-c", source, "-o", target)
    called = set(re.findall(r" U (\w+)", run(require_tool("arm-none-eabi-nm"), target)))
    assert "etel_xy_init" in called or page != "README.md"
    assert [name for name in called if re.search(r"aeabi_(d|\w+2d$)", name)] == []


def test_metres_do_not_become_a_position_by_themselves(repo_root: Path, tmp_path: Path) -> None:
    """In single precision: the call that is right in double precision does not compile."""
    source = tmp_path / "example.c"
    source.write_text(
        '#include "etel_xy_controller.h"\n'
        "float call(etel_xy_controller_t *axis, double metres);\n"
        "float call(etel_xy_controller_t *axis, double metres)\n"
        "{\n    return etel_xy_controller_tick(axis, metres, 1.0f);\n}\n",
        encoding="utf-8",
    )
    package = repo_root / "generated" / "etel_xy_controller"
    command = [*compiler(), "-std=c99", f"-I{package}", "-fsyntax-only", str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "etel_xy_controller_position" in done.stderr


@pytest.mark.parametrize("page", PROTOTYPES)
def test_c_example_compiles(page: str, repo_root: Path, tmp_path: Path) -> None:
    source = tmp_path / "example.c"
    source.write_text(example_of(repo_root, page), encoding="utf-8")
    package = repo_root / "generated" / "etel_xy"
    done = subprocess.run(
        [*compiler(), "-std=c99", *WARNING_FLAGS, f"-I{package}", "-c", str(source), "-o", str(tmp_path / "example.o")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_every_page_with_c_is_compiled(repo_root: Path) -> None:
    pages = [*repo_root.glob("*.md"), *repo_root.glob("docs/*.md")]
    assert {page.relative_to(repo_root).as_posix() for page in pages if "```c\n" in page.read_text("utf-8")} == set(
        PROTOTYPES
    )
