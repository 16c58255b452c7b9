"""The package on emulated microcontrollers: the host's numbers, exact counts, memory; and command `target`."""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sgms_mhe.host.targets
from c_packages import machine
from cli_cases import SMALL, done
from sgms_bench.motions import simulated_log
from sgms_bench.target.firmware import build_program, double_arithmetic
from sgms_bench.target.stacks import LIBRARY_FRAME, call_paths
from sgms_bench.target.trial import TargetTrial, compare_with_host, identical_updates, run_trial, single_precision
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.host.targets import TARGET_FLAGS, TARGETS, Target, run_tool
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.status import FLAGS
from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.toolchain import WARNING_FLAGS

FLASH = 52_000
"""What a package may take, bytes."""

CORES = [
    pytest.param(TARGETS["cortex_m7"], marks=pytest.mark.needs_arm, id="cortex_m7"),
    pytest.param(TARGETS["riscv32"], marks=pytest.mark.needs_riscv, id="riscv32"),
]
M7 = TARGETS["cortex_m7"]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    """Two elements, 1 kHz, 20 samples per update, single precision."""
    path = tmp_path_factory.mktemp("machine") / "small.toml"
    path.write_text(SMALL)
    return single_precision(load_machine(path))


@pytest.fixture(scope="module")
def small_log(small: Machine) -> Log:
    return simulated_log(small, "mixed", 60)


@pytest.fixture(scope="module", params=CORES)
def small_trial(request: pytest.FixtureRequest, small: Machine, small_log: Log) -> TargetTrial:
    return run_trial(small, small_log, request.param)


# --- the host's numbers ------------------------------------------------------------------------------------------


@pytest.mark.needs_arm
def test_cortex_m7_repeats_the_host_to_the_last_bit() -> None:
    """etel_xy over 5 s: presliding, reversals, moves at 0.3 m/s and beyond, standstill, missing samples."""
    settings = single_precision(load_machine("etel_xy"))
    log = simulated_log(settings, "mixed", 500)
    velocity = np.diff(log.position_m) * log.rate
    assert np.abs(velocity).max() > 0.9
    assert np.count_nonzero(np.abs(np.abs(velocity) - 0.3) < 0.01) > 100
    position, force = log.position_m.copy(), log.force_N.copy()
    position[30_000:30_020] = np.nan
    force[20_000] = np.inf
    log = replace(log, position_m=position, force_N=force)
    trial = run_trial(settings, log, M7)
    host = compare_with_host(trial, log)
    assert len(trial.estimates) == 500
    assert host.identical, host
    assert host.comparison.status_mismatches == 0
    # The record has to have asked for something.
    seen = {name for name, flag in FLAGS.items() if np.any(trial.estimates.status & flag)}
    assert {"filling", "missing", "hold"} <= seen
    assert np.count_nonzero(trial.estimates.status == 0) > 200
    assert np.ptp(trial.estimates.friction_N) > 4.0
    assert np.all(np.abs(trial.estimates.parameters[-1] / trial.estimates.parameters[0] - 1.0) > 0.0)
    # One task or two: the same.
    assert identical_updates(trial.estimates, trial.tick_estimates).all()
    # Memory and arithmetic of the shipped machine.
    assert trial.double_arithmetic == ()
    assert 1_000 < trial.memory.package <= trial.memory.flash <= FLASH
    assert trial.memory.data == 0


VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "rk4": {"sampling": {"integrator": {"scheme": "rk4"}}},
    "ekf": {"estimator": {"kind": "ekf"}},
    "fixed": {"estimator": {"arrival_cost": {"update": "fixed"}}},
    "ripple": {"effects": [{"name": "force_ripple", "pitch_m": 0.001, "amplitude_N": 0.8, "phase_rad": 0.7}]},
}


@pytest.mark.needs_arm
@pytest.mark.parametrize("variant", VARIANTS)
def test_other_packages_repeat_the_host(variant: str, small: Machine) -> None:
    settings = override_machine(small, VARIANTS[variant])
    log = simulated_log(settings, "mixed", 20)
    trial = run_trial(settings, log, M7)
    assert compare_with_host(trial, log).identical
    assert trial.double_arithmetic == ()


def test_the_small_trial_repeats_the_host(small_trial: TargetTrial, small_log: Log) -> None:
    host = compare_with_host(small_trial, small_log)
    assert host.identical and host.agrees
    assert host.identical_updates == len(small_trial.estimates) == 60
    np.testing.assert_allclose(np.diff(small_trial.estimates.time_s), 0.02)


