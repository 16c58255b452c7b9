"""The map over position: its table against its sines, lists in machine files, the emitted table, and its diagnosis."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from record_cases import simulate_log
from sgms_bench.diagnosis.motions import draw_motion
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose, maps
from sgms_mhe.diagnosis.alignment import decimate
from sgms_mhe.diagnosis.candidates import search
from sgms_mhe.diagnosis.criteria import ProgressReport, make_criteria, make_effect
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.diagnosis.parametrisation import CandidateEffect
from sgms_mhe.diagnosis.proposals import Residual
from sgms_mhe.diagnosis.reduction import join_map, reduce_orders
from sgms_mhe.emission.package import emit_package
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.model.effects.periodic_table import POINTS, periodic_spline, spline_coefficients
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.recordings.evidence import Nuisance, find_nuisance, noise_floor
from sgms_mhe.recordings.excitation import measure_excitation
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]

MAP: Mapping[str, Any] = {"order": (1, 2, 6), "sine_N": (0.5, 0.1, 0.15), "cosine_N": (0.2, -0.3, 0.05)}


# --- table ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("orders", [(1,), (1, 2, 6), (7, 28, 100)])
def test_the_table_is_the_sum_of_its_sines(orders: tuple[int, ...]) -> None:
    sines, cosines = (0.5, -0.2, 0.3)[: len(orders)], (0.1, 0.4, -0.6)[: len(orders)]
    u = ca.SX.sym("u")
    spline = periodic_spline(spline_coefficients(orders, sines, cosines), u)
    value = ca.Function("value", [u], [spline, ca.gradient(spline, u)])
    random = np.random.default_rng(1)
    edges = [0.0, -1e-20, 1.0, -3.0, 1.0 - 1e-16, 1e6 + 0.25]
    worst = 0.0
    for place in [*edges, *random.uniform(-5.0, 5.0, 300)]:
        angle = 2.0 * math.pi * (place - math.floor(place))
        expected = sum(
            s * math.sin(n * angle) + c * math.cos(n * angle) for n, s, c in zip(orders, sines, cosines, strict=True)
        )
        slope = sum(
            n * (s * math.cos(n * angle) - c * math.sin(n * angle))
            for n, s, c in zip(orders, sines, cosines, strict=True)
        )
        found, derivative = (float(x) for x in value(place))
        worst = max(worst, abs(found - expected))
        assert derivative == pytest.approx(2.0 * math.pi * slope, abs=2e-4 * 2.0 * math.pi * max(orders))
    size = sum(math.hypot(s, c) for s, c in zip(sines, cosines, strict=True))
    assert 1e-8 * size < worst < (2.0 * math.pi / POINTS) ** 4 / 384.0 * size * 1.2


# --- lists in machine files -------------------------------------------------------------------------------------


def mapped(machine: str = "etel_xy", **changes: Any) -> Machine:
    base = load_machine(machine)
    entry = {"name": "position_map", "pitch_m": 0.032, **MAP, **changes}
    return override_machine(base, {"name": "mapped", "effects": [base.plant.units.keyed(entry)]})


def test_entries_have_names_of_their_own_and_become_lists_again() -> None:
    definition = effect_definition("position_map")
    values: dict[str, Any] = {"pitch_m": 0.03, "order": (1.0, 4.0), "sine_N": (0.1, 0.2), "cosine_N": (0.3, 0.4)}
    entries = definition.entries(values)
    assert entries["order_2"] == 4.0 and entries["sine_1_N"] == 0.1 and entries["cosine_2_N"] == 0.4
    assert tuple(entries) == definition.names(entries) and definition.entries(entries) == entries
    assert definition.lists(entries) == values
    assert definition.parameter("sine_2_N").name == "sine_N"
    assert mapped("etel_xy_rotary").as_dict()["effects"][0]["sine_Nm"] == list(MAP["sine_N"])
    # A list that is left out is as long as the others.
    assert mapped(cosine_N=0.0, order=3, sine_N=0.1).effects[0].parameters["cosine_N"] == (0.0,)


@pytest.mark.parametrize(
    ("changes", "key", "allowed"),
    [
        ({"sine_N": [0.1, 0.2]}, "sine_N", "3 entries"),
        ({"order": [1, 2, 2]}, "order", "each number once"),
        ({"order": [1, 2, 2.5]}, "order", "a whole number from 1 to 100"),
        ({"order": [1, 2, 101]}, "order", "a whole number from 1 to 100"),
        ({"order": [], "sine_N": [], "cosine_N": []}, "order", "1 entries"),
        ({"sine_N": [0.1, 0.2, "much"]}, "sine_N", "number"),
        ({"sine_N": [0.1, 0.2, math.nan]}, "sine_N", "number"),
        ({"pitch_m": [0.03]}, "pitch_m", "number"),
    ],
)
def test_lists_that_do_not_fit_are_refused(changes: dict[str, Any], key: str, allowed: str) -> None:
    with pytest.raises(InputError, match=re.escape(key)) as error:
        mapped(**changes)
    assert allowed in str(error.value)


def test_other_effects_take_no_lists() -> None:
    with pytest.raises(InputError, match="force_N"):
        override_machine(load_machine("etel_xy"), {"effects": [{"name": "constant_offset", "force_N": [0.1]}]})


# --- emitted C --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("orders", [(1, 2, 6), (3, 50, 100)])
def test_the_emitted_work_does_not_hang_on_the_orders(orders: tuple[int, ...]) -> None:
    files = emit_package(mapped(order=orders), selftest=False).files
    assert f"static const sgms_real table_1[{POINTS * orders[-1] + 5}]" in files["mapped_table.h"]
    text = files["mapped_model.h"]
    output = text[text.index("/* Friction force") : text.index("/* What signals alone")]
    assert "Operations: 13 add, 2 floor, 4 lookup, 20 mul, 2 sq, 5 sub." in output
    assert "sgms_sin" not in output and output.count("sgms_entry(table_1") == 4
    assert "sgms_table.h" in files


def test_packages_without_a_map_have_no_table() -> None:
    files = emit_package(load_machine("etel_xy"), selftest=False).files
    assert not any("table" in name for name in files) and "table" not in files["etel_xy_model.h"]


# --- diagnosis --------------------------------------------------------------------------------------------------


def diagnosis_of(name: str, pitch: float | None) -> tuple[float, Diagnosis]:
    """Of an axis whose force over a pitch, or over the whole travel, nobody knows of."""
    machine = load_machine(name)
    moves = make_trajectory("mixed", machine.sampling.rate)
    period = pitch or float(np.ptp(moves.position_m))
    log = simulate_log(machine, ("position_map", {"pitch_m": period, **MAP}), path=moves, seed=1)
    return period, diagnose(machine, log)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "pitch"), [("etel_xy", None), ("etel_xy_rotary", 0.032)], ids=["stroke", "pitch"])
def test_a_hidden_map_is_found_with_its_orders(name: str, pitch: float | None) -> None:
    period, diagnosis = diagnosis_of(name, pitch)
    assert [cause.name for cause in diagnosis.causes] == ["position_map"], diagnosis.summary
    assert diagnosis.verdict == "explained"
    found = diagnosis.causes[0].parameters
    assert found["pitch_m"] == pytest.approx(period, rel=3e-3)
    orders = [round(value) for key, value in found.items() if key.startswith("order")]
    assert set(MAP["order"]) <= set(orders) and len(orders) <= len(MAP["order"]) + 1
    for i, order in enumerate(MAP["order"]):
        j = orders.index(order) + 1
        assert found[f"sine_{j}_N"] == pytest.approx(MAP["sine_N"][i], abs=0.02)
        assert found[f"cosine_{j}_N"] == pytest.approx(MAP["cosine_N"][i], abs=0.02)
    assert diagnosis.rms.held_out_after < 1.2 * diagnosis.noise_floor_N
    assert diagnosis.extended is not None
    assert diagnosis.extended.effects[0].parameters["order"] == tuple(float(n) for n in orders)


@pytest.mark.parametrize(
    ("pitch", "orders", "sizes", "seed"),
    [
        (0.1472, (1, 2, 8), (0.737, 0.500, 0.340), 4),
        (0.1472, (1, 2, 8), (0.737, 0.500, 0.340), 16),
        (0.1905, (1, 4, 6), (0.563, 0.348, 0.215), 6),
        (0.0800, (1, 4, 8), (0.250, 0.200, 0.150), 11),
    ],
)
def test_a_period_is_found_though_no_single_sine_tells_it(
    pitch: float, orders: tuple[int, ...], sizes: tuple[float, ...], seed: int
) -> None:
    """Where the strongest sine is far below the finest one, its period is too vague for that one's order."""
    machine, random = load_machine("etel_xy"), np.random.default_rng(seed)
    angles = random.uniform(-math.pi, math.pi, 3)
    cosines, sines = np.array(sizes) * np.cos(angles), np.array(sizes) * np.sin(angles)
    hidden = {"pitch_m": pitch, "order": orders, "sine_N": tuple(sines), "cosine_N": tuple(cosines)}
    moves = draw_motion("workout", machine, 12.0, random)
    log = simulate_log(machine, ("position_map", hidden), path=moves, seed=seed, force_noise_N=0.05)
    subject = decimate(Subject.of(machine, prepare(machine, log)))
    base = fit_model(subject, ())
    (found,) = search(
        subject, base, ["position_map"], find_nuisance(base.jacobian[subject.recording.used][:, base.interior])
    )
    assert found.parameters["pitch_m"] == pytest.approx(pitch, rel=0.01)
    told = {round(value) for key, value in found.parameters.items() if key.startswith("order")}
    assert set(orders) <= told and len(told) <= len(orders) + 1


