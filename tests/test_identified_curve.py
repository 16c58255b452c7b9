"""Friction over speed of any shape in an identification: found where it is, written as it is, and never without cause.

Friction beyond the axis's own is added to the force alone: the controller holds the reference against it.
"""

import json
import math
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import done
from record_cases import simulate_log, slow_axis
from sgms_bench.studies.identification import draw_axis
from sgms_mhe import read_log
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.identification import Identification, Wanted, identify
from sgms_mhe.identification.companions import is_possible
from sgms_mhe.identification.description import effect_numbers
from sgms_mhe.identification.final_fit import FinalIdentification
from sgms_mhe.identification.fits import AxisFit, covariance, quantities
from sgms_mhe.identification.identify import explore
from sgms_mhe.identification.terms import Term
from sgms_mhe.machine import Machine
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.logs import Log, write_log

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]

CURVES: dict[str, Curve] = {
    "root": lambda v: 18.0 * np.sign(v) * np.sqrt(np.abs(v)),
    "logarithm": lambda v: 1.5 * np.sign(v) * np.log1p(np.abs(v) / 0.003),
    "root, half backward": lambda v: np.where(v > 0.0, 18.0, 9.0) * np.sign(v) * np.sqrt(np.abs(v)),
}
"""Friction beyond level, damping and Stribeck effect of the machine."""


@cache
def machine() -> Machine:
    return slow_axis()


@cache
def log(curve: str, seed: int = 2) -> Log:
    """Return the log of an axis with more friction over speed than a machine file has numbers for."""
    axis = machine()
    path = make_trajectory("mixed", axis.sampling.rate, duration_s=10.0, max_velocity=0.4)
    clean = simulate_log(axis, path=path, seed=seed, force_noise_N=0.05)
    return replace(clean, force_N=clean.force_N + CURVES[curve](path.velocity_m_s))


@cache
def identify_axis(curve: str) -> Identification:
    return identify([log(curve)], Wanted("curved"))


