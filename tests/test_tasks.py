"""Two tasks on one axis: a call that comes into another is harmless, or refused; never another number in silence."""

from __future__ import annotations

from collections.abc import Callable
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
