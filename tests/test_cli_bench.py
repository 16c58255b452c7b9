"""Command `bench`, and the C harness that it times."""

from __future__ import annotations

import io
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cli_cases import SMALL, done
from sgms_mhe.benchmark import build_harness
from sgms_mhe.build import DEFAULT_FLAGS, WARNING_FLAGS
from sgms_mhe.compiled import CompiledEstimator
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.logs import read_log
from sgms_mhe.machine import Machine, load_machine, override_machine


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("machine") / "small.toml"
    path.write_text(SMALL)
    return path


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


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_harness_compiles_without_a_warning(
    compiler: str,
    machine: Machine,
    package: Package,
    monkeypatch: pytest.MonkeyPatch,
    require_tool: Callable[[str], str],
) -> None:
    monkeypatch.setenv("CC", require_tool(compiler))
    build_harness(machine, package, [*DEFAULT_FLAGS, *WARNING_FLAGS])


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
    np.testing.assert_array_equal(table[:, -1], expected.status)


def test_harness_has_a_motion_of_its_own(harness: Path) -> None:
    table = rows(ran(harness, "--motion", "30").stdout)
    assert table.shape == (30, 3 + 2 + 3 + 3 + 1)
    assert np.all(np.isfinite(table))
    assert np.ptp(table[:, 1]) > 1.0


def test_harness_times_every_update(harness: Path) -> None:
    printed = ran(harness, "--motion", "30", "--time").stdout
    assert printed.startswith("samples_us,feedback_us,prepare_us\n")
    times = rows(printed)
    assert times.shape == (30, 3)
    assert np.all(times >= 0.0)
    assert times.sum() > 0.0


def test_harness_runs_the_vectors_of_the_package(machine: Machine, package: Package, harness: Path) -> None:
    result = ran(harness, "--selftest")
    if f"{machine.name}_selftest.h" in package.files:
        assert result.returncode == 0, result.stdout
        assert result.stdout.startswith("selftest passed")
    else:
        assert result.returncode == 2
        assert "without vectors" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "is needed"),
        (["--log", "absent.csv"], "absent.csv: not a readable log"),
        (["--log"], "not one of"),
        (["--motion", "0"], "a number of updates"),
        (["--loop"], "not one of"),
    ],
    ids=str,
)
def test_harness_refuses(harness: Path, arguments: list[str], message: str) -> None:
    result = ran(harness, *arguments)
    assert result.returncode == 2
    assert result.stdout == ""
    assert message in result.stderr


def test_harness_refuses_a_log_without_the_columns(harness: Path, tmp_path: Path) -> None:
    log = tmp_path / "x.csv"
    log.write_text("time_s,position_m\n0.0,0.0\n")
    assert "no columns position_m and force_N" in ran(harness, "--log", log).stderr


# --- bench -------------------------------------------------------------------------------------------------------


def test_bench_has_the_agreed_json(small: Path) -> None:
    result = json.loads(done("bench", small, "--updates", "40", "--json").stdout)
    assert set(result) == {"variants", "peers"}
    assert [variant["precision"] for variant in result["variants"]] == ["double", "single"]
    for variant in result["variants"]:
        assert list(variant) == [
            "name",
            "precision",
            "relinearise",
            "update_us",
            "feedback_us",
            "instructions_mean",
            "instructions_max",
            "state_error",
            "sensitivity_error",
        ]
        assert 0.0 < variant["feedback_us"] < variant["update_us"]
    double, single = result["variants"]
    assert double["state_error"] < 1e-8 < single["state_error"] < 1e-4
    assert double["sensitivity_error"] < 1e-6


def test_bench_counts_instructions(small: Path, require_tool: Callable[[str], str]) -> None:
    require_tool("valgrind")
    first, second = (
        json.loads(done("bench", small, "--updates", "40", "--json").stdout)["variants"][0] for _ in range(2)
    )
    assert 1e3 < first["instructions_mean"] <= first["instructions_max"]
    assert second["instructions_mean"] == pytest.approx(first["instructions_mean"], rel=1e-3)


def test_bench_without_valgrind_has_null_for_instructions(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    result = json.loads(done("bench", small, "--updates", "5", "--json").stdout)
    assert result["variants"][0]["instructions_mean"] is None
    assert "-" in done("bench", small, "--updates", "5").stdout
