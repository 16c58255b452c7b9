"""Forces without a name are learned: where they are there, only there, and by the gain on unseen data."""

import json
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.signal import lfilter

from diagnosis_cases import explained, name_nothing
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose, learned_machine, learner, write_diagnosis
from sgms_mhe.diagnosis.coordinates import Coordinate, Warp, cubic, follow_late, memory_of_reversals
from sgms_mhe.diagnosis.criteria import material_force, small_force
from sgms_mhe.diagnosis.learned import Learned, LearnedRecord, LearnedTerm
from sgms_mhe.diagnosis.learned_machine import adopt_tables
from sgms_mhe.diagnosis.learner import learn_residual
from sgms_mhe.emission.package import emit_package, write_package
from sgms_mhe.evaluation.prediction import predict_log
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.model.building import logged_share
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
    (LearnedTerm((Coordinate(Warp("speed", 0.1), -0.8, 0.8, 2),), np.array([0.0, 0.1, 0.2, 0.1, 0.0])),),
    held_out_before=0.4,
    held_out_after=0.2,
    gain_interval=(0.4, 0.6),
    unseen=np.zeros(0),
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
    terms = [term.at(*(c.warp.along(*motion) for c in term.coordinates)) for term in learned.terms]
    return np.asarray(np.sum(terms, axis=0))


def test_splines_are_those_of_scipy_sum_to_one_and_end_in_zero() -> None:
    u = np.linspace(-1.0, 5.0, 601)
    known = BSpline.basis_element(np.arange(5.0), extrapolate=False)(u)
    assert cubic(u) == pytest.approx(np.nan_to_num(known), abs=1e-15)
    grid = Coordinate(Warp("place", 1.0), -0.2, 0.3, 7)
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


def test_late_speed_is_that_of_its_differential_equation() -> None:
    lag, step = 0.1, 1e-3
    time = step * np.arange(1, 501)
    speed = follow_late(np.concatenate((np.full(500, 0.2), np.zeros(500))), step, lag)
    assert speed[:500] == pytest.approx(0.2 * (1.0 - np.exp(-time / lag)), rel=1e-9)
    assert speed[500:] == pytest.approx(speed[499] * np.exp(-time / lag), rel=1e-9)


@pytest.mark.slow
def test_friction_that_follows_speed_late_is_learned_and_holds_on_another_record() -> None:
    """By a tenth of a second, strongest at low speed: no place, speed or way since the reversal says it."""
    here, there = record(), record(0.17)

    def late_force(recording: Recording, seed: int) -> Array:
        late = follow_late(recording.velocity, 1.0 / recording.rate, 0.1)
        return np.tanh(late / 0.02) - np.tanh(recording.velocity / 0.02) + NOISE_N * noise(len(recording.time), seed)

    learned = learn(here, late_force(here, 3))
    assert learned is not None
    assert "late speed" in learned.over
    low, _ = learned.gain_interval
    residual = late_force(there, 4)[there.used]
    after = residual - predict(learned, there)[there.used]
    gain = 1.0 - float(np.sqrt(np.mean(after**2) / np.mean(residual**2)))
    assert gain > max(low, 0.5)


@pytest.mark.slow
def test_a_map_over_place_and_speed_is_learned_and_holds_on_another_record() -> None:
    here, there = record(), record(0.17)
    learned = learn(here, hidden_force(here) + NOISE_N * noise(len(here.time), 3))
    assert learned is not None
    assert {"place", "speed"} <= set(learned.over)
    low, high = learned.gain_interval
    assert 0.0 < low < learned.gain < high
    force = (hidden_force(here) + NOISE_N * noise(len(here.time), 3))[here.used]
    assert learned.held_out_before == pytest.approx(np.sqrt(np.mean(force**2)), rel=1e-12)
    # The gain that it states is that on a record that nothing has seen, if anything less.
    residual = (hidden_force(there) + NOISE_N * noise(len(there.time), 4))[there.used]
    after = residual - predict(learned, there)[there.used]
    gain = 1.0 - float(np.sqrt(np.mean(after**2) / np.mean(residual**2)))
    assert gain > 0.5
    assert gain > low


