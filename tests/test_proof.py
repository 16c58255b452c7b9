"""Static proof by Frama-C/Eva that no call leaves its memory, and that it finds an index that does."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from sgms_bench.verification.proof import ALARMS, analyse_call, check_proof
from sgms_bench.verification.specimens import specimen
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import Package, emit_package

Tool = Callable[[str], str]


@pytest.fixture(scope="module")
def package() -> Package:
    """The default package."""
    return emit_package(load_machine("etel_xy"), selftest=False)


@pytest.mark.slow
def test_no_call_leaves_its_memory(require_tool: Tool) -> None:
    """Of the default package every call; each alarm that is left is on the list, and is still there."""
    require_tool("frama-c")
    outcome = check_proof([load_machine("etel_xy")], print)
    assert outcome.skipped is None and outcome.failures == ()
    assert outcome.tried.endswith(f"{len(ALARMS)} alarms left, with a reason each")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf", "newest", "auto", "switching", "signals"])
def test_tick_of_other_kinds_does_not_either(name: str, require_tool: Tool) -> None:
    require_tool("frama-c")
    assert check_proof([specimen(name)], print, ("TICK",)).failures == ()


@pytest.mark.slow
def test_origin_does_not_either(require_tool: Tool) -> None:
    require_tool("frama-c")
    assert "set_origin(" in emit_package(specimen("signals"), selftest=False).files["specimen_signals.h"]
    assert check_proof([specimen("signals")], print, ("SET", "INSERT")).failures == ()


@pytest.mark.slow
def test_tables_looked_up_by_position_are_not_left_either(require_tool: Tool) -> None:
    """By any place and any travel, of which each has a table; nothing but the one alarm of all packages is left."""
    require_tool("frama-c")
    package = emit_package(specimen("tables"), selftest=False)
    assert all(f"sgms_entry(table_{k}, " in package.files["specimen_tables_model.h"] for k in (1, 2))
    outcome = check_proof([specimen("tables")], print)
    assert outcome.failures == () and outcome.tried.endswith(f"{len(ALARMS)} alarms left, with a reason each")


def test_table_entry_out_of_range_is_found(require_tool: Tool) -> None:
    require_tool("frama-c")
    package = emit_package(specimen("tables"), selftest=False)
    header = package.files["sgms_table.h"].replace("sgms_index(place, last)", "(int)place")
    spoilt = replace(package, files={**package.files, "sgms_table.h": header})
    found = [alarm for alarm in analyse_call(spoilt, "SAMPLE") if alarm not in ALARMS]
    assert any(alarm.function == "sgms_entry" for alarm in found)


@pytest.mark.parametrize(
    ("good", "bad", "call", "said"),
    [
        (
            "return sgms_place(self->interval.filling, SLOTS - 1);",
            "return (int)self->interval.filling;",
            "SAMPLE",
            "index",
        ),
        ("self->sweep.cursor = done + 1;", "self->sweep.cursor++;", "PREPARE", "signed_overflow"),
    ],
)
def test_index_out_of_range_is_found(
    good: str, bad: str, call: str, said: str, package: Package, require_tool: Tool
) -> None:
    require_tool("frama-c")
    source = package.files["etel_xy.c"]
    assert source.count(good) == 1
    spoilt = replace(package, files={**package.files, "etel_xy.c": source.replace(good, bad)})
    found = [alarm for alarm in analyse_call(spoilt, call) if alarm not in ALARMS]
    assert any(said in alarm.code or "mem_access" in alarm.code for alarm in found)
