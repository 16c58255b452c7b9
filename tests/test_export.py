"""Exports of an axis: their texts, the command with its refusals, and the error of simpler forms."""

import csv
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import sgms_mhe
from cli_cases import SMALL, done, refused
from export_cases import BASES, FORMS, SUFFIX, machine_of_effect, machine_with
from package_variants import EFFECTS, GEARED
from sgms_mhe.configuration import load_machine, make_machine, override_machine, step_every_sample
from sgms_mhe.emission.axis_equations import axis_model
from sgms_mhe.emission.axis_forms import axis_numbers
from sgms_mhe.emission.friction_table import choose_knots, steady_friction
from sgms_mhe.evaluation.prediction import predict_signals
from sgms_mhe.machine import Machine
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.support.errors import InputError

# --- numbers as text ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("base", BASES)
def test_csv_has_every_number_of_the_machine_file(base: str) -> None:
    text = sgms_mhe.export(base, "csv").text
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    found = {row["name"]: float(row["value"]) for row in rows}
    machine = load_machine(base)
    assert found.pop(machine.plant.units.inert) == machine.plant.moved
    assert [found[f"stiffness_{i + 1}"] for i in range(4)] == list(machine.friction.stiffness)
    assert found["coulomb"] == machine.friction.coulomb and ("zeta" in found) == (base != "etel_xy_switching")
    units = {row["name"]: row["unit"] for row in rows}
    rotary = base == "etel_xy_rotary"
    assert (units["viscous"], units["fraction_1"]) == ("N m s/rad" if rotary else "N s/m", "")


def test_matlab_is_matlab(tmp_path: Path) -> None:
    machine = machine_of_effect("position_map")
    path = tmp_path / "numbers.m"
    sgms_mhe.export(machine, "matlab", path)
    lint = [sys.executable, "-c", "from miss_hit.mh_lint import main; main()", "--brief", str(path)]
    assert subprocess.run(lint, capture_output=True, check=False, cwd=tmp_path).returncode == 0
    found = {name: float(value) for name, value in re.findall(r"^numbers\.(\w+) = (\S+);", path.read_text(), re.M)}
    assert found == {number.identifier: number.value for number in axis_numbers(machine)}


# --- equations ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "more"), [("mass_mismatch", 1.5), ("structural_resonance", 0.0), ("force_gain", 0.0)])
def test_inertia_is_what_a_slow_acceleration_meets(name: str, more: float) -> None:
    assert axis_model(machine_of_effect(name)).inertia == pytest.approx(20.0 + more, rel=1e-9)


def equations_of(text: str, language: str) -> dict[str, str]:
    """Right sides of the equations by the names on the left, as Python."""
    found = re.findall(r"^ *(\w+) = (.+);$", text.partition("equation")[2], re.M)
    python = {}
    for name, right in found:
        if language == "simscape":
            right = re.sub(r"value\((\w+), '[^']*'\)", r"\1", right)
            while "if " in right:
                right = re.sub(
                    r"\bif ((?:(?!\bif\b).)*?), ((?:(?!\bif\b).)*?) else ((?:(?!\bif\b).)*?) end",
                    r"((\2) IF (\1) ELSE (\3))",
                    right,
                )
            right = right.replace("IF", "if").replace("ELSE", "else")
        python[name] = right.replace("^", "**")
    return python


