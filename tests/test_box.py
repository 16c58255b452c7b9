"""The step of a fit within a box: the minimum, by its optimality conditions and by enumeration."""

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from sgms_mhe.recordings.least_squares import solve_box

Array = NDArray[np.float64]


def random_problem(seed: int, n: int) -> tuple[Array, Array, Array, Array]:
    """Nearly collinear columns of very different size, and a box that holds 0, often at its edge."""
    random = np.random.default_rng(seed)
    X = random.standard_normal((4 * n, n)) + 3.0 * random.standard_normal((4 * n, 1))
    X *= 10.0 ** random.uniform(-4.0, 4.0, n)
    A = X.T @ X
    g = X.T @ (X @ (random.standard_normal(n) / np.sqrt(np.diag(A))) * 3.0 + random.standard_normal(4 * n))
    width = 10.0 ** random.uniform(-2.0, 0.5, n) / np.sqrt(np.diag(A))
    lower, upper = -width * random.integers(0, 2, n), width * random.integers(0, 2, n)
    upper[random.random(n) < 0.2] = np.inf
    return A, g, lower, upper


def cost(A: Array, g: Array, s: Array) -> float:
    return float(0.5 * s @ A @ s - g @ s)


@pytest.mark.parametrize("seed", range(40))
def test_a_small_box_is_solved_as_enumeration_does(seed: int) -> None:
    A, g, lower, upper = random_problem(seed, 4)
    best = np.inf
    for ends in product((None, lower, upper), repeat=4):
        at = np.array([e is not None for e in ends])
        s = np.array([0.0 if e is None else e[i] for i, e in enumerate(ends)])
        if not np.isfinite(s).all():
            continue
        if not at.all():
            s[~at] = np.linalg.solve(A[np.ix_(~at, ~at)], g[~at] - A[np.ix_(~at, at)] @ s[at])
        room = 1e-9 / np.sqrt(np.diag(A))
        if np.all((s >= lower - room) & (s <= upper + room)):
            best = min(best, cost(A, g, s))
    found = solve_box(A, g, lower, upper)
    assert np.all((found >= lower) & (found <= upper))
    assert cost(A, g, found) == pytest.approx(best, rel=1e-8, abs=1e-10 * float(g @ (g / np.diag(A))))


@pytest.mark.parametrize("seed", range(60))
def test_a_step_never_promises_a_loss(seed: int) -> None:
    """Clipping what leaves the box and solving the rest again promised one in 7 of 242 steps."""
    A, g, lower, upper = random_problem(1000 + seed, 25)
    step = solve_box(A, g, lower, upper)
    assert np.all((step >= lower) & (step <= upper))
    assert cost(A, g, step) <= 0.0
    scale = 1.0 / np.sqrt(np.diag(A))
    slope = (A @ step - g) * scale
    size = 1e-7 * float(np.abs(g * scale).max())
    assert np.all(np.abs(slope[(step > lower) & (step < upper)]) <= size)
    assert np.all(slope[(step == lower) & (lower < upper)] >= -size)
    assert np.all(slope[(step == upper) & (lower < upper)] <= size)
