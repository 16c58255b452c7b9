"""Rules of MISRA C:2012: emitted code has no hit without a reason, and a hit is found."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from sgms_bench.verification.misra import ADVISORY, REQUIRED, check_misra, find_hits
from sgms_bench.verification.specimens import specimen, specimens
from sgms_mhe.emission.package import Package, emit_package

Tool = Callable[[str], str]


@pytest.fixture(scope="module")
def package() -> Package:
    """A small package with most of what others have."""
    return emit_package(specimen("merged_auto"), selftest=False)


@pytest.mark.slow
def test_every_kind_of_code_has_no_hit_without_a_reason(require_tool: Tool) -> None:
    """And every reason is one of a rule that is still hit."""
    require_tool("cppcheck")
    outcome = check_misra(list(specimens()), print)
    assert outcome.skipped is None and outcome.failures == ()


@pytest.mark.slow
def test_hits_are_found(package: Package, require_tool: Tool) -> None:
    """One of each of three rules, all in one package: every run takes some seconds."""
    require_tool("cppcheck")
    file = f"{package.machine.name}.c"
    spoilt, expected = package.files[file], set()
    for good, bad, rule in (
        ("const bool good = ", "const int good = ", "10.3"),
        ("version % 2u == 0u", "version % 2 == 0", "10.4"),
        ("if ((status & SPECIMEN_MERGED_AUTO_STALE) != 0)", "if (status & SPECIMEN_MERGED_AUTO_STALE)", "14.4"),
    ):
        assert good in spoilt, f"{good} is not in the package any more"
        expected.add((file, spoilt.count("\n", 0, spoilt.index(good)) + 1, rule))
        spoilt = spoilt.replace(good, bad, 1)
    assert expected <= find_hits(replace(package, files={**package.files, file: spoilt}))


def test_page_lists_the_rules_with_their_reasons(repo_root: Path) -> None:
    page = (repo_root / "docs" / "verification.md").read_text()
    table = page[page.index("| rule |") :].split("\n\n")[0].splitlines()[2:]
    expected = [f"| {rule} | required | {reason} |" for rule, reason in REQUIRED.items()]
    expected += [f"| {rule} | advisory | {reason} |" for rule, reason in ADVISORY.items()]
    assert table == expected
