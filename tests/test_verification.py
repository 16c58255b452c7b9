"""The bounded part of `make verify`; and that each of its checks finds what it is there to find."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from sgms_bench.verification import coverage, limits, upsets
from sgms_bench.verification.bits import BIG_ENDIAN, Build, exercise, required_statuses, same_bits, target_builds
from sgms_bench.verification.constructs import jumps_and_storage, pointers_and_recursion, unbounded_loops
from sgms_bench.verification.coverage import check_coverage, measure
from sgms_bench.verification.fuzzing import SANITIZERS, fuzz_package
from sgms_bench.verification.gaps import Gap
from sgms_bench.verification.limits import check_limits
from sgms_bench.verification.mcdc import UNDECIDED, check_conditions
from sgms_bench.verification.specimens import SPECIMENS, specimen, specimens
from sgms_bench.verification.syntax import syntax_tree
from sgms_bench.verification.upsets import check_upsets
from sgms_mhe.configuration import override_machine
from sgms_mhe.emission.package import Package, emit_package

Tool = Callable[[str], str]
PLAIN = SANITIZERS["plain"]


@pytest.fixture(scope="module")
def package() -> Package:
    return emit_package(specimen("merged_auto"), selftest=False)


def broken(package: Package, ending: str, before: str, after: str) -> Package:
    """The package with something else in one of its files."""
    file = f"{package.machine.name}{ending}"
    assert before in package.files[file]
    return replace(package, files={**package.files, file: package.files[file].replace(before, after, 1)})


def test_every_effect_of_a_specimen_has_a_size() -> None:
    """One of no size would be code that changes no number: whatever was wrong with it, nobody would see."""
    sizes = [next(iter(effect.parameters.values())) for machine in specimens() for effect in machine.effects]
    assert len(sizes) >= 13 and all(sizes)


# --- random calls ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["merged_auto", "ekf", "switching_levels", "signals"])
def test_random_calls_find_nothing(name: str, require_tool: Tool, tmp_path: Path) -> None:
    require_tool("gcc")
    made, failure = fuzz_package(PLAIN, emit_package(specimen(name), selftest=False), 40_000, 7, tmp_path / "kept")
    assert not failure
    assert made >= 40_000 and not (tmp_path / "kept").exists()


@pytest.mark.parametrize(
    ("ending", "before", "after", "said"),
    [
        (".c", "fill(self->chain.lowpass, 0.0f, SGMS_FILTER_STATES);", "", "what was before is still there|no number"),
        (
            ".c",
            "self->interval.lost = 0;\n    self->interval.net",
            "self->interval.net",
            "good data are not taken|still there",
        ),
        ("_compensation.h", "force = sgms_fmin(sgms_fmax(force, -LIMIT), LIMIT);", "", "a force beyond its limit"),
        (  # an interrupt that resets the axis inside of a sample
            ".c",
            "sgms_place(self->interval.step / SPACING - 1, INNER - 1)",
            "(int)self->interval.step / SPACING - 1",
            "index -1 out of bounds",
        ),
        (
            ".c",
            "saved->machine[0] == SPECIMEN_MERGED_AUTO_SAVED_MACHINE_0 &&",
            "",
            "saved data of another package are taken",
        ),
        (
            "_compensation.h",
            "1 + sgms_index(wanted, AHEAD_MOST)",
            "1 + (int)(wanted * 1e30f)",
            "outside the range of representable",
        ),
    ],
)  # fmt: skip
def test_random_calls_find_what_is_wrong(
    ending: str, before: str, after: str, said: str, package: Package, tmp_path: Path, require_tool: Tool
) -> None:
    require_tool("gcc")
    wrong = broken(package, ending, before, after)
    _, failure = fuzz_package(PLAIN, wrong, 200_000, 1, tmp_path / "kept")
    assert any(text in failure for text in said.split("|")), failure
    assert (tmp_path / "kept" / "fuzz").is_file()


# --- bits that flip --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bits_that_flip_leave_no_memory_and_are_told_or_forgotten(require_tool: Tool) -> None:
    require_tool("gcc")
    outcome = check_upsets([specimen("merged_auto"), specimen("ekf")], 1000, 3)
    assert outcome.skipped is None and outcome.failures == ()
    back, told, neither = map(int, re.findall(r"(\d+) (?:back|told|neither)", outcome.tried))
    assert back + told + neither == 1000 and back > 900 and told > 5


@pytest.mark.slow
def test_bit_that_moves_an_index_is_found(
    package: Package, require_tool: Tool, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_tool("gcc")
    good, bad = "return sgms_place(self->interval.filling, SLOTS - 1);", "return (int)self->interval.filling;"
    wrong = broken(package, ".c", good, bad)
    monkeypatch.setattr(upsets, "emit_package", lambda *_, **__: wrong)
    outcome = check_upsets([package.machine], 3000, 11)
    assert len(outcome.failures) == 1 and ("out of bounds" in outcome.failures[0] or "Sanitizer" in outcome.failures[0])


# --- bits ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", ["merged_auto", "switching"])
def test_compilers_and_levels_give_the_same_bits(name: str, precision: str, require_tool: Tool) -> None:
    emitted = emit_package(override_machine(specimen(name), {"code": {"precision": precision}}), selftest=False)
    first = exercise(emitted, Build(require_tool("gcc"), ("-O2",)))
    wanted = required_statuses(emitted.machine)
    assert first.statuses & wanted == wanted and first.numbers > 10_000
    for build in (Build("gcc", ("-O0",)), Build(require_tool("clang"), ("-O3", "-mavx2"))):
        assert exercise(emitted, build) == first, build.title
    fused = exercise(emitted, Build("gcc", ("-O2", "-mfma", "-ffp-contract=fast")))
    assert fused.numbers == first.numbers and fused.bits != first.bits


@pytest.mark.slow
@pytest.mark.needs_arm
@pytest.mark.needs_riscv
def test_processors_give_the_same_bits() -> None:
    builds = list(target_builds(("-O2",)))
    assert BIG_ENDIAN in [build.target for build in builds]
    outcomes = same_bits([specimen("switching")], builds, print)
    assert len(outcomes) == 3 and all(o.failures == () and o.skipped is None for o in outcomes)


# --- coverage --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_line_is_reached_or_explained(require_tool: Tool) -> None:
    require_tool("gcov")
    outcome = check_coverage(list(specimens()), print)
    assert outcome.skipped is None and outcome.failures == ()


def test_gap_without_a_reason_is_found(require_tool: Tool, monkeypatch: pytest.MonkeyPatch) -> None:
    require_tool("gcov")
    found = measure(emit_package(specimen("ekf")))
    alone = measure(emit_package(specimen("ekf")), exercised=False)
    assert alone.lines[0] < found.lines[0] < found.lines[1] == alone.lines[1]
    assert alone.branches[0] < found.branches[0] < found.branches[1]
    left = coverage.find_gaps([found])
    assert not coverage.find_gaps(
        [found, replace(found, counts={place: (1,) * (1 + place.branches) for place in left})]
    )
    monkeypatch.setattr(coverage, "GAPS", (Gap("absent", "nothing", "of a function that no package has"),))
    monkeypatch.setattr(coverage, "measure", lambda _: found)
    outcome = check_coverage([specimen("ekf")], print)
    assert len(outcome.failures) == len(left) + 1
    assert "no package has this gap any more: absent: nothing" in outcome.failures


# --- constructs ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SPECIMENS)
def test_code_is_without_what_no_proof_deals_with(name: str, require_tool: Tool) -> None:
    require_tool("clang")
    emitted = emit_package(specimen(name), selftest=False)
    tree = syntax_tree(emitted)
    for find in (pointers_and_recursion, jumps_and_storage, unbounded_loops):
        count, found = find(emitted, tree)
        assert count > 50 and found == []


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("static int (*kept)(int) = 0;", "kept is a pointer to a function"),
        ("int f(int n);\nint g(int n) { return n ? f(n - 1) : 0; }\nint f(int n) { return g(n); }", "f calls itself"),
        ("int f(int n);\nint g(int (*to)(int)) { return to(1); }\nint h(void) { return g(f); }", "f is taken"),
        ("double sin(double x);\ndouble f(double x) { return sin(x); }", "sin is called"),
        ("int f(int n) { static int kept; kept += n; return kept; }", "kept is writable"),
        ("static const int *kept;", "kept is writable"),
        ("int f(int n) { int a[n]; a[0] = 1; return a[0]; }", "a has no constant length"),
        ("int f(int n) { again: n--; if (n > 0) { goto again; } return n; }", "GotoStmt"),
        ("int f(int n) { while (n > 0) { n -= 2; } return n; }", "a loop without a bound"),
        ("int f(int n) { for (int i = 0; i < n; i++) { i -= 1; } return n; }", "a loop without a bound"),
        ("int f(int n) { for (int i = 0; i < n; i++) { n++; } return n; }", "a loop without a bound"),
        ("int f(int n) { for (int i = 0; i != n; i++) { } return n; }", "a loop without a bound"),
        ("int f(int n) { do { n--; } while (n); return n; }", "a loop without a bound"),
    ],
)  # fmt: skip
def test_what_no_proof_deals_with_is_found(code: str, said: str, package: Package, require_tool: Tool) -> None:
    require_tool("clang")
    name = package.machine.name
    wrong = replace(package, files={f"{name}.c": f"{code}\n"})
    tree = syntax_tree(wrong)
    checks = (pointers_and_recursion, jumps_and_storage, unbounded_loops)
    found = [text for find in checks for text in find(wrong, tree)[1]]
    assert any(said in text for text in found), found


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.needs_arm
@pytest.mark.needs_riscv
def test_work_and_stack_stay_within_what_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    machines = [specimen("merged_auto"), specimen("ekf")]
    outcomes = check_limits(machines, print)
    assert len(outcomes) == 2 and all(o.failures == () and o.skipped is None for o in outcomes)
    monkeypatch.setattr(limits, "INSTRUCTIONS_PER_OPERATION", 0.01)
    beyond = check_limits(machines[:1], print)
    assert all(any("feedback takes" in text for text in o.failures) for o in beyond)


# --- conditions ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_condition_decides_or_is_explained() -> None:
    outcome = check_conditions(list(specimens()), print)
    if outcome.skipped is not None:
        pytest.skip(outcome.skipped)
    assert outcome.failures == ()
    deciding, count = map(int, re.findall(r"(\d+) (?:of|conditions)", outcome.tried)[:2])
    assert count > 150 and deciding == count - len(UNDECIDED) > 0.95 * count


# --- the table -------------------------------------------------------------------------------------------------------
