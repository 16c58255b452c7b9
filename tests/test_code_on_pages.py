"""Code on the pages: every block is run, compiled or at least parsed by what would run it; what is not says why."""

import importlib.util
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import numpy as np
import pytest

from cli_cases import done, run
from sgms_mhe.cli import cli, command_names
from sgms_mhe.support.toolchain import WARNING_FLAGS

ROOT = Path(__file__).resolve().parents[1]
PAGES = {path.relative_to(ROOT).as_posix(): path for path in sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])}
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)

WITHOUT_CODE = {"", "math", "text"}
"""Blocks that are no code: formulas, tables, what a command prints, folders."""

NO_TOOL = {"matlab": "MATLAB is nowhere that tests run"}
"""Languages that nothing here can run or parse, and why."""

HELD_ELSEWHERE = {
    ("README.md", "c"): "test_readme.py::test_c_example_says_the_same_in_both_precisions",
    ("docs/own_axis.md", "c"): "test_readme.py::test_c_example_says_the_same_in_both_precisions",
    ("docs/python.md", "python"): "test_api.py::test_code_on_the_page_runs",
    ("docs/walk.md", "sh"): "test_walk.py::test_from_a_trace_to_firmware",
}
"""Blocks of a page that a test of their own runs."""

NEITHER_RUN_NOR_PARSED = {
    ('eval "$(_SGMS_MHE_COMPLETE=bash_source sgms-mhe)"', "a shell's start file; test_terminal.py completes"),
    ('eval "$(_SGMS_MHE_COMPLETE=zsh_source sgms-mhe)"', "a shell's start file; test_terminal.py completes"),
    ("_SGMS_MHE_COMPLETE=fish_source sgms-mhe | source", "a shell's start file; test_terminal.py completes"),
    ('export PATH="$PWD/.venv/bin:$PATH"', "of the reader's shell alone"),
    ("logger | sgms-mhe watch my_axis.toml -", "whatever writes the samples; test_watch.py"),
}
"""Lines of shell that no test looks into, and why."""

ONLY_PARSED = {
    "diagnose": "a minute; the walk runs it",
    "identify": "a minute; test_identification.py",
    "compare": "a quarter of a minute; the walk runs it",
    "target": "an emulated core; the walk runs it",
    "bench": "counts instructions; test_cli_bench.py",
}
"""Commands of the pages in RUN that are parsed there, not run, and why."""

RUN = ("README.md", "docs/own_axis.md", "docs/logs.md")
"""Pages whose commands are run, one after the other, on the machine file of the README and a log of it."""


def blocks(page: str) -> list[tuple[str, str]]:
    """Language and text of all blocks of a page."""
    return FENCE.findall(PAGES[page].read_text(encoding="utf-8"))


def lines(page: str) -> Iterator[str]:
    """Lines of shell on a page, continued ones joined, without comments and the synopses of commands."""
    for language, block in blocks(page):
        if language == "sh" and not is_synopsis(page, block):
            for line in block.replace("\\\n", " ").splitlines():
                bare = re.sub(r"\s+#.*$|^#.*$", "", line).strip()
                if bare:
                    yield bare


def is_synopsis(page: str, block: str) -> bool:
    """Whether a block states what a command takes; test_docs.py holds these against the command's options."""
    return page == "docs/commands.md" and bool(re.match(rf"sgms-mhe ({'|'.join(command_names())})\b", block))


def test_every_block_is_held() -> None:
    unheld = []
    for page in PAGES:
        for language, block in blocks(page):
            here = language in ("sh", "toml", *NO_TOOL) or (page, language) in HELD_ELSEWHERE
            if language in WITHOUT_CODE:
                here = not re.search(r"^(\$ )?(sgms-mhe|make|python|pip) ", block, flags=re.MULTILINE)
            if not (here or (page == "docs/bindings.md" and language in ("python", "cpp"))):
                unheld.append((page, language, block[:60]))
    assert unheld == []


def test_tests_that_hold_blocks_exist() -> None:
    for (page, language), place in HELD_ELSEWHERE.items():
        assert language in [own for own, _ in blocks(page)]
        file, _, name = place.partition("::")
        source = (ROOT / "tests" / file).read_text(encoding="utf-8")
        assert f"def {name}(" in source and Path(page).name in source


def test_reasons_are_of_lines_that_stand_there() -> None:
    found = Counter(line for page in PAGES for line in lines(page))
    assert {line for line, _ in NEITHER_RUN_NOR_PARSED if found[line] == 0} == set()
    assert set(ONLY_PARSED) <= {line.split()[1] for page in RUN for line in lines(page) if line.startswith("sgms-mhe")}


# --- shell: every line is parsed by what would run it ----------------------------------------------------------------


def parse_command(arguments: list[str]) -> None:
    """By the command itself: its options, their types and ranges, what is required."""
    context = click.Context(cli, info_name="sgms-mhe")
    command = cli.get_command(context, arguments[0])
    assert command is not None, f"sgms-mhe {arguments[0]}"
    command.make_context(arguments[0], arguments[1:], parent=context)


