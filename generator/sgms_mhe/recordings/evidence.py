"""Evidence that holds under coloured residuals: blocks of the record are the independent units."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Self

import numpy as np
from scipy import stats
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from sgms_mhe.recordings.noise import find_colour, quiet_variance
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import TINY, Array

UNSEEN: Final = 1e-9  # of the longest column: a shorter one is not excited
RANK: Final = 1e-10  # of the largest eigenvalue of the scaled Gram matrix
SOLVABLE: Final = 1e-12  # of the largest eigenvalue of an information matrix
SINGULAR: Final = 1e14  # condition of the scores' covariance that no test rests on
PIECES: Final = 4  # that a noise floor needs
AT_REST: Final = 1e-3  # RMS speed of a piece over that of all
MOVING: Final = 0.1  # of the pieces: fewer are no sample of the noise
CONFIDENCE: Final = 0.95
"""Probability of the intervals that decide."""
EQUAL_T: Final = 2.5
"""T over blocks up to which two fits are equally good [1]: two-sided one percent."""
FAST_PARTS: Final = 20  # of a record: what is slower than one of them may be a force that wanders
FAST_LEAST: Final = 1e-3  # of a contribution's power: of one with less, an offset say, no change is fast
DRAWS: Final = 1000  # of blocks; the interval's ends are then sure to a few percent of its width
SMOOTH_ROWS: Final = 16
"""Stretch that a model's errors are smooth over and keep their sign, a reversal: what a parabola leaves there is noise
[rows]; they are, but where the axis is fast; the quieter half decides."""
WHITE_FLOOR: Final = 0.1
"""Scatter of scores over blocks, at least [white noise]: blocks that balance by chance prove nothing."""
ENCODER_STEPS_MOST: Final = 0.2
"""RMS of the force that an encoder's steps leave, as much of which is noise of the record [f_C]: what hides more than
that says of no model that it is adequate."""
CONSTANCY_PARTS: Final = 6
"""Parts of a record that a size is compared in, by time, place and speed [1]: each with several blocks."""
UNKNOWN: Final = 1e-15  # of the largest eigenvalue of the information
ALONE: Final = 0.9
"""Share of the information on a number that one block may hold: with all of it there is none to move to without it."""
SMOOTH_SHARE: Final = 0.15  # of a frequency, to either side: its power is the mean of these
SMOOTH_LEAST: Final = 4  # half frequencies, of a record's length: the slowest few are one
UNSEEN_ERROR: Final = 0.15
"""RMS that a model may get wrong beyond what is seen, for intervals [noise floor]: a floor that is right to 1 % hides
as much."""


@dataclass(frozen=True)
class Nuisance:
    """Directions of the parameters that are free anyway, orthonormal on the used rows.

    basis: (rows used, p).
    """

    basis: Array

    def project(self, columns: Array) -> Array:
        """Return the part of columns (rows used, ...) that no nuisance parameter explains."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def find_nuisance(X: Array) -> Nuisance:
    """Orthonormal basis of X (rows used, p), directions without excitation left out."""
    if X.shape[1] == 0:
        return Nuisance(X)
    scale = np.sqrt(np.sum(X**2, axis=0))
    kept = scale > max(UNSEEN * float(scale.max()), TINY)
    if not kept.any():
        return Nuisance(X[:, :0])
    Y = X[:, kept] / scale[kept]
    values, vectors = np.linalg.eigh(Y.T @ Y)
    large = values > RANK * values.max()
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
    meat = meat + WHITE_FLOOR * H * float(rest @ rest) / len(rest)
    if not np.all(np.isfinite(meat)) or np.linalg.cond(meat) > SINGULAR:
        return 1.0, coefficients
    score = H @ coefficients
    statistic = float(score @ np.linalg.solve(meat, score)) * freedom / (k * max(1, B - 1))
    return float(stats.f.sf(statistic, k, freedom)), coefficients


def noise_floor(recording: Recording, residual: Array, encoder: Array | None = None) -> float:
    """RMS of the noise at the fit's rate, from the residual of a smooth curve through a few rows [N].

    Model errors are smooth over SMOOTH_ROWS but at reversals and pushes, whose segments are found by their residual,
    and where they come again in time or in place (`quiet_variance`). Noise of an encoder's steps is slow where few of
    them pass, comes again at one speed, and is largest where stiff elements stick: no less than that.

    Args:
        recording: the record.
        residual: measured minus model (m) [N].
        encoder: force the encoder's steps leave (m) [N]; None: by their effect on the acceleration.
    """
    quiet, background = _quiet_power(recording, residual)
    encoder = recording.steps_inertia if encoder is None else encoder
    if encoder is None:
        return math.sqrt(background)
    steps = float(np.mean(encoder[recording.used] ** 2))
    noise = min(quiet, background + steps)  # of lines at one speed the encoder may have made some
    return math.sqrt(noise if hides_friction(recording, encoder) else max(steps, noise))


