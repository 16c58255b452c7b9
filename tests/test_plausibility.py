"""Logs that no axis can have left: refused by every command that reads one, with what was seen and what to write."""

import json
import math
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from markupsafe import escape

from cli_cases import SMALL, files, refused, run
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.identification.sampling import unknown_axis
from sgms_mhe.logfiles import plausibility
from sgms_mhe.logfiles.plausibility import check_plausible, note_speed_scale
from sgms_mhe.logfiles.reading import read_log, understand
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import TRAJECTORIES, make_trajectory
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.errors import InputError

COMMANDS = ("estimate", "predict", "compare")


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    path = tmp_path_factory.mktemp("machine") / "small.toml"
    path.write_text(SMALL)
    return load_machine(path)


def simulated(machine: Machine, trajectory: str = "paper", config: AxisConfig | None = None) -> Log:
    reference = make_trajectory(trajectory, machine.sampling.rate, max_velocity=machine.sampling.max_velocity)
    return simulate_axis(machine, reference, config, truth=False).log


@pytest.fixture(scope="module")
def log(machine: Machine) -> Log:
    return simulated(machine)


def swapped(log: Log) -> Log:
    return replace(log, position_m=log.force_N, force_N=log.position_m)


def with_gap(log: Log) -> Log:
    position = np.full(len(log), 0.2)
    position[100:300] = np.nan
    return replace(log, position_m=position)


def with_velocity(factor: float) -> Callable[[Log], Log]:
    """The log with a recorded velocity that is `factor` times the position's."""
    return lambda log: replace(log, velocity_m_s=factor * np.gradient(log.position_m) * log.rate)


def with_acceleration(factor: float) -> Callable[[Log], Log]:
    """The log with a recorded acceleration that is `factor` times the position's, over a hundredth of a second."""

    def change(log: Log) -> Log:
        smooth = np.convolve(log.position_m, np.full(10, 0.1), mode="same")
        return replace(log, acceleration_m_s2=factor * np.gradient(np.gradient(smooth)) * log.rate**2)

    return change


REFUSED: list[tuple[str, Callable[[Log], Log], str]] = [
    ("swapped", swapped, r"position_m = 'beyond .* m/s.*': a position in metres.*swapped with force_N"),
    ("constant position", lambda log: replace(log, position_m=np.full(len(log), 0.2)), "position_m, every row = 0.2"),
    ("constant but for a gap", with_gap, "position_m, every row = 0.2"),
    ("constant force", lambda log: replace(log, force_N=np.zeros(len(log))), "force_N, every row = 0.0"),
    ("time for position", lambda log: replace(log, position_m=log.time_s + 7.0), "grows by 1 every second"),
    ("milliseconds", lambda log: replace(log, position_m=1e3 * log.time_s), "grows by 1000 every second"),
    ("row for force", lambda log: replace(log, force_N=np.arange(float(len(log)))), "grows by 1000 every second"),
    ("position twice", lambda log: replace(log, force_N=log.position_m), "the same signal"),
    ("position twice, scaled", lambda log: replace(log, force_N=3.0 - 7.0 * log.position_m), "the same signal"),
    ("micrometres", lambda log: replace(log, position_m=1e6 * log.position_m), "another column or unit"),
    ("millimetres", lambda log: replace(log, position_m=1e3 * log.position_m), 'position_m = .*unit = "mm"'),
    ("micronewtons", lambda log: replace(log, force_N=1e6 * log.force_N), "N rms measured|N per m/s"),
    ("other force", lambda log: replace(log, force_N=-log.force_N), r"column force_N = .*scale = -1.0"),
    ("other position", lambda log: replace(log, position_m=-log.position_m), r"column force_N = .*scale = -1.0"),
    ("kilonewtons", lambda log: replace(log, force_N=1e-3 * log.force_N), 'force_N = .*unit = "kN"'),
    ("millinewtons", lambda log: replace(log, force_N=1e3 * log.force_N), 'force_N = .*unit = "mN"'),
    ("millimetres a second", with_velocity(1e3), 'velocity_m_s = .*unit = "mm/s"'),
    ("other velocity", with_velocity(-1.0), "velocity_m_s = .*scale = -1.0"),
    ("odd velocity", with_velocity(7.0), r"velocity_m_s = .*scale = \.\.\."),
    ("millimetres a second squared", with_acceleration(1e3), 'acceleration_m_s2 = .*unit = "mm/s.2"'),
]