def parse_make(arguments: list[str]) -> None:
    """By make, which says what it would do."""
    command = ["make", "--dry-run", "--old-file=.venv/.installed", *arguments]
    asked = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert asked.returncode == 0 and asked.stdout, asked.stderr


def parse_python(arguments: list[str]) -> None:
    """A module that can be found, with files that exist; or a script of the repository that compiles."""
    if arguments[0] == "-m":
        assert importlib.util.find_spec(arguments[1]) is not None, arguments[1]
        assert all((ROOT / path).is_file() for path in arguments[2:] if path.endswith(".py"))
    else:
        compile((ROOT / arguments[0]).read_text(encoding="utf-8"), arguments[0], "exec")


def parse_pip(arguments: list[str]) -> None:
    """A distribution of the repository, or an extra of this one."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert arguments[0] == "install"
    for wanted in arguments[1:]:
        extra = re.fullmatch(r"sgms-mhe\[([\w,]+)\]", wanted)
        known = set(extra[1].split(",")) <= set(extras) if extra else (ROOT / wanted / "pyproject.toml").is_file()
        assert known, wanted


def parse_bash(arguments: list[str]) -> None:
    """By bash, which reads it without running it."""
    subprocess.run(["bash", "-n", str(ROOT / arguments[0])], check=True)


PARSERS: dict[str, Callable[[list[str]], None]] = {
    "sgms-mhe": parse_command,
    "make": parse_make,
    "python": parse_python,
    "pip": parse_pip,
    "bash": parse_bash,
}


@pytest.mark.parametrize("page", [page for page in PAGES if any(lines(page)) and (page, "sh") not in HELD_ELSEWHERE])
def test_every_line_of_shell_is_understood(page: str) -> None:
    excused = {line for line, _ in NEITHER_RUN_NOR_PARSED}
    for line in lines(page):
        if line not in excused:
            program, *arguments = shlex.split(line)
            PARSERS[program.removeprefix(".venv/bin/")](arguments)


def test_make_says_what_it_will_do_before_it_does() -> None:
    def said(*goals: str) -> str:
        command = ["make", "--dry-run", "--old-file=.venv/.installed", *goals]
        ours = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
        return subprocess.run(command, cwd=ROOT, env=ours, capture_output=True, text=True, check=True).stdout

    first = said().splitlines()[:6]
    steps = [line.split()[0] for line in first[1:5]]
    assert first[0].startswith("make: what it will do") and steps == ["environment", "package", "compile", "experiment"]
    assert all(re.match(r"  \w+ +(is there|\d+ (s|min))  ", line) for line in first[1:5])
    assert "generate" in first[5] and said("all") == said()
    assert "what it will do" not in said("experiment")


# --- shell: what takes seconds is run --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the README's machine file and a log of its axis."""
    folder = tmp_path_factory.mktemp("pages")
    (machine,) = [block for language, block in blocks("README.md") if language == "toml"]
    (folder / "my_axis.toml").write_text(machine, encoding="utf-8")
    done("simulate", folder / "my_axis.toml", "--out", folder / "log.csv", "--duration", "2")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN)
def test_commands_of_a_page_run(page: str, bench: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = [shlex.split(line)[1:] for line in lines(page) if line.startswith("sgms-mhe ")]
    assert asked
    for name, *arguments in asked:
        if name not in ONLY_PARSED:
            # `start` without a log writes the machine file that the others read.
            monkeypatch.chdir(tmp_path if name == "start" and "--rate" in arguments else bench)
            result = run(name, *arguments)
            assert result.exit_code == 0, f"{name} {arguments}\n{result.output}"


# --- Python and C++ of the bindings ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_bindings_of_the_page(
    require_tool: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "etel_xy"
    done("generate", "etel_xy", "--out", package, "--bindings", "python,cpp")
    found = blocks("docs/bindings.md")
    monkeypatch.syspath_prepend(package)
    monkeypatch.delitem(sys.modules, "etel_xy", raising=False)
    samples = np.arange(1500)
    names: dict[str, object] = {"position": 1e-3 * np.sin(2e-3 * samples), "force": 4.0 * np.cos(2e-3 * samples)}
    for i, block in enumerate(block for language, block in found if language == "python"):
        exec(compile(block, f"docs/bindings.md, Python block {i + 1}", "exec"), names)
    assert isinstance(names["fed"], float) and np.isfinite(names["fed"])
    compiled = [block for language, block in found if language == "cpp"]
    assert compiled
    for i, block in enumerate(compiled):
        source = tmp_path / f"block_{i}.cpp"
        source.write_text(f"int start();\ndouble fast_task(double, double);\n{block}", encoding="utf-8")
        flags = [flag for flag in WARNING_FLAGS if flag != "-Wmissing-prototypes"]
        command = [require_tool("g++"), "-std=c++17", *flags, f"-I{package}", "-fsyntax-only", str(source)]
        subprocess.run(command, check=True)
