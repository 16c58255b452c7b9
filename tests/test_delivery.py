"""What a package brings beside its C, used as a firmware project would: page, build files, list, digests, licence."""

import hashlib
import json
import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import c_packages
from c_packages import PRECISIONS, STRICT, build, compile_object, run, symbols, written
from package_variants import LOOP_WITH_ALL, VARIANTS
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.support.errors import InputError

Tool = Callable[[str], str]

# The page's functions are called by a firmware; a prototype is all they lack here.
PROTOTYPES = "int start(void);\nREAL fast_task(int64_t, REAL);\nvoid slow_task(void);\n"
MOTION = """
#include <stdio.h>
int main(void)
{
    int status = start();
    for (long k = 0; k <= 6000 && status == 0; k++) {
        const double forth = (double)((k / 1500) % 2 ? 1500 - k % 1500 : k % 1500) / 1500.0;
        printf("%.17g\\n", (double)fast_task((int64_t)((0.3 + 1e-3 * forth) * COUNTS), (k / 1500) % 2 ? -4 : 4));
        SLOW_TASK
    }
    return status;
}
"""
KINDS: dict[str, dict[str, Any]] = {
    "double": {"code": {"precision": "double"}},
    "single": {"code": {"precision": "single"}},
    "ekf": {"code": {"precision": "double"}, "estimator": {"kind": "ekf"}},
    "loop": {"code": {"precision": "single"}, "drive": LOOP_WITH_ALL},
}


@cache
def package_of(kind: str) -> Package:
    """A package with its self-test."""
    if kind == "rotary":
        return emit_package(load_machine("etel_xy_rotary"))
    return c_packages.package_of(selftest=True, **KINDS[kind])


each_kind = pytest.mark.parametrize("kind", ["double", "single", "ekf", "rotary", "loop"])


def blocks(package: Package) -> list[str]:
    """C on the package's page: one task; two tasks; the question for an estimate; a power cycle, with a drive."""
    found = re.findall(r"```c\n(.*?)```", package.files["README.md"], flags=re.DOTALL)
    assert len(found) == 4 + has_drive(package)
    return [*found[:3], "".join(found[3:])]


def has_drive(package: Package) -> bool:
    """True where the command is no force."""
    return package.machine.drive.kind != "force"


@each_kind
def test_lines_of_the_page_compile_and_both_ways_say_the_same(kind: str, require_tool: Tool, tmp_path: Path) -> None:
    """Word for word, every warning an error; what is returned is the same to the last bit."""
    package = package_of(kind)
    one, two, ask, cycle = blocks(package)
    name, folder, said = package.machine.name, written(package, tmp_path), []
    # The page says `start` as above: the block above, with its fast task under another name.
    counts = 2**20 / math.tau if kind == "rotary" else 1e9
    prototypes = f'#include "{name}.h"\n#define COUNTS {counts}\n' + PROTOTYPES.replace("REAL", f"{name}_real")
    above = f"#define fast_task unused_fast_task\n{prototypes}{one}#undef fast_task\n"
    question = f"int ask({name}_estimate_t *estimate);\n{ask}"
    question += f"int after_power_on({name}_saved_t *);\nint before_power_off({name}_saved_t *);\n"
    if has_drive(package):
        question += f"{name}_real commanded_task({name}_position, {name}_position, bool);\n"
    question += cycle
    programs = {
        "one": (prototypes + one + question + MOTION, ""),
        "two": (above + prototypes + two + MOTION, "if (k % 100 == 40) slow_task();"),
    }
    for title, (text, slow) in programs.items():
        source, program = tmp_path / f"{title}.c", tmp_path / title
        source.write_text(text.replace("SLOW_TASK", slow), encoding="utf-8")
        options = [*STRICT, "-Wno-redundant-decls", "-O1", f"-I{folder}"]
        build(require_tool("gcc"), [source, *sorted(folder.glob("*.c"))], program, options)
        said.append(run(program).splitlines())
    assert len(said[0]) == 6001 and said[0] == said[1]
    assert max(abs(float(line)) for line in said[0]) > 0.1


