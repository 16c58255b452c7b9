"""Origin of an axis's position along a first motion: where it is found, where it is not, and what the C makes of it."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sgms_mhe
from binding_cases import module_of
from c_packages import written
from cli_cases import SMALL, done, refused, run
from record_cases import simulate_log, small_axis
from sgms_bench.diagnosis.motions import draw_motion
from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.other_record import Origin
from sgms_mhe.emission.package import emit_package
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

PITCH = 0.0171
RIPPLE: Mapping[str, Any] = {"amplitude_N": 1.2, "pitch_m": PITCH, "phase_rad": 0.4}
FINE: Mapping[str, Any] = {"amplitude_N": 0.7, "pitch_m": 0.0053, "phase_rad": -1.1}
SPRING: Mapping[str, Any] = {"stiffness_N_m": 60.0, "centre_m": 0.01}


@pytest.fixture(scope="module")
def small() -> Machine:
    return small_axis()


def with_effects(small: Machine, *effects: tuple[str, Mapping[str, Any]]) -> Machine:
    return override_machine(small, {"effects": [{"name": name, **numbers} for name, numbers in effects]})


def moved(
    small: Machine,
    origin: float,
    *effects: tuple[str, Mapping[str, Any]],
    seed: int = 1,
    style: str = "workout",
    seconds: float = 4.0,
) -> Log:
    """A motion as an axis logs it whose counter reads `origin` at home: colder than its file, and with an offset."""
    hidden = [*effects, ("constant_offset", {"force_N": 0.2})]
    trajectory = draw_motion(style, small, seconds, np.random.default_rng(seed))
    scale = {"coulomb": 1.1, "viscous": 1.3}
    log = simulate_log(small, *hidden, path=trajectory, scale=scale, seed=seed)
    return replace(log, position_m=log.position_m + origin, source="first motion")


def error_of(found: Origin, origin: float) -> float:
    """Error of an origin that is known but for periods [m]."""
    assert found.position_m is not None and found.period_m is not None, found.reason
    return (found.position_m - origin + 0.5 * found.period_m) % found.period_m - 0.5 * found.period_m


@pytest.mark.slow
def test_an_origin_is_found_within_its_deviation(small: Machine) -> None:
    axis, within = with_effects(small, ("force_ripple", RIPPLE)), []
    for seed in range(20):
        origin = float(np.random.default_rng(seed).uniform(-0.05, 0.05))
        style = ("workout", "strokes", "crawl", "one_way")[seed % 4]
        found = sgms_mhe.find_origin(axis, moved(small, origin, ("force_ripple", RIPPLE), seed=seed, style=style))
        assert found.period_m == PITCH
        assert found.candidates_m == (found.position_m,)
        assert found.deviation_m is not None and found.deviation_m < 1e-4
        within.append(abs(error_of(found, origin)) / found.deviation_m)
    assert sum(error < 2.0 for error in within) >= 18  # of 20 at 95 %
    assert max(within) < 4.0
    assert max(within) > 0.5, "a deviation that says nothing"


def test_two_periods_tell_the_origin_beyond_either(small: Machine) -> None:
    effects = ("force_ripple", RIPPLE), ("force_ripple", FINE)
    axis, log = with_effects(small, *effects), moved(small, 0.0243, *effects)
    with pytest.raises(InputError, match="within = 'none': how far from 0 the origin may be: the forces over place do"):
        sgms_mhe.find_origin(axis, log)
    found = sgms_mhe.find_origin(axis, log, within_m=0.06)
    assert found.period_m is None
    assert found.position_m == pytest.approx(0.0243, abs=5e-5)
    elsewhere = sgms_mhe.find_origin(axis, log, within_m=0.02)
    assert not elsewhere.is_determined


def test_what_tells_nothing_of_the_place_determines_no_origin(small: Machine) -> None:
    axis = with_effects(small, ("force_ripple", RIPPLE))
    smooth = sgms_mhe.find_origin(axis, moved(small, 0.004))
    assert smooth.reason == "knowing the place gains nothing on held-out blocks of this motion"
    assert (smooth.position_m, smooth.deviation_m, smooth.candidates_m) == (None, None, ())
    plain = sgms_mhe.find_origin(small, moved(small, 0.004), within_m=0.1)
    assert plain.reason == "no force of small tells the origin along this motion"
    sprung = with_effects(small, ("position_spring", SPRING))
    spring = sgms_mhe.find_origin(sprung, moved(small, 0.004, ("position_spring", SPRING)), within_m=0.1)
    assert spring.reason == plain.reason  # another centre is another offset


@pytest.mark.slow
def test_a_short_travel_gives_the_right_origin_or_none(small: Machine) -> None:
    axis, undetermined = with_effects(small, ("force_ripple", RIPPLE)), 0
    for seed in range(93030, 93050):
        log = moved(small, 0.0031, ("force_ripple", RIPPLE), seed=seed, style="loops", seconds=2.0)
        found = sgms_mhe.find_origin(axis, log)
        if found.is_determined:
            assert abs(error_of(found, 0.0031)) < 0.05 * PITCH
        else:
            undetermined += 1
            assert "fit as well" not in found.reason or len(found.candidates_m) > 1
    assert 0 < undetermined < 20


@pytest.mark.slow
def test_the_c_with_the_origin_found_estimates_what_the_homed_axis_does(small: Machine, tmp_path: Path) -> None:
    axis = with_effects(small, ("force_ripple", RIPPLE))
    home, origin = moved(small, 0.0, ("force_ripple", RIPPLE)), 0.0062
    log = replace(home, position_m=home.position_m + origin)
    found = sgms_mhe.find_origin(axis, log)
    assert abs(error_of(found, origin)) < 1e-4
    module = module_of(written(emit_package(axis, selftest=False, bindings=("python",)), tmp_path))
    homed, other, unaware = (module.Estimator() for _ in range(3))
    other.set_origin(found.position_m)
    wanted = homed.estimate(home.position_m, home.force_N)
    told, wrong = (each.estimate(log.position_m, log.force_N) for each in (other, unaware))
    slope = 2.0 * math.pi / PITCH * RIPPLE["amplitude_N"]  # N/m
    allowed = 3.0 * slope * abs(error_of(found, origin)) + 1e-3
    assert np.abs(told.compensation - wanted.compensation).max() < allowed < 0.2
    assert np.abs(wrong.compensation - wanted.compensation).max() > 1.0
    scale = np.abs(wanted.parameter[-1])
    assert np.abs((told.parameter[-1] - wanted.parameter[-1]) / scale).max() < 0.02


def test_the_command_finds_the_origin_and_predicts_from_there(small: Machine, tmp_path: Path) -> None:
    effect = f'\n[[effects]]\nname = "force_ripple"\namplitude_N = 1.2\npitch_m = {PITCH}\nphase_rad = 0.4\n'
    machine, trace, out = tmp_path / "axis.toml", tmp_path / "log.csv", tmp_path / "p.csv"
    machine.write_text(SMALL + effect)
    log = moved(small, 0.0062, ("force_ripple", RIPPLE))
    log.to_frame().to_csv(trace, index=False)
    options = ("predict", machine, trace, "--out", out)
    plain = json.loads(done(*options, "--json").stdout)
    told = json.loads(done(*options, "--json", "--find-origin").stdout)
    assert plain["origin"] is None
    assert told["origin"]["determined"] is True
    assert told["origin"]["position_m"] == sgms_mhe.find_origin(machine, log.to_frame()).position_m
    assert told["residual_rms_N"] < 0.8 * plain["residual_rms_N"]
    text = done(*options, "--find-origin").stdout
    assert text.startswith(f"origin: {told['origin']['position_m']:.8g} m, one standard deviation ")
    assert f"or any whole multiple of {PITCH} m from there" in text
    moved(small, 0.0, seed=2).to_frame().to_csv(trace, index=False)
    lost = run(*options, "--find-origin")
    assert lost.exit_code == 1
    assert "origin: not determined: knowing the place gains nothing" in lost.stdout
    assert "measured minus simulated" in lost.stdout
    assert "--within = 0.1: beside --find-origin" in refused(*options, "--within", "0.1")