@pytest.mark.parametrize(("change", "message"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED])
def test_what_no_axis_can_have_measured_is_refused(
    change: Callable[[Log], Log], message: str, machine: Machine, log: Log
) -> None:
    with pytest.raises(InputError, match=message) as refusal:
        check_plausible(change(log), machine)
    assert "column" in refusal.value.where


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("case", [REFUSED[0], REFUSED[1], REFUSED[3], REFUSED[6]], ids=lambda case: str(case[0]))
def test_every_command_refuses(
    command: str, case: tuple[str, Callable[[Log], Log], str], machine: Machine, log: Log, tmp_path: Path
) -> None:
    path, out = tmp_path / "log.npz", tmp_path / "out"
    write_log(path, case[1](log))
    options = [] if command == "compare" else ["--out", out]
    assert str(path) in refused(command, machine.source, path, *options)
    assert files(tmp_path) == {"log.npz"}


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: str(case[0]))
def test_a_diagnosis_says_what_cannot_be_meant(
    case: tuple[str, Callable[[Log], Log], str], machine: Machine, log: Log, tmp_path: Path
) -> None:
    write_log(tmp_path / "log.npz", case[1](log))
    arguments = ("diagnose", machine.source, tmp_path / "log.npz", "--out", tmp_path / "out")
    result = run(*arguments)
    if any(
        word in case[0] for word in ("constant", "time for", "milliseconds", "row for", "twice")
    ):  # no signal at all
        assert result.exit_code == 2 and not (tmp_path / "out").exists()
        return
    assert result.exit_code == 1
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found["verdict"] == "unexplained" and found["causes"] == []
    assert found["limits"] == [found["summary"]] and re.search(case[2], found["summary"])
    assert f"unexplained: {found['summary']}" in result.stdout
    report = (tmp_path / "out" / "report.html").read_text()
    assert "Nothing was fitted to this log" in report and str(escape(found["summary"])) in report
    assert f"<title>{machine.name}" in report
    assert json.loads(run(*arguments, "--json").stdout) == found


@pytest.mark.parametrize("column", ["position_m", "force_N"])
@pytest.mark.parametrize("value", [math.inf, 1e308, -1e308, math.nan])
def test_what_is_no_reading_is_no_evidence(column: str, value: float, machine: Machine, log: Log) -> None:
    spoilt = log.columns[column].copy()
    spoilt[::9] = value
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_plausible(replace(log, **{column: spoilt}), machine)  # type: ignore[arg-type]


def test_a_part_that_stands_still_is_refused(machine: Machine, log: Log, tmp_path: Path) -> None:
    still = replace(log, position_m=np.where(log.time_s < 0.5, log.position_m[500], log.position_m))
    check_plausible(still, machine)
    path = tmp_path / "log.npz"
    write_log(path, still)
    assert "every row" in refused("diagnose", machine.source, path, "--to", "0.4", "--out", tmp_path / "out")


def stuck(log: Log, spans: tuple[tuple[float, float], ...]) -> Log:
    """The log of an encoder that repeats its value over these spans [share of the record]."""
    position = log.position_m.copy()
    for start, end in spans:
        first, last = (int(share * len(log)) for share in (start, end))
        position[first:last] = position[first]
    return replace(log, position_m=position)


@pytest.mark.parametrize("spans", [((0.4, 0.46),), ((0.1, 0.13), (0.5, 0.7), (0.8, 0.85)), ((0.3, 0.8),)])
@pytest.mark.parametrize(("trajectory", "name"), [("mixed", "etel_xy"), ("circle_x", "small")])
def test_a_stuck_encoder_is_no_unit(
    spans: tuple[tuple[float, float], ...], trajectory: str, name: str, machine: Machine
) -> None:
    chosen = machine if name == "small" else load_machine(name)
    log = stuck(simulated(chosen, trajectory), spans)
    moved = np.gradient(log.position_m) * log.rate
    check_plausible(log, chosen)
    check_plausible(log, None)
    check_plausible(replace(log, velocity_m_s=moved), chosen)
    for wrong in (replace(log, position_m=1e3 * log.position_m), replace(log, force_N=1e-3 * log.force_N)):
        with pytest.raises(InputError, match="unit ="):
            check_plausible(wrong, chosen)


