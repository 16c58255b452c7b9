"""Lines of emitted C: at most 100 columns whatever names stand in them, and the same code as before."""

import re

import pytest

from package_variants import TOY, VARIANTS
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.bindings import BINDINGS
from sgms_mhe.emission.columns import COLUMNS, wrap_columns
from sgms_mhe.emission.package import Package, emit_package

SHAPES = (
    "flow", "flow, 5 merged, single", "rk4, all", "every effect", "effects: upstream, 5 merged", "switching, levels",
    "switching, 5 merged", "compensation, ekf, single", "geared, compensation", "n_z 10", "linear model", "accuracy",
)  # fmt: skip
"""Variants whose code differs in kind."""


def c_files(package: Package) -> dict[str, str]:
    return {file: text for file, text in package.files.items() if file.endswith((".c", ".h", ".hpp"))}


def long_lines(package: Package) -> list[str]:
    return [f"{f}: {line}" for f, text in c_files(package).items() for line in text.splitlines() if len(line) > COLUMNS]


def tokens(text: str) -> list[str]:
    """Words and signs of C, comments and continued lines aside."""
    code = re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL).replace("\\\n", " ")
    return re.findall(r'"(?:[^"\\]|\\.)*"|[\w.]+|\S', code)


@pytest.mark.parametrize("title", SHAPES)
def test_no_line_is_longer(title: str) -> None:
    assert not long_lines(VARIANTS[title].package)


def test_no_line_is_longer_with_a_long_name_and_every_binding() -> None:
    machine = override_machine(load_machine(TOY), {"name": "n" * 36})
    package = emit_package(machine, bindings=BINDINGS)
    assert any(file.endswith(".hpp") for file in package.files)
    assert not long_lines(package)


@pytest.mark.parametrize("name", ["n" * 30, "a_name_that_is_longer_than_most_of_them"])
def test_code_is_the_same(name: str) -> None:
    """Of lines that a longer name has made too long: the same words in the same order, and nothing left to do."""
    for file, text in c_files(VARIANTS["flow, 5 merged, all"].package).items():
        longer = text.replace("element_", f"{name}_").replace("etel_xy_", f"{name}_")
        within = wrap_columns(longer)
        assert tokens(within) == tokens(longer), file
        assert wrap_columns(within) == within, file


def test_comments_are_filled_and_tables_keep_their_columns() -> None:
    words = "word " * 30
    text = (
        f"/* {words}end.\n * more.\n *\n * short\n * lines\n *   name   {words}end\n *   other  short\n"
        f" * - {words}end\n *   of the item\n */\n"
    )
    lines = wrap_columns(text).splitlines()
    assert all(len(line) <= COLUMNS for line in lines)
    assert lines[0].startswith("/* word") and lines[1].startswith(" * word") and lines[1].endswith("word end. more.")
    assert lines[2:5] == [" *", " * short", " * lines"]
    assert lines[5].startswith(" *   name   word") and lines[6].startswith(" *          word")
    assert " *   other  short" in lines
    item = next(k for k, line in enumerate(lines) if line.startswith(" * - "))
    assert lines[item + 1].startswith(" *   word") and lines[item + 1].endswith("end of the item")
    assert lines[-1] == " */"


def test_a_comment_behind_code_stands_before_it() -> None:
    line = f"    int32_t shifts, pending; /* {'word ' * 20}*/"
    assert wrap_columns(f"{line}\n").splitlines()[-1] == "    int32_t shifts, pending;"


def test_lines_break_outside_of_calls_and_strings() -> None:
    first, second = "f(" + "a, " * 15 + "a)", '"' + "b, " * 15 + '"'
    lines = wrap_columns(f"    x = {first} + {second};\n").splitlines()
    assert lines == [f"    x = {first} +", f"        {second};"]
    macro = wrap_columns(f"#define MACRO {first} + {second}\n").splitlines()
    assert macro[0].endswith(" \\") and len(macro) == 2
