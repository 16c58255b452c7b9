"""Displacement flow of the reference: against an ODE solver, its own algebra, and the Runge-Kutta integrator."""

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from reference_cases import arrays, moving, simulate, variant, with_integrator
from sgms_mhe.machine import Smoothing
from sgms_mhe.model import build_model
from sgms_mhe.reference.flow import Flow, gate_ratio, relaxation, window
from sgms_mhe.reference.integrator import ReferenceIntegrator

SMOOTHINGS = [(0.9, 35.0), (0.9, 10.0), (0.8, 100.0), (0.95, 300.0)]


def smoothing(zeta: float, lambda_: float, gamma: float = 35.0) -> Smoothing:
    return Smoothing.model_validate({"zeta": zeta, "lambda": lambda_, "gamma": gamma})


TABLE = Flow.of(smoothing(0.9, 35.0))


@pytest.mark.parametrize(("zeta", "lambda_"), SMOOTHINGS)
def test_flow_solves_its_ode(zeta: float, lambda_: float) -> None:
    settings = smoothing(zeta, lambda_)
    flow = Flow.of(settings)
    rng = np.random.default_rng(3)

    def rhs(_: float, y: np.ndarray) -> list[float]:
        r, slope = y
        inside = math.tanh(lambda_ * (r - zeta)) ** 2 - math.tanh(lambda_ * (r + zeta)) ** 2
        derivative = -(window(r, settings) - 0.5 * lambda_ * r * inside) if r > 0.0 else 0.0
        return [1.0 - float(window(r, settings)) * max(r, 0.0), float(derivative) * slope]

    for _ in range(20):
        r0, xi = rng.uniform(-1.5, 2.5), 10.0 ** rng.uniform(-4.0, 1.3)
        solution = solve_ivp(rhs, [0.0, xi], [r0, 1.0], method="DOP853", rtol=3e-14, atol=1e-15)
        r1, slope, g1 = flow.advance(r0, xi)
        assert r1 == pytest.approx(solution.y[0, -1], abs=1e-13)
        assert slope == pytest.approx(solution.y[1, -1], abs=1e-12)
        assert g1 == pytest.approx(rhs(0.0, [r1, 0.0])[0], abs=1e-14)


@given(r0=st.floats(-2.0, 3.0), xi=st.floats(0.0, 60.0), part=st.floats(0.0, 1.0))
def test_flow_composes(r0: float, xi: float, part: float) -> None:
    r1, slope, g1 = TABLE.advance(r0, xi)
    middle, first, _ = TABLE.advance(r0, part * xi)
    end, second, g_end = TABLE.advance(middle, (1.0 - part) * xi)
    assert end == pytest.approx(r1, abs=1e-13)
    assert first * second == pytest.approx(slope, abs=1e-12)
    assert g_end == pytest.approx(g1, abs=1e-12)


@given(r0=st.floats(-1.5, 2.5), xi=st.floats(1e-3, 20.0))
def test_flow_sensitivities_are_differences(r0: float, xi: float) -> None:
    _, slope, g1 = TABLE.advance(r0, xi)
    e = 1e-5
    by_start = (TABLE.advance(r0 + e, xi)[0] - TABLE.advance(r0 - e, xi)[0]) / (2.0 * e)
    by_xi = (TABLE.advance(r0, xi + e)[0] - TABLE.advance(r0, xi - e)[0]) / (2.0 * e)
    assert slope == pytest.approx(by_start, abs=1e-6)
    assert g1 == pytest.approx(by_xi, abs=1e-6)


def test_flow_settles_where_it_stands_still() -> None:
    assert TABLE.advance(TABLE.r_star, 5.0)[0] == TABLE.r_star
    for r0 in (-1.0, 0.3, 0.99, 1.2, 5.0):
        r1, slope, g1 = TABLE.advance(r0, 200.0)
        assert (r1, g1) == (pytest.approx(TABLE.r_star, abs=1e-15), pytest.approx(0.0, abs=1e-15))
        assert 0.0 <= slope < 1e-60


