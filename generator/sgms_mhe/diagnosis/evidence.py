"""Evidence that holds under coloured residuals: blocks of the record are the independent units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from sgms_mhe.diagnosis.residuals import Recording

Array = NDArray[np.float64]

PARTS = 6  # that a record is cut into


@dataclass(frozen=True)
class Nuisance:
    """Directions of the parameters that are free anyway, orthonormal on the used rows.

    basis: (rows used, p).
    """

    basis: Array

    def project(self, columns: Array) -> Array:
        """What is left of columns (rows used, ...) that no nuisance parameter explains."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def nuisance(X: Array) -> Nuisance:
    """Orthonormal basis of X (rows used, p), directions without excitation left out."""
    if X.shape[1] == 0:
        return Nuisance(X)
    scale = np.sqrt(np.sum(X**2, axis=0))
    kept = scale > 1e-9 * max(float(scale.max()), 1e-300)
    if not kept.any():
        return Nuisance(X[:, :0])
    Y = X[:, kept] / scale[kept]
    values, vectors = np.linalg.eigh(Y.T @ Y)
    large = values > 1e-10 * values.max()
    return Nuisance(np.asarray(Y @ (vectors[:, large] / np.sqrt(values[large]))))


def score_test(recording: Recording, Z: Array, residual: Array) -> tuple[float, Array]:
    """Test that projected columns Z (rows used, k) explain nothing of the residual (rows used).

    The covariance of the scores is the sum over blocks of their outer products, from the residual that is left when the
    columns are fitted: colour within a block does not matter. Returns p of the F statistic and the coefficients (k).
    """
    H = Z.T @ Z
    k = Z.shape[1]
    if not np.all(np.isfinite(H)):
        return 1.0, np.zeros(k)
    coefficients: Array = np.asarray(np.linalg.lstsq(H, Z.T @ residual, rcond=1e-12)[0], dtype=np.float64)
    rest = residual - Z @ coefficients
    block = recording.block[recording.used]
    scores = np.column_stack([np.bincount(block, weights=Z[:, j] * rest, minlength=recording.blocks) for j in range(k)])
    B = recording.blocks
    freedom = B - k - 1
    if freedom < 2:
        return 1.0, coefficients
    meat = scores.T @ scores * B / (B - k)
    # At least what white noise would give: blocks that balance by chance prove nothing.
    meat = meat + 0.1 * H * float(rest @ rest) / len(rest)
    if not np.all(np.isfinite(meat)) or np.linalg.cond(meat) > 1e14:
        return 1.0, coefficients
    score = H @ coefficients
    statistic = float(score @ np.linalg.solve(meat, score)) * freedom / (k * max(1, B - 1))
    return float(stats.f.sf(statistic, k, freedom)), coefficients


def gain_force(before: Array, after: Array, rows: Array) -> float:
    """RMS of the force that a fit explains beyond another [N], from losses per block; negative for less."""
    difference = float((before - after).sum()) / max(1.0, float(rows.sum()))
    return math.copysign(math.sqrt(abs(difference)), difference)


def gain_interval(before: Array, after: Array, rows: Array, *, draws: int = 1000) -> tuple[float, float]:
    """95 % interval of `gain_force` by resampling blocks."""
    random = np.random.default_rng(1)
    count = len(before)
    if count < 2:
        return math.nan, math.nan
    pick = random.integers(count, size=(draws, count))
    difference = (before - after)[pick].sum(axis=1) / np.maximum(1.0, rows[pick].sum(axis=1))
    low, high = np.quantile(difference, [0.025, 0.975])
    return math.copysign(math.sqrt(abs(low)), low), math.copysign(math.sqrt(abs(high)), high)


def difference_statistic(first: Array, second: Array) -> float:
    """t of the mean difference of two fits' losses over blocks; positive where the second is worse."""
    difference = second - first
    spread = math.sqrt(
        float(np.sum((difference - difference.mean()) ** 2)) * len(difference) / max(1, len(difference) - 1)
    )
    return float(difference.sum()) / spread if spread > 0.0 else 0.0


def inconstancy(recording: Recording, contribution: Array, residual: Array, *, inertial: bool = False) -> float:
    """How much the size of a cause changes over the record: 0 for the same everywhere, 1 for as much as the size.

    What only imitates something else fits here and misfits there. The record is cut into parts by time, by place and by
    speed; within each part the residual is regressed on the cause's contribution c: a - 1 = c'e / c'c. The RMS of
    a - 1, weighted by c'c, is as large as the worst of the three ways to cut says.

    Args:
        recording: the record.
        contribution: what the cause explains that the others cannot, residual without minus residual with it (m).
        residual: with it (m).
        inertial: the cause acts where the axis accelerates. By place and by speed such parts are mixed with
            break-away to different degrees, and what the model gets wrong there would count against the cause: by time
            only.
    """
    used = recording.used
    c, e = contribution[used], residual[used]
    total = float(c @ c)
    if total <= 0.0:
        return math.inf
    worst = 0.0
    for coordinate in (recording.time, recording.position, np.abs(recording.velocity))[: 1 if inertial else 3]:
        x = coordinate[used]
        # Parts that the cause acts equally much in, so that none has no say.
        order = np.argsort(x, kind="stable")
        part = np.empty(len(x), dtype=np.int64)
        part[order] = np.minimum(PARTS - 1, (np.cumsum(c[order] ** 2) / total * PARTS).astype(np.int64))
        power = np.bincount(part, weights=c * c, minlength=PARTS)
        change = np.bincount(part, weights=c * e, minlength=PARTS) / np.maximum(power, 1e-300)
        worst = max(worst, math.sqrt(float(power @ change**2) / total))
    return worst


def effective_rows(residual: Array) -> float:
    """Number of independent rows that a coloured series is worth, from its autocorrelation up to 50 rows."""
    centred = residual - residual.mean()
    total = float(centred @ centred)
    if total <= 0.0 or len(centred) < 100:
        return float(len(centred))
    rho = np.array([float(centred[:-lag] @ centred[lag:]) / total for lag in range(1, 51)])
    weights = 1.0 - np.arange(1, 51) / 51.0
    return float(len(centred) / max(1.0, 1.0 + 2.0 * float(weights @ rho)))


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjusted p-values (Holm)."""
    order = np.argsort(p_values)
    count = len(p_values)
    adjusted, running = [1.0] * count, 0.0
    for rank, index in enumerate(order):
        running = max(running, min(1.0, (count - rank) * p_values[index]))
        adjusted[int(index)] = running
    return adjusted
