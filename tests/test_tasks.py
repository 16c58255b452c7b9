"""Two tasks on one axis: a call that comes into another is harmless, or refused; never another number in silence."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from c_packages import PROBES, STRICT, machine, run, written
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import replay_definitions

ESTIMATORS: dict[str, dict[str, Any]] = {
    "all": {"relinearise": "all"},
    "auto": {"relinearise": "auto"},
    "newest": {"relinearise": "newest"},
    "fixed": {"arrival_cost": {"update": "fixed"}},
    "ekf": {"kind": "ekf"},
}
UPDATES = 120


@pytest.fixture(scope="module", params=list(ESTIMATORS))
def interrupted(
    request: pytest.FixtureRequest, require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Callable[[str], tuple[int, int, int, int]]]:
    """Kind of estimator, and what tests/c/preemption.c counts: other task came in, refused, wrong, statuses OVERLAP."""
    kind, scratch = request.param, tmp_path_factory.mktemp("tasks")
    settings = machine(estimator={"horizon": 6, **ESTIMATORS[kind]})
    folder = written(emit_package(settings, selftest=False), scratch)
    compile_c = [require_tool("gcc"), *STRICT, "-O1", f"-I{folder}", *replay_definitions("etel_xy")]
    package, program = scratch / "package.o", scratch / "program"
    run(compile_c, "-finstrument-functions", "-c", folder / "etel_xy.c", "-o", package)
    run(compile_c, PROBES / "preemption.c", package, "-o", program)

    def counts(other: str) -> tuple[int, int, int, int]:
        came_in, refused, wrong, statuses = (int(word) for word in run(program, other).split())
        return came_in, refused, wrong, statuses

    return kind, counts


# --- one task after the other, at chosen places --------------------------------------------------------------------


def test_feedback_inside_of_prepare_is_refused_and_changes_nothing(interrupted: Any) -> None:
    kind, counts = interrupted
    came_in, refused, wrong, _ = counts("feedback")
    assert kind == "ekf" or came_in > 0.75 * UPDATES  # a filter prepares nothing
    assert refused == came_in and wrong == 0


@pytest.mark.parametrize("other", ["prepare", "sample", "prepare_in_feedback"])
def test_calls_that_may_come_into_others_change_nothing(other: str, interrupted: Any) -> None:
    kind, counts = interrupted
    came_in, refused, wrong, statuses = counts(other)
    assert came_in > 0.5 * UPDATES or (kind == "ekf" and "feedback" not in other)
    assert (refused, wrong, statuses) == (0, 0, 0)


def test_reset_inside_of_prepare_is_noticed(interrupted: Any) -> None:
    kind, counts = interrupted
    came_in, _, _, statuses = counts("reset")
    assert kind == "ekf" or came_in > 20
    assert statuses >= came_in - 1  # the last one may be followed by no update


def test_third_task_sees_numbers_of_one_update(interrupted: Any) -> None:
    came_in, refused, wrong, _ = interrupted[1]("estimate_in_feedback")
    assert came_in > 0.5 * UPDATES and wrong == 0
    assert refused < 0.1 * came_in


# --- at the same time ----------------------------------------------------------------------------------------------

SIDE_BY_SIDE = 60
"""Updates of tests/c/threads.c."""
BARRIER = ("-DSGMS_FENCE()=__sync_synchronize()",)
"""What tasks on two cores need."""
SANITIZED = ("-std=gnu11", "-O1", "-g", "-fsanitize=thread")
SHARED = ("-Dvolatile=_Atomic", "-DSGMS_FENCE()=((void)0)")
"""The words by which calls tell of each other, and they alone, are atomic: all else that two tasks share is a race."""
MEETING = ("-finstrument-functions",)


@pytest.fixture(scope="module", params=list(ESTIMATORS))
def threads(
    request: pytest.FixtureRequest, require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Callable[..., Path]]:
    """Kind of estimator, and how to compile tests/c/threads.c with its package: flags of both, flags of the package."""
    kind, scratch = request.param, tmp_path_factory.mktemp("threads")
    settings = machine(estimator={"horizon": 6, **ESTIMATORS[kind]})
    folder = written(emit_package(settings, selftest=False), scratch)
    compile_c = [require_tool("gcc"), f"-I{folder}", *replay_definitions("etel_xy")]

    def compiled(both: Sequence[str], package: Sequence[str]) -> Path:
        made, program = scratch / "package.o", scratch / "program"
        run(compile_c, both, package, "-c", folder / "etel_xy.c", "-o", made)
        atomic = [flag for flag in package if flag == SHARED[0]]
        run(compile_c, both, atomic, PROBES / "threads.c", made, "-pthread", "-o", program)
        return program

    return kind, compiled


def test_interrupt_between_any_two_instructions_changes_nothing(threads: Any) -> None:
    kind, compiled = threads
    updates, met, _, wrong, _ = map(int, run(compiled(["-std=gnu99", "-O2"], []), "interrupt").split())
    assert (updates, wrong) == (SIDE_BY_SIDE, 0)
    assert kind == "ekf" or met > SIDE_BY_SIDE  # samples inside of prepare


def test_threads_come_to_the_estimates_of_one_task(threads: Any) -> None:
    kind, compiled = threads
    updates, met, _, wrong, lost = map(int, run(compiled(["-std=gnu99", "-O2", *BARRIER], MEETING), "patient").split())
    assert (updates, wrong, lost) == (SIDE_BY_SIDE, 0, 0)
    assert kind == "ekf" or met > 10 * SIDE_BY_SIDE


def test_thread_that_does_not_wait_is_told(threads: Any) -> None:
    """Feedback while prepare is under way: OVERLAP each time, and OVERRUN for the samples that came meanwhile."""
    kind, compiled = threads
    updates, _, refused, wrong, lost = map(
        int, run(compiled(["-std=gnu99", "-O2", *BARRIER], MEETING), "hurried").split()
    )
    assert (updates, wrong) == (SIDE_BY_SIDE, 0)
    assert refused == lost == (0 if kind == "ekf" else SIDE_BY_SIDE - 1)  # before the first there is no prepare


def sanitized(program: Path, mode: str, kind: str) -> str:
    """What ThreadSanitizer finds.

    Where all intervals are linearised side by side prepare() reads the series of the one under way as well, as the lane
    of a slot whose result nobody reads: of that one place it says nothing.
    """
    suppressions = program.with_name("suppressions.txt")
    suppressions.write_text("race:^integrate_lanes$\n" if kind in ("all", "fixed") else "")
    environment = os.environ | {"TSAN_OPTIONS": f"exitcode=0 history_size=7 suppressions={suppressions}"}
    return subprocess.run([str(program), mode], env=environment, capture_output=True, text=True, check=True).stderr


@pytest.mark.parametrize("mode", ["patient", "hurried"])
def test_tasks_share_the_words_that_are_told_and_no_others(mode: str, threads: Any) -> None:
    kind, compiled = threads
    found = sanitized(compiled(SANITIZED, [*MEETING, *SHARED]), mode, kind)
    assert "WARNING" not in found, found


def test_sanitizer_would_find_a_shared_word(threads: Any) -> None:
    """Where the words are not atomic it names them."""
    kind, compiled = threads
    found = sanitized(compiled(SANITIZED, MEETING), "patient", kind)
    assert kind == "ekf" or "WARNING: ThreadSanitizer: data race" in found