def test_integration_is_ten_lines() -> None:
    """But for blank lines, comments and braces that stand alone."""
    one = re.sub(r"/\*.*?\*/", "", blocks(package_of("double"))[0])
    assert len([line for line in one.splitlines() if line.strip(" {}")]) <= 10


@each_kind
def test_page_states_sizes_as_compilers_find_them(kind: str, require_tool: Tool, tmp_path: Path) -> None:
    package = package_of(kind)
    name, folder = package.machine.name, written(package, tmp_path)
    page = package.files["README.md"]
    stated = {what: int(size) for size, what in re.findall(r"\| (\d+) \| `sizeof\((\w+)\)`", page)}
    assert stated.keys() == {f"{name}_t", f"{name}_estimate_t"} | ({f"{name}_drive_t"} if has_drive(package) else set())
    checks = "".join(f"char {what}_is[sizeof({what}) == {size} ? 1 : -1];\n" for what, size in stated.items())
    (tmp_path / "sizes.c").write_text(f'#include "{name}.h"\n{checks}')
    run(require_tool("gcc"), "-std=c99", f"-I{folder}", "-c", tmp_path / "sizes.c", "-o", tmp_path / "sizes.o")
    # Without optimization every constant is in the object as it is declared.
    whole = compile_object(require_tool("gcc"), folder / f"{name}.c", "-std=c99", "-O0")
    rows = [line.split() for line in run("nm", "-S", whole).splitlines()]
    tables = {row[3].partition(".")[0]: int(row[1], 16) for row in rows if len(row) == 4 and row[2] in "rd"}
    arrays = {n: size for n, size in tables.items() if n not in ("chain", "flow_table", "__func__", "zero")}
    (found,) = re.findall(r"\| flash, tables \| (\d+) \|", page)
    assert sum(arrays.values()) == int(found), arrays


@pytest.mark.needs_arm
def test_sizes_are_those_of_the_target(require_tool: Tool, tmp_path: Path) -> None:
    package = package_of("single")
    folder, page = written(package, tmp_path), package.files["README.md"]
    checks = [f"char a{size}[sizeof({what}) == {size} ? 1 : -1];" for size, what in
              re.findall(r"\| (\d+) \| `sizeof\((\w+)\)`", page)]  # fmt: skip
    (tmp_path / "sizes.c").write_text('#include "etel_xy.h"\n' + "\n".join(checks))
    run(require_tool("arm-none-eabi-gcc"), "-std=c99", f"-I{folder}", "-fsyntax-only", tmp_path / "sizes.c")


def linkable(package: Package) -> set[str]:
    """Names that the page says a compiler may call."""
    section = package.files["README.md"].partition("## What it links\n")[2].partition("\n## ")[0]
    return {name for row in section.splitlines() if row.startswith("| `") for name in
            re.findall(r"`(\w+)`", row.split("|")[1])}  # fmt: skip


COMPILERS = [
    *(("gcc", (level,)) for level in ("-O0", "-O2", "-Os", "-O3")),
    ("clang", ("-O2",)),
    ("arm-none-eabi-gcc", ("-O2", "-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard")),
    ("arm-none-eabi-gcc", ("-Os", "-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")),
    ("riscv64-unknown-elf-gcc", ("-O2", "-march=rv32imafc", "-mabi=ilp32f")),
]


@pytest.mark.parametrize(
    ("compiler", "flags"), COMPILERS, ids=lambda value: value if isinstance(value, str) else value[0]
)
@pytest.mark.parametrize("kind", ["double", "single", "clock"])
def test_links_nothing_but_what_the_page_names(
    kind: str, compiler: str, flags: tuple[str, ...], require_tool: Tool, tmp_path: Path
) -> None:
    if kind == "double" and compiler.startswith(("arm", "riscv")):
        return  # these cores have no double precision: a library for it is the application's choice
    package = VARIANTS["effects: time, ekf, single"].package if kind == "clock" else package_of(kind)
    folder, tool = written(package, tmp_path), require_tool(compiler)
    options = ["-std=c99", *flags, "-ffreestanding", "-fno-stack-protector", "-fno-pie"]
    made = [compile_object(tool, source, options) for source in sorted(folder.glob("*.c"))]
    found = [row for path in made for row in symbols(path)]
    defined = {name for symbol, name in found if symbol != "U"}
    assert {name for symbol, name in found if symbol == "U"} - defined <= linkable(package)


