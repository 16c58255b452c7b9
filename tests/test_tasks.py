"""Two tasks on one axis: a call that comes into another is harmless, or refused; never another number in silence."""

import os
import re
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from c_packages import PROBES, STRICT, build, compile_object, machine, run, written
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
    gcc, options = require_tool("gcc"), [*STRICT, "-O1", f"-I{folder}", *replay_definitions("etel_xy")]
    package = compile_object(gcc, folder / "etel_xy.c", options, "-finstrument-functions")
    program = build(gcc, [PROBES / "preemption.c", package], scratch / "program", options)

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


def test_tick_inside_of_prepare_says_so_in_the_estimate(interrupted: Any) -> None:
    kind, counts = interrupted
    came_in, refused, _, statuses = counts("tick")
    assert kind == "ekf" or came_in > 0.75 * UPDATES
    assert refused == came_in and statuses == 0  # feedback() after prepare() is accepted


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


def test_estimate_is_given_after_an_axis_was_started_inside_of_feedback(interrupted: Any) -> None:
    """The header forbids it; the mark of numbers half written does not stay for that."""
    came_in, refused, _, _ = interrupted[1]("init_in_feedback")
    assert came_in > 0.9 * UPDATES and refused == 0


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="the trap flag is x86-64's")
@pytest.mark.parametrize("kind", ["auto", "ekf"])
def test_estimate_is_of_one_update_after_every_instruction(
    kind: str, require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    """Before a call or after it, in every bit: also where there is no solution and the window starts anew."""
    package = emit_package(machine(estimator={"horizon": 6, **ESTIMATORS[kind]}), selftest=False)
    folder = written(package, tmp_path)
    options = ["-std=gnu99", "-O2", f"-I{folder}", *replay_definitions("etel_xy")]
    sources = [PROBES / "single_steps.c", folder / "etel_xy.c"]
    program = build(require_tool("gcc"), sources, tmp_path / "program", options)
    numeric, filling = -2, 1
    for call, status in (("feedback", None), ("numeric", numeric), ("reset", filling), ("hold", filling)):
        came_in, refused, wrong, before, after, updates, cause = map(int, run(program, call).split())
        assert came_in > 100 and wrong == 0, call
        assert before >= 0 and (after == status if status else after >= 0), call
        assert refused > 0, call  # while it is written
        assert updates == (call == "feedback"), call
        assert cause & 1 if call == "numeric" else cause == 0, call  # the state is no number


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
    gcc, options = require_tool("gcc"), [f"-I{folder}", *replay_definitions("etel_xy")]

    def compiled(both: Sequence[str], package: Sequence[str]) -> Path:
        made = compile_object(gcc, folder / "etel_xy.c", options, both, package)
        atomic = [flag for flag in package if flag == SHARED[0]]
        return build(gcc, [PROBES / "threads.c", made], scratch / "program", options, both, atomic, "-pthread")

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


def sanitized(program: Path, mode: str, kind: str) -> list[str]:
    """What ThreadSanitizer finds, one text per race.

    Where all intervals are linearised side by side prepare() reads the series of the one under way as well, as the lane
    of a slot whose result nobody reads: of that one place it says nothing. A read that lies too far back has lost its
    stack, which is then told by the place alone.
    """
    reads_the_series = kind in ("all", "fixed")
    suppressions = program.with_name("suppressions.txt")
    suppressions.write_text("race:^integrate_lanes$\n" if reads_the_series else "")
    environment = os.environ | {"TSAN_OPTIONS": f"exitcode=0 history_size=7 suppressions={suppressions}"}
    printed = subprocess.run([str(program), mode], env=environment, capture_output=True, text=True, check=True).stderr
    first, size = map(int, run(program, "series").split())
    return [
        report
        for report in printed.split("=" * 18)
        if "WARNING" in report and not (reads_the_series and is_lost_read(report, first, size))
    ]


def is_lost_read(report: str, first: int, size: int) -> bool:
    """Whether a race is one of a read without a stack, within `size` bytes of the axis from `first` on."""
    lost = re.search(
        r"Previous read of size \d+ at (0x[0-9a-f]+) by thread T1:\s+\[failed to restore the stack\]", report
    )
    axis = re.search(r"Location is global 'axis' of size \d+ at (0x[0-9a-f]+)", report)
    if lost is None or axis is None:
        return False
    return 0 <= int(lost[1], 16) - int(axis[1], 16) - first < size


@pytest.mark.parametrize("mode", ["patient", "hurried"])
def test_tasks_share_the_words_that_are_told_and_no_others(mode: str, threads: Any) -> None:
    kind, compiled = threads
    found = sanitized(compiled(SANITIZED, [*MEETING, *SHARED]), mode, kind)
    assert not found, "\n".join(found)


def test_sanitizer_would_find_a_shared_word(threads: Any) -> None:
    """Where the words are not atomic it names them."""
    kind, compiled = threads
    found = sanitized(compiled(SANITIZED, MEETING), "patient", kind)
    assert kind == "ekf" or any("WARNING: ThreadSanitizer: data race" in report for report in found)


LOST_READ = """
WARNING: ThreadSanitizer: data race (pid=7)
  Write of size 8 at 0x55f003cce6f8 by main thread:
    #0 sample_terms etel_xy_model.h:21 (program+0x1949b)

  Previous read of size 8 at 0x55f003cce6f8 by thread T1:
    [failed to restore the stack]

  Location is global 'axis' of size 24656 at 0x55f003cce200 (program+0x2d6f8)
"""


def test_read_that_lost_its_stack_is_left_out_of_the_series_alone() -> None:
    assert is_lost_read(LOST_READ, 0x4F8, 8)
    assert not is_lost_read(LOST_READ, 0x4F0, 8)
    assert not is_lost_read(LOST_READ, 0x500, 8)
    assert not is_lost_read(LOST_READ.replace("[failed to restore the stack]", "#0 condense"), 0x4F8, 8)