def test_an_estimator_says_where_the_encoder_stuck(machine: Machine, log: Log, tmp_path: Path) -> None:
    write_log(tmp_path / "log.npz", stuck(log, ((0.4, 0.5),)))
    result = run("estimate", machine.source, tmp_path / "log.npz", "--out", tmp_path / "out.csv", "--json")
    assert result.exit_code == 0, result.output
    status = json.loads(result.stdout)["status"]
    assert status["doubt"] + status["missing"] > 0
    assert status["good"] > 0


@pytest.mark.parametrize("trajectory", ["paper", "mixed", "step_and_settle", "circle_x"])
@pytest.mark.parametrize("name", ["etel_xy", "small"])
def test_what_an_axis_leaves_is_taken(name: str, trajectory: str, machine: Machine) -> None:
    chosen = machine if name == "small" else load_machine(name)
    coarse = AxisConfig(encoder_resolution_m=5e-6, force_noise_N=2.0, encoder_noise_m=1e-7)
    for config in (None, coarse):
        log = simulated(chosen, trajectory, config)
        check_plausible(log, chosen)
        wrong = replace(log, force_N=3.0 * log.force_N + 200.0)
        check_plausible(wrong, chosen)  # that is for a diagnosis to find


@pytest.mark.parametrize("kind", ["force", "position"])
def test_the_sign_needs_no_machine(kind: str, log: Log) -> None:
    check_plausible(log, None)
    name = f"{kind}_{'N' if kind == 'force' else 'm'}"
    with pytest.raises(InputError, match="of the other sign"):
        check_plausible(replace(log, **{name: -log.columns[name]}), None)  # type: ignore[arg-type]


@pytest.mark.parametrize("trajectory", TRAJECTORIES)
@pytest.mark.parametrize(
    ("hidden", "config"),
    [
        ((), AxisConfig(encoder_noise_m=3e-8, force_noise_N=0.5)),
        ((("force_delay", {"delay_s": 2e-3}),), AxisConfig()),
        ((("position_spring", {"stiffness_N_m": 2000.0, "centre_m": 0.0}),), AxisConfig()),
        ((("constant_offset", {"force_N": 60.0}),), AxisConfig()),
        ((("force_ripple", {"amplitude_N": 8.0, "pitch_m": 0.004, "phase_rad": 0.7}),), AxisConfig()),
        ((("structural_resonance", {"frequency_Hz": 40.0, "damping_ratio": 0.03, "mass_kg": 8.0}),), AxisConfig()),
    ],
    ids=["noise", "late", "spring", "offset", "ripple", "resonance"],
)
def test_no_effect_passes_for_a_wrong_sign_or_unit(
    trajectory: str, hidden: tuple[tuple[str, dict[str, float]], ...], config: AxisConfig, machine: Machine
) -> None:
    reference = make_trajectory(trajectory, 1000.0, max_velocity=0.1)
    log = simulate_axis(machine, reference.repeat(min(reference.duration_s, 8.0)), config, hidden_effects=hidden).log
    for judge in (machine, None, override_machine(machine, {"plant": {"mass": 60.0}, "friction": {"coulomb": 1.0}})):
        check_plausible(log, judge)