def misread_forces(inertial: Array, friction: Sequence[Array]) -> list[Array]:
    """Return the forces an encoder's steps leave in a residual (m) [N], one for each encoder.

    Args:
        inertial: force of the acceleration the steps make (m) [N].
        friction: a model's (m) [N], along a trajectory without steps and along those that encoders make of it.
    """
    true, *misread = friction
    return [inertial + true - other for other in misread]


def largest_force(recording: Recording, forces: Sequence[Array]) -> Array | None:
    """Return the largest (m) of encoders' residuals; None where there is none, or one is not finite.

    An axis that stops at few places is read right or wrong there by chance: by a factor of two from encoder to encoder.
    """
    sizes = [recording.rms(force) for force in forces]
    return forces[int(np.argmax(sizes))] if sizes and np.all(np.isfinite(sizes)) else None


def hides_friction(recording: Recording, encoder: Array) -> bool:
    """Return True if the force that an encoder's steps leave (m) [N] is so large that no model can be judged."""
    return recording.rms(encoder) >= ENCODER_STEPS_MOST * recording.machine.friction.coulomb


def _quiet_power(recording: Recording, residual: Array) -> tuple[float, float]:
    """Power [N^2] of a residual's noise in the segments that hold nothing else: with and without lines of its spectra.

    Of those in which the axis moves, where there are enough: at rest an encoder that rounds has no noise.
    """
    width = SMOOTH_ROWS
    k = len(residual) // width
    whole = recording.used[: k * width].reshape(k, width).all(axis=1)
    if whole.sum() < PIECES:
        power = float(np.var(residual[recording.used]))
        return power, power

    def pieces(series: Array) -> Array:
        return np.asarray(series[: k * width].reshape(k, width)[whole])

    speed = np.sqrt(np.mean(pieces(recording.velocity) ** 2, axis=1))
    moves = speed > AT_REST * float(np.sqrt(np.mean(speed**2)))
    if moves.sum() < max(PIECES, MOVING * len(speed)):
        moves = np.ones_like(moves)
    rest, time, position = (pieces(series)[moves] for series in (residual, recording.time, recording.position))
    return quiet_variance(
        rest,
        find_colour(recording.machine, recording.factor, width, is_filtered=recording.is_filtered),
        (time, position),
    )


def cross_loss(recording: Recording, X: Array, residual: Array, prior: Array) -> Array:
    """Sum of squares per block as predicted by a fit without the block's fold.

    That fit is as far from the whole one as the optimum without the fold is from that of all rows, both to first order.
    Where the whole one stopped short of its optimum, that is left: a step that was promised and not found is no merit.
    X (m, p): derivatives of the model; `prior` (p): information that is always there.
    """
    if X.shape[1] == 0:
        return recording.sum_blocks(residual**2)
    H, g, s = block_moments(recording, X, residual)
    result = np.empty(recording.blocks)
    total_H = H.sum(axis=0) + np.diag(prior)
    # Without it a fold that alone tells of a number would send it as far as a fit is short of its optimum there.
    promised = np.linalg.lstsq(total_H, g.sum(axis=0), rcond=SOLVABLE)[0]
    for fold in np.unique(recording.fold):
        inside = recording.fold == fold
        own_H, own_g = H[inside].sum(axis=0), g[inside].sum(axis=0)
        step = np.linalg.lstsq(total_H - own_H, own_H @ promised - own_g, rcond=SOLVABLE)[0]
        result[inside] = s[inside] - 2.0 * g[inside] @ step + np.einsum("bij,i,j->b", H[inside], step, step)
    return result


def block_moments(recording: Recording, X: Array, residual: Array) -> tuple[Array, Array, Array]:
    """Per block: X'X (blocks, p, p), X'e (blocks, p), e'e (blocks)."""
    used, p = recording.used, X.shape[1]
    order = recording.block[used]
    rows, e = X[used], residual[used]
    edges = np.searchsorted(order, np.arange(recording.blocks + 1))
    H, g, s = np.empty((recording.blocks, p, p)), np.empty((recording.blocks, p)), np.empty(recording.blocks)
    for b, (start, end) in enumerate(pairwise(edges)):
        part, rest = rows[start:end], e[start:end]
        H[b], g[b], s[b] = part.T @ part, part.T @ rest, rest @ rest
    return H, g, s


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordLoss:
    """Residual of a record along a model, and its squares by blocks.

    Attributes:
        residual: measured minus model (m) [N].
        loss: sum of its squares per block (blocks).
        rows: used rows per block (blocks).
    """

    residual: Array
    loss: Array
    rows: Array

    @property
    def rms(self) -> float:
        """RMS of the residual on used rows [N]."""
        return math.sqrt(float(self.loss.sum() / self.rows.sum()))


