"""The hand-written C alone: elementary functions, small least squares, signal chain, in both precisions."""

import ctypes
import dataclasses
import itertools
import platform
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from c_packages import PRECISIONS, PROBES, REAL, STRICT, machine, pointer, run, runtime_probe
from sgms_mhe.machine import Machine
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.chain import Signals, bridge_fading, lowpass_coefficients, settle_samples, signals_from_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.paths import runtime_dir

pytestmark = pytest.mark.core

Array = NDArray[Any]

# --- elementary functions ----------------------------------------------------------------------------------------

# Bounds and ranges of the table at the head of sgms_math.h. A longdouble holds 11 bits more than a double.
LIMITS: dict[str, dict[str, tuple[float, float]]] = {
    "exp": {"double": (-700.0, 709.0), "single": (-86.0, 88.0)},
    "exp2_core": {"double": (-1000.0, 1000.0), "single": (-120.0, 120.0)},
    "tanh": {"double": (-1e16, 1e16), "single": (-1e8, 1e8)},
    "sin": {"double": (-1e6, 1e6), "single": (-1e3, 1e3)},
    "cos": {"double": (-1e6, 1e6), "single": (-1e3, 1e3)},
    "log": {"double": (2.3e-308, 1.7e308), "single": (1.2e-38, 3.4e38)},
    "sqrt": {"double": (2.3e-308, 1.7e308), "single": (1.2e-38, 3.4e38)},
    "inverse_sqrt": {"double": (2.3e-308, 1.7e308), "single": (1.2e-38, 3.4e38)},
}
BOUND: dict[str, dict[str, float]] = {
    "exp": {"double": 5e-16, "single": 2e-7},
    "exp2_core": {"double": 8e-13, "single": 3e-7},
    "tanh": {"double": 3e-15, "single": 8e-7},
    "sin": {"double": 2e-15, "single": 3e-7},
    "cos": {"double": 2e-15, "single": 3e-7},
    "log": {"double": 4e-16, "single": 3e-7},
    "sqrt": {"double": 3e-16, "single": 2e-7},
    "inverse_sqrt": {"double": 6e-16, "single": 3e-7},
}
# What the bound is relative to, by the exact value.
SCALE: dict[str, Callable[[Array], Array]] = {
    "exp": np.abs,
    "exp2_core": np.abs,
    "tanh": np.ones_like,
    "sin": np.ones_like,
    "cos": np.ones_like,
    "log": lambda y: 1.0 + np.abs(y),
    "sqrt": np.abs,
    "inverse_sqrt": np.abs,
}
POINTS = 200_000


def exact_value(library: Any, function: str, x: Any) -> Any:
    """The function in numpy or mpmath, which have no inverse root; mpmath has no power of two either."""
    if function == "inverse_sqrt":
        return 1 / library.sqrt(x)
    if function == "exp2_core":
        return 2**x
    return getattr(library, function)(x)


def evaluate(function: str, precision: str, x: Array, *, vectors: bool = True) -> tuple[Array, Array]:
    """Arguments as the precision holds them, and the C's values there."""
    x = np.ascontiguousarray(x, dtype=REAL[precision])
    y = np.empty_like(x)
    getattr(runtime_probe(precision, vectors), f"probe_{function}")(ctypes.c_long(len(x)), pointer(x), pointer(y))
    return x, y


def arguments(function: str, precision: str) -> Array:
    """Random, dense and edge arguments over the stated range."""
    rng = np.random.default_rng(7)
    low, high = LIMITS[function][precision]
    eps = float(np.finfo(REAL[precision]).eps)
    if function in ("log", "sqrt", "inverse_sqrt"):
        spread = np.exp(rng.uniform(np.log(low), np.log(high), POINTS))
        near_one = 1.0 + eps * np.arange(-50.0, 51.0)
        return np.concatenate(
            [spread, np.linspace(0.25, 4.0, POINTS), near_one, 2.0 ** np.arange(-100.0, 101.0), [low, high]]
        )
    spans = [min(high, s) for s in (1e-3, 1.0, 20.0, 1e3, 1e5)]
    parts = [rng.uniform(max(low, -s), s, POINTS) for s in spans]
    multiples = np.arange(-600.0, 601.0) * (np.pi / 4.0 if function in ("sin", "cos") else 0.5 * np.log(2.0))
    multiples = multiples[(multiples >= low) & (multiples <= high)]
    tiny = np.array([0.0, -0.0, 1e-30, -1e-30, eps, -eps])
    reach = np.geomspace(1.0, high, 400)
    parts += [np.linspace(max(low, -30.0), min(high, 30.0), POINTS), multiples, tiny, reach, np.array([low, high])]
    if low < 0.0:
        parts.append(-np.geomspace(1.0, -low, 400))
    return np.concatenate(parts)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("function", list(BOUND))
