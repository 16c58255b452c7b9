"""A film that follows speed late is found in a log, with the friction curve that it carries, and without one."""

import pytest

from diagnosis_cases import Within, assert_found
from record_cases import simulate_log, slow_axis
from sgms_mhe.diagnosis import Diagnosis, diagnose

CURVE = {"speed_m_s": (0.02, 0.08), "forward_N": (1.6, 2.4), "backward_N": (1.5, 2.0), "end_m_s": 0.4}


def diagnose_film(lag_s: float, *, curved: bool) -> Diagnosis:
    axis = slow_axis()
    hidden = [*([("friction_curve", CURVE)] if curved else []), ("viscous_lag", {"time_constant_s": lag_s})]
    return diagnose(axis, simulate_log(axis, *hidden, seconds=12.0, fastest=0.4, seed=2, force_noise_N=0.05))


@pytest.mark.slow
def test_late_film_of_a_curve_is_found_with_its_lag() -> None:
    lag_s = 0.25
    found = diagnose_film(lag_s, curved=True)
    assert_found(found, {"friction_curve": {}, "viscous_lag": {"time_constant_s": Within(lag_s)}}, "explained")
    assert all(2.0 * cause.std.get("time_constant_s", 0.0) < 0.02 * lag_s for cause in found.causes)
    assert found.rms.held_out_after < 1.1 * found.noise_floor_N


@pytest.mark.slow
def test_late_viscous_friction_is_no_mass() -> None:
    found = diagnose_film(0.08, curved=False)
    assert_found(found, {"viscous_lag": {"time_constant_s": pytest.approx(0.08, rel=0.05)}})
