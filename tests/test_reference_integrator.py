"""The reference integrator: order, plan, sensitivities, and its two ways to run the same loops."""

import dataclasses
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from reference_cases import Array, along_lines, arrays, linear_model, lines, moving, simulate, variant, with_integrator
from sgms_mhe.configuration import override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.reference import compiled_loops as module
from sgms_mhe.reference.integrator import ReferenceIntegrator
from sgms_mhe.reference.plan import Plan
from sgms_mhe.signals.chain import Signals, signal_array
from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.toolchain import shared_library

BoolArray = NDArray[np.bool_]
ALL = ["stiffness", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity"]
THETA = np.array([1.05, 1.1, 0.9, 1.02, 0.98, 1.1, 0.97, 1.01])


def test_order_of_convergence() -> None:
    # A soft window and gate bring the asymptotic range within reach; the move per sample is below 0.1.
    soft = {"zeta": 0.7, "lambda": 6.0, "gamma": 3.0}
    machine = variant(friction={"smoothing": soft}, sampling={"integrator": {"scheme": "rk4"}})
    signals = moving(1e-3 * (1.2 + np.sin(2.0 * np.pi * 40.0 * np.arange(101) / 10000.0)))
    ends = []
    for factor in (1, 2, 4, 64):
        chosen = with_integrator(machine, scheme="rk4", substeps=100 * factor, displacement=10.0)
        ends.append(simulate(ReferenceIntegrator(build_model(chosen)), signals, np.ones(4), np.full(4, 0.1))[-1])
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(4, abs=0.35)


@pytest.mark.parametrize("state_as", ["force", "deflection"])
@pytest.mark.parametrize("scheme", ["rk4", "flow"])
def test_sensitivities_are_differences(scheme: str, state_as: str) -> None:
    machine = variant(estimator={"parameters": ALL, "bounds": {}})
    noise = machine.estimator.noise.model_dump() | {"state_as": state_as}
    machine = with_integrator(variant(estimator={"parameters": ALL, "bounds": {}, "noise": noise}), scheme=scheme)
    integrator = ReferenceIntegrator(build_model(machine))
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
    compiled, plain = ReferenceIntegrator(model), ReferenceIntegrator(model, compiled=False)
    plan = compiled.plan(moving(velocity))
    for a, b in zip(
        arrays(compiled.intervals(plan, 0, x, THETA)), arrays(plain.intervals(plan, 0, x, THETA)), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12)
    w = np.random.default_rng(3).standard_normal((2, 5))
    for a, b in zip(compiled.outputs(x, w, THETA), plain.outputs(x, w, THETA), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-12)


def test_coupled_states_make_one_block() -> None:
    model = linear_model()
    compiled, plain = ReferenceIntegrator(model), ReferenceIntegrator(model, compiled=False)
    assert [block.states for block in compiled.blocks] == [(0, 2), (1,)]
    plan = compiled.plan(moving(np.sin(np.arange(41.0)), rate=100.0))
    x, theta = np.random.default_rng(2).standard_normal((8, 3)), np.array([1.3, 0.8, 0.9])
    for a, b in zip(
        arrays(compiled.intervals(plan, 0, x, theta)), arrays(plain.intervals(plan, 0, x, theta)), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-13)


def test_without_a_compiler_python_takes_over(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise BuildError("no compiler")

    monkeypatch.setattr(module, "shared_library", refuse)
    assert shared_library is not module.shared_library
    integrator = ReferenceIntegrator(build_model(with_integrator(scheme="rk4")))
    assert integrator.intervals(integrator.plan(moving(np.zeros(101))), 0, np.ones((1, 4)), np.ones(4)).x1.shape == (
        1,
        4,
    )


def test_substeps_follow_the_displacement() -> None:
    integrator = ReferenceIntegrator(build_model(with_integrator(scheme="rk4")))
    speeds = np.array([0.0, 1e-3, -0.02, 0.3, 1.0, 7.0])
    plan = integrator.plan(moving(np.concatenate([[0.0], np.repeat(speeds, 100)])))
    rho = np.array([120e3, 25e3, 7.1e3, 7.9e3]) / (4.0 * np.array([0.067, 0.056, 0.047, 0.83]))
    # Beyond max_velocity the count stays what it is there.
    expected = np.maximum(1, np.ceil(np.minimum(np.abs(speeds), 1.0)[:, None] * 1e-4 * rho / 0.03))
    np.testing.assert_array_equal(plan.substeps[::100], expected)
    np.testing.assert_allclose(plan.path, np.abs(speeds) * 0.01)
    np.testing.assert_allclose(plan.fastest, np.abs(speeds))


def test_a_rate_over_time_adds_to_the_substeps() -> None:
    integrator = ReferenceIntegrator(linear_model())
    plan = integrator.plan(moving(np.full(6, 0.5), rate=100.0))
    # (|v| 4/m + 3/s) 0.01 s / 0.5
    assert set(plan.substeps.ravel().tolist()) == {math.ceil((0.5 * 4.0 + 3.0) * 0.01 / 0.5)}
    states = tuple(dataclasses.replace(state, rate_per_second=300.0) for state in integrator.model.states)
    plan = ReferenceIntegrator(dataclasses.replace(integrator.model, states=states)).plan(
        moving(np.full(6, 0.5), rate=100.0)
    )
    assert set(plan.substeps.ravel().tolist()) == {math.ceil((0.5 * 4.0 + 300.0) * 0.01 / 0.5)}


def test_merged_samples_keep_the_displacement() -> None:
    signals = moving(1e-3 * np.concatenate([[9.0], np.repeat([0.3, -0.5, 0.4, 0.1, 0.2], 20)]))
    ends = []
    for settings in ({"substeps": 5}, {"substeps": 100}):
        machine = with_integrator(scheme="rk4", displacement=0.002, **settings)
        ends.append(simulate(ReferenceIntegrator(build_model(machine)), signals, np.ones(4))[-1])
    np.testing.assert_allclose(*ends, atol=1e-9)
    uneven = dataclasses.replace(signals, velocity=signals.velocity + 1e-4 * np.cos(np.pi * np.arange(101)))
    merged = ReferenceIntegrator(build_model(with_integrator(scheme="rk4", substeps=5))).plan(uneven)
    assert merged.steps == 5
    middle = 0.5 * (merged.start + merged.end)
    np.testing.assert_allclose(middle[:, 1].sum() * merged.h, uneven.velocity[1:].sum() * 1e-4, rtol=1e-12)
    np.testing.assert_allclose(merged.stair[:, 1].sum() * 1e-4, uneven.velocity[1:].sum() * 1e-4, rtol=1e-12)


# --- merged samples ----------------------------------------------------------------------------------------------

MERGED = 5


def merging(machine: Machine | None = None, scheme: str = "flow") -> Machine:
    """An interval of ten steps of five samples each."""
    settings = {"rate": 10000.0, "update_rate": 200.0}
    return with_integrator(machine or variant(sampling=settings), scheme=scheme, substeps=50 // MERGED)


def one_step(**tables: dict[str, Any]) -> ReferenceIntegrator:
    """Every interval one step of five samples, so that each step can be judged by itself."""
    machine = variant(**{"sampling": {"update_rate": 2000.0}} | tables)
    return ReferenceIntegrator(build_model(with_integrator(machine, scheme="flow", substeps=1)))


def is_near(integrator: ReferenceIntegrator, plan: Plan, x: Array) -> BoolArray:
    """Which elements of one-step intervals slide through (n, n_x)."""
    displacement, level = plan.slide[:, :1], np.where(plan.slide[:, 1:2] > 0.0, plan.slide[:, 1:2], np.nan)
    return np.asarray(np.abs(np.sign(displacement) * x / level - integrator.flow.r_star) < 0.004)


def reversing(peak: float, frequency: float, steps: int) -> Signals:
    time = np.arange(MERGED * steps + 1) / 10000.0
    return moving(peak * (np.sin(2.0 * np.pi * frequency * time + 0.3) + 0.1))


@pytest.mark.parametrize("scheme", ["rk4", "flow"])
def test_python_and_compiled_loops_agree_on_merged_samples(scheme: str) -> None:
    model = build_model(with_integrator(variant(estimator={"parameters": ALL[:2]}), scheme=scheme, substeps=20))
    compiled, plain = ReferenceIntegrator(model), ReferenceIntegrator(model, compiled=False)
    signals = moving(2e-3 * np.sin(2.0 * np.pi * 15.0 * np.arange(801) / 10000.0) + 1e-3)
    plan, theta = compiled.plan(signals), THETA[:5]
    assert (plan.steps, plan.stairs) == (20, MERGED)
    x = simulate(compiled, signals, theta)[:-1]
    for a, b in zip(
        arrays(compiled.intervals(plan, 0, x, theta)), arrays(plain.intervals(plan, 0, x, theta)), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12)


def test_steps_below_the_gate_go_with_speed() -> None:
    """As many as their displacement asks for at the gate, the slower the fewer, and none is longer than at the gate."""
    longest, gate, h = 0.003, 0.36e-3, 1e-4
    machine = with_integrator(variant(), scheme="flow", slow_displacement=longest)
    velocity = gate * np.array([0.0, 1e-3, 0.19, 0.21, 0.5, 0.9, 0.999, 1.001, 30.0])
    plan = ReferenceIntegrator(build_model(machine)).plan(moving(np.concatenate([[7.0], np.tile(velocity, 100)])))
    taken = plan.substeps[: len(velocity)]
    rho = np.array([120e3, 25e3, 7.1e3, 7.9e3]) / (4.0 * np.array([0.067, 0.056, 0.047, 0.83]))
    most = np.maximum(1.0, np.ceil(gate * h * rho / longest))
    np.testing.assert_array_equal(most, [6.0, 2.0, 1.0, 1.0])
    np.testing.assert_array_equal(taken[:, 0], [1.0, 1.0, 2.0, 2.0, 4.0, 6.0, 6.0, 0.0, 0.0])
    np.testing.assert_array_equal(taken[6], most)
    slow = velocity < gate
    assert np.all(velocity[slow, None] * h * rho / taken[slow] <= gate * h * rho / most * (1.0 + 1e-12))


def test_merged_samples_take_lines_and_stairs() -> None:
    integrator = one_step()
    # One step each: a reversal, standstill, below the gate, a fast line, constant and fast, a fast reversal.
    begin = np.array([-1e-4, 0.0, 1e-4, 1e-3, 0.1, -0.5])
    end = np.array([3e-4, 0.0, 2e-4, 2e-3, 0.1, 0.6])
    tau = (2.0 * np.arange(MERGED) + 1.0) / MERGED - 1.0
    velocity = 0.5 * (begin + end)[:, None] + 0.5 * (end - begin)[:, None] * tau
    plan = integrator.plan(moving(np.concatenate([[7.0], velocity.ravel()])))
    np.testing.assert_allclose(plan.start[:, 1], begin, atol=1e-15)
    np.testing.assert_allclose(plan.end[:, 1], end, atol=1e-15)
    np.testing.assert_allclose(plan.stair[:, 1], velocity.ravel(), atol=1e-15)
    rho = np.array([120e3, 25e3, 7.1e3, 7.9e3]) / (4.0 * np.array([0.067, 0.056, 0.047, 0.83]))
    needed = np.maximum(1.0, np.ceil(0.5 * np.abs(begin + end)[:, None] * 5e-4 * rho / 0.02))
    expected = np.where(needed <= MERGED - 1, needed, 0.0)
    expected[[0, 5]] = 0.0
    np.testing.assert_array_equal(plan.substeps, expected)
    slow = np.ceil(0.36e-3 * 1e-4 * rho / 0.02)
    np.testing.assert_array_equal(
        plan.stair_substeps, np.where(np.abs(velocity).reshape(-1, 1) > 0.36e-3, 0.0, np.maximum(1.0, slow))
    )
    # Only the constant speed leaves the level where it is: from 1 to 2 mm/s it falls by 4 %.
    np.testing.assert_array_equal(plan.slide[:, 0] != 0.0, [False, False, False, False, True, False])
    np.testing.assert_allclose(plan.slide[4], [0.1 * 5e-4, 1.0, 0.0], rtol=1e-12, atol=1e-15)


def test_merged_runge_kutta_steps_follow_the_lines() -> None:
    machine = with_integrator(variant(sampling={"update_rate": 2000.0}), scheme="rk4", substeps=1)
    integrator = ReferenceIntegrator(build_model(machine))
    plan = integrator.plan(moving(np.concatenate([[0.0], np.repeat([0.0, -0.02, 0.3, 7.0], MERGED)])))
    rho = np.array([120e3, 25e3, 7.1e3, 7.9e3]) / (4.0 * np.array([0.067, 0.056, 0.047, 0.83]))
    speed = np.array([0.0, 0.02, 0.3, 1.0])  # max_velocity bounds the counts
    np.testing.assert_array_equal(plan.substeps, np.maximum(1, np.ceil(speed[:, None] * 5e-4 * rho / 0.03)))
    assert not plan.slide.any()


def test_mean_level_and_its_change_are_over_displacement() -> None:
    integrator = one_step()
    machine = integrator.model.machine
    signals = reversing(4e-3, 10.0, 200)
    plan = integrator.plan(signals)
    mean, change = lines(signals.velocity, MERGED)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    slides = np.flatnonzero(plan.slide[:, 0])
    assert 50 < len(slides) < 150
    for k in slides:
        v = mean[k] + change[k] * nodes
        s = 1.0 + machine.friction.stribeck_ratio * np.exp(-((v / machine.friction.stribeck_velocity) ** 2))
        share = 0.5 * weights * v / mean[k]
        place = nodes + 0.5 * change[k] / mean[k] * (nodes**2 - 1.0)  # displacement, from -1 to 1
        level = 1.0 / np.sum(share / s)
        np.testing.assert_allclose(plan.slide[k], [mean[k] * 5e-4, level, 3.0 * np.sum(share * place * s)], atol=1e-6)
        assert abs(plan.slide[k, 2]) <= 5e-4 * plan.slide[k, 1]
    fast = np.abs(mean) - np.abs(change) > 0.36e-3
    assert not plan.slide[~fast].any()
    assert np.count_nonzero(fast) > len(slides)


@pytest.mark.parametrize(("peak", "frequency"), [(1e-3, 2.0), (2e-3, 5.0)])
def test_merged_steps_solve_the_equations_along_their_lines(peak: float, frequency: float) -> None:
    integrator, signals = one_step(), reversing(peak, frequency, 800)
    plan, theta = integrator.plan(signals), np.ones(4)
    x = simulate(integrator, signals, theta)[:-1]
    mean, change = lines(signals.velocity, MERGED)
    exact = along_lines(integrator.model.machine, mean, change, 5e-4, x)
    found = integrator.intervals(plan, 0, x, theta)
    diagonals = (np.diagonal(matrix, axis1=1, axis2=2) for matrix in (found.A, found.B))
    errors = [np.abs(a - b) for a, b in zip((found.x1, *diagonals), exact, strict=True)]
    slides = is_near(integrator, plan, x)
    stairs = ~slides & (plan.substeps == 0)
    runge_kutta = ~slides & (plan.substeps > 0)
    # State, its derivative by the state before, and by log rho. RK4 at 0.02 alone leaves 3e-6 and 1.1e-4 of a window of
    # this width; stairs differ from the line that they stand for.
    for where, bounds in (
        (slides, (2e-7, 4e-6, 3e-7)),
        (runge_kutta, (1e-5, 2e-4, 2e-5)),
        (stairs, (5e-5, 5e-4, 5e-5)),
    ):
        assert np.count_nonzero(where) > 50
        for error, bound in zip(errors, bounds, strict=True):
            assert error[where].max() < bound


def test_sensitivities_of_merged_steps_are_differences() -> None:
    integrator = one_step(estimator={"parameters": ["stiffness", "coulomb"], "bounds": {}})
    signals, theta = reversing(2e-3, 5.0, 200), THETA[:5]
    plan = integrator.plan(signals)
    x = simulate(integrator, signals, theta)[:-1]
    exact = integrator.intervals(plan, 0, x, theta)
    chi = x / theta[4]
    slides = is_near(integrator, plan, chi)
    assert 50 < np.count_nonzero(slides) < slides.size - 50
    e = 1e-6

    def difference(dx: Array, dtheta: Array) -> Array:
        up, down = (integrator.intervals(plan, 0, x + s * dx, theta + s * dtheta).x1 for s in (e, -e))
        return np.asarray((up - down) / (2.0 * e))

    for j in range(4):
        error = np.abs(exact.A[:, :, j] - difference(np.eye(4)[j], np.zeros(5)))
        assert error[~slides].max() < 1e-7
        # The derivative of a slide is nearer to that of the solution than to that of the step: by a g'' D / k.
        assert error[slides].max() < 7e-5
    for j in range(5):
        error = np.abs(exact.B[:, :, j] - difference(np.zeros(4), np.eye(5)[j]))
        assert error[~slides].max() < 1e-7
        assert error[slides].max() < 7e-5


@pytest.mark.parametrize("scheme", ["flow", "rk4"])
def test_elastic_motion_keeps_its_displacement(scheme: str) -> None:
    integrator = ReferenceIntegrator(build_model(merging(scheme=scheme)))
    velocity = 2e-5 * np.random.default_rng(4).standard_normal(1001)
    signals = moving(velocity)
    x = simulate(integrator, signals, np.ones(4))
    travel = np.concatenate([[0.0], np.cumsum(velocity[1:].reshape(-1, 50).sum(axis=1)) * 1e-4])
    rho = np.array(integrator.model.function("rho")(np.zeros(5), np.ones(4))).ravel()
    assert np.abs(np.outer(travel, rho)).max() < 0.5  # nothing slips
    np.testing.assert_allclose(x, np.outer(travel, rho), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "free", "slides"),
    [
        ({"name": "force_ripple", "amplitude_N": 0.5}, ["force_ripple.amplitude_N"], True),
        ({"name": "asymmetric_coulomb", "ratio": 0.1}, [], True),
        ({"name": "asymmetric_coulomb", "ratio": 0.1}, ["asymmetric_coulomb.ratio"], False),
        ({"name": "encoder_periodic_error", "amplitude_m": 1e-6}, [], False),
        ({"name": "dwell_dependence", "ratio": 0.1}, ["dwell_dependence.ratio"], False),
        ({"name": "backlash", "gap_m": 1e-5}, [], False),
        ({"name": "actuator_lag", "time_constant_s": 1e-3}, ["actuator_lag.time_constant_s"], True),
    ],
)
def test_merged_samples_of_a_model_with_an_effect(effect: dict[str, Any], free: list[str], slides: bool) -> None:
    changes = {"effects": [effect], "estimator": {"parameters": ["stiffness", *free]}}
    model = build_model(override_machine(merging(), changes))
    compiled, plain = ReferenceIntegrator(model), ReferenceIntegrator(model, compiled=False)
    assert any(block.slides for block in compiled.blocks) is slides
    signals = moving(4e-3 * np.sin(2.0 * np.pi * 20.0 * np.arange(501) / 10000.0 + 1.0))
    theta = 1.0 + 0.05 * np.sin(np.arange(model.n_p))
    plan = compiled.plan(signals)
    x = simulate(compiled, signals, theta)[:-1]
    exact = compiled.intervals(plan, 0, x, theta)
    for a, b in zip(arrays(exact), arrays(plain.intervals(plan, 0, x, theta)), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12)
    for j in range(model.n_p):
        d = 1e-6 * np.eye(model.n_p)[j]
        up, down = (compiled.intervals(plan, 0, x, theta + s * d).x1 for s in (1.0, -1.0))
        np.testing.assert_allclose(exact.B[:, :, j], (up - down) / 2e-6, rtol=1e-6, atol=2e-5)


def test_the_friction_parameters_in_the_level_keep_elements_from_sliding() -> None:
    for free, slides in (("coulomb", True), ("stribeck_ratio", False), ("stribeck_velocity", False)):
        integrator = one_step(estimator={"parameters": ["stiffness", free]})
        assert [block.slides for block in integrator.blocks] == [slides] * 4


@pytest.mark.parametrize("name", ["actuator_lag", "force_delay", "structural_resonance"])
def test_merged_samples_keep_the_timing_of_the_force(name: str) -> None:
    parameters = {
        "actuator_lag": {"time_constant_s": 1e-3},
        "force_delay": {"delay_s": 1e-3},
        "structural_resonance": {"frequency_Hz": 80.0, "mass_kg": 2.0},
    }[name]
    time = np.arange(2001) / 10000.0
    signals = dataclasses.replace(
        moving(5e-3 * np.sin(2.0 * np.pi * 15.0 * time)), force=3.0 * np.sin(2.0 * np.pi * 40.0 * time)
    )
    outputs = []
    for substeps in (100, 20):
        machine = with_integrator(scheme="flow", substeps=substeps)
        model = build_model(override_machine(machine, {"effects": [{"name": name, **parameters}]}))
        integrator, theta = ReferenceIntegrator(model), np.ones(model.n_p)
        x = simulate(integrator, signals, theta)
        outputs.append(integrator.outputs(x, signal_array(signals, 1e-4)[::100], theta).y[5:])
    # Signals a quarter of a sample early or late would be 1 % of the amplitude.
    assert np.abs(outputs[1] - outputs[0]).max() < 2e-3 * np.abs(outputs[0]).max()


def test_an_incomplete_interval_does_not_count() -> None:
    integrator = ReferenceIntegrator(build_model(with_integrator(scheme="rk4")))
    for samples, intervals in ((0, 0), (1, 0), (100, 0), (101, 1), (200, 1), (201, 2)):
        assert len(integrator.plan(moving(np.zeros(max(samples, 2)))).path if samples > 1 else ()) == intervals
