"""The bounded part of `make benchmark-logs`, and that its judge finds what it is there to find."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sgms_bench.logs.cases import draw_truth
from sgms_bench.logs.claims import false_sentences
from sgms_bench.logs.faults import FAULTS, draw_recorder
from sgms_bench.logs.formats import FORMATS
from sgms_bench.logs.running import Trial, WrongError, differences, draw, run_draw

WITHOUT_IDENTIFY = [seed for seed in range(60) if not any("identify" in name for name in draw(seed)[3].commands)]


@pytest.mark.parametrize("part", range(4))
def test_drawn_logs_are_read_or_refused_rightly(part: int) -> None:
    came = [run_draw(seed) for seed in WITHOUT_IDENTIFY[part::4]]
    assert [outcome for outcome in came if outcome.came != "right"] == []


@pytest.mark.slow
def test_drawn_logs_are_identified() -> None:
    came = [run_draw(seed) for seed in range(30) if seed not in WITHOUT_IDENTIFY]
    assert len(came) > 3
    assert [outcome for outcome in came if outcome.came != "right"] == []


def test_the_judge_finds_another_log_and_a_false_sentence(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    recorder = draw_recorder(rng, draw_truth(rng), FORMATS["comma"])
    log, case = recorder.truth.log, FAULTS["none"](recorder, rng)
    assert list(differences(log, log, 1e-6)) == []
    for other in (
        replace(log, rate=2.0 * log.rate),
        replace(log, position_m=1.001 * log.position_m),
        replace(log, force_N=np.where(np.arange(len(log)) == 9, np.nan, log.force_N)),
        log.part(0.0, 1.0),
    ):
        assert len(list(differences(other, log, 1e-6))) == 1
    with pytest.raises(WrongError, match="off by") as caught:
        Trial(tmp_path, recorder, replace(case, expected=replace(log, force_N=-log.force_N)), "comma").run()
    assert caught.value.came == "wrong"
    with pytest.raises(WrongError, match="not refused"):
        Trial(tmp_path, recorder, replace(case, refusal="wrap"), "comma").run()
    assert list(false_sentences("position: turn it, scale = -1.0", case))
    wrapped = replace(case, facts=frozenset({"wraps"}), numbers={"wraps": 25.0})
    assert list(false_sentences("where it starts over: wrap = 24", wrapped))
    assert not list(false_sentences("where it starts over: wrap = 25", wrapped))


def test_a_traceback_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def trip(*_: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("sgms_mhe.logfiles.inspection.inspect_reading", trip)
    assert "ZeroDivisionError" in (outcome := run_draw(0)).reason and outcome.came == "traceback"