def test_rows_near_each_other_stand_as_one_for_all_of_them() -> None:
    random, period, orders = np.random.default_rng(3), 0.03, (1, 2, 5)
    x = np.concatenate((random.uniform(0.0, 0.2, 4000), random.uniform(0.05, 0.06, 4000)))
    basis = np.linalg.qr(np.column_stack((np.ones(8000), x, random.normal(size=8000))))[0]
    force = np.sin(2.0 * math.pi * 5.0 * x / period) + random.normal(0.0, 0.3, 8000)
    seen = Residual(None, None, Nuisance(basis), force - basis @ (basis.T @ force))  # type: ignore[arg-type]
    gathered, at, root = maps._gather(seen, x, period / (maps.BINS_PER_PERIOD * max(orders)))
    assert len(at) < 600 and np.sum(root**2) == pytest.approx(8000)
    every, few = maps._columns(x, period, orders), root[:, None] * maps._columns(at, period, orders)
    size = np.sqrt(np.sum(every**2, axis=0))
    np.testing.assert_allclose(few.T @ few, every.T @ every, atol=0.015 * float(np.max(size)) ** 2)
    np.testing.assert_allclose(gathered.free.basis.T @ few, basis.T @ every, atol=0.01 * float(np.max(size)))
    atol = 0.01 * float(np.max(size) * np.linalg.norm(force))
    np.testing.assert_allclose(few.T @ gathered.e, every.T @ seen.e, atol=atol)