@pytest.mark.parametrize("name", ["none", *EFFECTS, *GEARED, "switching"])
def test_simscape_has_the_equations_of_the_model(name: str) -> None:
    """Its text evaluated at random points; MATLAB itself was not at hand."""
    machine = machine_of_effect(name) if name in (*EFFECTS, *GEARED) else None
    machine = machine or machine_with(base="etel_xy_switching" if name == "switching" else "etel_xy")
    text, axis = sgms_mhe.export(machine, "simscape").text, axis_model(machine)
    model, rng = axis.model, np.random.default_rng(2)
    parameters = dict(re.findall(r"^    (\w+) = \{(\S+), '[^']*'\};", text.partition("variables")[0], re.M))
    evaluate = ca.Function("model", [model.chi, model.w, model.theta], [model.rhs, model.output])
    names = {
        "tanh": np.tanh,
        "exp": np.exp,
        "sqrt": np.sqrt,
        "sin": np.sin,
        "cos": np.cos,
        "floor": np.floor,
        "log": np.log,
    }
    names |= {"abs": abs, "min": min, "max": max, **{key: float(value) for key, value in parameters.items()}}
    for _ in range(20):
        w = rng.choice([-1.0, 1.0], 5) * 10.0 ** rng.uniform(-5.0, 0.5, 5)
        chi = rng.uniform(-1.2, 1.2, model.n_x)
        signals = ("position", "velocity", "acceleration", machine.plant.units.push, "time")
        states = re.findall(r"^      der\((\w+)\) == (\w+) \*", text, re.M)
        values = names | dict(zip(signals, w, strict=True)) | {s: x for (s, _), x in zip(states, chi, strict=True)}
        for left, right in equations_of(text, "simscape").items():
            values[left] = eval(right, {"__builtins__": {}}, values)
        rates, friction = evaluate(chi, w, [p.nominal for p in model.parameters])
        np.testing.assert_allclose([values[rate] for _, rate in states], np.array(rates).ravel(), rtol=1e-9, atol=1e-9)
        assert values["friction"] == pytest.approx(float(friction), rel=1e-9, abs=1e-12)


def test_simscape_states_units_of_the_axis() -> None:
    linear, rotary = (sgms_mhe.export(base, "simscape").text for base in ("etel_xy", "etel_xy_rotary"))
    assert "viscous = {20.0, 'N*s/m'}" in linear and "force : R.f -> C.f;" in linear
    assert "'N*m*s/rad'}" in rotary and "torque : R.t -> C.t;" in rotary and "R.w - C.w" in rotary


# --- friction over speed ------------------------------------------------------------------------------------------


def law_of(machine: Machine, speed: Any) -> Any:
    """The steady curve written apart: Coulomb level with the Stribeck effect, and viscous damping."""
    f = machine.friction
    rise = np.exp(-((speed / f.stribeck_velocity) ** 2))
    return f.coulomb * (1.0 + f.stribeck_ratio * rise) + f.viscous * speed


@pytest.mark.parametrize("base", ["etel_xy", "etel_xy_switching"])
def test_steady_friction_is_the_curve_of_the_law(base: str) -> None:
    machine, speed = load_machine(base), np.geomspace(1e-4, 1.0, 30)
    np.testing.assert_allclose(steady_friction(machine, speed), law_of(machine, speed), rtol=2e-3)
    np.testing.assert_allclose(steady_friction(machine, -speed), -law_of(machine, speed), rtol=2e-3)


@pytest.mark.parametrize(
    "name", ["backlash", "frictional_lag", "hose_hysteresis", "dwell_dependence", "asymmetric_coulomb"]
)
def test_steady_friction_with_an_effect_is_where_the_model_comes_to(name: str) -> None:
    """Along a motion at constant speed; states of effects too, which follow at their own pace."""
    machine, count = machine_of_effect(name), 40000
    time, none, every = np.arange(count) * machine.sampling.step, np.zeros(count), np.ones(count, dtype=bool)
    for speed in (0.004, -0.05):
        signals = Signals(time, speed * time, none + speed, none, none, none, every, ~every)
        friction = predict_signals(step_every_sample(machine), signals).friction_N
        assert steady_friction(machine, np.array([speed]))[0] == pytest.approx(friction[-1], rel=1e-4)


def test_a_drag_is_in_the_table_and_forces_of_place_are_not() -> None:
    drag = {"name": "quadratic_drag", "coefficient_N_s2_m2": 30.0}
    ripple = {"name": "force_ripple", "amplitude_N": 0.6, "pitch_m": 0.004, "phase_rad": 0.7}
    text = sgms_mhe.export(machine_with(drag, ripple), "csv", speed_range=(0.1, 0.5), points=2).text
    assert "with the effects quadratic_drag" in text and "Lost: the effects force_ripple" in text
    last = float(text.splitlines()[-1].partition(",")[2])
    assert last == pytest.approx(law_of(load_machine("etel_xy"), 0.5) + 30.0 * 0.25, rel=0.05)