def strokes(period: float) -> Recording:
    """To and fro for 20 s over 40 mm, at nearly one speed."""
    time = np.arange(20000) / 1000.0
    position = 0.04 / np.pi * np.arcsin(0.99 * np.sin(2.0 * np.pi * time / period))
    return prepare(machine(), Log(time, position, np.zeros(len(time)), 1000.0))


@pytest.mark.slow
def test_a_fine_ripple_is_learned_that_each_direction_has_elsewhere() -> None:
    """Twenty periods over the travel, as of a gear's teeth, a third of one apart between the directions."""
    here, there = strokes(1.7), strokes(1.9)

    def ripple(recording: Recording) -> Array:
        return np.sin(2.0 * np.pi * recording.position / 0.002 + np.sign(recording.velocity))

    learned = learn(here, ripple(here) + NOISE_N * noise(len(here.time), 6))
    assert learned is not None
    assert override_machine(machine(), {"effects": [term.entry(1.0) for term in learned.terms]}).effects
    force = ripple(there)[there.used]
    left = force - predict(learned, there)[there.used]
    assert np.sqrt(np.mean(left**2) / np.mean(force**2)) < 0.3


def test_no_memory_of_a_reversal_is_learned_before_an_axis_has_moved_its_length() -> None:
    """How it came to its first place no record says: a force at rest there was learned as one of that memory."""
    time = np.arange(20000) / 1000.0
    position = 0.1 - 0.1 * np.cos(np.pi * np.maximum(0.0, time - 3.0))
    here = prepare(machine(), Log(time, position, np.zeros(len(time)), 1000.0))
    terms = learner._make_terms(here, 1, here.used)
    moved = (np.cumsum(np.abs(here.velocity)) / here.rate)[here.used]
    lengths = [[c.warp.scale for c in term.coordinates if c.kind == "travel"] for term in terms]
    assert any(lengths) and not all(lengths)
    for term, length in zip(terms, lengths, strict=True):
        known = term.splines.any(axis=1)
        assert known[-1]
        if length:
            assert not known[moved < length[0]].any()


@pytest.mark.slow
def test_the_gain_is_none_of_the_blocks_that_are_learned_from() -> None:
    """A force on held-out blocks that others contradict: what these teach must be counted as a loss."""
    here = record()
    sign = np.where(here.rows_held_out(), -1.0, 1.0)
    assert learn(here, sign * hidden_force(here) + NOISE_N * noise(len(here.time), 3)) is None


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.0, 0.1, 1.0, 5.0])
def test_noise_is_not_learned(seconds: float) -> None:
    """White, coloured, wandering: of 24 draws together, over 20 s."""
    here = record(0.05)
    assert here.rate == RATE
    assert not any(learn(here, noise(len(here.time), 100 + k, seconds)) for k in range(6))


def test_nothing_is_learned_where_nothing_is_left() -> None:
    here = record()
    assert learn(here, NOISE_N * noise(len(here.time), 5)) is None
    assert learn(here, np.zeros(len(here.time))) is None


def test_a_learned_residual_is_in_the_document_and_on_the_page(tmp_path: Path) -> None:
    table = LearnedTerm(
        (Coordinate(Warp("place", 1.0), -0.1, 0.1, 2), Coordinate(Warp("travel", 0.01), -1.0, 1.0, 2)),
        np.full((5, 5), 0.1),
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
        "in_file": False,
    }
    page = write_report(diagnosis, tmp_path).read_text()
    assert "Learned, left out of the file: over speed, place and travel, 50 % of the residual." in page
    assert 'data-plot="learned_1"' in page
    assert 'data-plot="learned_2"' in page
    drawn = json.loads(page.split('<script type="application/json" id="data">')[1].split("</script>")[0])["plots"]
    assert [len(drawn[key]["series"]) for key in ("learned_1", "learned_2")] == [1, 3]
    assert explained(machine()).to_json()["learned"] is None