def test_a_map_is_stated_over_its_shortest_period() -> None:
    map_of = effect_definition("position_map").entries
    found = reduce_orders(CandidateEffect("position_map", map_of({"pitch_m": 0.3, **MAP, "order": (3, 12, 18)})))
    assert found.parameters == pytest.approx(map_of({"pitch_m": 0.1, **MAP, "order": (1, 4, 6)}))
    for extra in (found, CandidateEffect("constant_offset", {"force_N": 0.1})):
        assert reduce_orders(extra) == extra


@pytest.mark.parametrize(
    ("share", "named"), [(1.0, ["position_map"]), (1.13, ["force_ripple", "position_map"])], ids=["of it", "apart"]
)
def test_a_ripple_that_comes_again_with_a_map_belongs_to_it(share: float, named: list[str]) -> None:
    """A ripple of three periods of the map makes one map with it; one of another period stays."""
    machine = load_machine("etel_xy")
    map_of = effect_definition("position_map").entries
    true = {"pitch_m": 0.024, "order": (1, 2), "sine_N": (0.2, 0.1), "cosine_N": (0.1, -0.1)}
    ripple = {"amplitude_N": 0.3, "pitch_m": 0.072 * share, "phase_rad": 0.7}
    log = simulate_log(machine, ("position_map", true), ("force_ripple", ripple), seconds=8.0, seed=2)
    recording = prepare(machine, log)
    subject = Subject.of(machine, recording)
    fit = fit_model(subject, (CandidateEffect("force_ripple", ripple), CandidateEffect("position_map", map_of(true))))
    floor = noise_floor(recording, fit.residual)
    criteria = make_criteria(
        machine, floor, measure_excitation(recording.signals, machine), ProgressReport(lambda step, share: None)
    )
    after = join_map(subject, fit, criteria).effects
    assert [extra.name for extra in after] == named
    if named == ["position_map"]:
        found = after[0].parameters
        assert found["pitch_m"] == pytest.approx(0.072, rel=1e-3)
        assert [round(value) for key, value in found.items() if key.startswith("order")] == [1, 3, 6]
        assert found["sine_1_N"] == pytest.approx(0.3 * math.cos(0.7), abs=0.02)
        assert found["cosine_1_N"] == pytest.approx(0.3 * math.sin(0.7), abs=0.02)


@pytest.mark.slow
def test_a_map_whose_other_sines_hardly_matter_is_ambiguous() -> None:
    """One long sine, the others too small to matter and yet seen: a ripple of the wrong pitch would be as good."""
    machine, random = load_machine("etel_xy"), np.random.default_rng(57)
    hidden = {"pitch_m": 0.245, "order": (1, 4, 7), "sine_N": (0.053, -0.045, 0.007), "cosine_N": (-0.04, 0.0, -0.029)}
    moves = draw_motion("workout", machine, 13.5, random)
    log = simulate_log(machine, ("position_map", hidden), path=moves, seed=57, force_noise_N=0.05)
    diagnosis = diagnose(machine, log)
    assert diagnosis.verdict == "ambiguous", diagnosis.summary
    assert diagnosis.causes[0].name == "position_map"
    assert ("force_ripple", "position_map") in [(a.name, a.instead_of) for a in diagnosis.alternatives if a.rival]


