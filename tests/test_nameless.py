"""Effects that help to predict but are no causes: they stay in the machine without a name, and are said to be none."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from record_cases import simulate_log, slow_axis
from sgms_bench.diagnosis.unmodelled import UNMODELLED
from sgms_mhe.diagnosis import Diagnosis, diagnose
from sgms_mhe.report import write_report

NAMELESS = "uncertain or not the same all over the record, no cause, but it predicts"


@cache
def diagnose_with(name: str) -> Diagnosis:
    """Diagnose an axis with an offset of 1 N and a force of the same size that is none of the catalogue's."""
    axis, offset = slow_axis(), ("constant_offset", {"force_N": 1.0})
    log = simulate_log(axis, offset, seconds=12.0, fastest=0.4, seed=2, force_noise_N=0.05)
    velocity = np.gradient(log.position_m, 1.0 / log.rate)
    force = UNMODELLED[name](np.random.default_rng(5), log.time_s, log.position_m, velocity)
    return diagnose(axis, replace(log, force_N=log.force_N + force / np.sqrt(np.mean(force**2))))


@pytest.mark.slow
def test_an_offset_that_changes_stays_without_a_name(tmp_path: Path) -> None:
    """Beside a force that jumps between two values an offset is not the same in all parts of the record."""
    found = diagnose_with("telegraph")
    (offset,) = found.causes
    assert found.verdict == "unexplained" and offset.name == "constant_offset"
    assert not found.identifies(offset) and f"constant_offset: {NAMELESS}" in found.limits
    assert "nothing is named" in found.summary and found.to_json()["causes"][0]["stands_for"] == "what has no name"
    # None the less it predicts: the machine has it, and leaves less on data that no fit has seen.
    assert offset.gain_N > 0.5 and found.rms.held_out_after < 0.8 * found.rms.held_out_before
    assert found.extended is not None and [effect.name for effect in found.extended.effects] == ["constant_offset"]
    page = write_report(found, tmp_path).read_text()
    assert f"constant_offset: {NAMELESS}." in page and "Found:" not in page


@pytest.mark.slow
def test_a_sure_cause_keeps_its_name_beside_one_without() -> None:
    """A curve over speed cannot follow a narrow bump all over the record; the offset beside it is the same there."""
    found = diagnose_with("bump_in_speed")
    sure, other = (next(c for c in found.causes if c.name == name) for name in ("constant_offset", "friction_curve"))
    assert found.verdict == "unexplained" and len(found.causes) == 2
    assert found.identifies(sure) and abs(sure.parameters["force_N"] - 1.0) < 2.0 * sure.std["force_N"] < 0.3
    assert not found.identifies(other) and f"friction_curve: {NAMELESS}" in found.limits
    assert found.summary.startswith("constant_offset, and more")
    assert {c["name"]: c["stands_for"] for c in found.to_json()["causes"]}[sure.name] is None