def test_knots_lose_least_of_all() -> None:
    """Beside every other choice of as many, and a curve of straight lines is met exactly."""
    rng, speed = np.random.default_rng(4), np.arange(9.0)
    curve = rng.standard_normal((1, 9)).cumsum(axis=1)

    def loss(knots: Any) -> float:
        return float(((np.interp(speed, speed[list(knots)], curve[0][list(knots)]) - curve[0]) ** 2).sum())

    found = choose_knots(speed, curve, 4)
    assert loss(found) == pytest.approx(min(loss((0, *middle, 8)) for middle in combinations(range(1, 8), 2)))
    bent = np.abs(speed - 3.0)[None] + np.maximum(speed - 6.0, 0.0)
    assert choose_knots(speed, bent, 4).tolist() == [0, 3, 6, 8]


@pytest.mark.parametrize(("base", "points"), [("etel_xy", 5), ("etel_xy", 10), ("etel_xy_rotary", 6)])
@pytest.mark.parametrize("form", ["twincat-table", "sinamics-table", "csv"])
def test_a_table_has_the_stated_loss_in_units_of_the_drive(form: str, base: str, points: int) -> None:
    exported = sgms_mhe.export(base, form, points=points, speed_range=(2e-4, 0.3))
    rotary = base == "etel_xy_rotary"
    if form == "csv":
        rows = [line.split(",") for line in exported.text.splitlines() if line[0] in "-0123456789"]
        speed, friction = np.array(rows[points:], dtype=float).T
        np.testing.assert_allclose(np.array(rows[:points], dtype=float)[::-1], -np.array([speed, friction]).T)
    else:
        pattern = r"^frict_comp.table.*?(?:in|out) (.*)" if form == "twincat-table" else r"^p38.. = (.*)"
        found = np.array(re.findall(pattern, exported.text, re.M), dtype=float)
        speed, friction = (found[::2], found[1::2]) if form == "twincat-table" else np.split(found, 2)
        scale = {"twincat-table": np.pi / 180e3 if rotary else 1e-6, "sinamics-table": np.pi / 30 if rotary else 1 / 60}
        speed = speed * scale[form]
    assert len(speed) == points and speed[[0, -1]] == pytest.approx([2e-4, 0.3], rel=1e-4)
    at = np.geomspace(2e-4, 0.3, 500)
    off = np.interp(at, speed, friction) - law_of(load_machine(base), at)
    unit = "N m" if rotary else "N"
    stated = re.search(rf"between the points (\S+) {unit} rms, (\S+) %", exported.lost[0])
    assert stated is not None
    assert np.sqrt(np.mean(off**2)) == pytest.approx(float(stated[1]), rel=0.1, abs=0.004)  # 1e-3: the smoothed corner
    assert float(stated[2]) < (2.0 if points < 7 else 0.2)


def test_tables_of_a_machine_with_two_directions() -> None:
    """EMPS: each direction by itself where the form has both, the mean elsewhere, and what that costs."""
    both, mean = (sgms_mhe.export("emps", form, points=6) for form in ("csv", "twincat-table"))
    assert not any("directions" in sentence for sentence in both.lost) and "directions" in mean.lost[-1]
    losses = [float(sentence.split()[3]) for sentence in (both.lost[0], mean.lost[0])]
    assert losses[0] < 0.05 * losses[1]


