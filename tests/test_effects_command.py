"""`effects`, and the names that a message suggests where an unknown one was written."""

import json
import math
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from cli_cases import SMALL, done, refused
from sgms_mhe.configuration import load_machine
from sgms_mhe.machine import OF_KIND
from sgms_mhe.model.effects import CAUSE_NAMES, EFFECT_NAMES, effect_definition, separating_moves
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.names import did_you_mean

ROTARY = SMALL.replace("mass = 20.0", 'kind = "rotary"\ninertia = 20.0')
SWITCHING = SMALL.replace("[friction]", '[friction]\nlaw = "switching"').replace('integrator = { scheme = "flow" }', "")

each_effect = pytest.mark.parametrize("name", EFFECT_NAMES)


@cache
def content(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(done("effects", name, "--json").stdout)
    return found


def test_the_list_has_every_effect_with_its_axis_and_summary() -> None:
    head, *lines = done("effects").stdout.splitlines()
    assert head.split() == ["effect", "axis", "what", "it", "is"]
    assert [line.split()[0] for line in lines] == list(EFFECT_NAMES)
    for name, line in zip(EFFECT_NAMES, lines, strict=True):
        definition = effect_definition(name)
        assert line.endswith(f"  {definition.summary}")
        assert f"  {' or '.join(definition.kinds)}  " in line
    listed = json.loads(done("effects", "--json").stdout)
    assert [entry["name"] for entry in listed] == list(EFFECT_NAMES)
    assert {entry["name"] for entry in listed if "linear" not in entry["kinds"]} == {
        name for name in EFFECT_NAMES if effect_definition(name).kinds == ("rotary",)
    }


@each_effect
def test_an_effect_is_described_by_its_definition(name: str) -> None:
    definition, found = effect_definition(name), content(name)
    assert found["summary"] == definition.summary
    assert found["excitation"]["text"] == definition.excitation.text
    assert len(found["excitation"]["needs"]) == len(definition.excitation.needs)
    assert [p["meaning"] for p in found["parameters"]] == [p.description for p in definition.parameters]
    for stated, parameter in zip(found["parameters"], definition.parameters, strict=True):
        assert stated["names"] == {kind: OF_KIND[kind].named(parameter.name) for kind in definition.kinds}
        assert stated["lower"] == (parameter.lower if math.isfinite(parameter.lower) else None)
        assert stated["upper"] == (parameter.upper if math.isfinite(parameter.upper) else None)
        assert all(stated["units"].values())
    assert found["confused_with"] == {
        other: list(separating_moves(name, other)) for other in CAUSE_NAMES if separating_moves(name, other)
    }
    assert set(definition.confused_with) <= set(found["confused_with"])


@each_effect
def test_the_text_says_what_the_content_holds(name: str) -> None:
    found, text = content(name), done("effects", name).stdout
    words = " ".join(text.split())
    assert text.endswith(f"\n\n{found['toml']}\n")
    assert found["excitation"]["text"] in words
    for rival, moves in found["confused_with"].items():
        assert f"- {rival}: {'; '.join(moves)}" in words
    for parameter in found["parameters"]:
        assert parameter["meaning"] in text and parameter["allowed"] in text
        assert set(parameter["names"].values()) <= set(words.replace(",", "").split())


@each_effect
def test_the_entry_can_be_pasted_and_changes_nothing(name: str, tmp_path: Path) -> None:
    definition, found = effect_definition(name), content(name)
    machine = ROTARY if definition.kinds == ("rotary",) else SMALL
    path = tmp_path / "axis.toml"
    path.write_text(f"{machine}\n{found['toml']}\n")
    (effect,) = load_machine(path).effects
    lists = {p.name for p in definition.parameters if p.array}
    assert effect.name == name
    assert effect.parameters == {p.name: (p.default,) if p.name in lists else p.default for p in definition.parameters}
    names = [p["names"][definition.kinds[0]] for p in found["parameters"]]
    assert list(tomllib.loads(found["toml"])["effects"][0]) == ["name", *names]


def test_what_an_effect_does_not_stand_beside_is_said(tmp_path: Path) -> None:
    smooth_only = [name for name in EFFECT_NAMES if content(name)["not_with_switching"]]
    assert smooth_only == ["backlash", "micro_viscous"]
    path = tmp_path / "axis.toml"
    for name in smooth_only:
        path.write_text(f"{SWITCHING}\n{content(name)['toml']}\n")
        with pytest.raises(InputError, match=re.escape(content(name)["not_with_switching"])):
            load_machine(path)
    assert "- actuator_lag: together they cancel" in done("effects", "force_delay").stdout


# --- names that were meant --------------------------------------------------------------------------------------


def test_the_nearest_name_comes_first_and_far_ones_not_at_all() -> None:
    assert did_you_mean("Force_Riple", EFFECT_NAMES).startswith("; did you mean force_ripple")
    assert did_you_mean("xyzzy", EFFECT_NAMES) == ""
    assert did_you_mean("", EFFECT_NAMES) == ""


@pytest.mark.parametrize(
    ("written", "meant"),
    [("estimat", "estimate"), ("DIAGNOSE", "diagnose"), ("bench_diagnosis", "bench-diagnosis"), ("efects", "effects")],
)
def test_an_unknown_command_suggests_the_nearest(written: str, meant: str) -> None:
    message = refused(written)
    assert f"No such command {written!r}; did you mean {meant}" in message


def test_an_unknown_command_that_nothing_is_near_is_just_unknown() -> None:
    assert "No such command 'xyzzy'.\n" in refused("xyzzy")


def test_an_unknown_effect_suggests_the_nearest() -> None:
    message = refused("effects", "backlsh")
    assert "effects: name = 'backlsh': one of force_ripple" in message
    assert message.rstrip().endswith("; did you mean backlash?")


def test_a_plan_suggests_the_cause_that_was_meant(tmp_path: Path) -> None:
    out = tmp_path / "plan.csv"
    message = refused("plan", "etel_xy", "--separate", "coulomb", "constant_ofset", "--out", out)
    assert "'constant_ofset'" in message and "did you mean constant_offset" in message
    assert not out.exists()


def test_a_machine_file_suggests_the_effect_that_was_meant(tmp_path: Path) -> None:
    path = tmp_path / "axis.toml"
    path.write_text(f'{SMALL}\n[[effects]]\nname = "actuator_lags"\n')
    message = refused("check", path)
    assert f"{path}: effects[1].name = 'actuator_lags'" in message
    assert "did you mean actuator_lag" in message


# --- schema -----------------------------------------------------------------------------------------------------


def test_the_schema_knows_every_effect_and_its_parameters() -> None:
    schema = json.loads(done("schema").stdout)
    effect = schema["$defs"]["Effect"]
    assert effect["properties"]["name"]["enum"] == list(EFFECT_NAMES)
    rules = {rule["if"]["properties"]["name"]["const"]: rule["then"] for rule in effect["allOf"]}
    assert list(rules) == list(EFFECT_NAMES)
    for name, rule in rules.items():
        definition = effect_definition(name)
        named = {OF_KIND[kind].named(p.name): p for kind in definition.kinds for p in definition.parameters}
        assert rule["propertyNames"]["enum"] == ["name", *rule["properties"]]
        assert set(rule["properties"]) == set(named)
        for key, value in rule["properties"].items():
            number = value["anyOf"][0] if named[key].array else value
            assert number.get("minimum", -math.inf) == named[key].lower
            assert number.get("maximum", math.inf) == named[key].upper
            assert value["default"] == named[key].default