MOTOR = """
name = "motor"
plant = { kind = "rotary", inertia = 1e-6 }
friction = { stiffness = [0.2, 0.05], fraction = [0.5, 0.5], viscous = 1e-4, coulomb = 1.5e-3 }
sampling = { rate = 440.0, update_rate = 44.0, velocity_cutoff = 50.0, max_velocity = 10.0 }

[log]
resample = true
time_s = { row = 1 }
position_rad = { row = 2, unit = "counts", counts_per = 8192.0 }
torque_Nm = { row = 3, unit = "A", scale = 0.0083 }
"""
NOISE = 1e-3  # N m, of the weight of the prior


def motor(folder: Path) -> Machine:
    """A small brushless motor, its log in an encoder's counts and amperes."""
    (folder / "motor.toml").write_text(MOTOR, encoding="utf-8")
    return load_machine(folder / "motor.toml")


@pytest.mark.parametrize("turns", [0.3, 0.5])
def test_no_sine_of_a_map_is_longer_than_what_was_passed_twice(turns: float, tmp_path: Path) -> None:
    """One way over part of a turn: what wanders beside cogging is no sine, and the turn tells those of the cogging."""
    machine, random, time = motor(tmp_path), np.random.default_rng(7), np.arange(7_000) / 440.0
    angle = 2.0 * math.pi * turns * time / time[-1]
    cogging = 7e-3 * np.sin(7 * angle) + 4e-3 * np.cos(28 * angle) + 2e-3 * np.sin(12 * angle)
    wandering = 1.5e-3 * np.cumsum(random.normal(size=time.size)) / math.sqrt(time.size)
    torque = 1.5e-3 + cogging + wandering + 1e-3 * random.normal(size=time.size)
    recording = prepare(machine, Log(time, angle, torque, 440.0, kind="rotary", source="one_way.csv"))
    subject = replace(Subject.of(machine, recording), noise=NOISE)
    base = fit_model(subject, ())
    free = find_nuisance(base.jacobian[recording.used][:, base.interior])
    (found,) = search(subject, base, ["position_map"], free)
    sines = [found.parameters["pitch_m"] / n for key, n in found.parameters.items() if key.startswith("order")]
    assert max(sines) < 1.05 * 2.0 * math.pi * turns / 2.0
    for order in (7, 12, 28):
        assert min(abs(2.0 * math.pi / sine - order) for sine in sines) < 0.3 / turns, sines


# --- measured ---------------------------------------------------------------------------------------------------


def test_a_measured_motor_s_cogging_is_mapped_as_well_as_by_its_ten_strongest_harmonics(
    measured_data: Callable[[str], Path], tmp_path: Path
) -> None:
    """One turn, one way: what the map leaves on blocks that its fit has not seen, and what plain least squares does."""
    machine = motor(tmp_path)
    recording = prepare(machine, read_log(measured_data("odrive/slow2_slower_nocomp_0.npy"), machine))
    subject = replace(Subject.of(machine, recording), noise=NOISE)
    base, used, held = fit_model(subject, ()), recording.used, recording.rows_held_out()
    (found,) = search(subject, base, ["position_map"], find_nuisance(base.jacobian[used][:, base.interior]))
    fit = fit_model(subject, (make_effect(found),), warm=base, rows=used & ~held)
    left = float(np.sqrt(np.mean(fit.residual[held] ** 2)))

    def harmonics(orders: Sequence[int]) -> Array:
        angle = recording.position
        return np.column_stack([np.ones(len(angle)), *(f(n * angle) for n in orders for f in (np.sin, np.cos))])

    def fitted(orders: Sequence[int], rows: NDArray[np.bool_]) -> Array:
        return np.asarray(np.linalg.lstsq(harmonics(orders)[rows], recording.friction[rows], rcond=None)[0])

    everything = fitted(range(1, 81), used)
    strongest = (1 + np.argsort(-np.hypot(everything[1::2], everything[2::2])))[:10].tolist()
    rest = recording.friction - harmonics(strongest) @ fitted(strongest, used & ~held)
    bar = float(np.sqrt(np.mean(rest[held] ** 2)))
    assert left < bar < 0.2 * float(np.std(recording.friction[held]))
    orders = {round(value) for key, value in found.parameters.items() if key.startswith("order")}
    assert {7, 12, 14, 28, 36} <= orders
