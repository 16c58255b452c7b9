"""Statements: one object of each judgement, and every output says what it says."""

import math
import string
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import diagnosis_cases as cases
from record_cases import simulate_log
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis import Alternative, Diagnosis
from sgms_mhe.diagnosis.own_numbers import OwnDifference
from sgms_mhe.diagnosis.parametrisation import ParameterGroup
from sgms_mhe.diagnosis.parts import RefutedNumber
from sgms_mhe.identification import Wanted, identify
from sgms_mhe.machine import Machine
from sgms_mhe.support.statements import Rule, Statement, list_open
from statement_cases import check_identification, check_outputs

ROOT = Path(__file__).resolve().parents[1]


def changed(**changes: object) -> Callable[[Machine], Diagnosis]:
    """A ripple that was found, with other evidence."""

    def make(machine: Machine) -> Diagnosis:
        first = cases.explained(machine)
        return replace(first, causes=tuple(replace(cause, **changes) for cause in first.causes))  # type: ignore[arg-type]

    return make


def refuted(machine: Machine) -> Diagnosis:
    """A rough file whose numbers gave way to the record's."""
    number = RefutedNumber("coulomb_N", 4.0, 6.2, 0.1)
    return replace(cases.certain(cases.explained(machine)), refuted=(number,), is_rough=True)


CASES: dict[str, tuple[Callable[[Machine], Diagnosis], Rule]] = {
    "found": (cases.explained, Rule.FOUND),
    "green": (lambda machine: cases.certain(cases.explained(machine)), Rule.EXPLAINED),
    "adequate": (cases.adequate, Rule.ADEQUATE),
    "rival": (cases.ambiguous, Rule.RIVAL),
    "left": (cases.unexplained, Rule.LEFT),
    "still": (cases.motionless, Rule.STILL),
    "chance": (changed(p_value=0.98), Rule.CHANCE),
    "no gain": (changed(gain_interval_N=(-0.1, 0.9)), Rule.NO_GAIN),
    "vague": (changed(vague=("phase_rad",)), Rule.VAGUE),
    "transfers": (changed(transfers=True), Rule.TRANSFERS),
    "first alone": (changed(transfers=False), Rule.FIRST_ALONE),
    "curve": (changed(stands_for="curve over speed"), Rule.PART_OF_CURVE),
    "nameless": (changed(stands_for="what has no name"), Rule.NAMELESS),
    "refuted": (refuted, Rule.REFUTED),
}


@pytest.mark.parametrize("axis", ["etel_xy", "etel_xy_rotary"])
@pytest.mark.parametrize("name", CASES)
def test_no_output_contradicts_another(name: str, axis: str, tmp_path: Path) -> None:
    make, rule = CASES[name]
    found = make(load_machine(axis))
    assert rule in {statement.rule for statement in found.statements}
    check_outputs(found, tmp_path)


def test_a_summary_is_of_the_numbers_beside_it(machine: Machine) -> None:
    """What is learned lowers the residual after the causes are judged: the sentence has the later number."""
    first = cases.explained(machine)
    later = replace(first, rms=replace(first.rms, held_out_after=0.0456))
    assert "0.0456" in later.summary and "0.0456" not in first.summary


def test_a_number_has_one_owner(machine: Machine) -> None:
    """A wrong number of the machine is its cause's, and not the base model's once more."""
    first = cases.explained(machine)
    values = {"coulomb_N": 4.4}
    wrong = replace(
        first.causes[0], name="coulomb", label="coulomb", parameters=values, std={"coulomb_N": 0.05}, nominal=values
    )
    rival = Alternative("constant_offset", "fits as well", True, "coulomb")
    found = replace(first, causes=(wrong,), alternatives=(rival,))
    about = {s.about: s.sure for s in found.statements if s.kind == "number" and "coulomb" in s.about}
    assert about == {"coulomb.coulomb_N": "open"}


def test_a_number_that_differs_between_records_is_stated_once(machine: Machine, tmp_path: Path) -> None:
    first = cases.explained(machine)
    group = ParameterGroup("own", "force_ripple", "force_ripple")
    found = replace(first, differences=(OwnDifference(group, "amplitude_N", (0.8, 1.6)),))
    about = {s.about: s for s in found.statements if s.kind == "number"}
    assert about["force_ripple.amplitude_N"].rule is Rule.DIFFERING and not found.identifies(found.causes[0])
    check_outputs(found, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["etel_xy", "etel_xy_rotary"])
def test_an_identification_says_the_same_everywhere(axis: str) -> None:
    machine = load_machine(axis)
    log = simulate_log(machine, path="paper", seconds=8.0, force_noise_N=0.05, seed=1)
    found = identify([log], Wanted("axis", machine.plant.moved))
    check_identification(found)
    units = machine.plant.units
    stated = {s.about: s.unit for s in found.statements if s.kind == "number"}
    assert stated["coulomb"] == units.force and stated["viscous"] == units.damping
    assert stated[units.named("mass")] == units.mass and stated["stiffness_1"] == units.stiffness
    assert [s for s in found.statements if s.rule in (Rule.STAND_IN, Rule.DEFAULT)] == [
        n.state(units) for n in found.numbers if n.rule in (Rule.STAND_IN, Rule.DEFAULT)
    ]


@pytest.mark.parametrize(
    ("std", "interval", "shown"),
    [(0.05, (3.9, 4.1), "4.000 +- 0.100"), (math.nan, None, "4"), (0.0, None, "4"), (math.inf, None, "4")],
)
def test_intervals_are_two_standard_deviations(std: float, interval: tuple[float, float] | None, shown: str) -> None:
    stated = Statement.of_number(Rule.DETERMINED, "coulomb", 4.0, std, "N")
    assert stated.interval == (pytest.approx(interval) if interval else None)
    assert stated.sentence == f"coulomb = {shown} N" == stated.line
    assert math.isnan(stated.std) if interval is None else stated.std == pytest.approx(std)


def test_every_rule_is_on_the_page_of_outputs() -> None:
    text = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    table = text.partition("## Statements")[2].partition("\n## ")[0]
    rules = [rule.name.lower().replace("_", " ") for rule in Rule]
    assert len(rules) == len({rule.value for rule in Rule}), "two rules are one member"
    missing = [rule for rule in rules if f"`{rule}`" not in table]
    assert not missing


def test_a_sentence_has_all_its_numbers() -> None:
    """What stands in braces is a field of a statement, or said to be one of its numbers."""
    for rule in Rule:
        fields = {name for _, name, _, _ in string.Formatter().parse(rule.text) if name}
        words = dict.fromkeys(fields - {"about", "value", "shown", "unit"}, 1.0)
        text = {key: value if _takes_number(rule, key) else "word" for key, value in words.items()}
        assert "{" not in Statement(rule, "subject", 1.0, (0.5, 1.5), "N", text).sentence


def _takes_number(rule: Rule, name: str) -> bool:
    return any(key == name and form for _, key, form, _ in string.Formatter().parse(rule.text))


def test_reasons_are_given_once(machine: Machine) -> None:
    found = cases.ambiguous(machine)
    rules = [statement.rule for statement in list_open(found.statements)]
    assert Rule.RIVAL in rules and Rule.HAS_RIVAL not in rules and Rule.OF_DOUBTFUL not in rules