def test_bam_s_model_has_the_friction_of_the_law(tmp_path: Path) -> None:
    """Its formula (compute_frictions, m2) written out: level and damping of the file at speeds of the axis."""
    exported = sgms_mhe.export("etel_xy_rotary", "bam", tmp_path / "xl330.json")
    p, machine = json.loads(exported.text), load_machine("etel_xy_rotary")
    assert (p["model"], p["actuator"], p["armature"]) == ("m2", "xl330", machine.plant.moved)
    speed = np.geomspace(1e-4, 1.0, 30)
    level = p["friction_base"] + p["friction_stribeck"] * np.exp(-((speed / p["dtheta_stribeck"]) ** p["alpha"]))
    np.testing.assert_allclose(level + p["friction_viscous"] * speed, steady_friction(machine, speed), rtol=2e-3)
    plain = override_machine(machine, {"friction": {"stribeck_ratio": 0.0}})
    assert json.loads(sgms_mhe.export(plain, "bam").text)["model"] == "m1"


# --- the command -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a machine file and its log."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "small.toml").write_text(SMALL + '[[effects]]\nname = "force_gain"\ngain = 1.05\n')
    done("simulate", folder / "small.toml", "--trajectory", "mixed", "--duration", "4", "--out", folder / "log.csv")
    return folder


