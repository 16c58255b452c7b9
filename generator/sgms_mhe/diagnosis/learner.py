"""A residual that has no name, learned: a sum of smooth functions of place, speed and travel since a reversal.

Penalised cubic B-splines over one coordinate or two, in closed form; they end in zero where the data end. Terms and
their penalties are selected by cross-validation over segments of the record that are long beside the residual's
correlation time. What a segment gains is predicted by terms that were selected, and fitted, without it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import solve

from sgms_mhe.diagnosis.coordinates import Coordinate, Kind, Warp, warp_motion
from sgms_mhe.diagnosis.learned import Learned, LearnedTerm
from sgms_mhe.recordings.evidence import CONFIDENCE, difference_statistic
from sgms_mhe.recordings.recording import Recording, split_blocks
from sgms_mhe.recordings.series import row_means
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.parallel import run_parallel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

ROWS: Final = 5000  # means over so many parts of a record are learned from
SEGMENTS: Final = (8, 24)  # that a record is cut into, at least and at most
CORRELATION: Final = 0.2  # autocorrelation of the residual that ends its correlation time
LONG: Final = 2.0  # a segment, at least [correlation times]
MOST_TERMS: Final = 3
GRIDS: Final[tuple[tuple[tuple[Kind, int], ...], ...]] = (
    (("place", 16),),
    (("place", 64),),
    (("speed", 9),),
    (("travel", 8),),
    (("place", 9), ("speed", 5)),
    (("place", 64), ("speed", 1)),
    (("late speed", 5), ("travel", 4)),
    (("place", 9), ("travel", 4)),
)
"""Coordinates of the candidates, and cells of the grid over each. A ripple of a gear may be finer over place than
anything is over speed, and shifted from one direction to the other."""
PENALTIES: Final = (1e-3, 3e-2, 1.0)
"""Weights of second differences [mean information of a spline]."""
SUPPORT: Final = 1.0  # rows under a spline from which a segment tells of it
BETTER_T: Final = 1.0
"""T over segments that a further term must gain by [1]: a term that gains by chance costs little, and the held-out
blocks judge the sum."""


@dataclass(frozen=True, eq=False)
class _Basis:
    """A term under test: its columns of the design, and the penalty on them (k, k) of weight 1."""

    coordinates: tuple[Coordinate, ...]
    columns: slice
    penalty: Array
    kept: Mask


@dataclass(frozen=True, eq=False)
class _FoldSums:
    """Normal equations of rows by fold: products of columns (folds, p, p), with the residual (folds, p)."""

    H: Array
    g: Array
    known: dict[tuple[int, ...], tuple[Array, Array]] = field(default_factory=dict, repr=False)

    def over(self, folds: Sequence[int]) -> tuple[Array, Array]:
        """Sums over some folds (p, p), (p)."""
        key = tuple(folds)
        if key not in self.known:
            self.known[key] = self.H[list(key)].sum(axis=0), self.g[list(key)].sum(axis=0)
        return self.known[key]


@dataclass(frozen=True, eq=False)
class _Selected:
    """A selected candidate and the weight of its penalty."""

    candidate: _Basis
    weight: float


@dataclass(frozen=True, eq=False)
class _Data:
    """Rows that are learned from.

    Attributes:
        X: all columns of all candidates (m, p).
        candidates: by which the columns are divided.
        segment: of each row; `fold`: of each segment.
        full, blind: residual of the fit of all blocks, and of the one without the held-out ones (m) [N].
        place: of each row among the means of a record, of `every` rows each.
    """

    X: Array
    candidates: tuple[_Basis, ...]
    segment: Index
    fold: Index
    full: Array
    blind: Array
    place: Index
    every: int

    def sums(self, residual: Array) -> _FoldSums:
        """Return the normal equations of a residual (m)."""
        folds = self.fold[self.segment]
        parts = [folds == f for f in range(int(self.fold.max()) + 1)]
        found = [(self.X[part], residual[part]) for part in parts]
        return _FoldSums(np.stack([A.T @ A for A, _ in found]), np.stack([A.T @ e for A, e in found]))

    def losses(self, rows: Mask, residual: Array, predicted: Array) -> tuple[Array, Array]:
        """Sums of squares of a record's residual before and after a prediction (m), over its rows in each segment."""
        groups = -(-len(residual) // self.every)
        force, segment = np.zeros(groups), np.zeros(groups, dtype=np.int64)
        force[self.place], segment[self.place] = predicted, self.segment
        at = np.arange(len(residual))[rows] // self.every
        # A mean that is not learned from belongs to the segment before it.
        own = np.maximum.accumulate(segment)[at]
        before, after = residual[rows] ** 2, (residual[rows] - force[at]) ** 2
        there = np.bincount(own, minlength=len(self.fold)) > 0
        sums = (np.bincount(own, weights=series, minlength=len(self.fold)) for series in (before, after))
        first, second = (np.asarray(series[there], dtype=np.float64) for series in sums)
        return first, second

    def per_segment(self, series: Array, rows: Mask) -> Array:
        """Sum of a series (m) over some rows of each segment."""
        sums = np.bincount(self.segment[rows], weights=series[rows], minlength=len(self.fold))
        return np.asarray(sums, dtype=np.float64)


def learn_residual(recording: Recording, full: Array, blind: Array, *, floor: float, material: float) -> Learned | None:
    """Learn a residual; None where nothing is gained on held-out blocks, or less than matters.

    Args:
        recording: the record.
        full: residual of the fit of all blocks (m) [N].
        blind: of the fit that has not seen the held-out blocks (m) [N].
        floor: noise of the measured friction [N].
        material: RMS gain that matters [N].
    """
    held_out = recording.rows_held_out()
    if not held_out.any() or float(np.mean(blind[held_out] ** 2)) < floor**2 + material**2:
        return None
    data = _prepare(recording, full, blind)
    if data is None:
        return None
    everything = np.ones(len(data.segment), dtype=np.bool_)
    folds = range(int(data.fold.max()) + 1)
    sums = data.sums(data.full)
    chosen = _select(data, sums, everything, data.full, tuple(folds))
    if not chosen:
        return None
    seen = data.sums(data.blind)
    predicted = np.sum(run_parallel([partial(_predict_fold, data, seen, fold) for fold in folds]), axis=0)
    before, after = data.losses(recording.used, blind, predicted)
    low, high = _gain_interval(before, after)
    total = float(np.count_nonzero(recording.used))
    gain = float((before - after).sum()) / total
    log_decision(
        "learner",
        "residual learned over coordinates of the motion, where it gains on held-out blocks",
        over=[[c.kind for c in choice.candidate.coordinates] for choice in chosen],
        gain_interval=(low, high),
        gain_N=math.copysign(math.sqrt(abs(gain)), gain),
        material_N=material,
    )
    if not (low > 0.0 and gain > material**2):
        return None
    coefficients = _solve(sums, chosen, tuple(folds))
    return Learned(
        terms=_make_terms(chosen, coefficients),
        held_out_before=math.sqrt(float(before.sum()) / total),
        held_out_after=math.sqrt(float(after.sum()) / total),
        gain_interval=(low, high),
    )


def _prepare(recording: Recording, full: Array, blind: Array) -> _Data | None:
    """Return the data of a record; None where it is too short, or nothing moves."""
    every = -(-len(recording.time) // ROWS)
    whole = row_means(recording.used.astype(np.float64), every) == 1.0
    position, velocity = (row_means(np.nan_to_num(x), every) for x in (recording.position, recording.velocity))
    left, unseen = (row_means(series, every)[whole] for series in (full, blind))
    if whole.sum() < SEGMENTS[0]:
        return None
    # Along few strokes what goes with time alone looks like a function of place, or of anything slow.
    count = min(SEGMENTS[1], _count_segments(left))
    if count < SEGMENTS[0]:
        log_decision("learner", "too few segments beside the residual's correlation", segments=count)
        return None
    segment = np.arange(int(whole.sum())) * count // int(whole.sum())
    step = every / recording.rate
    warped = {warp: x[whole] for warp, x in warp_motion(position, velocity, step).items()}
    moved, passed = np.cumsum(np.abs(velocity)) * step, np.arange(len(velocity)) * step
    X, candidates = _make_candidates(warped, segment, moved[whole], passed[whole])
    if not candidates:
        return None
    fold, _ = split_blocks(count, recording.machine)
    return _Data(
        X=X,
        candidates=candidates,
        segment=segment,
        fold=fold,
        full=left,
        blind=unseen,
        place=np.flatnonzero(whole),
        every=every,
    )


def _count_segments(residual: Array) -> int:
    """Count the segments of a residual (m) that are long beside the rows over which its autocorrelation falls."""
    e = residual - residual.mean()
    power = np.abs(np.fft.rfft(e, 2 * len(e))) ** 2
    correlation = np.fft.irfft(power)[: len(e)]
    below = correlation < CORRELATION * correlation[0]
    return int(len(e) / (LONG * max(1, int(np.argmax(below))))) if below.any() else 0


def _make_candidates(
    warped: Mapping[Warp, Array], segment: Index, moved: Array, passed: Array
) -> tuple[Array, tuple[_Basis, ...]]:
    """Return the columns of all candidates (m, p), and these.

    A memory begins where the axis has `moved` (m) [m] its length, and its lag has `passed` (m) [s]: how it came to its
    first place is not known.
    """
    columns: list[Array] = []
    candidates: list[_Basis] = []
    first = 0
    for cells, warps in _list_grids(warped):
        coordinates = tuple(_make_coordinate(w, warped[w], count) for w, count in zip(warps, cells, strict=True))
        own = [c.splines(warped[c.warp]) for c in coordinates]
        B = own[0] if len(warps) == 1 else (own[0][:, :, None] * own[1][:, None, :]).reshape(len(segment), -1)
        B[moved < max((w.scale for w in warps if w.kind == "travel"), default=0.0)] = 0.0
        B[passed < max(w.lag for w in warps)] = 0.0
        kept = _find_supported(B, segment)
        if not kept.any():
            continue
        columns.append(B[:, kept])
        penalty = _penalise([c.size for c in coordinates], kept)
        last = first + int(kept.sum())
        candidates.append(_Basis(coordinates, slice(first, last), penalty, kept))
        first = last
    return (np.hstack(columns) if columns else np.empty((len(segment), 0))), tuple(candidates)


def _list_grids(warps: Iterable[Warp]) -> list[tuple[tuple[int, ...], tuple[Warp, ...]]]:
    """Return the cells and the warps of every candidate's coordinates."""
    known = list(warps)
    return [
        (tuple(cells for _, cells in grid), chosen)
        for grid in GRIDS
        for chosen in itertools.product(*([warp for warp in known if warp.kind == kind] for kind, _ in grid))
    ]


def _make_coordinate(warp: Warp, x: Array, cells: int) -> Coordinate:
    low, high = (-1.0, 1.0) if warp.kind == "travel" else (float(x.min()), float(x.max()))
    return Coordinate(warp, low, high, cells)


def _find_supported(B: Array, segment: Index) -> Mask:
    """Return the splines (k) that two segments tell of; the others stay zero, so that the sum ends where data end."""
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    return np.asarray((np.add.reduceat(B, starts, axis=0) > SUPPORT).sum(axis=0) >= 2)


def _penalise(sizes: Sequence[int], kept: Mask) -> Array:
    """Return the penalty of second differences along each axis of a table, and a little of its entries (k, k)."""
    total = np.zeros((len(kept), len(kept)))
    places = np.arange(len(kept)).reshape(sizes)
    for axis in range(len(sizes)):
        lines = np.moveaxis(places, axis, -1).reshape(-1, sizes[axis])
        for triple in np.lib.stride_tricks.sliding_window_view(lines, 3, axis=1).reshape(-1, 3):
            if kept[triple].all():
                total[np.ix_(triple, triple)] += np.outer((1.0, -2.0, 1.0), (1.0, -2.0, 1.0))
    return np.asarray(total[np.ix_(kept, kept)] + np.eye(int(kept.sum())))


def _solve(sums: _FoldSums, chosen: Sequence[_Selected], folds: Sequence[int]) -> Array:
    """Coefficients of a choice's columns, fitted to some folds."""
    at = np.concatenate([np.arange(c.candidate.columns.start, c.candidate.columns.stop) for c in chosen])
    all_H, all_g = sums.over(folds)
    H, first = all_H[np.ix_(at, at)], 0
    for choice in chosen:
        own = slice(first, first + len(choice.candidate.penalty))
        first = own.stop
        information = float(np.trace(H[own, own])) / (own.stop - own.start) or 1.0  # folds without data: zero
        H[own, own] += choice.weight * information * choice.candidate.penalty
    return np.asarray(solve(H, all_g[at], assume_a="pos", overwrite_a=True, check_finite=False), dtype=np.float64)


def _predict(data: _Data, chosen: Sequence[_Selected], coefficients: Array, rows: Mask) -> Array:
    """Force at some rows (m) [N], zero elsewhere."""
    found, first = np.zeros(len(data.segment)), 0
    for choice in chosen:
        last = first + len(choice.candidate.penalty)
        found[rows] += data.X[rows, choice.candidate.columns] @ coefficients[first:last]
        first = last
    return found


def _select(data: _Data, sums: _FoldSums, rows: Mask, residual: Array, folds: tuple[int, ...]) -> tuple[_Selected, ...]:
    """Add the term that predicts folds best which it was not fitted to, as long as it predicts significantly better."""
    inside = np.isin(np.arange(len(data.fold)), np.flatnonzero(np.isin(data.fold, folds)))
    chosen: tuple[_Selected, ...] = ()
    left = data.per_segment(residual**2, rows)[inside]
    while len(chosen) < MOST_TERMS:
        taken = {id(choice.candidate) for choice in chosen}
        trials = [
            (*chosen, _Selected(candidate, weight))
            for candidate in data.candidates
            if id(candidate) not in taken
            for weight in PENALTIES
        ]
        losses = run_parallel([partial(_cross_losses, data, sums, t, rows, residual, folds) for t in trials])
        best = min(range(len(trials)), key=lambda k: float(losses[k].sum()))
        after = losses[best][inside]
        if not difference_statistic(after, left) > BETTER_T:
            break
        chosen, left = trials[best], after
    return chosen


def _cross_losses(
    data: _Data, sums: _FoldSums, chosen: Sequence[_Selected], rows: Mask, residual: Array, folds: Sequence[int]
) -> Array:
    """Sum of squares per segment of `_cross_residual`."""
    return data.per_segment(_cross_residual(data, sums, chosen, rows, residual, folds) ** 2, rows)


def _cross_residual(
    data: _Data, sums: _FoldSums, chosen: Sequence[_Selected], rows: Mask, residual: Array, folds: Sequence[int]
) -> Array:
    """Residual (m) [N] of rows, each fold predicted by a fit to the others."""
    left = residual.copy()
    for fold in folds:
        inside = rows & (data.fold[data.segment] == fold)
        coefficients = _solve(sums, chosen, [f for f in folds if f != fold])
        left -= _predict(data, chosen, coefficients, inside)
    return left


def _predict_fold(data: _Data, seen: _FoldSums, fold: int) -> Array:
    """Force (m) [N] at the rows of a fold, by terms that were selected and fitted on those of the others."""
    others = tuple(f for f in range(len(seen.g)) if f != fold)
    inside = data.fold[data.segment] == fold
    chosen = _select(data, seen, ~inside, data.blind, others)
    if not chosen:
        return np.zeros(len(data.segment))
    return _predict(data, chosen, _solve(seen, chosen, others), inside)


def _gain_interval(before: Array, after: Array) -> tuple[float, float]:
    """Interval of 1 - sqrt(sum after / sum before), as wide as the test of the losses per segment is unsure."""
    count, statistic = len(before), difference_statistic(after, before)
    if count < 3 or statistic == 0.0 or not before.sum() > 0.0:
        return math.nan, math.nan
    share = 1.0 - math.sqrt(float(after.sum() / before.sum()))
    reach = float(stats.t.ppf(0.5 * (1.0 + CONFIDENCE), count - 1)) * abs(share / statistic)
    return share - reach, share + reach


def _make_terms(chosen: Sequence[_Selected], coefficients: Array) -> tuple[LearnedTerm, ...]:
    """Return the terms of a choice, splines without support at zero."""
    terms, first = [], 0
    for choice in chosen:
        candidate = choice.candidate
        last = first + len(candidate.penalty)
        table = np.zeros(len(candidate.kept))
        table[candidate.kept] = coefficients[first:last]
        terms.append(LearnedTerm(candidate.coordinates, table.reshape([c.size for c in candidate.coordinates])))
        first = last
    return tuple(terms)
