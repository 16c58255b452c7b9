"""Checks that every output says of a judgement what its statement says."""

import json
import re
from collections.abc import Mapping
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from sgms_mhe.commands.diagnose import _text
from sgms_mhe.diagnosis import Diagnosis, write_diagnosis
from sgms_mhe.identification import Identification
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.report import write_report
from sgms_mhe.support.statements import Rule, list_open

RULES = {rule.name.lower().replace("_", " "): rule for rule in Rule}


def check_statements(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Check the form of the statements of a command's JSON, and return them."""
    statements: list[dict[str, Any]] = content["statements"]
    assert statements
    for entry in statements:
        assert set(entry) == {"kind", "about", "value", "interval", "unit", "sure", "why", "next"}
        rule = RULES[entry["why"]["rule"]]
        assert (entry["kind"], entry["sure"]) == (rule.kind, rule.sure) and entry["about"]
        assert all(isinstance(value, str | float | int | None) for value in entry["why"]["numbers"].values())
        assert entry["next"] is None or isinstance(entry["next"], str)
        if entry["interval"] is not None:
            low, high = entry["interval"]
            assert low < high
            assert entry["kind"] != "number" or low + high == pytest.approx(
                2.0 * entry["value"], abs=1e-6 * (high - low)
            )
    names = [entry["about"] for entry in statements if entry["kind"] == "number"]
    assert len(set(names)) == len(names), "a number is judged twice"
    return statements


def read_comments(toml: str) -> str:
    """Return the comments of a file as one line of text."""
    return " ".join(line.partition("#")[2].strip() for line in toml.splitlines() if "#" in line)


def check_identification(found: Identification) -> None:
    """Check JSON, file and notebook of an identification against its statements."""
    content = found.to_json()
    entries = check_statements(content)
    comments, html = read_comments(found.toml), unescape(found._repr_html_())
    for number, entry, said in zip(found.numbers, entries, content["numbers"], strict=False):
        assert said["name"] == entry["about"] and said["value"] == entry["value"]
        assert said["identified"] == number.determined == (entry["sure"] == "yes")
        assert said["note"] == number.note and number.note in comments and number.note in html
        if entry["interval"] is not None:
            assert entry["interval"][1] - entry["interval"][0] == pytest.approx(4.0 * number.std)
            assert number.interval in comments and number.interval in html
    for sentence in found.limits:
        assert sentence in comments


def check_outputs(found: Diagnosis, folder: Path) -> None:
    """Check JSON, terminal, page, notebook and written file of a diagnosis against its statements."""
    content = json.loads((write_diagnosis(found, folder) / "diagnosis.json").read_text())
    entries, statements = check_statements(content), found.statements
    lines = [line.strip() for line in _text(found, folder, None, None).splitlines()]
    source = unescape(write_report(found, folder).read_text())
    page = " ".join(re.sub(r"<script.*?</script>|<style.*?</style>|<[^>]+>", " ", source, flags=re.S).split())
    comments, html = read_comments(found.extended_file(folder) or ""), unescape(found._repr_html_())
    for entry, s in zip(entries, statements, strict=True):
        assert (entry["sure"], entry["about"]) == (s.sure, s.about)
        if s.kind != "verdict" and s.rule is not Rule.REFITTED:
            said = ("open: " if s.sure != "yes" else "") + s.sentence
            assert said in lines and said in html
            assert found.extended is None or said in comments
        if s.kind == "number" and s.text:
            assert s.text in page
    assert content["summary"] == found.summary == statements[0].sentence and lines[0].endswith(found.summary)
    assert content["limits"] == [s.sentence for s in list_open(statements)]
    _check_causes(found, content, page)
    green = 'class="pill certain"' in source
    assert green == (statements[0].sure == "yes" and not content["limits"])


def _check_causes(found: Diagnosis, content: Mapping[str, Any], page: str) -> None:
    """Check that what is called found is sure, and that no interval of it holds what is nothing."""
    sure = {s.about: s.sure == "yes" for s in found.statements if s.kind in ("cause", "number")}
    headline = page.partition("What this record")[0]
    assert ("Found:" in headline) == any(sure[cause.label] for cause in found.causes)
    for cause, entry in zip(found.causes, content["causes"], strict=True):
        named = found.machine.plant.units.named
        numbers = [f"{cause.label}.{named(name)}" for name in cause.parameters]
        assert entry["identified"] == all(sure[name] for name in (cause.label, *numbers))
        if not sure[cause.label]:
            assert not any(sure[name] for name in numbers)
            continue
        assert cause.gain_interval_N[0] > 0.0
        for name in cause.parameters if cause.name not in BASE_CAUSES else ():
            parameter, reach = effect_definition(cause.name).parameter(name), 2.0 * cause.std[name]
            is_nothing = abs(cause.parameters[name] - parameter.none) <= reach
            assert not is_nothing or name in cause.vague or parameter.role == "place" or cause.nominal
    identified = [found.identifies(cause) for cause in found.causes for _ in cause.parameters]
    assert list(found.to_frame()["identified"]) == identified