@pytest.mark.slow
def test_what_can_be_learned_is_not_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    path = make_trajectory("mixed", 1000.0, duration_s=10.0, max_velocity=0.2)
    log = simulate_axis(machine(), path, AxisConfig(seed=2, force_noise_N=NOISE_N)).log
    asked: list[float] = []

    def learn_curve(recording: Recording, full: Array, blind: Array, *, floor: float, material: float) -> Learned:
        held_out = recording.rows_held_out()
        asked.extend((float(np.sqrt(np.mean(blind[held_out] ** 2))), floor, material))
        assert full.shape == blind.shape == recording.time.shape
        return CURVE

    monkeypatch.setattr(learned_machine, "learn_residual", learn_curve)
    again = diagnose(machine(), log)
    # A curve that is not there: run along the record its table gains nothing, so the machine does not have it.
    assert (again.verdict, again.learned, again.extended) == ("unexplained", CURVE, None)
    assert asked[-3:-1] == pytest.approx([again.rms.held_out_after, again.noise_floor_N], rel=1e-9)
    assert asked[-1] == max(material_force(machine(), asked[-2]), small_force(machine()))  # as a cause has to be
    assert "no known effect accounts for" in again.summary


# --- the machine that has it --------------------------------------------------------------------------------------


HIDDEN = {
    "place_cells": 4,
    "place_low_m": 0.0,
    "place_high_m": 0.2,
    "speed_cells": 2,
    "speed_scale_m_s": 0.05,
    "speed_low_m_s": -0.2,
    "speed_high_m_s": 0.2,
    "force_N": tuple(np.random.default_rng(5).uniform(-1.0, 1.0, 35).tolist()),
}
"""A force over place and speed that no cause of the catalogue is."""


def machine_file(folder: Path) -> Machine:
    """The machine of these tests as a file, which an extended machine can extend."""
    path = folder / "base.toml"
    sampling = "rate = 1000.0\nvelocity_cutoff = 100.0\nupdate_rate = 100.0"
    path.write_text(f'name = "base"\nextends = "etel_xy"\n[sampling]\n{sampling}\n')
    return load_machine(path)


def moved_with_force(speed: float, seed: int, effect: str = "learned_residual") -> Log:
    path = make_trajectory("mixed", 1000.0, duration_s=20.0, max_velocity=speed)
    config = AxisConfig(seed=seed, force_noise_N=NOISE_N)
    return simulate_axis(machine(), path, config, hidden_effects=[(effect, HIDDEN)], truth=False).log


def learn_along(log: Log, axis: Machine) -> Diagnosis:
    """A diagnosis of a log that names nothing, with what its residual teaches."""
    here = prepare(axis, log)
    simulated = here.reduce(CompiledModel(axis).predict(here.signals))
    learned = learn(here, here.friction - simulated)
    assert learned is not None
    traces = replace(
        explained(machine()).traces,
        position_m=here.position,
        velocity_m_s=here.velocity,
        friction_N=here.friction,
        extended_N=simulated,
        held_out_fit_N=simulated,
        used=here.used,
        held_out=here.rows_held_out(),
        rate=here.rate,
    )
    bare = replace(explained(machine()), machine=axis, causes=(), extended=None, changes=None, learned=learned)
    return adopt_tables(replace(bare, verdict="unexplained", traces=traces), log)


def left_by(axis: Machine, log: Log) -> float:
    found = predict_log(axis, log)
    return float(np.sqrt(np.nanmean((found.friction_measured_N - found.friction_N) ** 2)))


