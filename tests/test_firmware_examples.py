"""The examples of a bare target and of two tasks: run on a host, the slow task interrupted at every point."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from c_packages import PROBES, STRICT, build, compile_object, run, written
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import emit_package

FIRMWARE = Path(__file__).parents[1] / "examples" / "firmware"
UPDATES, SAMPLES = 700, 100

Program = Callable[..., tuple[list[str], list[int]]]


@pytest.fixture(scope="module")
def programs(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Program]:
    """A program by an example's name: called with arguments it gives the forces' bits and what the board counted."""
    scratch = tmp_path_factory.mktemp("firmware")
    folder = written(emit_package(load_machine("etel_xy_controller")), scratch)
    gcc, options = require_tool("gcc"), [*STRICT, "-O1", f"-I{folder}", f"-I{FIRMWARE}"]
    package = compile_object(gcc, folder / "etel_xy_controller.c", options, "-finstrument-functions")
    selftest = folder / "etel_xy_controller_selftest.c"
    for name in ("bare", "two_tasks"):
        compile_object(gcc, FIRMWARE / f"{name}.c", options)
        example = compile_object(gcc, FIRMWARE / f"{name}.c", options, "-Wno-missing-prototypes", "-Dmain=example")
        build(gcc, [PROBES / "board.c", example, package, selftest], scratch / name, options)

    def program(name: str) -> Program:
        def ran(*arguments: str) -> tuple[list[str], list[int]]:
            *forces, counts = run(scratch / name, *arguments).splitlines()
            return forces, [int(word) for word in counts.split()]

        return ran

    return program


def numbers(forces: list[str]) -> np.ndarray:
    return np.array([int(bits, 16) for bits in forces], dtype=np.uint32).view(np.float32)


@pytest.mark.slow
def test_bare_and_two_tasks_feed_the_same_forward(programs: Callable[[str], Program]) -> None:
    (bare, _), (tasks, _) = programs("bare")(), programs("two_tasks")()
    assert len(bare) == len(tasks) == UPDATES * SAMPLES + 1
    differ = {k for k, pair in enumerate(zip(bare, tasks, strict=True)) if pair[0] != pair[1]}
    assert differ <= set(range(0, len(bare), SAMPLES))  # there the one task has the new estimate already
    assert np.abs(numbers(tasks)).max() > 1.0 and len(set(tasks)) > 1000


def test_interruptions_at_every_point_of_the_slow_task_change_no_bit(programs: Callable[[str], Program]) -> None:
    """In more than half of the updates every function entered is one where the fast task comes in, then or later."""
    program = programs("two_tasks")
    alone, (_, entries, _) = program()
    assert entries > 20
    forces, (interrupted, _, whole) = program("everywhere")
    assert forces == alone
    assert interrupted > 10 * UPDATES and whole >= UPDATES // 2


def test_late_slow_task_is_refused_and_recovers(programs: Callable[[str], Program]) -> None:
    """Feedback comes into prepare: OVERLAP, the next sample asks again, and what is fed forward stays a number."""
    forces, (interrupted, _, _) = programs("two_tasks")("late", "10")
    alone, _ = programs("two_tasks")()
    assert interrupted >= UPDATES // 20 and forces != alone
    assert np.isfinite(numbers(forces)).all() and np.abs(numbers(forces)).max() < 60.0


def test_package_of_another_header_is_not_started(require_tool: Callable[[str], str], tmp_path: Path) -> None:
    folder = written(emit_package(load_machine("etel_xy_controller"), selftest=False), tmp_path)
    (tmp_path / "selftest.c").write_text(
        '#include "etel_xy_controller.h"\nint etel_xy_controller_selftest_with(etel_xy_controller_t *axis)'
        " { return axis == 0; }\n"
    )
    compile_c = [require_tool("gcc"), "-std=c99", "-O1", f"-I{folder}", f"-I{FIRMWARE}"]
    run(compile_c, "-c", folder / "etel_xy_controller.c", "-o", tmp_path / "package.o")
    header = folder / "etel_xy_controller.h"
    text, count = re.subn(r"(_HEADER 0x)[0-9a-f]{8}u", r"\g<1>00000000u", header.read_text())
    assert count == 1
    header.write_text(text)
    for name in ("bare", "two_tasks"):
        program, example = tmp_path / name, tmp_path / "example.o"
        run(compile_c, "-Dmain=example", "-c", FIRMWARE / f"{name}.c", "-o", example)
        main = tmp_path / "main.c"
        main.write_text("int example(void);\nint main(void) { return example() != 1; }\n")
        board = (PROBES / "board.c").read_text().partition("/* The example's own main")[0]
        (tmp_path / "board.c").write_text(board)
        objects = [example, tmp_path / "package.o", tmp_path / "selftest.c", tmp_path / "board.c", main]
        run(compile_c, *objects, "-o", program)
        assert "another header" in run(program)
