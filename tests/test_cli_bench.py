"""Command `bench`, and the C harness that it times."""

import io
import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import done
from sgms_bench.benchmark.harness import build_harness, instructions_of
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.machine import Machine


@pytest.fixture(params=["double", "single"])
def machine(request: pytest.FixtureRequest, small: Path) -> Machine:
    return override_machine(load_machine(small), {"code": {"precision": request.param}})


@pytest.fixture
def package(machine: Machine) -> Package:
    return emit_package(machine)


@pytest.fixture
def harness(machine: Machine, package: Package) -> Path:
    return build_harness(machine, package)


def ran(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)


def rows(text: str) -> np.ndarray:
    return np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1)


# --- harness -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("compiler", "flags"), [("gcc", "-O2"), ("clang", "-O2"), ("gcc", "-O3 -mavx2")])
def test_what_a_compiler_gets_is_the_form_of_fewer_instructions(
    compiler: str, flags: str, monkeypatch: pytest.MonkeyPatch, require_tool: Callable[[str], str]
) -> None:
    """Without a word from the build; and both forms print the same, to the bit."""
    monkeypatch.setenv("CC", require_tool(compiler))
    require_tool("valgrind")
    axis = load_machine("etel_xy")
    package, words = emit_package(axis, selftest=False), ["-std=c99", "-ffp-contract=off", *flags.split()]
    counts, printed = [], set()
    for forced in ([], ["-DSGMS_VECTORS=0"], ["-DSGMS_VECTORS=1"]):
        command = [str(build_harness(axis, package, [*words, *forced])), "--motion", "60"]
        printed.add(ran(*command).stdout)
        found = instructions_of(command, "harness_update")
        assert found is not None
        counts.append(found[20:].sum())
    assert len(printed) == 1
    assert counts[0] == min(counts) < 0.95 * max(counts)


def test_harness_replays_a_log_as_the_estimator_does(
    machine: Machine, package: Package, harness: Path, small: Path, tmp_path: Path
) -> None:
    log = tmp_path / "axis.csv"
    done("simulate", small, "--out", log, "--duration", "2")
    lines = log.read_text().splitlines()
    lines[501] = lines[501].rsplit(",", 1)[0] + ","  # a missing force
    log.write_text("\r\n".join(lines))
    printed = ran(harness, "--log", log)
    expected = CompiledEstimator(machine, package).estimate_log(read_log(log), mode="tasks")
    assert printed.stdout.startswith("time_s,friction_measured_N,friction_N,z_1_m,z_2_m,parameter_1,")
    table = rows(printed.stdout)
    np.testing.assert_allclose(table[:, 0], expected.time_s, rtol=1e-15)
    np.testing.assert_array_equal(table[:, 2], expected.friction_N)
    np.testing.assert_array_equal(table[:, 5:8], expected.parameters)
    np.testing.assert_array_equal(table[:, -4], expected.status)


# --- bench -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def quick(small: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(done("bench", small, "--quick", "--updates", "100", "--json").stdout)
    return result


@pytest.mark.slow
def test_bench_states_the_errors_beside_the_cost(quick: dict[str, Any]) -> None:
    double, single = (
        next(v for v in quick["variants"] if v["precision"] == precision) for precision in ("double", "single")
    )
    assert double["state_error"] < 1e-7 < single["state_error"] < 1e-4
    assert double["sensitivity_error"] < 1e-6
    # A step per sample is closer than one in ten; both are farther off than the displacement flow.
    errors = {peer["steps"]: peer["state_error"] for peer in quick["peers"]}
    assert double["state_error"] < errors[20] < errors[2]
