"""`sgms-mhe start`: a machine file to begin with, which every other command takes."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner

from record_cases import simulate_log
from sgms_mhe.api.starting import start_text
from sgms_mhe.cli import cli
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import emit_package
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


@pytest.mark.slow
def test_from_a_log_the_file_is_identified(tmp_path: Path) -> None:
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
