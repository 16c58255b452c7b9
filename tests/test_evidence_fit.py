"""Groups of columns fitted by the evidence: against its formula, by differences, and on rows that are held out."""

from functools import reduce
from operator import add

import numpy as np
import pytest
from numpy.typing import NDArray

from sgms_mhe.diagnosis.evidence_fit import (
    Design,
    EvidenceFit,
    Moments,
    SmoothGroup,
    fit_evidence,
    fit_without,
    maximise_evidence,
)

Array = NDArray[np.float64]
ROWS = 800
NOISE = 0.3


def curve(x: Array, count: int) -> SmoothGroup:
    """Hat functions over 0 to 1, with a penalty on second differences."""
    knots = np.linspace(0.0, 1.0, count)
    D = np.diff(np.eye(count), 2, axis=0)
    return SmoothGroup(np.maximum(0.0, 1.0 - np.abs(x[:, None] - knots) * (count - 1)), D.T @ D)


def example() -> tuple[Design, Array, tuple[Moments, ...]]:
    """A curve over one coordinate, another coordinate that says nothing, and a drift, in eight parts."""
    rng = np.random.default_rng(4)
    x, idle = rng.uniform(size=(2, ROWS))
    time = np.linspace(0.0, 1.0, ROWS)
    drift = curve(time, 5)
    design = Design.of([curve(x, 12), curve(idle, 9), SmoothGroup(drift.columns, drift.penalty, nuisance=True)])
    y = np.sin(6.0 * x) + 0.5 * time + NOISE * rng.standard_normal(ROWS)
    return design, y, design.sum_parts(y, np.arange(ROWS) * 8 // ROWS)


def log_evidence(design: Design, rows: Moments, fit: EvidenceFit, phi: float) -> float:
    """Logarithm of the density of y beside what does not hang on the prior, from the covariance of y itself."""
    prior = design.find_prior(rows, fit.size, fit.rough)
    A = rows.H + np.diag(prior)
    squares = rows.square - rows.g @ np.linalg.solve(A, rows.g)
    return float(0.5 * (np.log(prior).sum() - np.linalg.slogdet(A)[1] - squares / phi))


def test_variances_are_where_the_evidence_is_largest() -> None:
    """Its derivatives, by differences, are zero in those variances that no bound holds."""
    design, _, parts = example()
    rows = reduce(add, parts)
    fit = maximise_evidence(design, rows, 1.0, steps=400)
    prior = design.find_prior(rows, fit.size, fit.rough)
    told = np.trace(np.linalg.solve(rows.H + np.diag(prior), rows.H))
    phi = rows.loss(fit.b) / (rows.rows - told)
    assert phi == pytest.approx(NOISE**2, rel=0.15)
    step = 1e-3
    for name, numbers in (("size", fit.size), ("rough", fit.rough)):
        for k in range(3):
            moved = []
            for sign in (-1.0, 1.0):
                changed = {"size": fit.size.copy(), "rough": fit.rough.copy()}
                changed[name][k] += sign * step
                moved.append(log_evidence(design, rows, EvidenceFit(fit.b, tau=1.0, **changed), phi))
            slope = (moved[1] - moved[0]) / (2.0 * step)
            # A variance on its way to none has a slope that falls with it; one at its floor may want to be larger.
            at_floor = name == "size" and numbers[k] == fit.size.min()
            assert abs(slope) < 0.05 or at_floor or numbers[k] > 2.0


def test_coefficients_are_the_penalised_least_squares() -> None:
    design, y, parts = example()
    rows = reduce(add, parts)
    fit = fit_evidence(design, parts)
    prior = design.find_prior(rows, fit.size, fit.rough)
    stacked = np.vstack((design.X, np.diag(np.sqrt(prior))))
    known = np.linalg.lstsq(stacked, np.concatenate((y, np.zeros(len(prior)))), rcond=None)[0]
    assert fit.b == pytest.approx(known, abs=1e-9)
    # In a group's own columns it is the same force.
    x = np.random.default_rng(4).uniform(size=(2, ROWS))[0]
    own = curve(x, 12).columns @ design.split(fit.b)[0]
    assert own == pytest.approx(design.X[:, design.group == 0] @ fit.b[design.group == 0], abs=1e-9)
    assert float(np.std(own - np.sin(6.0 * x))) < 0.15
    idle = design.X[:, design.group == 1] @ fit.b[design.group == 1]
    assert float(np.std(idle)) < 0.05


def test_a_part_is_predicted_by_the_others_without_their_drift() -> None:
    design, y, parts = example()
    fit = fit_evidence(design, parts)
    left = fit_without(design, parts, fit)
    assert all(not b[~design.predicts].any() for b in left)
    # What the part itself says does not matter to its prediction.
    spoilt = y.copy()
    spoilt[: ROWS // 8] += 100.0
    again = fit_without(design, design.sum_parts(spoilt, np.arange(ROWS) * 8 // ROWS), fit)
    assert again[0] == pytest.approx(left[0], rel=1e-6, abs=1e-6)
    assert sum(p.loss(b) for p, b in zip(parts, left, strict=True)) < sum(p.square for p in parts)


def test_large_forces_that_cancel_are_no_prior() -> None:
    """Two nearly equal columns: no group has a larger prior variance than the rows."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal(ROWS)
    twin = x + 1e-3 * rng.standard_normal(ROWS)
    y = 1000.0 * (x - twin) + 0.01 * rng.standard_normal(ROWS)
    design = Design.of([SmoothGroup(column[:, None], np.zeros((1, 1))) for column in (x, twin)])
    fit = maximise_evidence(design, design.sum_parts(y, np.zeros(ROWS, dtype=np.int64))[0], 1.0)
    assert float(np.abs(fit.b).max()) < 900.0
