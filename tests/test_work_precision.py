"""Integrators by accuracy: what a tolerance chooses, and that the emitted code keeps it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import SMALL, done, refused
from sgms_bench.benchmark.integration_errors import Recording, emitted_errors
from sgms_bench.benchmark.running import Bench
from sgms_bench.motions import there_and_back
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.integration.schemes import SCHEMES
from sgms_mhe.integration.work_precision import CANDIDATES, ROUNDING, candidates, element_errors
from sgms_mhe.machine import Machine
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.toolchain import DEFAULT_FLAGS

PAPER = (0.9, 35.0, 35.0)


def with_tolerance(tolerance: float, **sampling: Any) -> Machine:
    changes = {"sampling": {**sampling, "integrator": {"tolerance": tolerance}}}
    return override_machine(load_machine("etel_xy"), changes)


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    """The paper's motion, moves that a Runge-Kutta step per sample does not survive, moves below the gate's speed."""
    bench = Bench(load_machine("etel_xy"), DEFAULT_FLAGS)
    return [
        bench.record(make_trajectory("paper", 1e4, duration_s=2.0)),
        bench.record(there_and_back(1e4, 0.02)),
        bench.record(there_and_back(1e4, 2.8e-4)),
    ]


@pytest.mark.parametrize(
    ("tolerance", "sampling", "scheme"),
    [
        (1e-2, {}, "flow"),
        (1e-4, {}, "flow"),
        (1e-7, {}, "flow"),
        # Slower than the gate the flow has nothing to offer.
        (1e-2, {"max_velocity": 3e-4}, "rk2"),
        (1e-4, {"max_velocity": 3e-4}, "bs23"),
        (1e-6, {"max_velocity": 3e-4}, "rk4"),
    ],
    ids=str,
)
def test_emitted_code_keeps_the_tolerance(
    tolerance: float, sampling: dict[str, Any], scheme: str, recordings: list[Recording]
) -> None:
    machine = with_tolerance(tolerance, **sampling)
    assert machine.sampling.integrator.scheme == scheme
    package = emit_package(machine, selftest=False)
    # A machine that is slow by its own word is asked for no more than its word.
    for recording in recordings[2:] if sampling else recordings:
        found = emitted_errors(machine, package, recording)
        assert all(error is not None and error <= tolerance for error in found), recording.name


def test_a_tighter_tolerance_costs_more_and_leaves_less() -> None:
    machines = [with_tolerance(tolerance) for tolerance in (1e-3, 1e-5, 1e-6, 1e-7)]
    slow = [machine.sampling.integrator.slow_displacement for machine in machines]
    assert slow == sorted(slow, reverse=True)
    assert len(set(slow)) > 2


@pytest.mark.parametrize("scheme", ["rk4", "bs23", "rk2", "euler"])
def test_measured_errors_fall_with_the_order_of_the_scheme(scheme: str) -> None:
    # Fine enough to be asymptotic, coarse enough to stand above the converged steps.
    steps = {"rk4": (0.01, 0.005), "bs23": (0.01, 0.005), "rk2": (0.01, 0.005), "euler": (0.004, 0.002)}[scheme]
    coarse, fine = (element_errors(*PAPER, scheme, step) for step in steps)
    for large, small in zip(coarse, fine, strict=True):
        assert np.log2(large / small) == pytest.approx(SCHEMES[scheme].order, abs=0.35)


def test_steps_that_diverge_are_infinitely_wrong() -> None:
    assert element_errors(*PAPER, "euler", 0.3).largest > 0.1


def test_every_candidate_stands_with_its_errors_and_work() -> None:
    machine = load_machine("etel_xy")
    found = candidates(machine.friction, machine.sampling, "double")
    assert [(c.scheme, c.displacement) for c in found] == list(CANDIDATES)
    for candidate in found:
        assert 0.0 < candidate.errors.largest < 1.0
        assert 0.0 < candidate.mean_work <= candidate.largest_work
    # 1 m/s, 1e-4 s, 447761 1/m over 0.03
    rk4 = next(c for c in found if (c.scheme, c.displacement) == ("rk4", 0.03))
    assert rk4.substeps[0] == 1493
    assert rk4.largest_work == 100 * 4 * sum(rk4.substeps)


def test_package_brings_the_table() -> None:
    machine = with_tolerance(1e-6)
    text = emit_package(machine, selftest=False).files["work_precision.txt"]
    marked = [line for line in text.splitlines() if line.startswith("*")]
    assert len(marked) == 1
    assert marked[0].split()[1:3] == ["flow", f"{machine.sampling.integrator.slow_displacement:g}"]
    assert text.count("rk4") >= 4
    assert "work_precision.txt" not in emit_package(load_machine("etel_xy"), selftest=False).files
    assert text == emit_package(with_tolerance(1e-6), selftest=False).files["work_precision.txt"]


@pytest.mark.parametrize(
    ("integrator", "message"),
    [
        ('{ tolerance = 1e-6, scheme = "rk4" }', "integrator.scheme = 'rk4': no scheme beside a tolerance"),
        ("{ tolerance = 1e-6, substeps = 100 }", "integrator.substeps = 100: no substeps beside a tolerance"),
        ("{ tolerance = 1e-6, displacement = 0.1 }", "no displacement beside a tolerance"),
        ('{ tolerance = 1e-6, velocity = "linear" }', "constant, where a tolerance is given"),
        ("{ tolerance = 0.0 }", "greater than 0"),
        ("{ tolerance = 1e-12 }", "integrator.tolerance = 1e-12: >= 5.0e-08, the least"),
    ],
)
def test_rules_of_a_tolerance_are_named(integrator: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(SMALL.replace('{ scheme = "flow" }', integrator))
    assert message in refused("check", path)


def test_single_precision_promises_no_more_than_it_holds() -> None:
    machine = override_machine(load_machine("etel_xy"), {"code": {"precision": "single"}})
    with pytest.raises(InputError, match="single precision"):
        override_machine(machine, {"sampling": {"integrator": {"tolerance": 0.5 * ROUNDING["single"]}}})


def test_a_file_may_replace_the_integrator_that_it_extends(tmp_path: Path) -> None:
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    first.write_text('extends = "etel_xy"\nname = "first"\n[sampling]\nintegrator = { tolerance = 1e-4 }\n')
    second.write_text('extends = "first.toml"\nname = "second"\n[sampling]\nintegrator = { scheme = "bs23" }\n')
    assert load_machine(first).sampling.integrator.tolerance == 1e-4
    integrator = load_machine(second).sampling.integrator
    assert (integrator.tolerance, integrator.scheme, integrator.displacement) == (None, "bs23", 0.02)
    assert '"tolerance": 0.0001' in done("check", first, "--json").stdout
