"""Series that are moved in time: judged by polynomials, and by differences."""

import math

import numpy as np
import pytest

from sgms_mhe.recordings.series import Shift

pytestmark = pytest.mark.core

RATE = 1000.0
TIME = np.arange(200) / RATE
INSIDE = slice(15, -15)


def cubic(t: np.ndarray) -> np.ndarray:
    return np.asarray(1.0 - 20.0 * t + 300.0 * t**2 - 900.0 * t**3)


@pytest.mark.parametrize("delay", [-7.3e-3, -4e-4, 0.0, 2.5e-4, 3e-3, 9.9e-3])
def test_a_cubic_is_moved_as_it_is(delay: float) -> None:
    moved = Shift.of(delay, RATE).of_series(cubic(TIME))
    np.testing.assert_allclose(moved[INSIDE], cubic(TIME - delay)[INSIDE], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("delay", [-7.3e-3, -4e-4, 2.5e-4, 9.9e-3])
def test_the_slope_is_the_derivative_in_the_delay(delay: float) -> None:
    series = np.random.default_rng(3).standard_normal((len(TIME), 2))
    step = 1e-8
    later, sooner = (Shift.of(delay + sign * step, RATE).of_series(series) for sign in (1.0, -1.0))
    slope = Shift.of(delay, RATE).slope_of(series)
    np.testing.assert_allclose(slope, (later - sooner) / (2.0 * step), rtol=0.0, atol=1e-4 * RATE)


def test_beyond_the_ends_the_last_one_goes_on() -> None:
    later, sooner = (Shift.of(delay, RATE).of_series(TIME) for delay in (5e-3, -5e-3))
    assert (later[:5] == TIME[0]).all() and (sooner[-5:] == TIME[-1]).all()


def test_a_gap_stays_one() -> None:
    series = TIME.copy()
    series[100] = np.nan
    assert np.isnan(Shift.of(-4e-4, RATE).of_series(series)[98:102]).all()
    assert np.isnan(Shift.of(-4e-4, RATE).of_series(series)).sum() == 4


def test_a_series_that_has_run_away_has_no_number_later() -> None:
    """Of a model that diverges: infinite values of either sign, and no warning of their difference."""
    series = np.where(np.arange(100) < 50, 1.0, np.where(np.arange(100) % 2 == 0, math.inf, -math.inf))
    later = Shift.of(3.4e-4, RATE).of_series(series)
    assert np.isnan(later[60:]).all() and np.isfinite(later[:45]).all()
