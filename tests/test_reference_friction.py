"""The S-GMS law through the reference integrator: what the model must do, whatever integrates it."""

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from reference_cases import linear_model, moving, simulate, variant, with_integrator
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.machine import Machine, Smoothing
from sgms_mhe.model import build_model
from sgms_mhe.reference.flow import window
from sgms_mhe.reference.integrator import ReferenceIntegrator

PAPER = Smoothing.model_validate({"zeta": 0.9, "lambda": 35.0, "gamma": 35.0})


def elements(n_z: int, **friction: Any) -> Machine:
    """A machine of n_z elements from stiff to soft."""
    fraction = np.arange(1.0, n_z + 1.0)
    machine = variant(
        friction={
            "stiffness": [1e5 * 0.8**i for i in range(n_z)],
            "fraction": (fraction / fraction.sum()).tolist(),
            "micro_viscous": [0.0] * n_z,
        }
        | friction
    )
    return with_integrator(machine, scheme="rk4")


@lru_cache
def flow_integrator() -> ReferenceIntegrator:
    return ReferenceIntegrator(build_model(with_integrator(scheme="flow")))


def test_window_ends() -> None:
    alpha = 1e-3
    # tanh(lambda (1 - zeta)) = 1 - 2 alpha (4)
    assert np.tanh(35.0 * 0.1) == pytest.approx(1.0 - 2.0 * alpha, abs=2e-4)
    assert float(window(0.0, PAPER)) == pytest.approx(0.0, abs=1e-15)
    exact = 0.5 * (1.0 - np.tanh(35.0 * 0.1))
    assert float(window(1.0, PAPER)) == pytest.approx(1.0 - exact, abs=1e-15)
    assert exact == pytest.approx(alpha, rel=0.1)


@given(r=st.floats(-3.0, 3.0))
def test_window_is_even_and_within_zero_and_one(r: float) -> None:
    assert float(window(r, PAPER)) == pytest.approx(float(window(-r, PAPER)), abs=1e-15)
    assert -1e-15 <= float(window(r, PAPER)) <= 1.0


@pytest.mark.parametrize("n_z", range(1, 11))
@pytest.mark.parametrize("speed", [3e-4, -2e-3, 0.05])
def test_steady_sliding_lands_on_the_stribeck_curve(n_z: int, speed: float) -> None:
    machine = elements(n_z)
    model = build_model(machine)
    integrator = ReferenceIntegrator(model)
    theta = np.ones(model.n_p)
    # Far enough for the softest element to slip.
    samples = 100 * int(1 + 12.0 * 4.0 / (1e5 * 0.8 ** (n_z - 1)) / abs(speed) / 0.01)
    x = simulate(integrator, moving(np.full(samples + 1, speed)), theta)[-1]
    friction = float(integrator.outputs(x[None], np.array([[0.0, speed, 0.0, 0.0, 0.0]]), theta).y[0])
    level = 4.0 * (1.0 + 0.12 * np.exp(-((speed / 1e-3) ** 2)))
    # The window leaves alpha of the level.
    assert friction == pytest.approx(np.sign(speed) * level + 20.0 * speed, rel=1.5e-3)


@pytest.mark.parametrize("n_z", [1, 4, 10])
def test_presliding_loops_close(n_z: int) -> None:
    # Non-local memory: an inner excursion that returns to where it left leaves no trace on the outer branch. The
    # smoothing is sharp here, because an element that retraces its last tenth before slip does so a little lower.
    model = build_model(elements(n_z, stribeck_ratio=0.0, smoothing={"zeta": 0.99, "lambda": 350.0, "gamma": 350.0}))
    integrator = ReferenceIntegrator(model)
    theta = np.ones(model.n_p)

    def travel(turns: list[float]) -> np.ndarray:
        """Positions in um from one turn to the next, at a constant speed with gentle ends."""
        parts = [np.zeros(1)]
        at = 0.0
        for to in turns:
            n = 100 * max(1, round(abs(to - at) * 1e-6 / 1e-3 / 0.01))
            shape = np.diff(0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, n + 1)))
            parts.append((to - at) * 1e-6 * shape * 10000.0)
            at = to
        return np.concatenate(parts)

    # Several times around first, so that the loop is stationary.
    outer = [30.0, -30.0] * 3 + [12.0]
    plain = simulate(integrator, moving(travel(outer)), theta)[-1]
    with_inner = simulate(integrator, moving(travel([*outer, 2.0, 12.0])), theta)[-1]
    np.testing.assert_allclose(with_inner, plain, atol=0.01)
    # A whole outer loop returns to its start.
    twice = simulate(integrator, moving(travel([*outer[:-1], 30.0, -30.0, 12.0])), theta)[-1]
    np.testing.assert_allclose(twice, plain, atol=1e-3)


