"""Axes that turn: the twin of a linear axis has its numbers to the last bit, under names and units of its own."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_packages import run
from cli_cases import done, refused
from record_cases import Hidden, simulate_log
from sgms_bench.benchmark.harness import build_harness
from sgms_mhe.configuration import load_machine, make_machine, override_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.emission.package import emit_package
from sgms_mhe.evaluation.comparison import compare_signals
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.machine import LINEAR, ROTARY, Machine
from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition
from sgms_mhe.report import write_report
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.errors import InputError

LINEAR_UNITS = re.compile(
    r"\[(N|m|m/s|m/s\^2|N/m|kg)\]|\b\d+(\.\d+)? (N(?! m)|m|m/s|kg(?! m)|N/m)\b|\bmetres?\b|\bmass\b|_(N|m|kg)\b"
)
"""What nobody should read of an axis that turns."""


def twin(**changes: Any) -> tuple[Machine, Machine]:
    """etel_xy with changes, and its rotary twin."""
    return tuple(override_machine(load_machine(name), changes) for name in ("etel_xy", "etel_xy_rotary"))  # type: ignore[return-value]


def moved(machine: Machine, *hidden: Hidden, seconds: float = 1.5) -> Log:
    return simulate_log(machine, *hidden, seconds=seconds, seed=3)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Logs of both twins."""
    folder = tmp_path_factory.mktemp("rotary")
    paths = folder / "linear.csv", folder / "rotary.csv"
    for machine, path in zip(twin(), paths, strict=True):
        write_log(path, moved(machine))
    return paths


# --- names --------------------------------------------------------------------------------------------------------


def test_names_end_in_the_units_of_their_kind() -> None:
    names = {
        "position_m": "position_rad",
        "force_N": "torque_Nm",
        "friction_measured_N": "friction_measured_Nm",
        "velocity_m_s": "velocity_rad_s",
        "acceleration_m_s2": "acceleration_rad_s2",
        "z_2_m": "z_2_rad",
        "force_ripple.amplitude_N": "force_ripple.amplitude_Nm",
        "stiffness_1_N_m": "stiffness_1_Nm_rad",
        "damping_N_s_m": "damping_Nm_s_rad",
        "mass_kg": "inertia_kg_m2",
        "mass": "inertia",
        "phase_rad": "phase_rad",
        "time_constant_s": "time_constant_s",
        "ratio": "ratio",
    }
    assert {name: ROTARY.named(name) for name in names} == names
    assert all(LINEAR.named(name) == name for name in names)


def test_every_parameter_of_an_effect_has_a_name_and_a_unit_on_either_kind() -> None:
    for effect in EFFECT_NAMES:
        names = [parameter.name for parameter in effect_definition(effect).parameters]
        turned = [ROTARY.named(name) for name in names]
        assert len(set(turned)) == len(names)
        assert [bool(LINEAR.unit(name)) for name in names] == [bool(ROTARY.unit(name)) for name in names]
        assert not any(name.endswith(("_m", "_N", "_kg")) for name in turned)


# --- the machine file ---------------------------------------------------------------------------------------------


def test_effects_and_estimates_take_names_of_their_kind() -> None:
    entry = {"name": "force_ripple", "amplitude_Nm": 0.8, "pitch_rad": 0.032, "phase_rad": 0.7}
    parameters = ["stiffness", "force_ripple.amplitude_Nm"]
    changes = {"effects": [entry], "estimator": {"parameters": parameters, "bounds": {}}}
    turned = override_machine(load_machine("etel_xy_rotary"), changes)
    assert turned.effects[0].parameters == {"amplitude_N": 0.8, "pitch_m": 0.032, "phase_rad": 0.7}
    content = turned.as_dict()
    assert content["effects"] == [entry]
    assert content["estimator"]["parameters"] == parameters
    assert content["plant"] == {"kind": "rotary", "inertia": 20.0}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"plant": {"inertia": None}}, "plant.inertia"),
        ({"plant": {"mass": 3.0}}, "plant.mass = 3.0: inertia [kg m^2] of a rotary axis"),
        ({"plant": {"kind": "round"}}, "linear"),
        ({"effects": [{"name": "force_ripple", "amplitude_N": 1.0}]}, "force_ripple has amplitude_Nm, pitch_rad"),
        ({"estimator": {"parameters": ["force_ripple.amplitude_N"]}, "effects": [{"name": "force_ripple"}]}, "_Nm"),
    ],
)
def test_what_a_rotary_axis_cannot_have_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as error:
        override_machine(load_machine("etel_xy_rotary"), changes)
    assert said in str(error.value)