@pytest.mark.needs_arm
def test_contracted_arithmetic_is_within_rounding_and_not_the_same(small: Machine, small_log: Log) -> None:
    """Fused multiply-adds round once where a host rounds twice: what the comparison is there to see."""
    host = compare_with_host(run_trial(small, small_log, M7, flags=("-std=gnu99", "-O2")), small_log)
    assert host.agrees
    assert not host.identical
    assert host.identical_updates < 60


# --- instructions ------------------------------------------------------------------------------------------------


@pytest.mark.needs_arm
def test_controller_keeps_its_budget() -> None:
    """100 us at 400 MHz are 40 000 cycles: about a quarter of them at worst, force fed forward included."""
    settings = load_machine("etel_xy_controller")
    log = simulated_log(settings, "mixed", 500)
    trial = run_trial(settings, log, M7, flags=("-std=c99", "-O3", "-ffp-contract=fast"))
    assert trial.update[settings.estimator.horizon :].mean() < 145_000
    assert trial.tick.max() < 9_900
    assert trial.memory.flash < FLASH
    assert trial.memory.ram < 20_100
    assert trial.double_arithmetic == ()


# --- memory ------------------------------------------------------------------------------------------------------


def test_memory_is_measured(small_trial: TargetTrial, small: Machine, tmp_path: Path) -> None:
    memory = small_trial.memory
    assert memory.axis == CompiledEstimator(small).memory_bytes  # no pointer in it: as large as on the host
    assert memory.flash == memory.package + memory.helpers
    assert memory.ram == memory.axis + max(memory.stack.values())
    # What is written stays within the deepest call path, and comes near it where the run takes that path.
    assert all(0 <= memory.used[call] <= memory.stack[call] for call in memory.stack)
    assert memory.used["tick"] > 0.5 * memory.stack["tick"]
    paths = build_program(small_trial.target, emit_package(small, selftest=False), tmp_path).paths
    assert {call: paths[f"small_{call}"] for call in memory.stack} == memory.stack
    assert paths["small_tick"] > paths["small_estimate"] >= LIBRARY_FRAME


@pytest.mark.needs_arm
def test_calls_of_a_drive_have_a_stack_too(small: Machine, small_log: Log) -> None:
    drive = {"kind": "voltage", "torque_constant": 1.0, "resistance": 1.0}
    memory = run_trial(override_machine(small, {"drive": drive}), small_log, M7).memory
    assert LIBRARY_FRAME <= memory.stack["drive_command"] <= memory.stack["drive_force"] < 400
    assert "drive_force" not in memory.used


GRAPH = """graph: { title: "a.c"
node: { title: "a.c:leaf" label: "leaf\\na.c:1:5\\n24 bytes (static)" }
node: { title: "top" label: "top\\na.c:2:5\\n100 bytes (static)" }
edge: { sourcename: "top" targetname: "a.c:leaf" label: "a.c:3:9" }
node: { title: "__aeabi_l2f" label: "__aeabi_l2f\\n<built-in>" shape : ellipse }
edge: { sourcename: "a.c:leaf" targetname: "__aeabi_l2f" label: "a.c:4:9" }
"""


def test_call_paths_add_up() -> None:
    assert call_paths(GRAPH) == {"leaf": 24 + LIBRARY_FRAME, "top": 124 + LIBRARY_FRAME}


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('edge: { sourcename: "a.c:leaf" targetname: "top" label: "a.c:5:9" }', "call itself"),
        ('node: { title: "__indirect_call" label: "Indirect Call Placeholder" shape : ellipse }', "through a pointer"),
        ('node: { title: "a.c:b" label: "b\\na.c:9:5\\n16 bytes (dynamic)" }', "no fixed size"),
    ],
)
def test_stack_without_a_bound_is_refused(more: str, message: str) -> None:
    with pytest.raises(BuildError, match=message):
        call_paths(GRAPH + more)


