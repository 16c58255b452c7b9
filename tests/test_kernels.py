"""Emitted kernels alone: integrator and its sensitivities, displacement flow, output, through predict.c.

predict.c is the stable way in: model and integrator without the estimator, whatever the emitted functions are called.
Only the flow is called by its own name (tests/c/flow_probe.c says which names that takes).
"""

import ctypes
import math
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from c_packages import PRECISIONS, QUICK, Array, compile_probe, elements, machine, pointer, scheme, written
from reference_cases import moving
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import CompiledModel, replay_definitions
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.reference.flow import Flow
from sgms_mhe.reference.integrator import ReferenceIntegrator
from sgms_mhe.signals.chain import signal_array
from sgms_mhe.support.paths import runtime_dir
from sgms_mhe.support.toolchain import shared_library

ALL = ["stiffness", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity"]
RIPPLE = [{"name": "force_ripple", "pitch_m": 0.001, "amplitude_N": 0.8, "phase_rad": 0.7}]


class Kernel:
    """Model and integrator of one machine, compiled."""

    def __init__(self, settings: Machine, folder: Path) -> None:
        self.model: Model = build_model(settings)
        package = written(emit_package(settings, self.model, selftest=False), folder)
        self.library = ctypes.CDLL(
            str(shared_library([runtime_dir() / "predict.c"], [package], [*QUICK, *replay_definitions(settings.name)]))
        )

    def run(self, w: Array, x: Array, theta: Array, d_x: Array | None = None) -> tuple[Array, Array, Array, Array]:
        """Along signals w (n, 5): state and its derivatives at the end, force (n) and its derivatives (n, n_p)."""
        n_x, n_p = self.model.n_x, self.model.n_p
        w, theta = np.ascontiguousarray(w), np.ascontiguousarray(theta)
        x = np.array(x, dtype=float)
        d_x = np.zeros((n_x, n_p)) if d_x is None else np.array(d_x, dtype=float, order="C")
        force, d_force = np.empty(len(w)), np.empty((len(w), n_p))
        done = self.library.sgms_predict(
            ctypes.c_long(len(w)), ctypes.c_long(1), *(pointer(a) for a in (w, theta, x, d_x, force, d_force)), None
        )
        assert done == 0
        return x, d_x, force, d_force

    def sensitivities(self, w: Array, x: Array, theta: Array) -> tuple[Array, Array, Array]:
        """State at the end of w, A = d(end)/d(x), B = d(end)/d(theta). d_x comes back as A d_x + B."""
        n_x, n_p = self.model.n_x, self.model.n_p
        x1, B, _, _ = self.run(w, x, theta)
        A = np.empty((n_x, n_x))
        for i in range(n_x):
            unit = np.zeros((n_x, n_p))
            unit[i, 0] = 1.0
            A[:, i] = (self.run(w, x, theta, unit)[1] - B)[:, 0]
        return x1, A, B


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Kernels by what they change in etel_xy, each built once."""
    built: dict[str, Kernel] = {}

    def build(**changes: Any) -> Kernel:
        key = repr(changes)
        if key not in built:
            built[key] = Kernel(machine(**changes), tmp_path_factory.mktemp("kernel"))
        return built[key]

    return build


def swings(seed: int, samples: int = 100, peak: float = 0.05) -> Array:
    """Velocity [m/s] of slow and fast samples of both signs, standstill included."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples + 1) / samples
    v = peak * np.sin(2.0 * np.pi * (rng.uniform() + rng.uniform(0.5, 2.0) * t)) * rng.uniform() ** 3
    v[rng.integers(0, samples, 5)] = 0.0
    return v


CASES: dict[str, dict[str, Any]] = {
    "flow": {"sampling": scheme("flow"), "estimator": {"parameters": ALL, "bounds": {}}},
    "rk4": {"sampling": scheme("rk4"), "estimator": {"parameters": ALL, "bounds": {}}},
    "two substeps": {"sampling": scheme("rk4", substeps=200)},
    "deflection": {
        "sampling": scheme("rk4"),
        "estimator": {"parameters": ["stiffness", "coulomb"], "bounds": {}, "noise": {"state_as": "deflection"}},
    },
    "one element": {"friction": elements(1), "sampling": scheme("flow")},
    "ten elements": {"friction": elements(10), "estimator": {"parameters": ["stiffness", "viscous"], "bounds": {}}},
    "micro-viscous": {"friction": {"micro_viscous": [50.0, 20.0, 10.0, 5.0]}, "sampling": scheme("rk4")},
    "soft window": {"friction": {"smoothing": {"zeta": 0.6, "lambda": 8.0}}, "sampling": scheme("rk4")},
    "ripple": {"effects": RIPPLE, "estimator": {"parameters": ["stiffness", "force_ripple.amplitude_N"]}},
}


@pytest.mark.parametrize("case", list(CASES))
def test_sensitivities_are_those_of_casadi(case: str, kernel: Any) -> None:
    compiled: Kernel = kernel(**CASES[case])
    model = compiled.model
    # Interpreted: compiling what CasADi prints takes longer than these few intervals.
    integrator = ReferenceIntegrator(model, compiled=False)
    is_flow = model.machine.sampling.integrator.scheme == "flow"
    rng = np.random.default_rng(1)
    for seed in range(3):
        signals = moving(swings(seed, peak=0.5 if is_flow else 0.01))
        plan = integrator.plan(signals)
        x = rng.uniform(-1.1, 1.1, model.n_x)
        theta = rng.uniform(0.8, 1.25, model.n_p)
        expected = integrator.intervals(plan, 0, x[None], theta)
        got = compiled.sensitivities(signal_array(signals, 1e-4), x, theta)
        for name, c, reference in zip(("x", "A", "B"), got, expected[:3], strict=True):
            # The largest entry sets the scale: a sensitivity that slip has wiped out is zero to rounding.
            scale = max(1.0, float(np.abs(reference).max()))
            np.testing.assert_allclose(c, reference[0], rtol=1e-10, atol=1e-11 * scale, err_msg=name)


@pytest.mark.parametrize("case", ["flow", "rk4", "micro-viscous", "ripple"])
def test_sensitivities_are_differences(case: str, kernel: Any) -> None:
    """Sixth-order differences of the C's own numbers: no other derivative is involved."""
    compiled: Kernel = kernel(**CASES[case])
    model = compiled.model
    rng = np.random.default_rng(2)
    w = signal_array(moving(swings(3, 12)), 1e-4)
    x, theta = rng.uniform(-0.6, 0.6, model.n_x), rng.uniform(0.9, 1.1, model.n_p)
    _, A, B = compiled.sensitivities(w, x, theta)
    h = 2e-4
    # Weights of the symmetric differences f(+k h) - f(-k h).
    weights = {1: 45.0, 2: -9.0, 3: 1.0}

    def slope(move: Callable[[float], Array]) -> Any:
        return np.sum([c * (move(k * h) - move(-k * h)) for k, c in weights.items()], axis=0) / (60.0 * h)

    for j, e in enumerate(np.eye(model.n_x)):

        def by_start(h: float, e: Array = e) -> Array:
            return compiled.run(w, x + h * e, theta)[0]

        np.testing.assert_allclose(A[:, j], slope(by_start), rtol=0.0, atol=1e-8 * np.abs(A).max())
    for j, e in enumerate(np.eye(model.n_p)):

        def by_theta(h: float, e: Array = e) -> Array:
            return compiled.run(w, x, theta + h * e)[0]

        np.testing.assert_allclose(B[:, j], slope(by_theta), rtol=0.0, atol=1e-8 * max(1.0, np.abs(B).max()))


@pytest.mark.parametrize("case", ["flow", "deflection", "ten elements", "micro-viscous", "ripple"])
def test_output_and_its_derivatives(case: str, kernel: Any) -> None:
    compiled: Kernel = kernel(**CASES[case])
    model = compiled.model
    of_node = ca.substitute(model.output, model.chi, model.from_node)
    jacobians = [ca.densify(ca.jacobian(of_node, s)) for s in (model.x, model.theta)]
    measure = ca.Function("measure", [model.x, model.w, model.theta], [of_node, *jacobians])
    rng = np.random.default_rng(4)
    for _ in range(25):
        x, theta = rng.uniform(-1.2, 1.2, model.n_x), rng.uniform(0.7, 1.3, model.n_p)
        w = rng.standard_normal((1, 5)) * [0.1, 10.0 ** rng.uniform(-4, 0), 10.0, 30.0, 5.0]
        y, C, D = (np.array(v) for v in measure(x, w[0], theta))
        _, _, force, d_force = compiled.run(w, x, theta)
        scale = np.abs(C).max() + np.abs(D).max()
        np.testing.assert_allclose(force[0], y.item(), rtol=1e-13, atol=1e-13 * scale)
        np.testing.assert_allclose(d_force[0], D[0], rtol=1e-12, atol=1e-13 * scale)
        for i in range(model.n_x):
            unit = np.zeros((model.n_x, model.n_p))
            unit[i] = 1.0
            np.testing.assert_allclose(
                compiled.run(w, x, theta, unit)[3][0] - D[0], C[0, i], rtol=1e-12, atol=1e-12 * scale
            )


def test_force_derivatives_follow_the_state_along_a_motion(kernel: Any) -> None:
    compiled: Kernel = kernel(**CASES["flow"])
    w = signal_array(moving(swings(5, 400, 0.01)), 1e-4)
    theta, h = np.ones(compiled.model.n_p), 1e-4
    _, _, _, d_force = compiled.run(w, np.zeros(4), theta)
    for j in range(compiled.model.n_p):
        e = h * np.eye(compiled.model.n_p)[j]
        forces = [compiled.run(w, np.zeros(4), theta + k * e)[2] for k in (-2, -1, 1, 2)]
        by_theta = (forces[0] - 8.0 * forces[1] + 8.0 * forces[2] - forces[3]) / (12.0 * h)
        np.testing.assert_allclose(d_force[:, j], by_theta, rtol=0.0, atol=1e-6 * np.abs(d_force).max())


# --- order -------------------------------------------------------------------------------------------------------


def test_order_by_step_halving(kernel: Any) -> None:
    """Slow motion, so that no substep is added by the displacement rule: only `substeps` counts."""
    rng = np.random.default_rng(6)
    v = 2e-4 + 8e-5 * np.sin(np.arange(61) / 7.0)
    w = signal_array(moving(v), 1e-4)
    theta = np.ones(4)
    start = rng.uniform(0.5, 0.7, 4)
    levels = (1, 2, 4)

    def end(times: int) -> Array:
        compiled: Kernel = kernel(sampling=scheme("rk4", substeps=100 * times, displacement=10.0))
        # The fastest element passes its window; the others stay elastic and integrate exactly.
        return compiled.run(w, start, theta)[0][:1]

    exact = end(32)
    errors = np.array([np.abs(end(k) - exact).max() for k in levels])
    assert errors[-1] > 1e-12, "nothing left to measure"
    found = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(found, 4.0, atol=0.35, err_msg=f"errors {errors}")


# --- displacement flow -------------------------------------------------------------------------------------------


@lru_cache(maxsize=4)
def exact_flow(zeta: float, lambda_: float) -> Mapping[float, tuple[Array, Array]]:
    """r1 and dr1/dr0 at XI for every start of R0, by DOP853 on the equation and its variation."""

    def rhs(_: float, y: Array) -> list[float]:
        r, slope = y
        up, down = math.tanh(lambda_ * (r + zeta)), math.tanh(lambda_ * (r - zeta))
        eta = 1.0 - 0.5 * up + 0.5 * down
        d_eta = 0.5 * lambda_ * (up * up - down * down)
        return [1.0 - eta * max(r, 0.0), -(eta + r * d_eta) * slope if r > 0.0 else 0.0]

    found = {}
    for r0 in R0:
        solution = solve_ivp(rhs, [0.0, XI[-1]], [r0, 1.0], method="DOP853", t_eval=XI, rtol=2.3e-14, atol=1e-15)
        found[float(r0)] = (solution.y[0], solution.y[1])
    return found


R0 = np.concatenate([np.linspace(-3.0, 1.5, 19), [0.5, 0.5711, 0.9, 0.999, 1.0, 1.05, 1.2289, 1.23]])
XI = np.concatenate([[0.0, 1e-9, 1e-4], np.geomspace(1e-3, 50.0, 40)])


@lru_cache(maxsize=4)
def flow_probe(precision: str, zeta: float, lambda_: float, folder: Path) -> ctypes.CDLL:
    settings = machine(
        code={"precision": precision},
        friction={"smoothing": {"zeta": zeta, "lambda": lambda_}},
        sampling=scheme("flow"),
    )
    package = written(emit_package(settings, selftest=False), folder)
    library = compile_probe("flow_probe.c", package, definitions=[f'-DSGMS_FLOW_HEADER="{settings.name}_flow.h"'])
    library.probe_gate.restype = ctypes.c_double
    return library


def flow_step(library: ctypes.CDLL, r0: Array, xi: Array) -> NDArray[np.float64]:
    """(r1, dr1/dr0, dr1/dxi) rows of the C."""
    r0, xi = np.ascontiguousarray(r0, dtype=float), np.ascontiguousarray(xi, dtype=float)
    out = np.empty((3, len(r0)))
    library.probe_flow(ctypes.c_long(len(r0)), pointer(r0), pointer(xi), *(pointer(row) for row in out))
    return out


SMOOTHINGS = [(0.9, 35.0), (0.8, 200.0), (0.95, 20.0)]  # of the second all slip sets in below the fixed point


@pytest.fixture(scope="module")
def flow_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("flow")


@pytest.mark.parametrize(("zeta", "lambda_"), SMOOTHINGS)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_flow_is_the_solution_of_its_equation(precision: str, zeta: float, lambda_: float, flow_folder: Path) -> None:
    library = flow_probe(precision, zeta, lambda_, flow_folder)
    # As far as DOP853 goes; see the next test for the digits behind. The derivative of a polynomial is less exact than
    # its value, most where the polynomial is shortest, about r*.
    atol, slope_atol = {"double": (1e-12, 5e-10), "single": (2e-6, 5e-5)}[precision]
    for r0, (r1, ratio) in exact_flow(zeta, lambda_).items():
        got = flow_step(library, np.full(len(XI), r0), XI)
        np.testing.assert_allclose(got[0], r1, rtol=0.0, atol=atol, err_msg=f"r1 from {r0}")
        np.testing.assert_allclose(got[1], ratio, rtol=0.0, atol=slope_atol, err_msg=f"dr1/dr0 from {r0}")
        eta = 1.0 - 0.5 * np.tanh(lambda_ * (r1 + zeta)) + 0.5 * np.tanh(lambda_ * (r1 - zeta))
        slope = 1.0 - eta * np.maximum(r1, 0.0)
        np.testing.assert_allclose(got[2], slope, rtol=0.0, atol=2.0 * slope_atol, err_msg=f"dr1/dxi from {r0}")


@pytest.mark.parametrize(("zeta", "lambda_"), SMOOTHINGS)
def test_flow_agrees_with_the_reference_to_rounding(zeta: float, lambda_: float, flow_folder: Path) -> None:
    library = flow_probe("double", zeta, lambda_, flow_folder)
    smoothing = machine(friction={"smoothing": {"zeta": zeta, "lambda": lambda_}}).friction.smoothing
    flow = Flow.of(smoothing)
    atol = 1e-10 if (zeta, lambda_) == SMOOTHINGS[0] else 5e-10
    for r0 in R0:
        got = flow_step(library, np.full(len(XI), r0), XI)
        r1, ratio, slope = np.array([flow.advance(float(r0), float(xi)) for xi in XI]).T
        np.testing.assert_allclose(got[0], r1, rtol=0.0, atol=2e-13, err_msg=f"r1 from {r0}")
        np.testing.assert_allclose(got[1], ratio, rtol=0.0, atol=atol, err_msg=f"dr1/dr0 from {r0}")
        np.testing.assert_allclose(got[2], slope, rtol=0.0, atol=atol, err_msg=f"dr1/dxi from {r0}")


@pytest.mark.parametrize("precision", PRECISIONS)
def test_flow_is_a_flow(precision: str, flow_folder: Path) -> None:
    """Parts compose, it is monotone in start and length, it never leaves for infinity, and it settles at r*."""
    library = flow_probe(precision, 0.9, 35.0, flow_folder)
    rng = np.random.default_rng(0)
    n = 20000
    tolerance, slope_tolerance = {"double": (1e-12, 2e-10), "single": (1e-5, 1e-4)}[precision]
    r0, xi = rng.uniform(-3.0, 3.0, n), 10.0 ** rng.uniform(-6.0, 1.7, n)
    whole = flow_step(library, r0, xi)
    part = rng.uniform(size=n)
    first = flow_step(library, r0, part * xi)
    second = flow_step(library, first[0], (1.0 - part) * xi)
    np.testing.assert_allclose(second[0], whole[0], rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(first[1] * second[1], whole[1], rtol=0.0, atol=slope_tolerance)
    assert np.all(whole[1] >= -1e-12) and np.all(whole[1] <= 1.0 + slope_tolerance)
    order = np.sort(r0)
    assert np.all(np.diff(flow_step(library, order, np.full(n, 0.3))[0]) >= -tolerance)
    for start in (-3.0, 0.0, 0.9, 1.0, 1.3, 5.0, 1e3):
        end = flow_step(library, np.full(3, start), np.array([60.0, 1e4, 1e9]))
        assert np.ptp(end[0]) <= tolerance and abs(end[0, 0] - 1.0) < 0.01
        np.testing.assert_allclose(end[1:], 0.0, atol=1e-6 if precision == "single" else 1e-12)


def test_gate_is_where_design_puts_it(flow_folder: Path) -> None:
    gate = float(flow_probe("double", 0.9, 35.0, flow_folder).probe_gate())
    assert gate == pytest.approx(0.36e-3, rel=1e-12)


# --- Table I -----------------------------------------------------------------------------------------------------


def trapezoid(peak: float, samples: Iterable[int] = (150, 150, 150, 50)) -> Array:
    """Velocity [m/s] of a move there and back: ramp, cruise, ramp, standstill."""
    up, cruise, down, wait = samples
    there = np.concatenate(
        [np.linspace(0.0, peak, up), np.full(cruise, peak), np.linspace(peak, 0.0, down), np.zeros(wait)]
    )
    return np.concatenate([[0.0], there, -there])


@pytest.mark.parametrize("peak", [0.002, 0.02, 0.1, 0.3, 1.0])
def test_force_is_converged_at_every_speed(peak: float, kernel: Any) -> None:
    w = signal_array(moving(trapezoid(peak)), 1e-4)

    def force(**integrator: Any) -> Array:
        compiled: Kernel = kernel(sampling={"integrator": integrator})
        return compiled.run(w, np.zeros(4), np.ones(4))[2]

    converged = force(scheme="rk4", substeps=400, displacement=0.01)
    assert np.ptp(converged) > {0.002: 1.9, 0.02: 6.4}.get(peak, 8.0)
    for name, allowed in (("flow", 1e-6), ("rk4", 1e-4)):
        error = np.abs(force(scheme=name) - converged).max()
        assert error < allowed, f"{name} at {peak} m/s is off by {error:.1e} N"


def test_single_precision_kernel_follows_double(kernel: Any) -> None:
    double: Kernel = kernel(sampling=scheme("flow"))
    for name in ("flow", "rk4"):
        single: Kernel = kernel(sampling=scheme(name), code={"precision": "single"})
        for peak in (0.002, 0.3):
            w = signal_array(moving(trapezoid(peak)), 1e-4)
            forces = [k.run(w, np.zeros(4), np.ones(4))[2] for k in (single, double)]
            assert np.abs(forces[0] - forces[1]).max() < 1e-4 * np.ptp(forces[1])


def test_force_at_the_last_of_some_samples() -> None:
    code = CompiledModel(load_machine("etel_xy_switching"))
    n_x, n_p = code.model.n_x, code.model.n_p
    w = np.zeros((41, 5))
    w[:, 1] = 0.01 * np.sin(np.arange(41.0))

    def run(rows: int) -> tuple[Array, Array]:
        force, slopes = np.empty(rows), np.empty((rows, n_p))
        code.advance(w, np.ones(n_p), np.zeros(n_x), np.zeros((n_x, n_p)), force, slopes)
        return force, slopes

    for every, all_of_them in zip(run(10), run(41), strict=True):
        np.testing.assert_array_equal(every, all_of_them[3::4])