def test_a_linear_axis_has_a_mass() -> None:
    content = {**load_machine("etel_xy").content, "plant": {"inertia": 1.0}}
    with pytest.raises(InputError, match=r"plant\.mass.*required of a linear axis"):
        make_machine(content, Path("x.toml"))


# --- logs and estimates -------------------------------------------------------------------------------------------


def test_the_twin_moves_and_is_estimated_alike(logs: tuple[Path, Path], tmp_path: Path) -> None:
    written = []
    for name, log in zip(("etel_xy", "etel_xy_rotary"), logs, strict=True):
        done("estimate", name, log, "--out", tmp_path / f"{name}.csv")
        written.append((tmp_path / f"{name}.csv").read_text().splitlines())
    assert logs[1].read_text().splitlines()[0] == "time_s,position_rad,torque_Nm"
    assert logs[0].read_text().splitlines()[1:] == logs[1].read_text().splitlines()[1:]
    assert written[0][1:] == written[1][1:]
    assert written[1][0].startswith(
        "time_s,friction_measured_Nm,friction_Nm,z_1_rad,z_2_rad,z_3_rad,z_4_rad,stiffness_1"
    )
    assert "status,innovation_Nm,test_ratio,noise_scale" in written[1][0]
    assert len(written[1]) > 100


def test_the_c_is_the_reference(logs: tuple[Path, Path]) -> None:
    machine = load_machine("etel_xy_rotary")
    comparison = compare_signals(machine, signals_from_log(read_log(logs[1], machine), machine))
    assert comparison.agrees
    assert {"friction_Nm", "z_1_rad"} <= {quantity.name for quantity in comparison.quantities}


def test_degrees_and_counts_are_read(logs: tuple[Path, Path], tmp_path: Path) -> None:
    machine = load_machine("etel_xy_rotary")
    log = read_log(logs[1], machine)
    per_turn = 2**32
    counts = np.round(log.position_m * per_turn / (2.0 * math.pi))
    table = np.column_stack((log.time_s, np.rad2deg(log.position_m), counts, 1e3 * log.force_N))
    path = tmp_path / "trace.csv"
    np.savetxt(path, table, delimiter=",", header="t,angle,counts,torque", comments="", fmt="%.12g")
    columns = {"time_s": "t", "torque_Nm": {"variable": "torque", "unit": "mN m"}}
    for source in (
        {"variable": "angle", "unit": "deg"},
        {"variable": "counts", "unit": "counts", "counts_per": per_turn},
    ):
        mapped = override_machine(machine, {"log": {**columns, "position_rad": source}})
        read = read_log(path, mapped)
        assert read.kind == "rotary"
        np.testing.assert_allclose(read.position_m, log.position_m, rtol=0.0, atol=1.5e-9)
        np.testing.assert_allclose(read.force_N, log.force_N, rtol=1e-11)


def test_logs_of_the_other_kind_are_refused(logs: tuple[Path, Path], tmp_path: Path) -> None:
    said = refused("estimate", "etel_xy_rotary", logs[0], "--out", tmp_path / "e.csv")
    assert "columns of a rotary axis, as etel_xy_rotary is" in said
    assert "position_rad, torque_Nm" in said


def test_a_wrong_sign_is_said_in_its_own_words(logs: tuple[Path, Path], tmp_path: Path) -> None:
    log = read_log(logs[1])
    negated = Log(log.time_s, log.position_m, -log.force_N, log.rate, kind="rotary")
    write_log(tmp_path / "negated.csv", negated)
    said = refused("estimate", "etel_xy_rotary", tmp_path / "negated.csv", "--out", tmp_path / "e.csv")
    assert 'torque_Nm = { variable = "torque_Nm", scale = -1.0, unit = "N m" }' in said
    assert not LINEAR_UNITS.search(said)


# --- what is emitted, reported, found -----------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_package_speaks_of_angles_and_torques(precision: str, tmp_path: Path) -> None:
    linear, turned = twin(code={"precision": precision})
    package, other = emit_package(turned), emit_package(linear)
    for name, text in package.files.items():
        if name.startswith(turned.name):
            found = [line for line in text.splitlines() if LINEAR_UNITS.search(line)]
            assert not found, f"{name}: {found[:3]}"
    header = package.files[f"{turned.name}.h"]
    assert "etel_xy_rotary_position_from_radians(double radians)" in header
    assert "drive torque" in header
    # But for comments and names it is the linear twin's code.
    ours, theirs = package.files[f"{turned.name}.c"], other.files[f"{linear.name}.c"]
    assert code_of(ours.replace("etel_xy_rotary", "etel_xy").replace("ETEL_XY_ROTARY", "ETEL_XY")) == code_of(theirs)
    run(build_harness(turned, package), "--selftest")


