"""`sgms-mhe start`: a machine file to begin with, which every other command takes; a first look at a log."""

import html
import json
import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner

from cli_cases import done, refused
from record_cases import simulate_log
from sgms_mhe.api.experiments import plan
from sgms_mhe.api.identification import survey
from sgms_mhe.api.starting import start_text
from sgms_mhe.cli import cli
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.model.effects import MOVES
from sgms_mhe.signals.logs import write_log


def started(*words: str, code: int = 0) -> str:
    result = CliRunner().invoke(cli, ["start", *words])
    assert result.exit_code == code, result.output
    return result.output


@pytest.mark.parametrize(
    "words",
    [
        ["--mass", "12", "--rate", "8000"],
        ["--mass", "0.1", "--rate", "500", "--coulomb", "0.05"],
        ["--mass", "500", "--rate", "20000", "--break-away", "2e-4", "--max-velocity", "3"],
        ["--mass", "3", "--rate", "1234.5", "--viscous", "40"],
        ["--inertia", "0.02", "--rate", "1000", "--coulomb", "0.4"],
    ],
)
def test_what_is_written_can_be_generated(words: list[str], tmp_path: Path) -> None:
    path = tmp_path / "my_axis.toml"
    assert str(path) in started("--out", str(path), *words)
    machine = load_machine(str(path))
    stated = dict(zip(words[::2], map(float, words[1::2]), strict=True))
    assert machine.sampling.rate == stated["--rate"]
    assert machine.plant.moved == stated.get("--mass", stated.get("--inertia"))
    assert machine.friction.coulomb == stated.get("--coulomb", machine.friction.coulomb)
    assert "my_axis.h" in emit_package(machine, within_budget=True).files


def test_assumed_is_what_nobody_gave(tmp_path: Path) -> None:
    def assumed(text: str) -> list[str]:
        return [line.split(" = ")[0] for line in text.splitlines() if "; assumed" in line]

    nothing, _ = start_text(tmp_path / "a.toml", "linear", 12.0, 8000.0)
    everything, _ = start_text(tmp_path / "a.toml", "linear", 12.0, 8000.0, coulomb=4.0, viscous=20.0, break_away=1e-4)
    always = ["fraction", "stribeck_ratio", "stribeck_velocity", "measurement"]
    assert assumed(nothing) == ["coulomb", "viscous", "stiffness", *always]
    assert assumed(everything) == always
    content = tomllib.loads(everything)
    friction = content["friction"]
    distances = [s * friction["coulomb"] / k for s, k in zip(friction["fraction"], friction["stiffness"], strict=True)]
    assert max(distances) == pytest.approx(1e-4, rel=1e-2)


def test_editor_finds_the_schema(tmp_path: Path) -> None:
    path, schema = tmp_path / "my_axis.toml", tmp_path / "machine.schema.json"
    words = ["--out", str(path), "--mass", "12", "--rate", "8000"]
    started(*words)
    directive, text = path.read_text().split("\n", 1)
    assert directive == "#:schema ./machine.schema.json"
    rules = json.loads(schema.read_text())
    jsonschema.validate(tomllib.loads(text), rules)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads(text.replace("mass = ", "mas = ")), rules)
    schema.write_text("somebody's\n")
    started(*words, "--force")
    assert schema.read_text() == "somebody's\n"


def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    path = tmp_path / "my_axis.toml"
    path.write_text("mine\n")
    words = ["--out", str(path), "--mass", "12", "--rate", "8000"]
    assert "--force" in started(*words, code=2)
    assert path.read_text() == "mine\n"
    started(*words, "--force")
    assert load_machine(str(path)).name == "my_axis"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--rate", "8000"], "--mass"),
        (["--mass", "12"], "--rate"),
        (["--mass", "12", "--inertia", "1", "--rate", "8000"], "--inertia"),
        (["--mass", "-1", "--rate", "8000"], "--mass"),
        (["--mass", "nan", "--rate", "8000"], "--mass"),
    ],
)
def test_what_is_missing_or_cannot_be_is_named(words: list[str], named: str, tmp_path: Path) -> None:
    path = tmp_path / "my_axis.toml"
    assert named in started("--out", str(path), *words, code=2)
    assert not path.exists()


TIME: Final = np.arange(12000) / 500.0


def moved(mass: float = 12.0, level: float = 4.0, constant: float = 0.0, noise: float = 0.05) -> dict[str, Any]:
    """Columns of an axis whose friction breaks away over 20 um; with slow and fast motion in both directions."""
    position = 0.1 * np.sin(1.3 * TIME) * np.sin(0.21 * TIME) + 0.01 * np.sin(7.0 * TIME) + 0.003 * np.sin(23.0 * TIME)
    speed = np.gradient(position, TIME)
    deflection, friction = 0.0, np.empty(len(TIME))
    for k, step in enumerate(np.diff(position, prepend=position[0])):
        deflection = min(20e-6, max(-20e-6, deflection + step))
        friction[k] = level * deflection / 20e-6
    white = noise * np.random.default_rng(1).standard_normal(len(TIME))
    force = mass * np.gradient(speed, TIME) + friction + 20.0 * speed + constant + white
    return {"time_s": TIME, "position_m": np.round(position / 1e-7) * 1e-7, "force_N": force}


def written(path: Path, columns: Mapping[str, Any]) -> str:
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")
    return str(path)


