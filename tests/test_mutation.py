"""Faults in emitted C that the package's self-test has to notice: by hand all, at random most (make verify: more)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import pytest

from sgms_bench.verification.faults import FAULTS, Fault
from sgms_bench.verification.mutation import Campaign, Verdict, check_self_test, draw_mutants, judge_campaign
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import Package, emit_package

Tool = Callable[[str], str]


@pytest.fixture(scope="module")
def package() -> Package:
    """The package that the faults are written for."""
    return emit_package(load_machine("etel_xy"))


@pytest.fixture(scope="module")
def campaign(package: Package, tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Programs of its self-test."""
    return Campaign(package, tmp_path_factory.mktemp("campaign"))


def test_faults_are_in_the_code_once(package: Package) -> None:
    """A fault whose place is gone would count as noticed by nobody."""
    assert len(FAULTS) >= 50 and len({fault.what for fault in FAULTS}) == len(FAULTS)
    for fault in FAULTS:
        assert fault.spoil(dict(package.files), "etel_xy") != package.files


def test_fault_without_effect_counts_for_nothing(package: Package, campaign: Campaign, require_tool: Tool) -> None:
    """The same bytes, a function that nothing calls; and one that the self-test cannot see: a text."""
    require_tool("gcc")
    source = package.files["etel_xy.c"]
    more = "\nint etel_xy_more(void);\nint etel_xy_more(void)\n{\n    return 1;\n}\n"
    assert campaign.judge({**package.files, "etel_xy.c": f"{source}\n"}) is Verdict.SAME
    assert campaign.judge({**package.files, "etel_xy.c": source + more}) is Verdict.UNCHANGED
    other_text = source.replace("faster than max_velocity", "slower than max_velocity")
    assert campaign.judge({**package.files, "etel_xy.c": other_text}) is Verdict.MISSED


@pytest.mark.parametrize("fault", FAULTS[::10], ids=lambda fault: fault.what)
def test_fault_is_noticed(fault: Fault, package: Package, campaign: Campaign, require_tool: Tool) -> None:
    require_tool("gcc")
    assert campaign.judge(fault.spoil(dict(package.files), "etel_xy")) is Verdict.NOTICED


@pytest.mark.slow
def test_faults_are_noticed(require_tool: Tool) -> None:
    """All faults by hand, and mutants: as many of these few as chance lets be of the many that `make verify` draws."""
    require_tool("gcc")
    by_hand, at_random = check_self_test(40, 7, lambda _: None)
    assert by_hand.failures == () and by_hand.tried.startswith(f"{len(FAULTS)} faults, {len(FAULTS)} noticed")
    counted, noticed = map(int, re.findall(r"(\d+) (?:faults|noticed)", at_random.tried))
    assert noticed > 0.8 * counted - 2.0 * math.sqrt(0.8 * 0.2 * counted), at_random.failures


def test_mutants_are_those_of_the_seed(package: Package) -> None:
    drawn = draw_mutants(package, 20, 3)
    assert drawn == draw_mutants(package, 20, 3) != draw_mutants(package, 20, 4)
    for mutant in drawn:
        assert mutant.spoil(package)[mutant.file] != package.files[mutant.file]


def test_campaign_fails_where_too_few_are_noticed() -> None:
    kinds = (Verdict.NOTICED, Verdict.MISSED, Verdict.UNCHANGED, Verdict.NOTICED, Verdict.SAME)
    verdicts = list(zip("abcde", kinds, strict=True))
    assert judge_campaign("t", verdicts, 0.5).failures == ()
    assert judge_campaign("t", verdicts, 0.9).failures == ("b",)
    assert (
        judge_campaign("t", verdicts, 0.5).tried == "3 faults, 2 noticed; 1 change no number of the exercise, 1 no byte"
    )