@pytest.mark.parametrize(("zeta", "lambda_"), [*SMOOTHINGS, (0.3, 4.0)])
def test_slope_and_curvature_at_the_fixed_point(zeta: float, lambda_: float) -> None:
    flow = Flow.of(smoothing(zeta, lambda_))

    def g(r: mpmath.mpf) -> mpmath.mpf:
        return 1 - r * (1 - mpmath.tanh(lambda_ * (r + zeta)) / 2 + mpmath.tanh(lambda_ * (r - zeta)) / 2)

    with mpmath.workdps(40):
        assert float(-mpmath.diff(g, flow.r_star)) == pytest.approx(flow.k, rel=1e-13)
        assert float(mpmath.diff(g, flow.r_star, 2)) == pytest.approx(flow.curvature, rel=1e-12)


def test_relaxation_answers_a_line() -> None:
    # e' = -x e + x (2 u - 1), e(0) = 0, ends at phi(x) = x * integral of e^(-x (1 - u)) (2 u - 1) over 0..1.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for x in np.concatenate([np.geomspace(1e-7, 0.49999, 30), np.linspace(0.5, 20.0, 40)]):
        early = 0.5 * (1.0 - nodes) * x
        mean = np.sum(0.5 * weights * nodes * np.expm1(-early))
        slope = mean - np.sum(0.5 * weights * nodes * early * np.exp(-early))
        phi, dphi = relaxation(float(x))
        assert phi == pytest.approx(x * mean, rel=1e-12)
        assert dphi == pytest.approx(slope, rel=1e-11)
    assert relaxation(1e6) == (pytest.approx(1.0, abs=3e-6), pytest.approx(0.0, abs=1e-11))


def test_gate_ratio_is_the_smallest_on_its_grid() -> None:
    settings = smoothing(0.9, 35.0)
    r = np.linspace(-3.0, 3.0, 6001)
    weight = np.abs(r) * window(r, settings)

    def change(c: float) -> float:
        return float(np.max(weight / (1.0 + np.exp(2.0 * 35.0 * c * np.abs(r)))))

    c = gate_ratio(settings)
    assert c == 0.36
    assert change(c) < 1e-10 <= change(c - 0.01)
    # A window that never closes at r = 0 never lets the gate go.
    assert gate_ratio(smoothing(0.1, 5.0)) == math.inf


@pytest.mark.parametrize("peak", [0.002, 0.05, 0.3])
def test_flow_agrees_with_converged_rk4(peak: float) -> None:
    machine = variant(estimator={"parameters": ["stiffness", "coulomb", "stribeck_ratio", "stribeck_velocity"]})
    velocity = peak * np.sin(2.0 * np.pi * 12.0 * np.arange(601) / 10000.0)
    theta = np.array([1.0, 1.1, 0.9, 1.05, 1.02, 0.97, 1.01])
    results = []
    for settings in ({"scheme": "flow"}, {"scheme": "rk4", "substeps": 1000, "displacement": 0.0015}):
        integrator = ReferenceIntegrator(build_model(with_integrator(machine, **settings)))
        plan = integrator.plan(moving(velocity))
        x = np.random.default_rng(0).uniform(-1.1, 1.1, (len(plan.path), 4))
        results.append(arrays(integrator.intervals(plan, 0, x, theta)))
    # Within an interval elements are under way, where the table's own error is larger than at rest at either end.
    for flow, rk4, within in zip(*results, (2e-8, 2e-8, 2e-8, 1e-7, 1e-7, 1e-7), strict=True):
        np.testing.assert_allclose(flow, rk4, rtol=0.0, atol=within)


def test_flow_is_used_for_elements_alone_and_above_the_gate_alone() -> None:
    integrator = ReferenceIntegrator(build_model(with_integrator(scheme="flow")))
    velocity = np.repeat([0.0, 0.359e-3, 0.361e-3, 1.0, -0.5], 100)
    plan = integrator.plan(moving(np.concatenate([[0.0], velocity])))
    expected = np.repeat([1, 1, 0, 0, 0], 100)
    assert all(block.saturates for block in integrator.blocks)
    np.testing.assert_array_equal(plan.substeps, np.repeat(expected[:, None], 4, axis=1))


def test_flow_stays_right_beyond_every_speed() -> None:
    integrator = ReferenceIntegrator(build_model(with_integrator(scheme="flow")))
    x = simulate(integrator, moving(np.full(201, 30.0)), np.ones(4))
    np.testing.assert_allclose(x[1:], TABLE.r_star, rtol=1e-12)
