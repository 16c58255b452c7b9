"""The bounded part of `make benchmark-logs`, and that its judge finds what it is there to find."""

import pytest

from sgms_bench.logs.running import draw, run_draw


def asks_identify(seed: int) -> bool:
    return any("identify" in name for name in draw(seed)[3].commands)


@pytest.mark.parametrize("part", range(4))
def test_drawn_logs_are_read_or_refused_rightly(part: int) -> None:
    came = [run_draw(seed) for seed in range(part, 60, 4) if not asks_identify(seed)]
    assert len(came) > 3
    assert [outcome for outcome in came if outcome.came != "right"] == []


@pytest.mark.slow
def test_drawn_logs_are_identified() -> None:
    came = [run_draw(seed) for seed in range(30) if asks_identify(seed)]
    assert len(came) > 3
    assert [outcome for outcome in came if outcome.came != "right"] == []