@pytest.mark.parametrize("amplitude", [0.7, 1.9, 8.0])
def test_a_controllers_answer_to_a_disturbance_on_a_crawl_is_no_mass(
    amplitude: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = load_machine("etel_xy")
    time = np.arange(16000) / machine.sampling.rate
    # A stroke of 40 mm in 5 s, and what a stiffness of 1.6 MN/m leaves of the disturbance.
    answer = amplitude * np.sin(2.0 * math.pi * 4.05 * time)
    position = 0.25 - 0.02 * np.cos(2.0 * math.pi * time / 10.0) - answer / 1.6e6
    friction = machine.friction.coulomb * np.tanh(np.sin(2.0 * math.pi * time / 10.0) / 0.1)
    force = friction + answer + np.random.default_rng(1).normal(0.0, 0.05, len(time))
    log = Log(rate=machine.sampling.rate, time_s=time, position_m=position, force_N=force)
    check_plausible(log, machine)
    with pytest.raises(InputError, match=r"N per m/s\^2"):
        check_plausible(replace(log, force_N=1e3 * log.force_N), machine)
    monkeypatch.setattr(plausibility, "WITHIN_FRICTION", 0.0)
    with pytest.raises(InputError, match=r"N per m/s\^2"):  # as which it would be taken
        check_plausible(log, machine)


@pytest.mark.parametrize("constant", [31.0, 44.0, 190.0])
@pytest.mark.parametrize("sampled", ["etel_xy", "small"])
def test_an_unknown_force_constant_is_a_scale_and_no_unit_of_position(
    constant: float, sampled: str, machine: Machine
) -> None:
    chosen = machine if sampled == "small" else load_machine(sampled)
    log = simulated(chosen, "mixed")
    with pytest.raises(InputError, match="over scale alone") as caught:
        check_plausible(replace(log, force_N=log.force_N / constant), chosen)
    said = caught.value.allowed
    stated = float(said.rpartition("scale = ")[2].partition(" ")[0])
    determined = float(said.rpartition("alone, ")[2].partition(" ")[0])
    assert stated == pytest.approx(constant, rel=0.05)
    assert determined == pytest.approx(chosen.plant.moved / constant, rel=0.05)
    assert 'unit = "cm"' not in said and 'unit = "in"' not in said
    check_plausible(replace(log, force_N=log.force_N / 15.0), chosen)  # that may be the mass's


def test_positions_in_too_large_a_unit_are_refused() -> None:
    machine = load_machine("etel_xy")
    log = simulated(machine, "mixed")
    with pytest.raises(InputError, match=r"N per m/s\^2"):
        check_plausible(replace(log, position_m=1e-2 * log.position_m), machine)


def test_recorded_columns_in_their_units_are_taken(machine: Machine, log: Log) -> None:
    for change in (with_velocity(1.0), with_velocity(0.7), with_acceleration(1.0), with_acceleration(1.5)):
        check_plausible(change(log), machine)
    random = np.random.default_rng(2).normal(size=len(log))
    check_plausible(replace(log, velocity_m_s=random), machine)  # nothing to judge a unit by


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_measured_axis_has_the_sign_that_it_has(sign: float, measured_data: Callable[[str], Path]) -> None:
    emps = load_machine("emps")
    log = read_log(measured_data("emps/DATA_EMPS.mat"), emps)
    changed = replace(log, force_N=sign * log.force_N)
    if sign > 0:
        check_plausible(changed, emps)
    else:
        with pytest.raises(InputError, match=r"'-9\d\.\d N per m/s\^2'"):
            check_plausible(changed, emps)


def pushed(machine: Machine, force: float, velocity: float, duration: float, seed: int) -> Log:
    """A log of an axis of Coulomb and viscous friction under a constant force from a velocity on, until it stops."""
    axis, rate = machine.friction, machine.sampling.rate
    positions, position = [], 0.0
    for _ in range(round(duration * rate)):
        positions.append(position)
        after = velocity + (force - axis.coulomb - axis.viscous * velocity) / machine.plant.moved / rate
        after = max(after, 0.0)
        position += (velocity + after) / 2.0 / rate
        velocity = after
    noise = np.random.default_rng(seed).normal(0.0, 2e-3 * axis.coulomb, len(positions))
    rounded = np.round(np.array(positions) / 1e-7) * 1e-7
    time = np.arange(len(positions)) / rate
    return Log(rate=rate, kind=machine.plant.kind, time_s=time, position_m=rounded, force_N=force + noise)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["etel_xy", "emps", "etel_xy_rotary"])