@dataclass(frozen=True, eq=False, kw_only=True)
class FitLoss(RecordLoss):
    """Residual of a fit, and its squares on blocks it has not seen.

    Attributes:
        cross: sum of squares per block, each predicted by a fit without its fold (blocks).
    """

    cross: Array

    @property
    def cross_rms(self) -> float:
        """RMS by cross-validation [N]."""
        return math.sqrt(max(0.0, float(self.cross.sum() / self.rows.sum())))

    def gain_over(self, other: Self) -> float:
        """RMS of the force this fit explains beyond another on unseen blocks [N]; negative for less."""
        return gain_force(other.cross, self.cross, self.rows)


def gain_force(before: Array, after: Array, rows: Array) -> float:
    """RMS of the force a fit explains beyond another [N], from losses per block; negative for less."""
    difference = float((before - after).sum()) / max(1.0, float(rows.sum()))
    return math.copysign(math.sqrt(abs(difference)), difference)


def gain_interval(before: Array, after: Array, rows: Array) -> tuple[float, float]:
    """95 % interval of `gain_force` by resampling blocks."""
    random = np.random.default_rng(1)
    count = len(before)
    if count < 2:
        return math.nan, math.nan
    pick = random.integers(count, size=(DRAWS, count))
    difference = (before - after)[pick].sum(axis=1) / np.maximum(1.0, rows[pick].sum(axis=1))
    low, high = np.quantile(difference, (0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)))
    return math.copysign(math.sqrt(abs(low)), low), math.copysign(math.sqrt(abs(high)), high)


def difference_statistic(first: Array, second: Array) -> float:
    """Return the test statistic of the difference of two fits' losses per block; positive where the second is worse.

    t of the mean difference, or the normal score of its signed ranks where that is surer and says the same: one block
    that holds most of the difference must not hide that all the others agree.
    """
    difference = second - first
    spread = math.sqrt(
        float(np.sum((difference - difference.mean()) ** 2)) * len(difference) / max(1, len(difference) - 1)
    )
    if spread == 0.0:
        return 0.0
    t = float(difference.sum()) / spread
    ranks = stats.rankdata(np.abs(difference)) * (difference != 0.0)
    z = float(ranks @ np.sign(difference)) / math.sqrt(float(ranks @ ranks))
    return z if z * t > 0.0 and abs(z) > abs(t) else t


