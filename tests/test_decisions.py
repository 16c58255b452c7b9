"""Decisions of an analysis: as log records for a library's user, and as the files of --trace."""

import json
import logging
import math
import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from sgms_mhe.support.decisions import log_decision, trace_decisions
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.parallel import run_parallel


def test_a_decision_is_a_log_record_with_its_numbers(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, "sgms_mhe"):
        log_decision(
            "verdict", "residual is near the noise", residual_N=0.04123456, allowed_N=0.05, outcome="explained"
        )
    (record,) = caplog.records
    assert record.name == "sgms_mhe.decision.verdict"
    assert record.getMessage() == (
        "residual is near the noise: residual_N = 0.04123, allowed_N = 0.05, outcome = explained"
    )


def test_a_trace_has_one_file_a_stage_in_their_order(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "trace"
    for _ in range(2):  # the second replaces the first, whose stages were others
        with trace_decisions(folder):
            log_decision("search", "first", gain_N=np.float64(0.5), p_value=math.nan)
            log_decision("verdict", "second")
            log_decision("search", "third", names=("a", "b"))
        assert sorted(path.name for path in folder.iterdir()) == ["01_search.json", "02_verdict.json"]
    assert json.loads((folder / "01_search.json").read_text()) == {
        "stage": "search",
        "decisions": [{"rule": "first", "gain_N": 0.5, "p_value": None}, {"rule": "third", "names": ["a", "b"]}],
    }
    with trace_decisions(folder):
        log_decision("law", "alone")
    assert [path.name for path in folder.iterdir()] == ["01_law.json"]


def test_a_trace_has_the_decisions_of_its_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SGMS_MHE_WORKERS", "3")
    both = threading.Barrier(2)  # each task waits for the other: they are in different threads

    def task(name: str) -> None:
        both.wait(10.0)
        log_decision("rivals", name)

    with trace_decisions(tmp_path):
        run_parallel([partial(task, name) for name in "ab"])
    decisions = json.loads((tmp_path / "01_rivals.json").read_text())["decisions"]
    assert sorted(decision["rule"] for decision in decisions) == ["a", "b"]


def test_a_trace_is_written_of_what_fails_and_of_nothing_else(tmp_path: Path) -> None:
    def elsewhere() -> None:
        log_decision("search", "of another log")

    def fail() -> None:
        with trace_decisions(tmp_path):
            other = threading.Thread(target=elsewhere)
            other.start()
            other.join()
            log_decision("search", "of this one")
            raise ValueError("found no more")

    with pytest.raises(ValueError, match="no more"):
        fail()
    decisions = json.loads((tmp_path / "01_search.json").read_text())["decisions"]
    assert decisions == [{"rule": "of this one"}]
    assert not logging.getLogger("sgms_mhe.decision").isEnabledFor(logging.DEBUG)


def test_a_trace_that_cannot_be_written_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="trace: a folder that can be made"), trace_decisions(tmp_path / "file"):
        pass
