"""Sums of groups of columns fitted at once: how large and how rough each group is says the evidence of the rows.

    y = sum_g X_g b_g + e,    b_g ~ N(0, phi (lambda_g I + mu_g S_g)^-1 / n),    e ~ N(0, phi I),    phi = tau s^2

S_g is the group's penalty of roughness and s^2 the residual variance of n rows. That is mostly the model's error,
and not white: tau rows count as one. lambda and mu are at the maximum of the evidence (MacKay's fixed
point), tau is the one by which parts of the rows are predicted best that are held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Final, Self

import numpy as np
from scipy.linalg import lapack

from sgms_mhe.support.arrays import Array, Index, Mask

CORRELATED: Final = (30.0, 10.0, 3.0)
"""Rows that may count as one [1], in the order of trial: a fit begins where the one before has ended."""
STEPS: Final = 40
STEPS_AGAIN: Final = 5
"""Steps of the fixed point, and where it begins at the variances of nearly the same rows [1]."""
SETTLED: Final = 0.05
"""Largest change of a logarithm of a variance in a step that is the last [1]."""
LONGEST_STEP: Final = 3.0
"""Largest change that a step makes [1]."""
BEGIN: Final = -4.0
LEAST: Final = -18.0
MOST: Final = 9.0
"""Logarithms of lambda and mu where a fit begins, and their bounds [1]."""
WEAK: Final = 1e-8
"""Prior information that every column has [of the rows']."""


@dataclass(frozen=True, eq=False)
class SmoothGroup:
    """Columns (m, k) of one size and one roughness.

    Attributes:
        columns: of the design.
        penalty: of the roughness (k, k).
        nuisance: whether they are fitted beside the others, and predict nothing.
    """

    columns: Array
    penalty: Array
    nuisance: bool = False


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums over rows: X'X (p, p), X'y (p), y'y, and how many these are."""

    H: Array
    g: Array
    square: float
    rows: int

    def __add__(self, other: Moments) -> Moments:
        return Moments(self.H + other.H, self.g + other.g, self.square + other.square, self.rows + other.rows)

    def __sub__(self, other: Moments) -> Moments:
        return Moments(self.H - other.H, self.g - other.g, self.square - other.square, self.rows - other.rows)

    def loss(self, b: Array) -> float:
        """Sum of squares of y - X b."""
        return float(self.square - 2.0 * b @ self.g + b @ self.H @ b)


@dataclass(frozen=True, eq=False)
class Design:
    """Columns of all groups, each group scaled to an RMS of 1 and turned so that its priors are diagonal.

    Attributes:
        X: the columns (m, p).
        rough: eigenvalue of the group's penalty (p).
        group: number of the group (p).
        predicts: columns of no nuisance (p).
        turns: matrix (k, k) by group that leads back to coefficients of its own columns.
    """

    X: Array
    rough: Array
    group: Index
    predicts: Mask
    turns: tuple[Array, ...]

    @classmethod
    def of(cls, groups: Sequence[SmoothGroup]) -> Self:
        """Return that of some groups; one whose columns are all zero stays zero."""
        rough, turns = [], []
        for group in groups:
            values, vectors = np.linalg.eigh(group.penalty / (np.trace(group.penalty) / len(group.penalty) or 1.0))
            rough.append(np.maximum(values, 0.0))
            turns.append(vectors / (float(np.sqrt(np.mean(group.columns**2))) or 1.0))
        sizes = [len(turn) for turn in turns]
        return cls(
            X=np.hstack([group.columns @ turn for group, turn in zip(groups, turns, strict=True)]),
            rough=np.concatenate(rough),
            group=np.repeat(np.arange(len(groups)), sizes),
            predicts=np.repeat([not group.nuisance for group in groups], sizes),
            turns=tuple(turns),
        )

    def sum_parts(self, y: Array, part: Index) -> tuple[Moments, ...]:
        """Return the moments of the parts the rows (m) are numbered by."""
        found = [(self.X[part == k], y[part == k]) for k in range(int(part.max()) + 1)]
        return tuple(Moments(A.T @ A, A.T @ b, float(b @ b), len(b)) for A, b in found)

    def find_prior(self, rows: Moments, size: Array, rough: Array) -> Array:
        """Return the prior information (p) of logarithms of lambda and mu (groups)."""
        return rows.rows * (WEAK + np.exp(size)[self.group] + np.exp(rough)[self.group] * self.rough)

    def predict(self, b: Array) -> Array:
        """Return the coefficients (p) that a prediction has."""
        return np.where(self.predicts, b, 0.0)

    def split(self, b: Array) -> tuple[Array, ...]:
        """Return the coefficients of each group's own columns."""
        return tuple(turn @ b[self.group == k] for k, turn in enumerate(self.turns))


@dataclass(frozen=True, eq=False)
class EvidenceFit:
    """Solution at the maximum of the evidence.

    Attributes:
        b: coefficients of the design's columns (p).
        size, rough: logarithms of lambda and mu (groups).
        tau: rows that count as one.
    """

    b: Array
    size: Array
    rough: Array
    tau: float


def fit_evidence(design: Design, parts: Sequence[Moments]) -> EvidenceFit:
    """Fit all groups to all parts, with the tau by which parts are predicted best that are held out."""
    rows = reduce(add, parts)
    fits: list[EvidenceFit] = []
    losses: list[float] = []
    for tau in CORRELATED:
        fits.append(maximise_evidence(design, rows, tau, fits[-1] if fits else None))
        prior = design.find_prior(rows, fits[-1].size, fits[-1].rough)
        losses.append(sum(part.loss(design.predict(_solve(rows - part, prior)[0])) for part in parts))
    return fits[int(np.argmin(losses))]


def fit_without(design: Design, parts: Sequence[Moments], fit: EvidenceFit) -> list[Array]:
    """Return the coefficients (p) that predict each part, its variances too by all others."""
    rows = reduce(add, parts)
    return [design.predict(maximise_evidence(design, rows - p, fit.tau, fit, STEPS_AGAIN).b) for p in parts]


def maximise_evidence(
    design: Design, rows: Moments, tau: float, begin: EvidenceFit | None = None, steps: int = STEPS
) -> EvidenceFit:
    """Fit all groups to some rows, from the variances of another fit or from the same ones of all groups.

    The force of no group has a larger prior variance than the rows have: it is a part of them, and no difference of
    large forces, which would not cancel where the rows have not been.
    """
    groups = np.zeros(len(design.turns))
    size, rough = (groups + BEGIN, groups + BEGIN) if begin is None else (begin.size, begin.rough)
    for _ in range(steps):
        prior = design.find_prior(rows, size, rough)
        b, factor = _solve(rows, prior)
        inverse = np.square(np.tril(lapack.dtrtri(factor, lower=1, overwrite_c=1)[0])).sum(axis=0)  # diagonal of A^-1
        told = float((1.0 - inverse * prior).sum())
        variance = max(rows.loss(b), WEAK * rows.square) / max(rows.rows - told, 0.1 * rows.rows)
        unsure = tau * variance * (1.0 / prior - inverse)
        least = np.log(tau * variance / rows.square * np.bincount(design.group)) if rows.square > 0.0 else MOST
        before = np.concatenate((size, rough))
        size = np.clip(_step(design.group, size, unsure, b**2), np.clip(least, LEAST, MOST), MOST)
        rough = np.clip(_step(design.group, rough, unsure * design.rough, b**2 * design.rough), LEAST, MOST)
        if np.abs(np.concatenate((size, rough)) - before).max() < SETTLED:
            break
    return EvidenceFit(_solve(rows, design.find_prior(rows, size, rough))[0], size, rough, tau)


def _solve(rows: Moments, prior: Array) -> tuple[Array, Array]:
    """Return the solution (p) beside a prior (p), and the lower Cholesky factor (p, p) of its information."""
    information = rows.H.T.copy(order="F")  # in the library's own order, which symmetric sums are in as well
    np.fill_diagonal(information, information.diagonal() + prior)
    factor = lapack.dpotrf(information, lower=1, overwrite_a=1, clean=0)[0]
    return lapack.dpotrs(factor, rows.g, lower=1)[0], factor


def _step(group: Index, log: Array, unsure: Array, square: Array) -> Array:
    """Return the next logarithms of variances (groups): the coefficients' variances over their squares."""
    tiny = np.finfo(np.float64).tiny
    above, below = (np.maximum(np.bincount(group, x, len(log)), tiny) for x in (unsure, square))
    return np.asarray(log + np.clip(np.log(above) - np.log(below), -LONGEST_STEP, LONGEST_STEP))