@pytest.mark.parametrize(
    ("made", "constant"), [({}, None), ({"constant": 30.0}, 30.0), ({"mass": 3.0, "level": 9.0}, None)]
)
def test_a_look_states_what_the_axis_has(made: dict[str, float], constant: float | None, tmp_path: Path) -> None:
    log, out = written(tmp_path / "log.csv", moved(**made)), tmp_path / "axis.toml"
    found = json.loads(done("start", log, "--out", out, "--json").stdout)
    stated = {s["about"]: s for s in found["statements"] if s["kind"] == "number"}
    truth = {"mass": made.get("mass", 12.0), "coulomb": made.get("level", 4.0), "viscous": 20.0}
    truth["constant_offset.force_N"] = constant or 0.0
    for name, value in truth.items():
        low, high = stated[name]["interval"]
        assert abs(stated[name]["value"] - value) <= high - low, name  # four deviations
        assert stated[name]["sure"] == "yes" and high - low < max(0.05 * value, 0.1)
    assert (stated["constant_offset.force_N"]["why"]["rule"] == "no force") == (constant is None)
    kinds = {s["kind"]: s for s in found["statements"] if s["kind"] in ("sign", "noise")}
    assert kinds["sign"]["sure"] == "yes" and 0.01 < kinds["noise"]["value"] < 0.06
    assert json.loads((tmp_path / "axis_start.json").read_text()) == found
    page = (tmp_path / "axis_start.html").read_text()
    assert 'data-plot="over_speed"' in page and "Mass " in page and f"plan {out} --open" in page
    assert load_machine(str(out)).plant.moved == pytest.approx(truth["mass"], rel=0.01)


@pytest.mark.parametrize(
    ("change", "reason", "drawn"),
    [
        (lambda c: {**c, "force_N": -c["force_N"]}, "of the other sign", True),
        (lambda c: {**c, "position_m": 1e-7 * (np.arange(len(TIME)) % 2)}, "in which the axis moves", True),
        (lambda c: {**c, "position_m": 1e-7 * np.round(np.sin(TIME))}, "what are its columns", True),
        (
            lambda c: dict(zip(("time_s", "pos", "force_N"), c.values(), strict=True)),
            "pos is there without a unit",
            False,
        ),
        (lambda _: moved(level=0.0), "a log that shows dry friction", True),
        (
            lambda c: {**c, "force_N": np.random.default_rng(2).normal(0.0, 5.0, len(TIME))},
            "what are its columns",
            True,
        ),
    ],
)
def test_a_look_that_tells_nothing_says_why_on_its_page(
    change: Callable[[dict[str, Any]], dict[str, Any]],
    reason: str,
    drawn: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert reason in started(written(tmp_path / "log.csv", change(moved())), code=2)
    page, found = (tmp_path / "log_start.html").read_text(), json.loads((tmp_path / "log_start.json").read_text())
    assert reason in html.unescape(page) and "Nothing was fitted" in page
    assert ('data-plot="log_force"' in page) == drawn
    assert reason in found["refusal"] and found["statements"] == []
    assert {path.suffix for path in tmp_path.iterdir()} == {".csv", ".html", ".json"}


def test_a_mass_that_does_not_show_is_open_and_friction_is_not(tmp_path: Path) -> None:
    columns = moved(mass=0.0, noise=0.2)
    log = written(tmp_path / "log.csv", columns)
    found = survey(log)
    stated = {s.about: s for s in found.statements}
    assert stated["mass"].sure == "no" and math.isnan(stated["mass"].value) and stated["mass"].next
    assert stated["coulomb"].value == pytest.approx(4.0, abs=0.1)
    assert "--mass" in started(log, "--out", str(tmp_path / "axis.toml"), code=2)


@pytest.mark.parametrize(
    ("about", "kind", "sure", "moves"),
    [
        ("viscous", "cause", "no", {"constant speeds in both directions"}),
        ("mass", "number", "no", {"hard accelerations and sines"}),
        ("element 2", "element", "no", {"presliding loops at two speeds"}),
        ("coulomb", "number", "yes", None),
        ("residual", "residual", "open", None),
    ],
)
def test_the_next_motion_is_for_what_is_open(
    about: str, kind: str, sure: str, moves: set[str] | None, tmp_path: Path
) -> None:
    path = tmp_path / "log_start.json"
    statement = {"about": about, "kind": kind, "sure": sure, "why": {"numbers": {}}, "next": "a motion"}
    path.write_text(json.dumps({"statements": [statement]}))
    if moves is None:
        assert "leaves something open" in refused("plan", "etel_xy", "--open", path, "--out", tmp_path / "p.csv")
        return
    found = plan("etel_xy", open_in=path)
    assert moves <= set(found.moves) < set(MOVES.values())
    assert len(found.trajectory.time_s) > 1


@pytest.mark.parametrize("text", ["no json", "{}", '{"statements": [{"sure": "no"}]}'])
def test_a_result_that_is_none_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(text)
    assert "it is none" in refused("plan", "etel_xy", "--open", tmp_path / "a.json", "--out", tmp_path / "p.csv")


@pytest.mark.slow
def test_from_a_log_the_file_is_of_its_numbers(tmp_path: Path) -> None:
    axis = load_machine("etel_xy")
    write_log(tmp_path / "log.csv", simulate_log(axis, seconds=6.0, seed=3))
    path = tmp_path / "my_axis.toml"
    assert "rate" in started(str(tmp_path / "log.csv"), "--out", str(path), "--rate", "8000", code=2)
    assert "inertia" in started(str(tmp_path / "log.csv"), "--out", str(path), "--inertia", "1", code=2)
    started(str(tmp_path / "log.csv"), "--out", str(path), "--mass", "20")
    machine = load_machine(str(path))
    assert machine.friction.coulomb == pytest.approx(axis.friction.coulomb, rel=0.05)
    assert machine.sampling.rate == axis.sampling.rate
    emit_package(machine, within_budget=True)