def test_function_keeps_its_stated_bound(function: str, precision: str) -> None:
    x, y = evaluate(function, precision, arguments(function, precision))
    exact = exact_value(np, function, x.astype(np.longdouble))
    error = np.abs(y - exact) / SCALE[function](exact)
    worst = int(np.argmax(error))
    assert error[worst] <= BOUND[function][precision], f"{function}({x[worst]!r}) is off by {error[worst]:.2e}"


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("function", list(BOUND))
def test_function_agrees_with_many_digits(function: str, precision: str) -> None:
    x, y = evaluate(function, precision, np.random.default_rng(3).permutation(arguments(function, precision))[:2000])
    with mpmath.workdps(40):
        exact = [exact_value(mpmath, function, mpmath.mpf(float(v))) for v in x]
        error = np.array([float(abs(mpmath.mpf(float(v)) - e)) for v, e in zip(y, exact, strict=True)])
    scale = SCALE[function](np.array([float(e) for e in exact]))
    assert np.max(error / scale) <= BOUND[function][precision]


@pytest.mark.parametrize("vectors", [False, True])
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("function", ["exp", "sin", "cos"])
def test_form_for_lanes_is_the_plain_one_to_the_bit(function: str, precision: str, vectors: bool) -> None:
    low, high = LIMITS[function][precision]
    beyond = [low, high, np.nextafter(low, -np.inf), np.nextafter(high, np.inf), -np.inf, np.inf, np.nan, -np.nan]
    x = np.concatenate((arguments(function, precision), beyond))
    plain, of_lanes = (evaluate(f"{form}{function}", precision, x, vectors=vectors)[1] for form in ("", "lane_"))
    np.testing.assert_array_equal(of_lanes, plain)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="these are registers of x86-64")
@pytest.mark.parametrize("precision", PRECISIONS)
def test_loops_over_functions_vectorise(precision: str) -> None:
    """A branch in one kept every loop over lanes with a Stribeck velocity, or a force of place, from it."""
    source = PROBES / "runtime_probe.c"
    flags = ["-std=c99", "-O3", "-mavx2", "-ffp-contract=off", "-DSGMS_VECTORS=1"]
    flags += [f"-DSGMS_SINGLE={int(precision == 'single')}", f"-I{runtime_dir()}", "-fopt-info-vec=/dev/stdout"]
    told = run("gcc", flags, "-c", source, "-o", "/dev/null")
    lines = source.read_text().splitlines()
    for function in ("lane_exp", "exp2_core", "tanh", "lane_sin", "lane_cos"):
        line = lines.index(f"OVER_ARRAYS({function})") + 1
        assert re.search(rf"runtime_probe\.c:{line}:\d+: optimized: loop vectorized", told), function


