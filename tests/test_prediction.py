"""The comparison of a model with a log: which rows count, what decimation leaves, the published force errors."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import done, refused
from record_cases import simulate_log
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.evaluation.prediction import ForceError, PredictedFriction, force_error, predict_log
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion, make_trajectory
from sgms_mhe.signals.logs import write_log
from sgms_mhe.support.errors import InputError

RATE = 1000.0
TIME = np.arange(4000) / RATE + 7.0  # a record need not start at zero


def predicted(residual: NDArray[np.float64], force: float = 2.0) -> PredictedFriction:
    """A model without friction along a drive force of constant size."""
    zero = np.zeros(len(residual))
    return PredictedFriction(TIME[: len(residual)], residual, zero, zero + force, "here.csv")


def sine(frequency: float) -> NDArray[np.float64]:
    return math.sqrt(2.0) * np.sin(2.0 * np.pi * frequency * TIME)


@pytest.fixture(scope="module")
def log(small: Path) -> Path:
    machine = load_machine(small)
    path = small.parent / "axis.csv"
    write_log(path, simulate_log(machine, ("step_disturbance", STEP), path="paper", seconds=4.0, seed=2))
    return path


STEP = {"force_N": 1.5, "time_s": 2.0}


# --- which rows are compared ------------------------------------------------------------------------------------


def test_error_is_relative_to_the_drive_force() -> None:
    error = force_error(predicted(0.5 * sine(5.0), force=-4.0))
    assert error.rows == 4000
    assert error.residual_rms_N == pytest.approx(0.5)
    assert error.friction_rms_N == pytest.approx(0.5)
    assert error.force_rms_N == pytest.approx(4.0)
    assert error.relative == pytest.approx(0.125)
    assert math.isnan(force_error(predicted(sine(5.0), force=0.0)).relative)


def test_seconds_count_from_the_first_sample() -> None:
    residual = np.where(TIME - TIME[0] >= 2.0, 3.0, 1.0)
    assert force_error(predicted(residual), end_s=1.9995) == ForceError(2000, 1.0, 1.0, 2.0)
    assert force_error(predicted(residual), start_s=1.9995) == ForceError(2000, 3.0, 3.0, 2.0)
    assert force_error(predicted(residual), start_s=1.9985, end_s=2.0005).rows == 2


def test_invalid_rows_do_not_count() -> None:
    residual = np.where(np.arange(4000) % 1000 < 250, np.nan, 1.0)
    assert force_error(predicted(residual)) == ForceError(3000, 1.0, 1.0, 2.0)


@pytest.mark.parametrize(("frequency", "left"), [(2.0, 1.0), (30.0, 1.0), (60.0, 0.0), (203.0, 0.0)])
def test_decimation_filters_before_it_picks(frequency: float, left: float) -> None:
    # 100 Hz after decimation: its Nyquist frequency is 50 Hz, the filter's edge 40 Hz. Picking alone would alias.
    error = force_error(predicted(sine(frequency)), start_s=0.5, end_s=3.5, factor=10)
    assert error.rows == 301
    assert error.residual_rms_N == pytest.approx(left, abs=0.03)
    assert force_error(predicted(sine(frequency))).residual_rms_N == pytest.approx(1.0, abs=1e-2)


def test_decimation_does_not_filter_across_gaps() -> None:
    # Levels that jump across a gap: a filter through it would ring on both sides.
    residual = np.where(TIME - TIME[0] < 2.0, 1.0, 5.0)
    residual[1990:2010] = np.nan
    residual[3000:3050] = np.nan
    residual[3120:] = np.nan  # 70 rows between gaps are too few to filter
    error = force_error(predicted(residual), factor=10)
    assert error.rows == 199 + 99
    assert error.residual_rms_N == pytest.approx(math.sqrt((199 + 99 * 25) / (199 + 99)))


@pytest.mark.parametrize(
    ("options", "where", "allowed"),
    [
        ({"factor": 0}, "decimation", "1 to 100"),
        ({"factor": 101}, "decimation", "1 to 100"),
        ({"start_s": 4.0}, "rows from 4 to 3.999 s", "1 valid rows"),
        ({"start_s": 3.95, "factor": 10}, "rows from 3.95 to 3.999 s", "100 valid rows"),
    ],
)
def test_nothing_to_compare_is_refused(options: dict[str, float], where: str, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        force_error(predicted(sine(5.0)), **options)  # type: ignore[arg-type]
    assert caught.value.where == where
    assert allowed in caught.value.allowed


# --- part of a log ----------------------------------------------------------------------------------------------


def test_part_of_a_log_is_a_log(small: Path, log: Path) -> None:
    whole = read_log(log, load_machine(small))
    part = whole.part(1.0, 2.5)
    assert len(part) == 1501
    assert part.rate == whole.rate
    for name, values in part.columns.items():
        np.testing.assert_array_equal(values, whole.columns[name][1000:2501])
    assert part.source == f"{log}, 1 to 2.5 s"
    assert whole.part() is whole
    assert whole.part(0.0, 1e9) is whole
    with pytest.raises(InputError, match=r"rows from 5 to 3\.999 s = 0: at least 2 rows within 0 to"):
        whole.part(5.0, 6.0)


# --- the command ------------------------------------------------------------------------------------------------


def test_predict_compares_a_part_and_writes_it_all(small: Path, log: Path, tmp_path: Path) -> None:
    out = tmp_path / "p.csv"

    def error(*options: str) -> dict[str, float]:
        result: dict[str, float] = json.loads(done("predict", small, log, "--out", out, "--json", *options).stdout)
        assert len(out.read_text().splitlines()) == 1 + result["samples"] == 4001
        return result

    before, after = error("--to", "1.99"), error("--from", "2.05")
    assert before["residual_rms_N"] < 0.2
    assert after["residual_rms_N"] == pytest.approx(STEP["force_N"], rel=0.05)
    assert after["force_error"] == pytest.approx(after["residual_rms_N"] / after["force_rms_N"])
    few = error("--from", "2.05", "--decimate", "10")
    assert few["valid"] == math.ceil(after["valid"] / 10)
    # More of the force noise passes a higher cutoff; the filters then settle sooner.
    wide = error("--to", "1.99", "--lowpass", "400")
    assert wide["residual_rms_N"] > 1.1 * before["residual_rms_N"]
    assert wide["valid"] > before["valid"]
    text = done("predict", small, log, "--out", out, "--from", "2.05").stdout
    assert f"force error: {100.0 * after['force_error']:.3g} % of" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--lowpass", "500"), "velocity_cutoff = 500.0: >= 0.1 Hz and < rate / 2 = 500 Hz"),
        (("--decimate", "0"), "0 is not in the range"),
        (("--from", "9"), "rows from 9 to 3.999 s = 0"),
        (("--from", "-1"), "-1.0 is not in the range"),
    ],
)
def test_predict_refuses_what_it_cannot_compare(
    small: Path, log: Path, tmp_path: Path, options: tuple[str, str], message: str
) -> None:
    assert message in refused("predict", small, log, "--out", tmp_path / "p.csv", *options)
    assert not list(tmp_path.iterdir())


# --- time -------------------------------------------------------------------------------------------------------


def test_forces_in_time_are_predicted_at_their_instant() -> None:
    """The log's clock and the model's are one, though the signals leave the chain a millisecond late."""
    machine = load_machine("etel_xy")
    path = make_trajectory("mixed", machine.sampling.rate, duration_s=4.0)

    def left(name: str, parameters: dict[str, float], start_s: float = 0.3, end_s: float = 4.0) -> tuple[float, float]:
        """RMS of the residual with the effect in plant and model, and with none in both."""
        found = []
        for effects in ([], [(name, parameters)]):
            axis = override_machine(machine, {"effects": [{"name": n, **p} for n, p in effects]})
            log = simulate_log(axis, path=path, seed=2, force_noise_N=0.02)
            found.append(force_error(predict_log(axis, log), start_s=start_s, end_s=end_s).residual_rms_N)
        return found[1], found[0]

    hum = {"amplitude_N": 0.8, "frequency_Hz": 40.0, "phase_rad": 0.7}
    with_it, without = left("periodic_disturbance", hum)
    assert with_it < 1.1 * without  # a millisecond would leave 0.14 N RMS
    # The chain rounds a step off, on both sides of its instant alike: what is left of it is not a millisecond of it.
    with_it, _ = left("step_disturbance", {"force_N": 1.5, "time_s": 2.0}, 1.98, 2.02)
    assert with_it < 0.1


# --- measured data ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cutoff", "tolerance"), [(60.0, 0.05), (100.0, 0.08)])
def test_published_fit_has_the_published_error(
    measured_data: Callable[[str], Path], cutoff: float, tolerance: float
) -> None:
    # 4.08 % is the published force error of the published parameters behind a 100 Hz low-pass, decimated by 10.
    machine = override_machine(load_machine("emps"), {"sampling": {"velocity_cutoff": cutoff}})
    prediction = predict_log(machine, read_log(measured_data("emps/DATA_EMPS.mat"), machine))
    assert 100.0 * force_error(prediction, factor=10).relative == pytest.approx(4.08, abs=tolerance)


# --- smoothing sharper than usual -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_sharp_elements_are_right_at_a_low_rate(small: Path, precision: str) -> None:
    # A fast sample of 5 ms is 500 deflections long, a slow one wider than the slip window of lambda = 350.
    friction = {"smoothing": {"zeta": 0.99, "lambda": 350.0}, "stiffness": [1e5, 5e4]}
    sampling = {"rate": 200.0, "update_rate": 20.0, "velocity_cutoff": 90.0}
    sharp = override_machine(load_machine(small), {"sampling": sampling, "friction": friction})
    motion = Motion(200.0)
    for target in (1e-4, -1e-4, 1e-4):
        motion.move_to(target, 5e-4, 0.1, 10.0)
    for target in (0.05, -0.05, 0.0):
        motion.move_to(target, 1.0, 100.0, 1e5)
    log = simulate_axis(
        sharp,
        motion.trajectory("sharp"),
        AxisConfig(control="prescribed", force_noise_N=0.0, encoder_resolution_m=0.0),
        truth=False,
    ).log
    assert np.abs(np.diff(log.position_m)).max() > 450 * 0.25 * 4.0 / 1e5
    flow = predict_log(override_machine(sharp, {"code": {"precision": precision}}), log).friction_N
    small_steps = {"sampling": {"integrator": {"scheme": "rk4", "displacement": 1e-3}}}
    reference = predict_log(override_machine(sharp, small_steps), log).friction_N
    np.testing.assert_allclose(flow, reference, atol=2e-4 if precision == "double" else 5e-3)
