"""The bounded part of the mutated logs of `make verify`, and that their judge finds what it is there to find."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from sgms_bench.logs import mutations
from sgms_bench.logs.mutations import COMMANDS, FORMS, MUTATIONS, check_logs, original, try_mutation
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.support.errors import InputError


def silent(_: str) -> None:
    """Of the progress."""


@pytest.mark.parametrize("part", range(6))
def test_no_log_trips_the_command_line(part: int) -> None:
    outcomes = check_logs(range(40 * part, 40 * (part + 1)), silent)
    assert [failure for outcome in outcomes for failure in outcome.failures] == []


def test_mutations_reach_every_end(tmp_path: Path) -> None:
    trials = [try_mutation(tmp_path, seed) for seed in range(120)]
    assert {trial.kind for trial in trials} == set(MUTATIONS)
    assert {trial.came for trial in trials} == {"read", "refused", "no log"}
    assert len({trial.command for trial in trials if trial.came == "read"}) > 3
    assert sum(COMMANDS.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "name", [name for name, form in FORMS.items() if not form.log and name != "groups of thousands"]
)
def test_what_is_mutated_is_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"log{FORMS[name].suffix}"
    path.write_bytes(original(name))
    assert len(read_log(path)) == mutations.SAMPLES


def trip(*_: Any, **__: Any) -> None:
    raise ZeroDivisionError


def stall(*_: Any, **__: Any) -> None:
    time.sleep(2.0)
    raise InputError("log", "rows", 0, "some")


@pytest.mark.parametrize(("work", "limit", "said"), [(trip, 60.0, "ZeroDivisionError"), (stall, 0.5, "no end within")])
def test_a_traceback_and_a_hang_are_found(work: Any, limit: float, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sgms_mhe.logfiles.inspection.read_table", work)
    monkeypatch.setattr(mutations, "LONGEST_S", limit)
    outcomes = check_logs(range(3), silent)
    failures = [failure for outcome in outcomes for failure in outcome.failures]
    assert failures and all(said in failure for failure in failures)


def test_memory_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutations, "LARGEST_MB", 1.0)
    assert " MB" in check_logs(range(1), silent)[0].failures[0]