def test_no_other_library_is_named_where_it_is_not_needed() -> None:
    assert linkable(package_of("double")) == {"memcpy", "memmove", "memset"}


# --- list, digests, licence --------------------------------------------------------------------------------------


@each_kind
def test_list_digests_and_licence(kind: str, repo_root: Path) -> None:
    files = package_of(kind).files
    listed = files["files.txt"].splitlines()
    assert sorted(listed) == sorted(file for file in files if file.endswith((".c", ".h"))) == sorted(set(listed))
    manifest = json.loads(files["MANIFEST.json"])
    assert manifest["sha256"] == {
        file: hashlib.sha256(text.encode()).hexdigest() for file, text in files.items() if file != "MANIFEST.json"
    }
    banner = files["README.md"].splitlines()[0]
    assert f"{manifest['generator']} from machine {manifest['machine_digest']}." in banner
    assert files["LICENSE"] == (repo_root / "LICENSE").read_text(encoding="utf-8")


# --- CMake, pkg-config -------------------------------------------------------------------------------------------

CONSUMER = """cmake_minimum_required(VERSION 3.13)
project(firmware LANGUAGES C)
{found}
add_executable(firmware main.c)
target_link_libraries(firmware etel_xy::etel_xy)
"""
MAIN = '#include "etel_xy.h"\nint main(void)\n{\n    return etel_xy_selftest();\n}\n'


