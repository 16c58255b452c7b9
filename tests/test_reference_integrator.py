"""The reference integrator: order, plan, sensitivities, and its two ways to run the same loops."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest

from reference_cases import linear_model, moving, simulate, variant, with_integrator
from sgms_mhe.build import shared_library
from sgms_mhe.errors import BuildError
from sgms_mhe.model import build_model
from sgms_mhe.reference import integrator as module
from sgms_mhe.reference.integrator import Integrator

ALL = ["stiffness", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity"]
THETA = np.array([1.05, 1.1, 0.9, 1.02, 0.98, 1.1, 0.97, 1.01])


@pytest.mark.parametrize("velocity", ["constant", "linear"])
@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("rk2", 2), ("bs23", 3), ("rk4", 4)])
def test_order_of_convergence(scheme: str, order: int, velocity: str) -> None:
    # A soft window and gate bring the asymptotic range within reach; the move per sample is below 0.1.
    machine = variant(friction={"smoothing": {"zeta": 0.7, "lambda": 6.0, "gamma": 3.0}})
    signals = moving(1e-3 * (1.2 + np.sin(2.0 * np.pi * 40.0 * np.arange(101) / 10000.0)))
    ends = []
    for factor in (1, 2, 4, 64):
        settings = {"scheme": scheme if factor < 64 else "rk4", "substeps": 100 * factor}
        chosen = with_integrator(machine, **settings, velocity=velocity, displacement=10.0)
        ends.append(simulate(Integrator(build_model(chosen)), signals, np.ones(4), np.full(4, 0.1))[-1])
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("state_as", ["force", "deflection"])
@pytest.mark.parametrize("scheme", ["rk4", "bs23", "rk2", "euler", "flow"])
def test_sensitivities_are_differences(scheme: str, state_as: str) -> None:
    machine = variant(estimator={"parameters": ALL, "bounds": {}})
    noise = machine.estimator.noise.model_dump() | {"state_as": state_as}
    machine = with_integrator(variant(estimator={"parameters": ALL, "bounds": {}, "noise": noise}), scheme=scheme)
    integrator = Integrator(build_model(machine))
    velocity = 3e-3 * np.sin(2.0 * np.pi * 30.0 * np.arange(401) / 10000.0) + 4e-4
    plan = integrator.plan(moving(velocity))
    x = np.random.default_rng(5).uniform(-0.95, 0.95, (4, 4))
    exact = integrator.intervals(plan, 0, x, THETA)
    w = np.column_stack([velocity, velocity, 0.0 * velocity, 0.0 * velocity, velocity])[100::100]
    outputs = integrator.outputs(x, w, THETA)
    e = 1e-6
    for j in range(4):
        d = e * np.eye(4)[j]
        up, down = (integrator.intervals(plan, 0, x + s * d, THETA).x1 for s in (1.0, -1.0))
        np.testing.assert_allclose(exact.A[:, :, j], (up - down) / (2.0 * e), atol=5e-8)
        up, down = (integrator.outputs(x + s * d, w, THETA).y for s in (1.0, -1.0))
        np.testing.assert_allclose(outputs.C[:, j], (up - down) / (2.0 * e), atol=5e-8)
    for j in range(len(THETA)):
        d = e * np.eye(len(THETA))[j]
        up, down = (integrator.intervals(plan, 0, x, THETA + s * d).x1 for s in (1.0, -1.0))
        np.testing.assert_allclose(exact.B[:, :, j], (up - down) / (2.0 * e), atol=5e-8)
        up, down = (integrator.outputs(x, w, THETA + s * d).y for s in (1.0, -1.0))
        np.testing.assert_allclose(outputs.D[:, j], (up - down) / (2.0 * e), atol=5e-8)


@pytest.mark.parametrize("scheme", ["rk4", "flow"])
def test_python_and_compiled_loops_agree(scheme: str) -> None:
    machine = variant(estimator={"parameters": ALL})
    model = build_model(with_integrator(machine, scheme=scheme))
    velocity = 4e-3 * np.sin(2.0 * np.pi * 30.0 * np.arange(201) / 10000.0)
    x = np.random.default_rng(2).uniform(-1.1, 1.1, (2, 4))
    compiled, plain = Integrator(model), Integrator(model, compiled=False)
    plan = compiled.plan(moving(velocity))
    for a, b in zip(compiled.intervals(plan, 0, x, THETA), plain.intervals(plan, 0, x, THETA), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12)
    w = np.random.default_rng(3).standard_normal((2, 5))
    for a, b in zip(compiled.outputs(x, w, THETA), plain.outputs(x, w, THETA), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-12)


def test_coupled_states_make_one_block() -> None:
    model = linear_model()
    compiled, plain = Integrator(model), Integrator(model, compiled=False)
    assert [block.states for block in compiled.blocks] == [(0, 2), (1,)]
    plan = compiled.plan(moving(np.sin(np.arange(41.0)), rate=100.0))
    x, theta = np.random.default_rng(2).standard_normal((8, 3)), np.array([1.3, 0.8, 0.9])
    for a, b in zip(compiled.intervals(plan, 0, x, theta), plain.intervals(plan, 0, x, theta), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-13)


def test_without_a_compiler_python_takes_over(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise BuildError("no compiler")

    monkeypatch.setattr(module, "shared_library", refuse)
    assert shared_library is not module.shared_library
    integrator = Integrator(build_model(with_integrator(scheme="rk4")))
    assert integrator.intervals(integrator.plan(moving(np.zeros(101))), 0, np.ones((1, 4)), np.ones(4)).x1.shape == (
        1,
        4,
    )


def test_substeps_follow_the_displacement() -> None:
    integrator = Integrator(build_model(with_integrator(scheme="rk4")))
    speeds = np.array([0.0, 1e-3, -0.02, 0.3, 1.0, 7.0])
    plan = integrator.plan(moving(np.concatenate([[0.0], np.repeat(speeds, 100)])))
    rho = np.array([120e3, 25e3, 7.1e3, 7.9e3]) / (4.0 * np.array([0.067, 0.056, 0.047, 0.83]))
    # Beyond max_velocity the count stays what it is there.
    expected = np.maximum(1, np.ceil(np.minimum(np.abs(speeds), 1.0)[:, None] * 1e-4 * rho / 0.03))
    np.testing.assert_array_equal(plan.substeps[::100], expected)
    np.testing.assert_allclose(plan.path, np.abs(speeds) * 0.01)
    np.testing.assert_allclose(plan.fastest, np.abs(speeds))


def test_a_rate_over_time_adds_to_the_substeps() -> None:
    integrator = Integrator(linear_model())
    plan = integrator.plan(moving(np.full(6, 0.5), rate=100.0))
    # (|v| 4/m + 3/s) 0.01 s / 0.5
    assert set(plan.substeps.ravel().tolist()) == {math.ceil((0.5 * 4.0 + 3.0) * 0.01 / 0.5)}
    states = tuple(dataclasses.replace(state, rate_per_second=300.0) for state in integrator.model.states)
    plan = Integrator(dataclasses.replace(integrator.model, states=states)).plan(moving(np.full(6, 0.5), rate=100.0))
    assert set(plan.substeps.ravel().tolist()) == {math.ceil((0.5 * 4.0 + 300.0) * 0.01 / 0.5)}


def test_merged_samples_keep_the_displacement() -> None:
    signals = moving(1e-3 * np.concatenate([[9.0], np.repeat([0.3, -0.5, 0.4, 0.1, 0.2], 20)]))
    ends = []
    for settings in ({"substeps": 5}, {"substeps": 100}):
        machine = with_integrator(scheme="rk4", displacement=0.002, **settings)
        ends.append(simulate(Integrator(build_model(machine)), signals, np.ones(4))[-1])
    np.testing.assert_allclose(*ends, atol=1e-9)
    uneven = dataclasses.replace(signals, velocity=signals.velocity + 1e-4 * np.cos(np.pi * np.arange(101)))
    merged = Integrator(build_model(with_integrator(scheme="rk4", substeps=5))).plan(uneven)
    assert merged.steps == 5
    np.testing.assert_allclose(merged.end[:, 1].sum() * merged.h, uneven.velocity[1:].sum() * 1e-4, rtol=1e-12)


def test_linear_velocity_runs_from_sample_to_sample() -> None:
    # Where nothing slips z is the travel, exactly the trapezoidal rule's.
    velocity = 1e-4 * np.sin(np.arange(101) / 30.0)
    integrator = Integrator(build_model(with_integrator(scheme="rk4", velocity="linear")))
    end = simulate(integrator, moving(velocity), np.ones(4))[-1]
    travel = np.sum(0.5 * (velocity[1:] + velocity[:-1])) * 1e-4
    rho = float(integrator.model.function("rho")(np.zeros(5), np.ones(4))[3])
    assert end[3] == pytest.approx(rho * travel, rel=1e-9)


def test_an_incomplete_interval_does_not_count() -> None:
    integrator = Integrator(build_model(with_integrator(scheme="rk4")))
    for samples, intervals in ((0, 0), (1, 0), (100, 0), (101, 1), (200, 1), (201, 2)):
        assert len(integrator.plan(moving(np.zeros(max(samples, 2)))).path if samples > 1 else ()) == intervals