@pytest.mark.parametrize("form", FORMS)
def test_every_form_says_what_it_holds(form: str, recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / f"axis{SUFFIX[form]}"
    machine = recorded / "small.toml"
    printed = done("export", machine, "--to", form, "--out", out).stdout
    first = out.read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {out.name}
    stated = [line for line in printed.splitlines() if line.startswith(("holds: ", "lost: "))]
    assert any(line.startswith("holds: ") for line in stated) and "error" not in printed
    if not form.startswith("fmu"):
        text, *sentences = (
            re.sub(r"\s+(?:[#%]|//)?\s*", " ", part)
            for part in (first.decode(), *(line.partition(": ")[2] for line in stated))
        )
        assert all(sentence in text for sentence in sentences)
    done("export", machine, "--to", form, "--out", out)
    assert out.read_bytes() == first
    found = json.loads(done("export", machine, "--to", form, "--out", out, "--json").stdout)
    assert found["form"] == form and found["error"] is None and found["holds"]


@pytest.mark.parametrize("form", ["mujoco", "urdf", "modelica", "csv", "fmu3"])
def test_the_error_along_a_log(form: str, recorded: Path, tmp_path: Path) -> None:
    machine, log = recorded / "small.toml", recorded / "log.csv"
    out = tmp_path / f"axis{SUFFIX[form]}"
    found = json.loads(done("export", machine, "--to", form, "--out", out, "--log", log, "--json").stdout)
    printed = done("export", machine, "--to", form, "--out", out, "--log", log).stdout
    if form in ("csv", "fmu3"):
        assert found["error"] is None and "error: none" in printed
        return
    error = found["error"]
    assert f"{error['rms_N']:.6g} N rms" in printed and error["samples"] > 3000
    for force in error["forces"]:
        share = f"{100.0 * force['relative']:.3g} % of it, "
        assert f"lost along {log}: {force['name']}, {force['lost_rms_N']:.4g} N rms, {share}" in printed
    if form == "modelica":
        # a gain of the logged force alone: (g - 1) of all of it, of which the model's friction is a part
        assert 0.0 < error["relative"] < 0.5
        return
    axis = load_machine(machine)
    prediction = sgms_mhe.predict(axis, log)
    assert error["relative"] == pytest.approx(error["rms_N"] / rms(prediction.friction_N, prediction), rel=1e-9)


def rms(values: Any, prediction: Any) -> float:
    return float(np.sqrt(np.mean(values[np.isfinite(prediction.friction_measured_N)] ** 2)))


def test_the_error_is_small_where_little_is_lost() -> None:
    """Stiff elements and no Stribeck effect leave what engines do at rest; softer ones make it several times that."""
    stiff = {"stiffness": [1e7], "fraction": [1.0], "micro_viscous": [0.0], "stribeck_ratio": 0.0}
    relative = []
    for friction in (stiff, {}):
        machine = override_machine(load_machine("etel_xy"), {"friction": friction})
        motion = make_trajectory("mixed", 1e4, duration_s=2.0, max_velocity=0.3)
        error = sgms_mhe.export(machine, "urdf", log=sgms_mhe.simulate(machine, motion).log).error
        assert error is not None
        relative.append(error.relative)
    assert relative[0] < 0.12 and relative[1] > 1.8 * relative[0]


EFFECTS_LOST: dict[str, dict[str, float]] = {
    "force_ripple": {"amplitude_N": 0.6, "pitch_m": 0.004, "phase_rad": 0.7},
    "position_spring": {"stiffness_N_m": 60.0, "centre_m": 0.002},
    "quadratic_drag": {"coefficient_N_s2_m2": 30.0},
    "mass_mismatch": {"mass_kg": 1.5},
    "force_delay": {"delay_s": 4e-5},
}
WRITTEN_APART: dict[str, Callable[[Signals], Any]] = {
    "force_ripple": lambda s: 0.6 * np.sin(2.0 * np.pi * s.position / 0.004 + 0.7),
    "position_spring": lambda s: 60.0 * (s.position - 0.002),
    "quadratic_drag": lambda s: 30.0 * s.velocity * np.abs(s.velocity),
}
OF_LAW = {"Stribeck effect", "micro-viscous damping"}
LOST = {
    "mujoco": {"quadratic_drag", "force_delay", "presliding and rest"},
    "urdf": {"force_ripple", "position_spring", "quadratic_drag", "force_delay", "presliding and rest", *OF_LAW},
    "modelica": {"force_delay"},
    "simscape": {"force_delay"},
    **dict.fromkeys(
        ("twincat-table", "sinamics-table"), set(EFFECTS_LOST) - {"quadratic_drag"} | {"presliding and rest"}
    ),
}
"""Forces that a form does not hold, by form; of those that are not named here every one is held."""


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("law", [{}, {"stribeck_ratio": 0.0, "micro_viscous": [0.0, 0.0]}])
def test_each_force_that_a_form_loses_is_stated_by_itself(form: str, law: dict[str, Any]) -> None:
    """One sum was given of all; a whole mass was said to be lost."""
    effects = [{"name": name, **numbers} for name, numbers in EFFECTS_LOST.items()]
    friction = {"stribeck_ratio": 0.2, "stribeck_velocity": 0.002, "micro_viscous": [8.0, 0.0], **law}
    changes = {"effects": effects, "friction": friction, "sampling": {"integrator": {"scheme": "flow", "substeps": 5}}}
    machine = override_machine(make_machine(tomllib.loads(SMALL), Path("small.toml")), changes)
    motion = make_trajectory("mixed", machine.sampling.rate, duration_s=4.0, max_velocity=0.3)
    log = sgms_mhe.simulate(machine, motion).log
    error = sgms_mhe.export(machine, form, log=log).error
    forces = {force.name: force for force in error.forces} if error is not None else {}
    assert set(forces) == LOST.get(form, set()) - (OF_LAW if law else set())
    if error is None:
        return
    signals = signals_from_log(log, machine)
    for name in set(forces) & set(WRITTEN_APART):
        true = float(np.sqrt(np.mean(WRITTEN_APART[name](signals)[signals.valid] ** 2)))
        assert forces[name].relative == pytest.approx(1.0, rel=1e-9)
        assert forces[name].lost == pytest.approx(true, rel=1e-3)  # later by the delay, to first order
    losses = [force.lost for force in error.forces]
    assert losses == sorted(losses, reverse=True) and error.rms < 1.001 * sum(losses)
    least, most = {"mujoco": (0.0, 0.1), "urdf": (0.05, 1.0)}.get(form, (0.0, np.inf))
    assert "presliding and rest" not in forces or least < (forces["presliding and rest"].relative or 0.0) < most


def test_rotary_names_are_those_of_the_axis(tmp_path: Path) -> None:
    run = sgms_mhe.simulate("etel_xy_rotary", duration_s=2.0)
    run.log.to_frame().to_csv(tmp_path / "log.csv", index=False)
    done_ = done(
        "export",
        "etel_xy_rotary",
        "--to",
        "urdf",
        "--out",
        tmp_path / "a.urdf",
        "--log",
        tmp_path / "log.csv",
        "--json",
    )
    assert set(json.loads(done_.stdout)["error"]) == {"samples", "rms_Nm", "relative", "forces"}


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        (("--to", "mujocco", "--out", "axis.xml"), "did you mean mujoco?"),
        (("--to", "fmu1", "--out", "axis.fmu"), "one of mujoco, urdf, bam, modelica, simscape, csv, matlab, twincat"),
        (("--to", "bam", "--out", "axis.json"), "rotary: BAM knows joints that turn"),
        (("--to", "urdf", "--out", "a.urdf", "--points", "5"), "one of twincat-table, sinamics-table, csv"),
        (("--to", "sinamics-table", "--out", "a.txt", "--points", "11"), "2 to 10 for sinamics-table"),
        (("--to", "csv", "--out", "a.csv", "--range", "0.1", "0.1"), "two speeds above 0, the slower one first"),
        ((), "a form and --out, or --log alone"),
        (("--to", "modelica", "--out", "axis.m"), "a name that ends in .mo"),
        (("--to", "modelica", "--out", "1axis.mo"), "a letter, then letters, digits and underscores"),
        (("--to", "simscape", "--out", "my-axis.ssc"), "it names the model in it"),
        (("--to", "csv", "--out", "absent/axis.csv"), "in a folder that exists"),
        (("--to", "csv"), "Missing option '--out'"),
        (("--to", "csv", "--out", "axis.csv", "--log", "absent.csv"), "absent.csv"),
    ],
)
def test_bad_requests_say_what_is_allowed(
    arguments: tuple[str, ...], allowed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert allowed in refused("export", "etel_xy", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_it_is_written_to_a_pipe_as_well() -> None:
    process = subprocess.run(
        [sys.executable, "-m", "sgms_mhe", "export", "etel_xy", "--to", "csv", "--out", "/dev/stdout"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert process.stdout == sgms_mhe.export("etel_xy", "csv").text and "holds: " in process.stderr


def test_without_a_form_every_error_is_stated(recorded: Path) -> None:
    machine, log = recorded / "small.toml", recorded / "log.csv"
    rows = dict(line.split(": ", 1) for line in done("export", machine, "--log", log).stdout.splitlines())
    found = json.loads(done("export", machine, "--log", log, "--json").stdout)
    assert list(rows) == list(found) and set(rows) == {*FORMS, "bam"}
    for form, row in rows.items():
        error = found[form]
        if isinstance(error, dict):
            assert row.startswith(f"{error['rms_N']:.3g} N rms, {100.0 * error['relative']:.3g} %")
        else:
            assert row == (error or "none")
    assert found["mujoco"]["rms_N"] < found["urdf"]["rms_N"] and rows["bam"].startswith("refused, rotary")


def test_a_drive_s_constants_go_to_bam_alone() -> None:
    drive = {"kind": "voltage", "torque_constant": 1.2, "resistance": 2.5, "supply": 12.0}
    axis = override_machine(load_machine("etel_xy_rotary"), {"drive": drive})
    found = json.loads(sgms_mhe.export(axis, "bam").text)
    assert (found["kt"], found["R"]) == (1.2, 2.5)
    assert "p3839" in sgms_mhe.export(axis, "sinamics-table").text
    with pytest.raises(InputError, match="no other simulator's form holds a drive"):
        sgms_mhe.export(axis, "mujoco")


def test_an_earlier_file_stays_where_the_log_is_refused(recorded: Path, tmp_path: Path) -> None:
    out, log = tmp_path / "axis.xml", tmp_path / "log.csv"
    out.write_text("earlier")
    log.write_text("time_s,position_m,force_N\n0,0,nan\n0.001,nan,0\n")
    refused("export", recorded / "small.toml", "--to", "mujoco", "--out", out, "--log", log)
    assert out.read_text() == "earlier"


def test_what_leaves_no_inertia_is_refused() -> None:
    lightened = machine_with({"name": "mass_mismatch", "mass_kg": -25.0})
    with pytest.raises(InputError, match="positive part"):
        sgms_mhe.export(lightened, "urdf")
