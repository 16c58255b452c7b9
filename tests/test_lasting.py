"""Errors of the model that stay: what the emitted estimators state about an axis that is not the machine file's."""

from __future__ import annotations

import numpy as np
import pytest

from sgms_bench.studies.lasting import ERRORS, MOTIONS, TRIED, LastingOutcome, erroneous_record, lasting_outcome


def outcome(name: str, motion: str = "mixed", variant: str = "ekf double", duration_s: float = 8.0) -> LastingOutcome:
    error = next(error for error in TRIED if error.name == name)
    return lasting_outcome(erroneous_record(error, motion, 0, duration_s), motion, variant)


@pytest.mark.parametrize("motion", MOTIONS)
def test_without_an_error_the_deviations_hold(motion: str) -> None:
    found = outcome("none", motion)
    assert found.beyond[1] == found.silent == found.doubted == 0.0
    assert found.covered > 0.93
    assert found.friction < 0.02


def test_an_error_is_in_the_log_and_in_the_count() -> None:
    """A gain of 2 % on a fast motion is contradicted; without it, the same axis has a smaller error."""
    found, clean = outcome("force's gain 1.02"), outcome("none")
    assert found.doubted > 0.5
    assert np.all(found.after > clean.after)
    assert found.friction > 2.0 * clean.friction


def test_every_error_moves_the_log() -> None:
    clean = erroneous_record(TRIED[0], "paper", 0, 0.5)
    for error in ERRORS:
        record = erroneous_record(error, "paper", 0, 0.5)
        assert np.any(record.run.log.force_N != clean.run.log.force_N), error.name
        assert record.theta == pytest.approx(clean.theta), error.name