def built(cmake: str, source: Path, build: Path, *options: str) -> str:
    """Configure and build; what the tool prints."""
    run(cmake, "-S", source, "-B", build, "-DCMAKE_BUILD_TYPE=Release", *options)
    return run(cmake, "--build", build)


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
def test_cmake_builds_installs_and_is_found(precision: str, require_tool: Tool, tmp_path: Path) -> None:
    """Without a warning; from another project as a folder, as an installed package, and by pkg-config."""
    cmake, prefix = require_tool("cmake"), tmp_path / "prefix"
    folder = written(package_of(precision), tmp_path)
    before = {path.name for path in folder.iterdir()}
    said = built(cmake, folder, tmp_path / "library", "-DCMAKE_C_FLAGS=-Werror", f"-DCMAKE_INSTALL_PREFIX={prefix}")
    assert "warning" not in said
    run(cmake, "--install", tmp_path / "library")
    assert {path.name for path in folder.iterdir()} == before
    assert [path.name for path in (prefix / "include").iterdir()] == ["etel_xy.h"]
    consumers = {
        "folder": f"add_subdirectory({folder} etel_xy)",
        "installed": "find_package(etel_xy 0.2.0 REQUIRED CONFIG)",
        "minor": "find_package(etel_xy 0.2 REQUIRED CONFIG)",
    }
    for title, found in consumers.items():
        source = tmp_path / title
        source.mkdir()
        (source / "main.c").write_text(MAIN)
        (source / "CMakeLists.txt").write_text(CONSUMER.format(found=found))
        built(cmake, source, source / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
        run(source / "build" / "firmware")
    (pc,) = prefix.rglob("etel_xy.pc")
    flags = run("env", f"PKG_CONFIG_PATH={pc.parent}", require_tool("pkg-config"), "--cflags", "--libs", "etel_xy")
    run(require_tool("gcc"), tmp_path / "folder" / "main.c", *flags.split(), "-o", tmp_path / "program")
    run(tmp_path / "program")


@pytest.mark.slow
def test_cmake_installs_nothing_of_a_folder_in_another_project(require_tool: Tool, tmp_path: Path) -> None:
    cmake, prefix = require_tool("cmake"), tmp_path / "prefix"
    folder = written(package_of("double"), tmp_path)
    (tmp_path / "main.c").write_text(MAIN)
    text = CONSUMER.format(found=f"add_subdirectory({folder} etel_xy)")
    (tmp_path / "CMakeLists.txt").write_text(text + "install(TARGETS firmware DESTINATION bin)\n")
    built(cmake, tmp_path, tmp_path / "build", f"-DCMAKE_INSTALL_PREFIX={prefix}")
    run(cmake, "--install", tmp_path / "build")
    assert [path.relative_to(prefix).as_posix() for path in prefix.rglob("*") if path.is_file()] == ["bin/firmware"]


@pytest.mark.slow
def test_cmake_refuses_an_earlier_minor_version(require_tool: Tool, tmp_path: Path) -> None:
    cmake, prefix = require_tool("cmake"), tmp_path / "prefix"
    folder = written(package_of("double"), tmp_path)
    built(cmake, folder, tmp_path / "library", f"-DCMAKE_INSTALL_PREFIX={prefix}")
    run(cmake, "--install", tmp_path / "library")
    source = tmp_path / "other"
    source.mkdir()
    (source / "main.c").write_text(MAIN)
    found = "find_package(etel_xy 0.1 CONFIG)\nif(etel_xy_FOUND)\n  message(FATAL_ERROR found)\nendif()\nreturn()"
    (source / "CMakeLists.txt").write_text(CONSUMER.format(found=found))
    run(cmake, "-S", source, "-B", source / "build", f"-DCMAKE_PREFIX_PATH={prefix}")


@pytest.mark.slow
def test_cmake_installs_the_header_of_cplusplus(require_tool: Tool, bound: Any, tmp_path: Path) -> None:
    cmake, prefix = require_tool("cmake"), tmp_path / "prefix"
    built(cmake, bound("double").folder, tmp_path / "library", f"-DCMAKE_INSTALL_PREFIX={prefix}")
    run(cmake, "--install", tmp_path / "library")
    assert {path.name for path in (prefix / "include").iterdir()} == {"etel_xy.h", "etel_xy.hpp"}
    (tmp_path / "main.cpp").write_text('#include "etel_xy.hpp"\nint main() { return 0; }\n')
    run(require_tool("g++"), "-std=c++11", f"-I{prefix / 'include'}", "-c", tmp_path / "main.cpp", "-o", tmp_path / "o")


# --- the folder that is replaced ---------------------------------------------------------------------------------


def test_only_a_package_is_replaced(tmp_path: Path) -> None:
    """What looks like a package's files and is listed by no manifest stays, and nothing is written."""
    package = package_of("double")
    for file in ("README.md", "LICENSE", "CMakeLists.txt", "MANIFEST.json"):
        folder = tmp_path / file
        folder.mkdir()
        (folder / file).write_text("mine")
        with pytest.raises(InputError, match=re.escape(file)):
            write_package(package, folder)
        assert [path.name for path in folder.iterdir()] == [file] and (folder / file).read_text() == "mine"
    folder = written(package, tmp_path)
    write_package(package_of("ekf"), folder)
    assert not (folder / "etel_xy_notes.c").exists()
    (folder / "etel_xy_notes.c").write_text("mine")
    with pytest.raises(InputError, match=r"etel_xy_notes\.c"):
        write_package(package, folder)
    assert (folder / "etel_xy_notes.c").read_text() == "mine"


def test_package_without_a_manifest_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "etel_xy"
    folder.mkdir()
    for file in ("etel_xy.c", "etel_xy.h", "structure.txt"):
        (folder / file).write_text("of an earlier version")
    write_package(package_of("double"), folder)
    assert {path.name for path in folder.iterdir()} == set(package_of("double").files)


def test_an_interrupted_write_leaves_the_folder_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = written(package_of("double"), tmp_path)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    calls: list[Path] = []

    def write_bytes(self: Path, *arguments: Any, **named: Any) -> int:
        calls.append(self)
        if len(calls) > 5:
            raise OSError(28, "No space left on device")
        return len(arguments)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    with pytest.raises(InputError, match="No space"):
        write_package(package_of("ekf"), folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["etel_xy"]
