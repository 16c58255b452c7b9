"""Forces without a name are learned: where they are there, only there, and by the gain on unseen data."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.signal import lfilter

from diagnosis_cases import explained
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import diagnose, write_diagnosis
from sgms_mhe.diagnosis import verdict as verdict_module
from sgms_mhe.diagnosis.coordinates import Coordinate, cubic, memory_of_reversals, warp
from sgms_mhe.diagnosis.criteria import material_force, small_force
from sgms_mhe.diagnosis.learner import Learned, LearnedTerm, learn_residual
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.recordings.recording import Recording, prepare
from sgms_mhe.report import write_report
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]

NOISE_N = 0.05
RATE = 200.0  # rows of a record per second
CURVE = Learned(
    (LearnedTerm((Coordinate("speed", 0.1, -0.8, 0.8, 2),), np.array([0.0, 0.1, 0.2, 0.1, 0.0])),),
    held_out_before=0.4,
    held_out_after=0.2,
    gain_interval=(0.4, 0.6),
)


@cache
def machine() -> Machine:
    return override_machine(load_machine("etel_xy"), {"sampling": {"rate": 1000.0, "velocity_cutoff": 100.0}})


@cache
def record(speed: float = 0.2) -> Recording:
    """A motion of 20 s; nothing looks at its force."""
    path = make_trajectory("mixed", 1000.0, duration_s=20.0, max_velocity=speed)
    n = len(path.position_m)
    return prepare(machine(), Log(np.arange(n) / 1000.0, path.position_m, np.zeros(n), 1000.0))


def noise(count: int, seed: int, seconds: float = 0.0) -> Array:
    """Noise of variance 1 at the rate of a record, with a correlation time."""
    white = np.random.default_rng(seed).standard_normal(count)
    share = np.exp(-1.0 / (RATE * seconds)) if seconds else 0.0
    return np.asarray(lfilter([np.sqrt(1.0 - share**2)], [1.0, -share], white))


def hidden_force(recording: Recording) -> Array:
    """Friction that is more in the middle of the travel, and grows with the root of speed [N]."""
    place = (recording.position - 0.1) / 0.1
    return np.exp(-(place**2)) * np.sign(recording.velocity) * np.sqrt(np.abs(recording.velocity) / 0.2)


def learn(recording: Recording, residual: Array) -> Learned | None:
    return learn_residual(recording, residual, residual, floor=NOISE_N, material=0.2 * NOISE_N)


def predict(learned: Learned, recording: Recording) -> Array:
    """Force (m) along a record [N], by the sum that the documents state."""
    motion = recording.position, recording.velocity, 1.0 / recording.rate
    terms = [term.at(*(warp(c.kind, c.scale, *motion) for c in term.coordinates)) for term in learned.terms]
    return np.asarray(np.sum(terms, axis=0))


def test_splines_are_those_of_scipy_sum_to_one_and_end_in_zero() -> None:
    u = np.linspace(-1.0, 5.0, 601)
    known = BSpline.basis_element(np.arange(5.0), extrapolate=False)(u)
    assert cubic(u) == pytest.approx(np.nan_to_num(known), abs=1e-15)
    grid = Coordinate("place", 1.0, -0.2, 0.3, 7)
    inside, outside = np.linspace(-0.2, 0.3, 101), np.array([-9.0, -0.2 - 3.01 / 14.0, 0.3 + 3.01 / 14.0, 9.0])
    assert grid.splines(inside).sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    assert grid.splines(inside).shape == (101, grid.size)
    assert not grid.splines(outside).any()


def test_memory_of_a_reversal_is_that_of_its_differential_equation() -> None:
    length, step = 0.01, 1e-5
    moved = np.concatenate((np.full(5000, step), np.full(3000, -step), np.zeros(10)))
    state = memory_of_reversals(moved, length)
    assert state[4999] == pytest.approx(1.0 - np.exp(-5.0), rel=1e-9)
    assert state[7999] == pytest.approx(-1.0 + (1.0 + state[4999]) * np.exp(-3.0), rel=1e-9)
    assert state[-1] == state[7999]  # rest forgets nothing


@pytest.mark.slow
def test_a_map_over_place_and_speed_is_learned_and_holds_on_another_record() -> None:
    here, there = record(), record(0.17)
    learned = learn(here, hidden_force(here) + NOISE_N * noise(len(here.time), 3))
    assert learned is not None
    assert {"place", "speed"} <= set(learned.over)
    low, high = learned.gain_interval
    assert 0.0 < low < learned.gain < high
    held_out = here.rows_held_out()
    force = hidden_force(here)[held_out] + NOISE_N * noise(len(here.time), 3)[held_out]
    assert learned.held_out_before == pytest.approx(np.sqrt(np.mean(force**2)), rel=1e-12)
    # The gain that it states is that on a record that nothing has seen, if anything less.
    residual = (hidden_force(there) + NOISE_N * noise(len(there.time), 4))[there.used]
    after = residual - predict(learned, there)[there.used]
    gain = 1.0 - float(np.sqrt(np.mean(after**2) / np.mean(residual**2)))
    assert gain > 0.5
    assert gain > low


@pytest.mark.slow
def test_the_gain_is_none_of_the_blocks_that_are_learned_from() -> None:
    """A force on held-out blocks that others contradict: what these teach must be counted as a loss."""
    here = record()
    sign = np.where(here.rows_held_out(), -1.0, 1.0)
    assert learn(here, sign * hidden_force(here) + NOISE_N * noise(len(here.time), 3)) is None


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.0, 0.1, 1.0, 5.0])
def test_noise_is_not_learned(seconds: float) -> None:
    """White, coloured, wandering: of 40 draws together, over 20 s."""
    here = record(0.05)
    assert here.rate == RATE
    assert not any(learn(here, noise(len(here.time), 100 + k, seconds)) for k in range(10))


def test_nothing_is_learned_where_nothing_is_left() -> None:
    here = record()
    assert learn(here, NOISE_N * noise(len(here.time), 5)) is None
    assert learn(here, np.zeros(len(here.time))) is None


def test_a_learned_residual_is_in_the_document_and_on_the_page(tmp_path: Path) -> None:
    table = LearnedTerm(
        (Coordinate("place", 1.0, -0.1, 0.1, 2), Coordinate("travel", 0.01, -1.0, 1.0, 2)), np.full((5, 5), 0.1)
    )
    learned = replace(CURVE, terms=(*CURVE.terms, table))
    diagnosis = replace(explained(machine()), verdict="unexplained", learned=learned)
    content = json.loads((write_diagnosis(diagnosis, tmp_path) / "diagnosis.json").read_text())
    assert content["learned"] == {
        "over": ["speed", "place", "travel"],
        "held_out_before": 0.4,
        "held_out_after": 0.2,
        "gain_interval": [0.4, 0.6],
        "other_records": {},
        "extended_machine": None,
    }
    page = write_report(diagnosis, tmp_path).read_text()
    assert "learned, no name: over speed, place and travel, 50 % of the residual on held-out blocks" in page
    assert 'data-plot="learned_1"' in page
    assert 'data-plot="learned_2"' in page
    drawn = json.loads(page.split('<script type="application/json" id="data">')[1].split("</script>")[0])["plots"]
    assert [len(drawn[key]["series"]) for key in ("learned_1", "learned_2")] == [1, 3]
    assert explained(machine()).to_json()["learned"] is None


@pytest.mark.slow
def test_what_can_be_learned_is_not_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    path = make_trajectory("mixed", 1000.0, duration_s=10.0, max_velocity=0.2)
    log = simulate_axis(machine(), path, AxisConfig(seed=2, force_noise_N=NOISE_N)).log
    found = diagnose(machine(), log)
    assert (found.verdict, found.learned) == ("adequate", None)
    asked: list[float] = []

    def learn_curve(recording: Recording, full: Array, blind: Array, *, floor: float, material: float) -> Learned:
        held_out = recording.rows_held_out()
        asked.extend((float(np.sqrt(np.mean(blind[held_out] ** 2))), floor, material))
        assert full.shape == blind.shape == recording.time.shape
        return CURVE

    monkeypatch.setattr(verdict_module, "learn_residual", learn_curve)
    again = diagnose(machine(), log)
    assert (again.verdict, again.learned) == ("unexplained", CURVE)
    assert asked[-3:-1] == pytest.approx([again.rms.held_out_after, again.noise_floor_N], rel=1e-9)
    assert asked[-1] == max(material_force(machine(), asked[-2]), small_force(machine()))  # as a cause has to be
    assert "no known effect accounts for" in again.summary