def test_one_element_that_slips_always_is_lugre() -> None:
    # zeta -> 0 opens the window everywhere (eta = 1); for motion in one direction from rest the gate is open too.
    machine = elements(1, smoothing={"zeta": 1e-12, "lambda": 1.0, "gamma": 1e3}, stribeck_ratio=0.5)
    model = build_model(machine)
    integrator = ReferenceIntegrator(model)
    speeds = np.concatenate([[0.0], np.repeat([2e-3, 1e-3, 5e-3], 100)])
    theta = np.ones(model.n_p)
    x0 = np.array([0.2])
    chi = simulate(integrator, moving(speeds), theta, x0)[:, 0]
    rho, expected = 1e5 / 4.0, [0.2]
    for v in (2e-3, 1e-3, 5e-3):
        # dz/dt = v - |v| z / zs(v) at constant v
        level = 1.0 + 0.5 * np.exp(-((v / 1e-3) ** 2))
        expected.append(level + (expected[-1] - level) * np.exp(-rho * v * 0.01 / level))
    np.testing.assert_allclose(chi, expected, atol=1e-5)


@given(amplitude=st.floats(1e-5, 0.02), frequency=st.floats(3.0, 40.0))
@example(amplitude=1.26e-4, frequency=5.0)
def test_no_element_exceeds_its_level(amplitude: float, frequency: float) -> None:
    integrator = flow_integrator()
    velocity = amplitude * np.sin(2.0 * np.pi * frequency * np.arange(1001) / 10000.0)
    x = simulate(integrator, moving(velocity), np.ones(4))
    # At r >= r* the window lets all motion slip, so d(chi)/dt <= rho |v| (1 - gate): what an element can gain above
    # its level is the travel, between two reversals, that the gate (r near 1) holds back while the axis creeps.
    friction = integrator.model.machine.friction
    rho = np.array(friction.stiffness) / (np.array(friction.fraction) * friction.coulomb)
    speed = np.abs(velocity)
    held = speed * 0.5 * (1.0 - np.tanh(friction.smoothing.gamma * speed / friction.stribeck_velocity))
    stretches = np.split(held, np.flatnonzero(np.diff(np.sign(velocity))) + 1)
    creep = max(float(stretch.sum()) for stretch in stretches) / 10000.0
    level = (1.0 + friction.stribeck_ratio) * integrator.flow.r_star
    assert (np.abs(x).max(axis=0) <= level + rho * creep + 1e-5).all()


def test_node_state_scalings_are_the_same_model() -> None:
    velocity = 2e-3 * np.sin(2.0 * np.pi * 12.0 * np.arange(1001) / 10000.0)
    theta = np.array([1.2, 0.9, 0.8, 1.1])
    ends = []
    for state_as in ("force", "deflection"):
        noise = variant().estimator.noise.model_dump() | {"state_as": state_as}
        model = build_model(with_integrator(variant(estimator={"noise": noise}), scheme="rk4"))
        x = simulate(ReferenceIntegrator(model), moving(velocity), theta)[-1]
        ends.append(np.array(model.function("deflection")(model.function("from_node")(x, theta), theta)))
    np.testing.assert_allclose(*ends, rtol=1e-12)


@pytest.mark.parametrize(
    ("friction", "estimator", "is_affine"),
    [
        ({}, {}, True),
        # The Coulomb level multiplies chi, which is the node state over it: on paper it cancels.
        ({}, {"parameters": ["stiffness", "coulomb", "viscous"]}, True),
        # A deflection times its stiffness.
        ({}, {"noise": {"state_as": "deflection"}}, False),
        ({}, {"noise": {"state_as": "deflection"}, "parameters": ["viscous"]}, True),
        # The rate of a state is not affine in it, whatever is estimated.
        ({"micro_viscous": [10.0] * 4}, {}, False),
        ({"micro_viscous": [10.0] * 4}, {"parameters": ["viscous"]}, False),
    ],
)
def test_output_is_affine_where_nothing_multiplies(
    friction: dict[str, Any], estimator: dict[str, Any], is_affine: bool
) -> None:
    machine = override_machine(load_machine("etel_xy"), {"friction": friction, "estimator": {"bounds": {}} | estimator})
    assert build_model(machine).output_is_affine == is_affine


def test_output_of_a_gain_is_not_affine() -> None:
    changes = {"effects": [{"name": "force_gain"}], "estimator": {"parameters": ["stiffness", "force_gain.gain"]}}
    assert not build_model(override_machine(load_machine("etel_xy"), changes)).output_is_affine
    assert linear_model().output_is_affine