def test_a_constant_force_and_none_move_an_axis(name: str, seed: int) -> None:
    chosen = load_machine(name)
    duration = (0.4, 1.0, 2.3)[seed]
    for pushes in (1.2, 2.0, 5.0):
        fast = override_machine(chosen, {"sampling": {"max_velocity": 1.0}})
        log = pushed(fast, pushes * chosen.friction.coulomb, 0.0, duration, seed)
        check_plausible(log, fast)
        with pytest.raises(InputError, match="kN"):
            check_plausible(replace(log, force_N=1e-3 * log.force_N), fast)
    check_plausible(pushed(chosen, 0.0, chosen.sampling.max_velocity, duration, seed), chosen)


def test_logs_too_short_for_an_interval_are_taken(machine: Machine, log: Log) -> None:
    check_plausible(log.part(0.5, 0.512), machine)


def test_gaps_are_passed_over(machine: Machine, log: Log) -> None:
    rng = np.random.default_rng(1)
    gaps = rng.random((2, len(log))) < 0.2
    position, force = (
        np.where(gap, np.nan, column) for gap, column in zip(gaps, (log.position_m, log.force_N), strict=True)
    )
    check_plausible(replace(log, position_m=position, force_N=force), machine)
    empty = np.full(len(log), np.nan)
    empty[::7] = log.position_m[::7]
    check_plausible(replace(log, position_m=empty), machine)


@pytest.mark.parametrize("seed", range(4))
def test_a_scale_is_told_by_a_small_inertia_where_little_else_is_left(machine: Machine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mass, level = machine.plant.moved, machine.friction.coulomb
    time = np.arange(12000) / machine.sampling.rate
    slow, fast = rng.uniform(2.0, 4.0), rng.uniform(9.0, 14.0)
    position = np.sin(slow * time) / slow**2 + 0.9 * np.sin(fast * time) / fast**2
    position *= 0.25 * level / (mass * np.std(np.sin(slow * time) + 0.9 * np.sin(fast * time)))
    velocity = np.gradient(position, time)
    friction = level * np.tanh(velocity / (0.02 * np.std(velocity))) + rng.normal(0.0, 0.05 * level, len(time))
    right = Log(time, position, mass * np.gradient(velocity, time) + friction, machine.sampling.rate)
    quick = override_machine(machine, {"sampling": {"max_velocity": 10.0}})
    for factor in (1.0, 8.0, 1.0 / 8.0):
        check_plausible(replace(right, force_N=factor * right.force_N), quick)
    factor = float(rng.uniform(30.0, 60.0))
    with pytest.raises(InputError, match=r"scale = 0\.0[123]"):
        check_plausible(replace(right, force_N=factor * right.force_N), quick)


@pytest.mark.parametrize(("factor", "said"), [(1.0, False), (1.05, False), (1.3, True), (1.9, True), (0.6, True)])
def test_a_velocity_of_another_scale_is_said(
    factor: float, said: bool, machine: Machine, log: Log, tmp_path: Path
) -> None:
    """Half a record was left out as too fast where the stamps of an arm were off by two, and nothing was said."""
    write_log(tmp_path / "log.npz", with_velocity(factor)(log))
    notes = understand(tmp_path / "log.npz", machine).notes
    scale = [note for note in notes if "times the rate of change of position_m" in note]
    assert len(scale) == int(said)
    assert not said or f"velocity_m_s is {factor:.3g} times" in scale[0]


@pytest.mark.parametrize(("size", "other"), [(1e308, 1.0), (1e160, 1.0), (1.0, 1e200), (1e200, 1e200)])
def test_the_scale_of_numbers_that_overflow_is_not_judged(size: float, other: float, log: Log) -> None:
    """A position of 1e308 that changes its sign overflows in its own rate of change: a warning, and a traceback."""
    signs = np.where(np.arange(len(log)) // 7 % 2, 1.0, -1.0)
    derivatives = {"velocity_m_s": other * np.gradient(signs), "acceleration_m_s2": other * signs}
    huge = replace(log, position_m=size * signs, **derivatives)
    assert note_speed_scale(huge) == ""


def test_the_fastest_speed_is_that_which_counts(machine: Machine, log: Log) -> None:
    slow, fast = (unknown_axis([with_velocity(factor)(log)], "axis", 20.0, None) for factor in (1.0, 1.9))
    assert fast.sampling.max_velocity == pytest.approx(1.9 * slow.sampling.max_velocity, rel=0.1)