@pytest.mark.slow
def test_the_machine_with_the_tables_predicts_another_record_as_well_as_stated(tmp_path: Path) -> None:
    """Its file, read again, gains on a log that nothing has seen what the diagnosis said; its package builds."""
    axis = machine_file(tmp_path)
    found = learn_along(moved_with_force(0.2, 1), axis)
    learned = found.learned
    assert learned is not None and learned.in_file and found.extended is not None
    write_diagnosis(found, tmp_path)
    assert sorted(path.name for path in tmp_path.glob("*.toml")) == ["base.toml", "base_extended.toml"]
    extended, text = load_machine(tmp_path / "base_extended.toml"), (tmp_path / "base_extended.toml").read_text()
    assert extended.digest == found.extended.digest
    assert "Learned, no cause" in text
    assert max(map(len, text.splitlines())) <= 110
    # Its numbers are those of the file, and a switch of the file leaves it out.
    assert found.rms.after == pytest.approx(learned.held_out_after, rel=0.1)
    off = override_machine(extended, {"learned": False})
    assert len(extended.effects) == len(learned.terms) and not off.effects
    other = moved_with_force(0.17, 2)
    before, after = left_by(axis, other), left_by(extended, other)
    low, _ = learned.gain_interval
    assert low < 1.0 - after / before and 1.0 - after / before > learned.gain - 0.05
    assert json.loads((tmp_path / "diagnosis.json").read_text())["learned"]["in_file"] is True
    write_package(emit_package(extended), tmp_path / "package")
    main = tmp_path / "main.c"
    main.write_text('#include "base_extended.h"\nint main(void) { return base_extended_selftest(); }\n')
    program, sources = tmp_path / "selftest", sorted((tmp_path / "package").glob("*.c"))
    built = ["gcc", "-std=c99", "-O1", "-Wall", "-Werror", f"-I{tmp_path / 'package'}", "-o", program, main, *sources]
    subprocess.run(built, check=True, timeout=60.0)
    assert subprocess.run([program], check=False, timeout=60.0).returncode == 0


def test_tables_behind_a_gain_are_smaller_by_it() -> None:
    """A learned force is one of the log, the force that acts is one on the axis."""
    effects = [{"name": "force_gain", "gain": 0.5}, {"name": "force_delay", "delay_s": 1e-3}]
    assert logged_share(override_machine(machine(), {"effects": effects})) == pytest.approx(0.5)
    ripple = [{"name": "force_constant_ripple", "ratio": 0.1, "pitch_m": 0.01}]
    assert logged_share(override_machine(machine(), {"effects": ripple})) == pytest.approx(1.0, abs=0.02)
    estimated = {"effects": effects, "estimator": {"parameters": ["stiffness", "force_gain.gain"]}}
    assert logged_share(override_machine(machine(), estimated)) == pytest.approx(0.5)
    assert logged_share(machine()) == 1.0
    entry = CURVE.terms[0].entry(0.5)
    assert entry["force_N"] == (0.0, 0.2, 0.4, 0.2, 0.0) and entry["speed_cells"] == 2
    assert entry["speed_high_m_s"] == pytest.approx(0.1 * 0.8 / 0.2)


def test_records_that_it_does_not_hold_on_are_said(tmp_path: Path) -> None:
    records = (LearnedRecord("b.csv", 0.5, 0.3, 0.6), LearnedRecord("c.csv", 0.5, 0.4, 0.35))
    learned = replace(CURVE, records=records)
    assert learned.to_json()["other_records"] == {
        "b.csv": {"before": 0.5, "after": 0.3, "plain": 0.6},
        "c.csv": {"before": 0.5, "after": 0.4, "plain": 0.35},
    }
    diagnosis = replace(explained(machine()), verdict="unexplained", learned=learned)
    said = [statement.sentence for statement in diagnosis.statements if statement.kind == "learned"]
    assert len(said) == 3 and "left out of the file" in said[0] and "on b.csv 0.5 N go to 0.3 N" in said[1]
    assert said[2] in diagnosis.limits and said[1] not in diagnosis.limits
    assert "is left out: on c.csv 0.5 N go to 0.4 N" in said[2] and "friction alone 0.35 N" in said[2]
    assert LearnedRecord("d", 0.5, 0.51, 0.9).is_worse and not LearnedRecord("d", 0.5, 0.49, 0.9).is_worse
    assert "hat was learned is left out" in write_report(diagnosis, tmp_path).read_text()


@pytest.mark.slow
def test_it_is_judged_on_another_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a whole diagnosis that names nothing: a map that transfers would have both records fitted together."""
    name_nothing(monkeypatch)
    axis = machine_file(tmp_path)
    here, there = moved_with_force(0.2, 1), moved_with_force(0.17, 2)
    found = diagnose(axis, here, others=[there])
    assert found.verdict == "unexplained" and found.learned is not None and len(found.learned.records) == 1
    record = found.learned.records[0]
    assert record.after < 0.7 * record.before and not record.is_worse
    extended = found.extended
    assert found.learned.in_file and extended is not None
    assert found.records[1].held_out_after == record.after
    assert left_by(extended, there) < 0.7 * left_by(override_machine(extended, {"learned": False}), there)