@pytest.mark.parametrize(
    ("core", "flags", "found"),
    [
        pytest.param(M7, M7.flags, "__aeabi_dadd", marks=pytest.mark.needs_arm, id="library"),
        pytest.param(M7, (*M7.flags, "-mfpu=fpv5-d16"), "vadd.f64", marks=pytest.mark.needs_arm, id="instructions"),
        pytest.param(
            TARGETS["riscv32"], TARGETS["riscv32"].flags, "__adddf3", marks=pytest.mark.needs_riscv, id="riscv library"
        ),
        pytest.param(
            TARGETS["riscv32"],
            ("-march=rv32imafdc", "-mabi=ilp32d"),
            "fadd.d",
            marks=pytest.mark.needs_riscv,
            id="riscv instructions",
        ),
    ],
)
def test_double_arithmetic_is_found(
    core: Target, flags: tuple[str, ...], found: str, small: Machine, tmp_path: Path
) -> None:
    package = emit_package(override_machine(small, {"code": {"precision": "double"}}), selftest=False)
    program = build_program(replace(core, flags=flags), package, tmp_path)
    assert found in program.double_arithmetic


@pytest.mark.needs_arm
@pytest.mark.parametrize("core", [M7, replace(M7, flags=(*M7.flags, "-mfpu=fpv5-d16"))], ids=["single", "double"])
def test_one_conversion_to_double_is_found(core: Target, tmp_path: Path) -> None:
    source = tmp_path / "package.c"
    source.write_text("float scaled(float x) { return x * 0.1; }\n")
    run_tool(core, "gcc", *core.flags, "-O2", "-c", source, "-o", tmp_path / "package.o")
    assert double_arithmetic(core, tmp_path / "package.o")
    source.write_text("float scaled(float x) { return x * 0.1f; }\n")
    run_tool(core, "gcc", *core.flags, "-O2", "-c", source, "-o", tmp_path / "package.o")
    assert double_arithmetic(core, tmp_path / "package.o") == ()


@pytest.mark.parametrize("core", CORES)
def test_compiles_for_the_target_without_a_warning(core: Target, small: Machine, tmp_path: Path) -> None:
    """The package and what runs it, with every warning an error."""
    package = emit_package(small, selftest=False)
    assert build_program(core, package, tmp_path, (*TARGET_FLAGS, *WARNING_FLAGS)).path.is_file()


# --- what goes wrong ---------------------------------------------------------------------------------------------


def test_double_precision_is_refused(small_log: Log) -> None:
    with pytest.raises(ValueError, match="single precision"):
        run_trial(machine(), small_log, M7)


def test_absent_tools_are_named(
    small: Machine, small_log: Log, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BuildError, match=r"arm-none-eabi-gcc: .*gcc-arm-none-eabi and qemu-system-arm"):
        run_trial(small, small_log, M7)


@pytest.mark.needs_arm
def test_absent_emulator_is_named(small: Machine, small_log: Log) -> None:
    with pytest.raises(BuildError, match=r"qemu-system-absent: .*gcc-arm-none-eabi and qemu-system-arm"):
        run_trial(small, small_log, replace(M7, emulator=("qemu-system-absent", *M7.emulator[1:])))


@pytest.mark.needs_arm
def test_run_that_stalls_is_stopped(small: Machine, small_log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    # Before its first instruction: the emulator waits for a debugger.
    monkeypatch.setattr(sgms_mhe.host.targets, "_STALLED_S", 0.3)
    with pytest.raises(BuildError, match=r"nothing came out of it for 0\.3 s"):
        run_trial(small, small_log, replace(M7, emulator=(*M7.emulator, "-S")))


# --- command -----------------------------------------------------------------------------------------------------


@pytest.fixture
def small_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.mark.needs_arm
def test_command_prints_one_table(small_file: Path, tmp_path: Path) -> None:
    log = tmp_path / "axis.csv"
    done("simulate", small_file, "--out", log, "--duration", "0.5")
    result = done("target", small_file, log)
    assert "double precision, taken as single" in result.stderr
    assert "24 updates" in result.stdout
    assert re.search(r"^update +\d+ +\d+", result.stdout, re.MULTILINE)
    assert "the same as on this host to the last bit" in result.stdout
    assert "double-precision arithmetic: none" in result.stdout


@pytest.mark.needs_arm
def test_command_prints_json(small_file: Path) -> None:
    result = json.loads(done("target", small_file, "--updates", "10", "--json").stdout)
    assert list(result) == [
        *("machine", "core", "updates", "instructions", "calibration", "bytes", "double_arithmetic", "host")
    ]
    assert result["updates"] == 10
    assert list(result["instructions"]) == ["update", "feedback", "prepare", "sample", "tick", "estimate"]
    for counts in result["instructions"].values():
        assert 0 < counts["mean"] <= counts["max"]
    assert result["bytes"]["ram"] == result["bytes"]["axis"] + max(result["bytes"]["stack"].values())
    assert result["host"]["identical"] is True