@pytest.mark.parametrize("precision", PRECISIONS)
def test_functions_beyond_their_range(precision: str) -> None:
    inf, nan = np.inf, np.nan
    low, high = LIMITS["exp"][precision]
    top = float(evaluate("exp", precision, np.array([high]))[1][0])
    for x, expected in (
        (np.nextafter(REAL[precision](low), REAL[precision](-inf)), 0.0),
        (-inf, 0.0),
        (inf, top),
        (high + 10.0, top),
        (nan, nan),
    ):
        np.testing.assert_equal(float(evaluate("exp", precision, np.array([x]))[1][0]), expected)
    np.testing.assert_equal(evaluate("sqrt", precision, np.array([0.0, -0.0, -1.0, nan]))[1], np.zeros(4))
    assert np.isnan(evaluate("tanh", precision, np.array([inf, nan]))[1]).all()
    huge = float(np.finfo(REAL[precision]).max)
    finite = np.array([0.0, -0.0, 1.0, -huge, huge, inf, -inf, nan])
    np.testing.assert_array_equal(evaluate("is_finite", precision, finite)[1], [1, 1, 1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(evaluate("fabs", precision, finite)[1], np.abs(finite.astype(REAL[precision])))
    np.testing.assert_array_equal(evaluate("sign", precision, finite[:7])[1], np.sign(finite[:7]))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_functions_are_odd_even_and_monotone(precision: str) -> None:
    x = np.linspace(0.0, 15.0, 20001)
    for function, sign in (("tanh", -1.0), ("sin", -1.0), ("cos", 1.0)):
        np.testing.assert_allclose(
            evaluate(function, precision, -x)[1],
            sign * evaluate(function, precision, x)[1],
            rtol=0.0,
            atol=2.0 * BOUND[function][precision],
        )
    assert float(evaluate("tanh", precision, np.zeros(1))[1][0]) == 0.0
    assert np.abs(evaluate("tanh", precision, np.linspace(-100.0, 100.0, 20001))[1]).max() <= 1.0


# --- tables ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", PRECISIONS)
def test_floor_is_exact_for_every_number(precision: str) -> None:
    random = np.random.default_rng(2)
    numbers = random.choice([-1.0, 1.0], POINTS) * 10.0 ** random.uniform(-30.0, 30.0, POINTS)
    whole = np.concatenate([np.arange(-40.0, 40.0), 2.0 ** np.arange(60)])
    near = np.concatenate([whole, -whole, whole + 0.5, np.nextafter(whole, 1e9), np.nextafter(whole, -1e9), [-0.0]])
    x, y = evaluate("floor", precision, np.concatenate([numbers, near]))
    np.testing.assert_array_equal(y, np.floor(x))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_look_ups_stay_within_their_table(precision: str) -> None:
    table = np.array([3.0, 5.0, 7.0], dtype=REAL[precision])
    places = np.array([0, 1, 2, -1, 3, 1e30, -1e30, np.inf, -np.inf, np.nan], dtype=REAL[precision])
    found = np.empty_like(places)
    call = (pointer(table), ctypes.c_int(2), ctypes.c_long(len(places)), pointer(places), pointer(found))
    runtime_probe(precision).probe_entry(*call)
    np.testing.assert_array_equal(found, [3, 5, 7, 3, 7, 7, 3, 7, 3, 3])


# --- triangular factors ------------------------------------------------------------------------------------------

EPS = {"double": 2e-15, "single": 1e-6}


def c_array(values: Array, precision: str) -> Array:
    return np.array(values, dtype=REAL[precision], order="C")


@pytest.mark.parametrize("precision", PRECISIONS)
def test_qr_keeps_the_normal_matrix_and_the_columns_beyond(precision: str) -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        rows, columns = int(rng.integers(1, 14)), int(rng.integers(1, 10))
        width = columns + int(rng.integers(0, 4))
        stride = width + int(rng.integers(0, 3))
        scale = 10.0 ** rng.uniform(-3.0, 3.0, width)
        a = c_array(
            np.pad(rng.standard_normal((rows, width)) * scale, ((0, 0), (0, stride - width)), constant_values=9),
            precision,
        )
        before = a.astype(float)
        runtime_probe(precision).probe_qr(pointer(a), rows, stride, width, columns)
        after = a.astype(float)
        np.testing.assert_array_equal(after[:, width:], before[:, width:])
        below = np.tril(np.ones((rows, columns)), -1).astype(bool)
        assert not np.any(after[:, :columns][below])
        got, expected = (m[:, :width] / scale for m in (after, before))
        # Orthogonal: every product of columns stays.
        np.testing.assert_allclose(got.T @ got, expected.T @ expected, atol=50.0 * EPS[precision] * rows)


def test_qr_of_numbers_whose_squares_lose_digits() -> None:
    # Squares of 1e-22 are subnormal in single precision: a reflection by them would not keep lengths.
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((9, 9)).astype(np.float32)
    rows[:, 0] *= 1e-22
    expected = rows[:, 1:].astype(float)
    got = c_array(rows, "single")
    runtime_probe("single").probe_qr(pointer(got), 9, 9, 9, 8)
    found = got[:, 1:].astype(float)
    np.testing.assert_allclose(found.T @ found, expected.T @ expected, atol=500.0 * EPS["single"])


@pytest.mark.parametrize("precision", PRECISIONS)
def test_qr_of_ranks_that_are_short(precision: str) -> None:
    probe = runtime_probe(precision)
    a = c_array(np.zeros((4, 3)), precision)
    probe.probe_qr(pointer(a), 4, 3, 3, 3)
    assert not a.any()
    column = c_array(np.outer([1.0, 2.0, -2.0], [1.0, 1.0, 1.0]), precision)
    probe.probe_qr(pointer(column), 3, 3, 3, 3)
    np.testing.assert_allclose(np.abs(column[0]), 3.0, rtol=EPS[precision])
    np.testing.assert_allclose(column[1:], 0.0, atol=5.0 * EPS[precision])


@pytest.mark.parametrize("precision", PRECISIONS)
def test_folded_rows_are_the_stacked_least_squares(precision: str) -> None:
    rng = np.random.default_rng(9)
    probe = runtime_probe(precision)
    for _ in range(60):
        n, count = int(rng.integers(1, 9)), int(rng.integers(1, 25))
        prior = np.triu(rng.standard_normal((n, n + 1)))
        prior[range(n), range(n)] = rng.uniform(0.5, 2.0, n)
        rows = rng.standard_normal((count, n + 1)) * (rng.uniform(size=(count, n + 1)) < 0.7)
        r = c_array(prior, precision)
        for row in rows:
            used = c_array(row, precision)
            probe.probe_qr_add_row(pointer(r), n, pointer(used))
        assert not np.any(np.tril(r[:, :n], -1))
        x, variance = np.empty(n, REAL[precision]), np.empty(n, REAL[precision])
        b = np.ascontiguousarray(r[:, n])
        probe.probe_back_substitute(pointer(r), n, n + 1, pointer(b), pointer(x))
        probe.probe_variances(pointer(r), n, n + 1, pointer(variance))
        stacked = np.vstack([prior, rows])
        expected = np.linalg.lstsq(stacked[:, :n], stacked[:, n])[0]
        covariance = np.linalg.inv(stacked[:, :n].T @ stacked[:, :n])
        condition = np.linalg.cond(stacked[:, :n])
        size = 1.0 + np.abs(expected).max() + np.abs(stacked[:, n]).max()
        np.testing.assert_allclose(x, expected, rtol=0.0, atol=20.0 * EPS[precision] * condition * size)
        np.testing.assert_allclose(variance, np.diag(covariance), rtol=100.0 * EPS[precision] * condition)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", ["zeros", "scales"])
def test_qr_is_that_of_numpy(kind: str, precision: str) -> None:
    """Signs aside; with zero rows, columns and entries, and with columns from tiny to huge."""
    rng = np.random.default_rng(7)
    for _ in range(200):
        rows, columns = int(rng.integers(2, 12)), int(rng.integers(1, 8))
        columns = min(rows, columns)
        width = columns + 1
        a = rng.standard_normal((rows, width))
        if kind == "zeros":
            # Square from the top: what is left out keeps the rank, or R would not be unique.
            a[columns:][rng.uniform(size=rows - columns) < 0.5] = 0.0
            a[columns:, :columns][:, rng.uniform(size=columns) < 0.3] = 0.0
            a[:columns, :columns] = np.triu(a[:columns, :columns]) + 2.0 * np.eye(columns)
        scale = 10.0 ** rng.uniform(-12.0, 12.0, width) if kind == "scales" else np.ones(width)
        got = c_array(a * scale, precision)
        expected = np.abs(np.linalg.qr(got.astype(float) / scale, mode="r"))[:columns]
        condition = float(np.linalg.cond(a[:, :columns]))
        runtime_probe(precision).probe_qr(pointer(got), rows, width, width, columns)
        error = np.abs(np.abs(got[:columns].astype(float) / scale) - expected)
        assert error.max() < 30.0 * EPS[precision] * condition * (1.0 + np.abs(a).max())


@pytest.mark.parametrize("precision", PRECISIONS)
def test_growth_adds_to_the_covariance(precision: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(100):
        n = int(rng.integers(1, 10))
        count = int(rng.integers(1, n + 1))
        r = np.triu(rng.standard_normal((n, n + 1)))
        r[range(n), range(n)] = rng.uniform(0.5, 2.0, n) * rng.choice([-1.0, 1.0], n)
        growth = rng.uniform(0.0, 2.0, count) * (rng.uniform(size=count) < 0.7)
        got = c_array(r, precision)
        runtime_probe(precision).probe_qr_grow(pointer(got), n, count, pointer(c_array(growth, precision)))
        assert not np.any(np.tril(got[:, :n], -1))
        covariance = np.linalg.inv(r[:, :n].T @ r[:, :n])
        covariance[range(n - count, n), range(n - count, n)] += growth**2
        found = np.linalg.inv(got[:, :n].astype(float).T @ got[:, :n].astype(float))
        condition = float(np.linalg.cond(r[:, :n])) ** 2
        np.testing.assert_allclose(
            found, covariance, rtol=0.0, atol=20.0 * EPS[precision] * condition * (1.0 + np.abs(covariance).max())
        )
        # The mean stays where it was.
        means = [np.linalg.solve(f[:, :n], f[:, n]) for f in (r, got.astype(float))]
        np.testing.assert_allclose(
            means[1], means[0], rtol=0.0, atol=20.0 * EPS[precision] * condition * (1.0 + np.abs(means[0]).max())
        )


def test_single_precision_survives_what_a_normal_matrix_does_not() -> None:
    # Two nearly equal columns: the squares of J'J would lose the difference in single precision.
    d = 1e-4
    rows = np.array([[1.0, 1.0, 2.0], [0.0, d, d], [d, 0.0, d]])
    r = c_array(rows, "single")
    runtime_probe("single").probe_qr(pointer(r), 3, 3, 3, 2)
    x, b = np.empty(2, np.float32), np.ascontiguousarray(r[:2, 2])
    runtime_probe("single").probe_back_substitute(pointer(r), 2, 3, pointer(b), pointer(x))
    np.testing.assert_allclose(x, 1.0, atol=5e-3)
    # Its square in single precision has lost d altogether.
    normal = rows[:, :2].astype(np.float32).T @ rows[:, :2].astype(np.float32)
    assert abs(np.linalg.det(normal.astype(float)) / (2.0 * d**2) - 1.0) > 0.5


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", ["sin", "cos"])
def test_a_sine_stays_within_one_whatever_its_argument(name: str, precision: str) -> None:
    """Also where the argument is so large that it has no digits left for a phase."""
    largest = float(np.finfo(REAL[precision]).max)
    points = np.geomspace(1.0, 0.99 * largest, 20_000)
    x = c_array(np.concatenate([points, -points]), precision)
    y = np.empty_like(x)
    getattr(runtime_probe(precision), f"probe_{name}")(ctypes.c_long(len(x)), pointer(x), pointer(y))
    assert np.abs(y).max() <= 1.0 + 4.0 * EPS[precision]


# --- least squares within bounds ---------------------------------------------------------------------------------


@dataclasses.dataclass
class Boxes:
    """Many problems min |r x - b|, lower <= x <= upper: r (k, n, n) upper triangular, the rest (k, n)."""

    r: Array
    b: Array
    lower: Array
    upper: Array

    def cost(self, x: Array) -> Any:
        """|r x - b|^2 (k)."""
        return np.sum((np.einsum("kij,kj->ki", self.r, x) - self.b) ** 2, axis=1)

    def size(self, x: Array) -> Any:
        """Sum of the squares of all terms that make |r x - b|: rounding is relative to it (k)."""
        return np.sum(self.b**2 + np.einsum("kij,kj->ki", self.r**2, x**2), axis=1)

    def solve(self, precision: str = "double") -> tuple[Array, Array, Array]:
        """x, pinned (k, n) and number of active bounds (k) from the C."""
        count, n = self.b.shape
        held = [c_array(a, precision) for a in (self.r, self.b, self.lower, self.upper)]
        x, pinned = np.empty((count, n), REAL[precision]), np.empty((count, n), np.int32)
        active = np.empty(count, np.int32)
        runtime_probe(precision).probe_box(
            ctypes.c_long(count), n, *(pointer(a) for a in held), pointer(x), pointer(pinned), pointer(active)
        )
        return x.astype(float), pinned, active

    def start(self) -> Array:
        """The unbounded solution, moved into the box."""
        return np.clip(np.linalg.solve(self.r, self.b[..., None])[..., 0], self.lower, self.upper)


def boxes(n: int, count: int, kind: str, seed: int = 0) -> Boxes:
    """Random problems: `plain`, `degenerate` (ties, optima on bounds, empty and open intervals), `stiff` (scales)."""
    rng = np.random.default_rng([n, count, seed])
    r = np.triu(rng.standard_normal((count, n, n)))
    r[:, range(n), range(n)] = rng.uniform(0.3, 2.0, (count, n)) * rng.choice([-1.0, 1.0], (count, n))
    middle = rng.standard_normal((count, n))
    half: Array = rng.uniform(0.0, 1.0, (count, n))
    b = rng.standard_normal((count, n)) * 2.0
    lower, upper = middle - half, middle + half
    if kind == "stiff":
        r *= 10.0 ** rng.uniform(-3.0, 3.0, (count, 1, n))
        b *= 10.0 ** rng.uniform(-1.0, 1.0, (count, 1))
    if kind == "degenerate":
        # Coarse numbers make ties: equal gradients, optima on bounds, intervals of no width.
        r, b, lower, upper = (np.round(2.0 * a) / 2.0 for a in (r, b, lower, upper))
        r[:, range(n), range(n)] = np.where(r[:, range(n), range(n)] == 0.0, 1.0, r[:, range(n), range(n)])
        lower = np.where(rng.uniform(size=lower.shape) < 0.25, -np.inf, lower)
        upper = np.where(rng.uniform(size=upper.shape) < 0.25, np.inf, upper)
    return Boxes(r, b, lower, upper)


def best_of_all_active_sets(problem: Boxes) -> tuple[Array, Array]:
    """Optimal x (k, n) and cost (k) by trying every combination of free and pinned variables."""
    count, n = problem.b.shape
    best, best_cost = np.full((count, n), np.nan), np.full(count, np.inf)
    for choice in itertools.product((0, 1, 2), repeat=n):
        pins = np.array(choice)
        free = pins == 0
        x = np.where(pins == 1, problem.lower, np.where(pins == 2, problem.upper, 0.0))
        possible: Array = np.asarray(np.isfinite(x).all(axis=1))
        x = np.where(possible[:, None], x, 0.0)
        if free.any():
            right = problem.b - np.einsum("kij,kj->ki", problem.r, x)
            q, t = np.linalg.qr(problem.r[:, :, free])
            x[:, free] = np.linalg.solve(t, np.einsum("kij,ki->kj", q, right)[..., None])[..., 0]
        tolerance = 1e-12 * (1.0 + np.abs(x))
        possible &= ((x >= problem.lower - tolerance) & (x <= problem.upper + tolerance)).all(axis=1)
        x = np.clip(x, problem.lower, problem.upper)
        cost = np.where(possible, problem.cost(x), np.inf)
        better = cost < best_cost
        best[better], best_cost[better] = x[better], cost[better]
    return best, best_cost


@pytest.mark.parametrize("kind", ["plain", "degenerate", "stiff"])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_box_solution_is_the_best_of_all_active_sets(n: int, kind: str) -> None:
    problem = boxes(n, 1500 if n < 4 else 500, kind)
    x, pinned, active = problem.solve()
    best, best_cost = best_of_all_active_sets(problem)
    assert np.all((x >= problem.lower) & (x <= problem.upper))
    assert np.all(problem.cost(x) <= best_cost + 1e-12 * problem.size(x))
    # As near as the condition lets a cost within rounding of the best be.
    condition = np.linalg.cond(problem.r)
    np.testing.assert_array_less(
        np.abs(x - best).max(axis=1), 1e-13 * condition**2 * (1.0 + np.abs(best).max(axis=1)) + 1e-12
    )
    np.testing.assert_array_equal(np.count_nonzero(pinned, axis=1), active)
    np.testing.assert_array_equal(x[pinned < 0], problem.lower[pinned < 0])
    np.testing.assert_array_equal(x[pinned > 0], problem.upper[pinned > 0])
    assert active.max() == n and active.min() < n


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", ["plain", "degenerate", "stiff"])
@pytest.mark.parametrize("n", [2, 4, 7, 12])
def test_box_solution_is_feasible_and_no_worse_than_its_start(n: int, kind: str, precision: str) -> None:
    problem = boxes(n, 3000, kind, seed=1)
    single = Boxes(*(a.astype(REAL[precision]).astype(float) for a in dataclasses.astuple(problem)))
    x, _, _ = single.solve(precision)
    assert np.all((x >= single.lower) & (x <= single.upper))
    start = single.start()
    size = single.size(x) + single.size(start)
    assert np.all(single.cost(x) <= single.cost(start) + 20.0 * n * EPS[precision] * size)


@pytest.mark.parametrize("kind", ["plain", "degenerate"])
@pytest.mark.parametrize("n", [7, 12])
def test_box_solution_satisfies_the_conditions_of_an_optimum(n: int, kind: str) -> None:
    problem = boxes(n, 3000, kind, seed=2)
    x, _, _ = problem.solve()
    gradient = np.einsum("kij,ki->kj", problem.r, np.einsum("kij,kj->ki", problem.r, x) - problem.b)
    tolerance = 1e-10 * (
        1.0 + np.abs(problem.b).max(axis=1, keepdims=True) * np.abs(problem.r).max(axis=(1, 2))[:, None]
    )
    assert np.all(gradient[x > problem.lower] <= np.broadcast_to(tolerance, x.shape)[x > problem.lower])
    assert np.all(gradient[x < problem.upper] >= -np.broadcast_to(tolerance, x.shape)[x < problem.upper])


def test_box_without_bounds_is_back_substitution() -> None:
    problem = boxes(6, 200, "plain", seed=3)
    problem.lower[:], problem.upper[:] = -np.inf, np.inf
    x, pinned, active = problem.solve()
    np.testing.assert_allclose(x, problem.start(), rtol=1e-10)
    assert not pinned.any() and not active.any()


# --- signal chain ------------------------------------------------------------------------------------------------


WANTED = {"velocity": 0, "friction": 0, "position": 1, "force": 2, "acceleration": 4}
"""What the C is asked for, by signal."""


def chain(log: Log, axis: Machine, precision: str, wanted: int = sum(WANTED.values())) -> Signals:
    """Blocks V and Y in C."""
    n = len(log.time_s)
    coefficients = np.array(lowpass_coefficients(axis))
    position: Array = log.position_m.copy()
    if precision == "single":
        good = np.abs(log.position_m) < 4e6
        position = np.full(n, np.iinfo(np.int64).max)
        position[good] = np.round(log.position_m[good] * 1e12).astype(np.int64)
    with np.errstate(over="ignore"):  # 1e300 is infinite in single precision
        force = c_array(log.force_N, precision)
    out, valid = np.empty((5, n), REAL[precision]), np.empty(n, REAL[precision])
    runtime_probe(precision).probe_chain(
        ctypes.c_long(n),
        pointer(coefficients),
        ctypes.c_double(axis.sampling.rate),
        ctypes.c_double(axis.plant.moved),
        ctypes.c_double(axis.sampling.position_step),
        settle_samples(axis),
        ctypes.c_double(bridge_fading(settle_samples(axis))),
        wanted,
        pointer(position),
        pointer(force),
        pointer(out),
        pointer(valid),
    )
    position_m, velocity, acceleration, force_N, friction = out.astype(float)
    good = valid > 0.0
    noise = 1.0 / np.where(good, valid, 1.0)
    none = np.zeros(n, bool)
    return Signals(log.time_s, position_m, velocity, acceleration, force_N, friction, good, none, noise=noise)


def motion(seed: int = 0, start_m: float = 0.2) -> Log:
    """A second of moves up to 0.3 m/s, with encoder steps and force noise."""
    rng = np.random.default_rng(seed)
    path = make_trajectory("mixed", 1e4, max_velocity=0.3).position_m[:14000] + start_m
    force = 5.0 * np.sign(np.gradient(path)) + 30.0 + rng.standard_normal(len(path))
    return Log(np.arange(len(path)) / 1e4, np.round(path / 1e-9) * 1e-9, force, rate=1e4)


def spoilt(log: Log, position: list[tuple[int, int]], force: list[tuple[int, int]], value: float = np.nan) -> Log:
    """The log with missing samples [first, last)."""
    q, u = log.position_m.copy(), log.force_N.copy()
    for channel, gaps in ((q, position), (u, force)):
        for first, last in gaps:
            channel[first:last] = value
    return dataclasses.replace(log, position_m=q, force_N=u)


SETTLE = settle_samples(machine())
GAPS: dict[str, tuple[list[tuple[int, int]], list[tuple[int, int]]]] = {
    "none": ([], []),
    "one position": ([(4321, 4322)], []),
    "one force": ([], [(4321, 4322)]),
    "short": ([(5000, 5012), (5020, 5021), (9000, 9040)], [(5005, 5025)]),
    "just settle": ([(6000, 6000 + SETTLE)], []),
    "settle and one": ([(6000, 6000 + SETTLE + 1)], []),
    "long": ([(3000, 4500), (8000, 8003)], [(4400, 7000)]),
    "two long": ([(3000, 3200), (3201, 3400), (3402, 3600)], []),
    "start of position": ([(0, 57)], []),
    "start of force": ([], [(0, 203)]),
    "start of both": ([(0, 31)], [(0, 300), (305, 306)]),
    "end": ([(13000, 14000)], [(13900, 14000)]),
    "all position": ([(0, 14000)], []),
    "all force": ([], [(0, 14000)]),
}


def compare_chains(log: Log, axis: Machine, precision: str) -> None:
    """The C against kinematics.signals_from_log, from the first good sample of each channel on."""
    expected = signals_from_log(log, axis)
    first_position, first_force = (
        int(np.argmax(good)) if (good := np.abs(channel) < limit).any() else len(channel)
        for channel, limit in ((log.position_m, 4e6), (log.force_N, 1e9))
    )
    # Rounding of the number itself, and of a difference of numbers times the rate; the lower the cutoff, the longer the
    # low-passes remember it.
    low = lowpass_coefficients(axis)
    eps = float(np.finfo(REAL[precision]).eps) / (1.0 + low[3] + low[4])
    rate, mass = axis.sampling.rate, axis.plant.moved
    reach, speed = float(np.abs(expected.position).max()), float(np.abs(expected.velocity).max())
    steps = (4.0 * 2.3e-16 * reach + 1e-12 * (precision == "single")) * rate
    # A missing sample's move is rounded, and goes on in those after it.
    bridged = 1.0 + (settle_samples(axis) if (expected.missing[first_position:]).any() else 0.0)
    steps, eps = steps * bridged, eps * bridged
    tolerance = {
        "position": 4.0 * eps * reach,
        "velocity": 2.0 * eps * speed + steps,
        # Of the second difference, not of the difference of two velocities: the drive's acceleration sets the scale.
        "acceleration": 20.0 * eps * float(np.abs(expected.acceleration).max()) + 2.0 * steps * rate,
        "force": 4.0 * eps * float(np.abs(expected.force).max()),  # through the same two low-passes as the position
    }
    tolerance["friction"] = tolerance["force"] + mass * tolerance["acceleration"]
    first = {"position": first_position, "force": first_force, "friction": max(first_position, first_force)}
    for wanted in (7, 0, 1, 6):  # everything; what a model without effects reads; with ripple; with moving masses
        got = chain(log, axis, precision, wanted)
        np.testing.assert_array_equal(got.valid, expected.valid)
        np.testing.assert_allclose(got.certainty, expected.certainty, rtol=1e3 * np.finfo(REAL[precision]).eps)
        for name, absolute in tolerance.items():
            if WANTED[name] & ~wanted:
                assert not getattr(got, name).any()
                continue
            after = slice(first.get(name, 0), None)
            np.testing.assert_allclose(
                getattr(got, name)[after], getattr(expected, name)[after], rtol=0.0, atol=absolute, err_msg=name
            )


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("gaps", list(GAPS))
def test_chain_is_that_of_the_logs(gaps: str, precision: str) -> None:
    compare_chains(spoilt(motion(), *GAPS[gaps]), machine(), precision)


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e300, -4e6, 1e9])
def test_what_is_no_reading_is_a_missing_sample(value: float) -> None:
    gap = GAPS["short"] if abs(value) >= 1e9 else (GAPS["short"][0], [])
    for precision in PRECISIONS:
        compare_chains(spoilt(motion(), *gap, value=value), machine(), precision)
    np.testing.assert_array_equal(
        chain(spoilt(motion(), *gap, value=value), machine(), "double").friction,
        chain(spoilt(motion(), *gap), machine(), "double").friction,
    )


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, 1999), st.integers(1, 120)), max_size=6),
    st.lists(st.tuples(st.integers(0, 1999), st.integers(1, 120)), max_size=6),
    st.sampled_from(PRECISIONS),
)
def test_chain_under_any_gaps(position: list[tuple[int, int]], force: list[tuple[int, int]], precision: str) -> None:
    full = motion()
    log = Log(full.time_s[:2000], full.position_m[3000:5000], full.force_N[3000:5000], rate=1e4)
    gaps = ([(a, a + n) for a, n in position], [(a, a + n) for a, n in force])
    compare_chains(spoilt(log, *gaps), machine(), precision)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("rate", "cutoff"), [(1e4, 100.0), (1e4, 2000.0), (1e3, 60.0), (2e4, 500.0)])
