"""A film that follows speed late is found in a log, with the friction curve that it carries, and without one."""

from __future__ import annotations

from functools import cache

import pytest

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory

CURVE = {
    "speed_m_s": (0.02, 0.08),
    "forward_N": (1.6, 2.4),
    "backward_N": (1.5, 2.0),
    "end_m_s": 0.4,
}


@cache
def diagnose_film(lag_s: float, *, curved: bool) -> Diagnosis:
    axis = override_machine(load_machine("etel_xy"), {"sampling": {"rate": 1000.0, "velocity_cutoff": 100.0}})
    path = make_trajectory("mixed", axis.sampling.rate, duration_s=12.0, max_velocity=0.4)
    hidden = [*([("friction_curve", CURVE)] if curved else []), ("viscous_lag", {"time_constant_s": lag_s})]
    return diagnose(axis, simulate_axis(axis, path, AxisConfig(seed=2, force_noise_N=0.05), hidden_effects=hidden).log)


@pytest.mark.slow
def test_late_film_of_a_curve_is_found_with_its_lag() -> None:
    lag_s = 0.25
    found = diagnose_film(lag_s, curved=True)
    assert {cause.name for cause in found.causes} == {"friction_curve", "viscous_lag"}, found.summary
    assert found.verdict == "explained"
    (lag,) = (cause for cause in found.causes if cause.name == "viscous_lag")
    assert abs(lag.parameters["time_constant_s"] - lag_s) < 2.0 * lag.std["time_constant_s"] < 0.02 * lag_s
    assert found.rms.held_out_after < 1.1 * found.noise_floor_N


@pytest.mark.slow
def test_late_viscous_friction_is_no_mass() -> None:
    found = diagnose_film(0.08, curved=False)
    assert [cause.name for cause in found.causes] == ["viscous_lag"], found.summary
    assert found.causes[0].parameters["time_constant_s"] == pytest.approx(0.08, rel=0.05)