def knots(found: Identification) -> list[dict[str, float]]:
    """Knots of an identified curve: the speed, and the force of either direction."""
    values = {n.name.removeprefix("friction_curve."): n.value for n in found.numbers if n.name.startswith("friction_c")}
    return [
        {"speed": values[f"speed_{i}_m_s"], "forward": values[f"forward_{i}_N"], "backward": values[f"backward_{i}_N"]}
        for i in range(1, sum(name.startswith("speed_") for name in values) + 1)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("curve", CURVES)
def test_friction_over_speed_is_that_of_the_axis(curve: str) -> None:
    """Level, damping and curve are together the friction of each direction, however they share it."""
    found, axis = identify_axis(curve), machine().friction
    effects = {effect.name for effect in found.machine.effects}
    assert "friction_curve" in effects
    own, half = found.machine.friction, 0.0
    if "asymmetric_viscous" in effects:
        half = found.number("asymmetric_viscous.difference_N_s_m").value
    for knot in knots(found)[-4:]:
        v = knot["speed"]
        for way, sign in (("forward", 1.0), ("backward", -1.0)):
            force = own.coulomb + (own.viscous + sign * half) * v + knot[way]
            truth = axis.coulomb + axis.viscous * v + abs(float(CURVES[curve](np.array(sign * v))))
            assert force == pytest.approx(truth, rel=0.02), (way, v)
    assert found.number("mass").value == pytest.approx(machine().plant.moved, rel=1e-3)
    assert found.held_out_rms_N < 0.015 * found.friction_rms_N
    assert all(found.number(f"friction_curve.forward_{i}_N").determined for i in range(5, len(knots(found)) + 1))


@pytest.mark.slow
def test_file_has_the_curve_as_lists_that_every_command_takes(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", log("root"))
    path = tmp_path / "curved.toml"
    stated = json.loads(done("identify", tmp_path / "log.csv", "--out", path, "--json").stdout)
    read = tomllib.loads(path.read_text())
    (effect,) = read["effects"]
    count = len(effect["speed_m_s"])
    assert len(effect["forward_N"]) == len(effect["backward_N"]) == count > 1
    by_name = {number["name"]: number for number in stated["numbers"]}
    for i, force in enumerate(effect["backward_N"], start=1):
        number = by_name[f"friction_curve.backward_{i}_N"]
        assert force == pytest.approx(number["value"], abs=number["std"])
    assert by_name["friction_curve.speed_1_m_s"]["std"] is None  # chosen, not measured
    comment = next(line for line in path.read_text().splitlines() if line.startswith("# backward_N: "))
    assert comment.count(" +- ") >= 3
    predicted = json.loads(done("predict", path, tmp_path / "log.csv", "--out", tmp_path / "p.csv", "--json").stdout)
    assert predicted["residual"]["rms_N"] == stated["residual_of_file"][0]["rms_N"]
    assert predicted["residual"]["rms_N"] < 0.1 * stated["residual_rms_N"]["friction"]


@pytest.mark.slow
def test_a_diagnosis_begins_from_the_curve_of_the_file() -> None:
    """Another record of the axis has nothing that its file lacks over speed, and refutes none of its numbers."""
    diagnosis = diagnose(identify_axis("root").machine, log("root", seed=5))
    assert "friction_curve" not in [cause.name for cause in diagnosis.causes]
    assert diagnosis.rms.before < 0.1 * identify_axis("root").friction_rms_N


@pytest.mark.slow
def test_no_curve_where_level_damping_and_stribeck_effect_reach() -> None:
    axis = draw_axis(7002, 12.0)
    final = explore([axis.log], Wanted("axis", axis.machine.plant.moved if axis.mass_given else None)).final
    assert "friction_curve" not in [term.name for term in final.fit.terms]


@pytest.mark.slow
def test_no_curve_on_the_axis_without_one() -> None:
    CURVES["none"] = np.zeros_like
    found = identify_axis("none")
    assert not found.machine.effects
    assert found.held_out_rms_N < 1.1 * found.noise_floor_N


# --- parts --------------------------------------------------------------------------------------------------------

KNOTS = {"speed_1_m_s": 0.1, "speed_2_m_s": 0.2, "end_m_s": 0.4}


def make_fit(coulomb: float, sizes: Array) -> AxisFit:
    """Return a fit of one element and a curve of two knots."""
    rows = np.ones(3)
    term = Term("friction_curve", np.ones((3, 4)), given=KNOTS)
    left = {"residual": rows, "loss": rows, "cross": rows, "rows": rows}
    return AxisFit(None, np.array([coulomb]), (term,), sizes, np.ones((3, 6)), rows, **left)  # type: ignore[arg-type]


@pytest.mark.parametrize(("lowest", "possible"), [(-1.9, True), (-2.1, False)])
def test_a_curve_that_drives_the_axis_is_none(lowest: float, possible: bool) -> None:
    """It may take away no more than the level, 2 N."""
    fit = make_fit(2.0, np.array([1.0, 0.5, lowest, 0.5]))
    assert is_possible(machine(), fit) == possible


def test_an_entry_of_nothing_is_as_sure_as_the_largest_of_its_list() -> None:
    """The force at a knot may be 0: a deviation over that says nothing."""
    fit = make_fit(2.0, np.array([4.0, 0.0, 0.3, 0.2]))
    cov = np.diag([0.0, 0.0, 0.01, 0.01, 0.01, 0.01])
    final = FinalIdentification(fit, cov, {}, None, math.nan, math.nan, None)  # type: ignore[arg-type]
    found = {n.name.removeprefix("friction_curve."): n for n in effect_numbers(final)}
    assert found["forward_2_N"].value == 0.0 and found["forward_2_N"].std == pytest.approx(0.1)
    assert found["forward_1_N"].determined and found["forward_2_N"].determined
    assert not found["backward_1_N"].determined and not found["backward_2_N"].determined
    assert math.isnan(found["speed_1_m_s"].std)


# --- friction that follows the speed about standstill -----------------------------------------------------------


def gradual_log(gradual: float, step: float, late: int = 0, seconds: float = 30.0, rate: float = 500.0) -> Log:
    """Return the log of a joint as simulators have it: 1 N m of friction from a speed on, in proportion below.

    Args:
        gradual: speed up to which friction is in proportion to it [rad/s].
        step: of the encoder [rad].
        late: samples by which the torque is logged late.
    """
    random, substeps = np.random.default_rng(5), 40
    time = np.arange(int(seconds * rate)) / rate
    pace, size = 2.0 * np.pi * np.array([0.17, 0.43, 0.71, 1.3]), np.array([0.9, 0.5, 0.3, 0.15])
    aim, aim_speed = np.sin(np.outer(time, pace)) @ size, np.cos(np.outer(time, pace)) @ (size * pace)
    inertia, h, q, w = 0.22, 1.0 / rate / substeps, 0.0, float(aim_speed[0])
    angle, torque = np.empty(len(time)), np.empty(len(time))
    for k in range(len(time)):
        drive = 150.0 * (aim[k] - q) + 8.0 * (aim_speed[k] - w)
        angle[k], torque[k] = round(q / step) * step, drive + 0.01 * random.standard_normal()
        for _ in range(substeps):
            friction = min(max(w / gradual, -1.0), 1.0) + 0.3 * w
            w += (drive - friction - 5.9 * math.sin(q)) / inertia * h
            q += w * h
    if late:
        torque = np.concatenate((np.full(late, torque[0]), torque[:-late]))
    return read_log({"position_rad": angle, "torque_Nm": torque}, rate=rate)


@pytest.mark.slow
@pytest.mark.parametrize(("gradual", "bits"), [(0.004, 14), (0.15, 20)])
def test_friction_that_follows_the_speed_is_a_level_and_no_delay(gradual: float, bits: int) -> None:
    """Not refused as frictionless where a curve explains all of it, nor taken for a torque that comes early."""
    found = identify([gradual_log(gradual, 2.0 * math.pi / 2**bits)], Wanted("gradual"))
    numbers = {number.name: number.value for number in found.numbers}
    assert numbers["mass"] == pytest.approx(0.22, rel=0.02)
    assert numbers["coulomb"] == pytest.approx(1.0, rel=0.15)
    assert numbers["unbalance.amplitude_N"] == pytest.approx(5.9, rel=0.02)
    assert not [sentence for sentence in found.limits if "the motion that it makes" in sentence]


@pytest.mark.slow
def test_a_torque_that_is_late_is_said() -> None:
    """Less what a drive is early by that holds its torque for a sample."""
    found = identify([gradual_log(0.004, 2.0 * math.pi / 2**20, late=8)], Wanted("late"))
    (said,) = [sentence for sentence in found.limits if "the motion that it makes" in sentence]
    milliseconds = re.search(r"comes (\S+) ms after", said)
    assert milliseconds and float(milliseconds[1]) == pytest.approx(
        16.0 - 1.0, rel=0.15
    )  # less what a drive that holds has


@pytest.mark.slow
def test_a_number_that_no_used_row_shows_is_unknown_and_leaves_the_others_theirs() -> None:
    """A break-away distance far below what a sample resolves moves nothing but rows that do not count."""
    final = explore([gradual_log(0.004, 2.0 * math.pi / 2**14, seconds=12.0)], Wanted("unseen")).final
    rows, jacobian = final.view.rows, final.fit.jacobian.copy()
    jacobian[:, 0] = 0.0
    jacobian[np.flatnonzero(~rows.used)[0], 0] = 1.0
    found = quantities(final.fit, cov := covariance(final.view, replace(final.fit, jacobian=jacobian)))
    assert np.isfinite(cov).all()
    assert found["stiffness_1"].relative > 1e6
    assert found["coulomb"].relative < 0.1
    unknown = quantities(final.fit, np.full_like(cov, np.nan))
    assert all(np.isnan(number.std) for number in unknown.values()), "a variance that is no number is no certainty"