def test_chain_at_other_rates(rate: float, cutoff: float, precision: str) -> None:
    axis = machine(sampling={"rate": rate, "velocity_cutoff": cutoff})
    path = make_trajectory("mixed", rate, max_velocity=0.3).position_m[: int(0.6 * rate)]
    log = Log(np.arange(len(path)) / rate, np.round(path / 1e-9) * 1e-9, np.full(len(path), 3.0), rate=rate)
    compare_chains(spoilt(log, [(300, 303)], [(400, 401)]), axis, precision)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("gaps", list(GAPS))
def test_chain_within_a_step_of_the_encoder(gaps: str, precision: str) -> None:
    log, counts = motion(), np.random.default_rng(1).integers(-1, 2, 14000)
    coarse = dataclasses.replace(log, position_m=1e-5 * (np.round(log.position_m / 1e-5) + counts))
    compare_chains(spoilt(coarse, *GAPS[gaps]), machine(sampling={"position_step": 1e-5}), precision)


def test_single_precision_takes_positions_that_a_float_cannot_hold() -> None:
    # 1 nm steps 2 m from the origin: a float resolves 120 nm there, the picometres do not notice.
    n = 4000
    q = 2.0 + 1e-9 * np.floor(np.arange(n) / 3.0)
    log = Log(np.arange(n) / 1e4, q, np.ones(n), rate=1e4)
    got = chain(log, machine(), "single")
    np.testing.assert_allclose(got.velocity[500:].mean(), 1e-9 / 3.0 * 1e4, rtol=1e-4)
    compare_chains(log, machine(), "single")


def test_positions_at_the_ends_of_their_range_overflow_nothing(
    require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    """Jumps from end to end, and motion that goes on from there while the position is missing."""
    checks = ["-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all", "-DSGMS_SINGLE=1"]
    files = [f"-I{runtime_dir()}", PROBES / "far_positions.c", "-o", tmp_path / "program"]
    run(require_tool("gcc"), STRICT, "-O1", "-g", checks, files)
    assert run(tmp_path / "program") == "0\n"


def test_motion_does_not_continue_out_of_the_range() -> None:
    """Missing positions go on up to 4e6 m in single precision, at the speed that they would have."""
    q = np.concatenate([[3.9999e6, 3.99995e6], np.full(100, np.nan)])
    log = Log(np.arange(len(q)) / 1e4, q, np.zeros(len(q)), rate=1e4)
    single, double = chain(log, machine(), "single"), chain(log, machine(), "double")
    np.testing.assert_allclose(single.velocity, double.velocity, rtol=1e-4)
    assert np.abs(single.position).max() < 4e6 < np.abs(double.position).max()