def inconstancy(recording: Recording, contribution: Array, residual: Array, *, inertial: bool = False) -> float:
    """Return the change of a cause's size over the record: 0 for the same everywhere, 1 for as much as the size.

    An imitation of something else fits here and misfits there. The record is cut into parts by time, by place and by
    speed; within each part the residual is regressed on the cause's contribution c: a - 1 = c'e / c'c. The RMS of
    a - 1, weighted by c'c, is as large as the worst of the three ways to cut says. And of c and e alone that changes
    faster than a part of the record, where some of c does: a force that wanders takes on the size of a slow cause, a
    step's say, but does not jump where that does.

    Args:
        recording: the record.
        contribution: explained by the cause alone, residual without minus residual with it (m).
        residual: with it (m).
        inertial: the cause acts where the axis accelerates. By place and by speed such parts are mixed with
            break-away to different degrees, and the model's error there would count against the cause: by time
            only.
    """
    used = recording.used
    c, e = contribution[used], residual[used]
    total = float(c @ c)
    if total <= 0.0:
        return math.inf
    worst, parts = 0.0, CONSTANCY_PARTS
    for coordinate in (recording.time, recording.position, np.abs(recording.velocity))[: 1 if inertial else 3]:
        x = coordinate[used]
        # Parts that the cause acts equally much in, so that none has no say.
        order = np.argsort(x, kind="stable")
        part = np.empty(len(x), dtype=np.int64)
        part[order] = np.minimum(parts - 1, (np.cumsum(c[order] ** 2) / total * parts).astype(np.int64))
        power = np.bincount(part, weights=c * c, minlength=parts)
        change = np.bincount(part, weights=c * e, minlength=parts) / np.maximum(power, TINY)
        worst = max(worst, math.sqrt(float(power @ change**2) / total))
    c, e = _drop_slow(c, len(c) // FAST_PARTS), _drop_slow(e, len(e) // FAST_PARTS)
    fast = float(c @ c)
    return worst if fast < FAST_LEAST * total else max(worst, abs(float(c @ e)) / fast)


def _drop_slow(series: Array, rows: int) -> Array:
    """Return a series minus its mean over so many samples around each."""
    return np.asarray(series - uniform_filter1d(series, max(1, rows), mode="nearest"))


def robust_covariance(recording: Recording, X: Array, residual: Array, H: Array, inverse: Array, wrong: float) -> Array:
    """Covariance of fitted numbers (p, p).

    Noise, by the change of the numbers without each block (`jackknife_covariance`), robust to colour within a block and
    to numbers that few blocks tell of, but no less than if the residual were white, or stationary with its own spectrum
    (`stationary_covariance`): parts slower than a block. And the error of the model, which does not average out as
    noise does: taken as coherent over SMOOTH_ROWS.

    Args:
        recording: rows of the fit.
        X: derivatives of the model (m, p).
        residual: measured minus model (m) [N].
        H: information of the used rows and of priors (p, p).
        inverse: of H, where that has one.
        wrong: RMS of the model's error [N].
    """
    noise = jackknife_covariance(recording, X, residual, H)
    # Blocks that happen to balance must not promise more than noise would allow.
    white = inverse * float(np.mean(residual[recording.used] ** 2))
    for least in (white, stationary_covariance(recording, X, residual, inverse)):
        # What is missing is added as that noise is correlated: a sum may be known of which no part is.
        variance = np.maximum(np.diag(least), TINY)
        missing = np.sqrt(np.maximum(0.0, variance - np.diag(noise)) / variance)
        noise = noise + least * np.outer(missing, missing)
    return np.asarray(noise + inverse * SMOOTH_ROWS * wrong**2)


def invert_information(H: Array) -> Array:
    """Return the inverse (p, p) of an information (p, p), 0 in directions of which nothing is known.

    Each number in units of its own deviation: which directions are known does not depend on the units of numbers.
    """
    root = _find_root_of_inverse(H)
    return np.asarray(root @ root.T)


def _find_root_of_inverse(H: Array) -> Array:
    """Return R (p, k) with R R' the inverse of an information (p, p) of rank k."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), TINY))
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    known = values > UNKNOWN * values.max(initial=0.0)
    return np.asarray(scale[:, None] * vectors[:, known] / np.sqrt(values[known]))


def stationary_covariance(recording: Recording, X: Array, residual: Array, inverse: Array) -> Array:
    """Covariance (p, p) of numbers fitted by X (m, p), were the residual stationary noise of its own spectrum.

    A sandwich in the frequency domain: the spectrum of the used rows' residual (m), a mean over SMOOTH_SHARE of the
    frequency to either side, weights the columns. Of a residual that wanders a block knows nothing, and numbers whose
    columns wander too are far less sure than as many white rows would make them. The share the fit itself took out of a
    frequency, the share of its columns there, counts as missing.
    """
    length = 2 * next_fast_len(len(residual), real=True)
    used = recording.used
    power = np.abs(rfft(np.where(used, residual, 0.0), length)) ** 2
    columns = rfft(np.where(used[:, None], X, 0.0), length, axis=0)
    taken = np.einsum("fi,ij,fj->f", columns.conj(), inverse, columns, optimize=True).real
    place = np.arange(len(power))
    reach = np.maximum(SMOOTH_LEAST, (SMOOTH_SHARE * place).astype(np.int64))
    first, last = np.maximum(place - reach, 0), np.minimum(place + reach + 1, len(power))

    def smooth(series: Array) -> Array:
        total = np.concatenate(((0.0,), np.cumsum(series)))
        return np.asarray((total[last] - total[first]) / (last - first))

    rows = max(1, int(np.count_nonzero(used)))
    density = smooth(power) / np.maximum(rows - smooth(taken), (1.0 - ALONE) * rows)
    weight = density * 2.0 / length
    weight[[0, -1]] *= 0.5  # the others stand for two frequencies each
    weighted = columns * np.sqrt(weight)[:, None]
    return np.asarray(inverse @ (weighted.conj().T @ weighted).real @ inverse)


def jackknife_covariance(recording: Recording, X: Array, residual: Array, H: Array) -> Array:
    """Covariance from the numbers' shifts when one block is left out (jackknife), of X (m, p): (p, p).

    A sandwich over blocks takes their residuals as they are; but in a block that alone tells of a number the fit has
    already made them small. H (p, p): information of all.
    """
    information, scores, _ = block_moments(recording, X, residual)
    root = _find_root_of_inverse(H)
    moves = []
    for own, score in zip(information, scores, strict=True):
        share, direction = np.linalg.eigh(root.T @ own @ root)
        moves.append(root @ direction @ (direction.T @ root.T @ score / (1.0 - np.minimum(share, ALONE))))
    moved = np.stack(moves)
    return np.asarray(moved.T @ moved * (len(moved) - 1) / len(moved))
