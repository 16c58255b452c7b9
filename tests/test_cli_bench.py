"""Command `bench`, and the C harness that it times."""

from __future__ import annotations

import io
import json
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import SMALL, done
from sgms_bench.benchmark.harness import build_harness, instructions_of
from sgms_bench.benchmark.integration_errors import SampledMotion, emitted_errors
from sgms_bench.benchmark.peers import KINDS, Kind, PeerEvaluation, PeerExport
from sgms_bench.benchmark.running import Bench
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.reference import ReferenceIntegrator
from sgms_mhe.reference.linearised import Linearised, Outputs
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, WARNING_FLAGS


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


def test_harness_has_a_motion_of_its_own(harness: Path) -> None:
    table = rows(ran(harness, "--motion", "30").stdout)
    assert table.shape == (30, 3 + 2 + 3 + 3 + 1 + 3)
    assert np.all(np.isfinite(table))
    assert np.ptp(table[:, 1]) > 1.0


def test_harness_times_every_update(harness: Path) -> None:
    printed = ran(harness, "--motion", "30", "--time").stdout
    assert printed.startswith("samples_us,feedback_us,prepare_us\n")
    times = rows(printed)
    assert times.shape == (30, 3)
    assert np.all(times >= 0.0)
    assert times.sum() > 0.0


def test_harness_runs_the_self_test_of_the_package(machine: Machine, package: Package, harness: Path) -> None:
    result = ran(harness, "--selftest")
    if f"{machine.name}_selftest.c" in package.files:
        assert result.returncode == 0, result.stdout
        assert result.stdout.startswith("selftest passed")
    else:
        assert result.returncode == 2
        assert "without the package's self-test" in result.stderr


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

VARIANT_KEYS = [
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


@pytest.fixture(scope="session")
def quick(small: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(done("bench", small, "--quick", "--updates", "100", "--json").stdout)
    return result


def test_bench_has_the_agreed_json(quick: dict[str, Any]) -> None:
    assert {"variants", "peers"} <= set(quick)
    assert {variant["precision"] for variant in quick["variants"]} == {"double", "single"}
    for variant in quick["variants"]:
        assert list(variant)[: len(VARIANT_KEYS)] == VARIANT_KEYS
        assert 0.0 < variant["feedback_us"] < variant["update_us"]
    for peer in quick["peers"]:
        assert list(peer)[:3] == ["name", "update_us", "instructions_mean"]
        assert peer["update_us"] > 0.0


def test_bench_states_the_errors_beside_the_cost(quick: dict[str, Any]) -> None:
    double, single = (
        next(v for v in quick["variants"] if v["precision"] == precision) for precision in ("double", "single")
    )
    assert double["state_error"] < 1e-7 < single["state_error"] < 1e-4
    assert double["sensitivity_error"] < 1e-6
    # A step per sample is closer than one in ten; both are farther off than the displacement flow.
    errors = {peer["steps"]: peer["state_error"] for peer in quick["peers"]}
    assert double["state_error"] < errors[20] < errors[2]


# --- peers -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fixed_step(small: Path) -> Machine:
    """One classical Runge-Kutta step per sample whatever the speed: the peers' discretisation."""
    integrator = {"scheme": "rk4", "displacement": 10.0}
    return override_machine(load_machine(small), {"sampling": {"max_velocity": 1e-3, "integrator": integrator}})


@pytest.fixture(scope="module")
def recording(fixed_step: Machine) -> SampledMotion:
    return Bench(fixed_step, DEFAULT_FLAGS).record(make_trajectory("paper", 1000.0, duration_s=1.2))


def evaluated(export: PeerExport, recording: SampledMotion, folder: Path) -> PeerEvaluation:
    (folder / "problems").write_bytes(export.problems(recording.windows))
    result = ran(export.program, folder / "problems", folder / "results")
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == len(recording.first)
    return export.evaluation(recording.windows, (folder / "results").read_bytes())


@pytest.mark.parametrize("kind", KINDS)
def test_peer_computes_the_residual_and_jacobian_of_the_reference(
    kind: Kind, fixed_step: Machine, recording: SampledMotion, tmp_path: Path
) -> None:
    windows = recording.windows
    found = evaluated(PeerExport(fixed_step, kind, windows.w.shape[1], 20), recording, tmp_path)
    integrator = ReferenceIntegrator(build_model(fixed_step))
    plan = integrator.plan(recording.signals)
    assert plan.substeps.max() == 1
    assert np.abs(found.A).max() > 0.1
    assert np.abs(found.B).max() > 0.01
    for i, first in enumerate(recording.first):
        expected = integrator.intervals(plan, first, windows.x[i, :-1], windows.theta)
        for name in ("x1", "A", "B"):
            np.testing.assert_allclose(getattr(found, name)[i], getattr(expected, name), rtol=0, atol=1e-12)
        outputs = integrator.outputs(windows.x[i], windows.w_node[i], windows.theta)
        np.testing.assert_allclose(found.residual[i], outputs.y - windows.y[i], rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.C[i], outputs.C, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.D[i], outputs.D, rtol=0, atol=1e-12)


def test_peer_computes_what_the_emitted_code_does(
    fixed_step: Machine, recording: SampledMotion, tmp_path: Path
) -> None:
    windows = recording.windows
    found = evaluated(PeerExport(fixed_step, "propagated", windows.w.shape[1], 20), recording, tmp_path)
    nothing = Outputs(*(np.empty(0) for _ in range(3)))
    exact = tuple(Linearised(*ends, nothing) for ends in zip(found.x1, found.A, found.B, strict=True))
    same = replace(recording, exact=exact)
    state, sensitivity = emitted_errors(fixed_step, emit_package(fixed_step, selftest=False), same)
    # The emitted elementary functions are good to 1e-9 by choice.
    assert state is not None and state < 1e-8
    assert sensitivity is not None and sensitivity < 1e-7