def code_of(text: str) -> list[str]:
    """Tokens of the code, without comments and the unit of a position: where lines wrap is the name's length."""
    bare = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL).replace(".prad", ".pm").replace(".rad", ".m")
    return re.findall(r"\w+|\S", bare)


@pytest.mark.slow
def test_a_diagnosis_finds_the_same_and_says_it_in_its_own_units(tmp_path: Path) -> None:
    ripple = ("force_ripple", {"amplitude_N": 0.9, "pitch_m": 0.03, "phase_rad": 0.4})
    found = [diagnose(machine, moved(machine, ripple, seconds=4.0)) for machine in (twin()[0], twin()[1])]
    assert [cause.name for cause in found[1].causes] == ["force_ripple"]
    assert found[0].causes[0].parameters == found[1].causes[0].parameters
    content = found[1].to_json()
    assert set(content["causes"][0]["parameters"]) == {"amplitude_Nm", "pitch_rad", "phase_rad"}
    assert "gain_Nm" in content["causes"][0]
    assert "residual_rms_Nm" in content
    extended = found[1].extended
    assert extended is not None
    assert "amplitude_Nm = " in (found[1].extended_file() or "")
    write_report(found[1], tmp_path)
    (tmp_path / "diagnosis.json").write_text(json.dumps(content))
    (tmp_path / "again.toml").write_text(found[1].extended_file() or "")
    assert load_machine(tmp_path / "again.toml").effects == extended.effects
    page = re.sub(r"<script.*?</script>|<style.*?</style>", "", (tmp_path / "report.html").read_text(), flags=re.DOTALL)
    words = re.sub(r"<[^>]*>", " ", page).replace("\N{NO-BREAK SPACE}", " ")
    assert "N m" in words
    assert not re.search(r"\d N(?! m)\b|\bmm\b|\bm/s\b|\bkg\b", words)


@pytest.mark.slow
def test_an_axis_that_turns_is_identified(tmp_path: Path) -> None:
    content = {
        "name": "truth",
        "plant": {"kind": "rotary", "inertia": 0.2},
        "friction": {
            "law": "switching",
            "stiffness": [2000.0, 150.0],
            "fraction": [0.4, 0.6],
            "viscous": 0.1,
            "coulomb": 0.5,
        },
        "sampling": {"rate": 2000.0, "update_rate": 100.0, "velocity_cutoff": 200.0, "max_velocity": 1.2},
    }
    truth = make_machine(content, Path("truth.toml"))
    log = moved(truth, seconds=14.0)
    write_log(tmp_path / "log.csv", log)
    said = done("identify", tmp_path / "log.csv", "--out", tmp_path / "axis.toml", "--inertia", "0.2", "--json").stdout
    found = json.loads(said)
    numbers = {number["name"]: number for number in found["numbers"]}
    assert numbers["coulomb"]["value"] == pytest.approx(0.5, rel=0.05)
    assert numbers["inertia"]["value"] == 0.2
    assert "held_out" in found["residual_rms_Nm"]
    machine = load_machine(tmp_path / "axis.toml")
    assert machine.plant.kind == "rotary"
    assert not LINEAR_UNITS.search((tmp_path / "axis.toml").read_text())
    said = refused("identify", tmp_path / "log.csv", "--out", tmp_path / "no.toml", "--mass", "0.2")
    assert "mass = 0.2: inertia [kg m^2]: the logs are of a rotary axis" in said


def test_commands_speak_of_angles_and_torques(logs: tuple[Path, Path], tmp_path: Path) -> None:
    said = done("check", "etel_xy_rotary").stdout
    said += done("predict", "etel_xy_rotary", logs[1], "--out", tmp_path / "p.csv").stdout
    said += done("estimate", "etel_xy_rotary", logs[1], "--out", tmp_path / "e.csv").stdout
    said += done(
        "simulate", "etel_xy_rotary", "--duration", "0.5", "--out", tmp_path / "s.csv", "--scale", "inertia=1.1"
    ).stdout
    said += done("plan", "etel_xy_rotary", "--separate", "coulomb", "viscous", "--out", tmp_path / "plan.csv").stdout
    assert not LINEAR_UNITS.search(said)
    assert (tmp_path / "plan.csv").read_text().startswith("time_s,position_rad\n")
    assert (tmp_path / "p.csv").read_text().startswith("time_s,friction_measured_Nm,friction_Nm\n")
    assert (
        '"residual_rms_Nm"' in done("predict", "etel_xy_rotary", logs[1], "--out", tmp_path / "p.csv", "--json").stdout
    )
