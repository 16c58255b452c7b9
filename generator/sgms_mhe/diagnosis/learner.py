"""A residual with no name, learned: one sum of smooth functions of place, speed and travel since a reversal.

All functions are fitted at once, as tables of cubic B-splines that end in zero where the data end; their sizes are told
by the evidence of the record (`evidence_fit.py`). A force that wanders with time is fitted beside them, and predicts
nothing. The gain is measured on long parts of the record, each predicted by a fit to the others.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from sgms_mhe.diagnosis.coordinates import Coordinate, Kind, Warp, warp_motion
from sgms_mhe.diagnosis.criteria import GAIN_SHARE
from sgms_mhe.diagnosis.evidence_fit import Design, EvidenceFit, SmoothGroup, fit_evidence, fit_without
from sgms_mhe.diagnosis.learned import Learned, LearnedTerm
from sgms_mhe.recordings.evidence import difference_statistic
from sgms_mhe.recordings.recording import ROWS_MIN, Recording
from sgms_mhe.recordings.series import row_means
from sgms_mhe.support.arrays import Array, Index, Mask
from sgms_mhe.support.decisions import log_decision

ROWS: Final = 5000
"""Means of a record that are learned from, at most [1]."""
PARTS: Final = 24
LEAST_PARTS: Final = 3
"""Parts of a record, at most and at least, each of which is predicted by the others [1]."""
CORRELATION: Final = 0.2
"""Autocorrelation of the residual that ends its correlation time [1]."""
LONG: Final = 2.0
"""Length of a part, at least, so that none is told by its neighbours [correlation times]."""
WANDER: Final = 12
"""Cells of the curve over time of a force that wanders [1]."""
BLOCKS: Final[tuple[tuple[tuple[Kind, int], ...], ...]] = (
    (("place", 16),),
    (("speed", 12),),
    (("travel", 8),),
    (("late speed", 6),),
    (("place", 64), ("speed", 1)),
    (("place", 9), ("speed", 5)),
    (("place", 9), ("travel", 2)),
    (("speed", 4), ("travel", 3)),
)
"""Coordinates of the functions, and cells of the grid over each; for each length and lag there is one. A ripple of a
gear may be finer over place than anything is over speed, and shifted from one direction to the other."""
SUPPORT: Final = 1.0
"""Rows under a spline from which the record tells of it [1]."""
SURE: Final = 0.98
"""Confidence of the interval of a gain: above zero is that of noise in one of a hundred."""
SMALL: Final = 0.01
"""Force of a function that is left out [RMS of the residual]."""


def learn_residual(recording: Recording, full: Array, blind: Array, *, floor: float, material: float) -> Learned | None:
    """Learn a residual; None where nothing is gained on held-out data, or less than matters.

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
    every = -(-len(recording.time) // ROWS)
    whole = row_means(recording.used.astype(np.float64), every) == 1.0
    if whole.sum() < ROWS_MIN:
        return None
    terms = _make_terms(recording, every, whole)
    if not terms:
        return None
    place = np.flatnonzero(whole)
    residual, unseen = (row_means(series, every)[whole] for series in (full, blind))
    # Along few strokes what goes with time alone looks like a function of place, or of anything slow.
    parts = min(PARTS, _count_parts(residual))
    if parts < LEAST_PARTS:
        return None
    part = np.arange(len(place)) * parts // len(place)
    design, fit = _fit(terms, residual, part)
    predicted = np.zeros(len(whole))
    for k, b in enumerate(fit_without(design, design.sum_parts(unseen, part), fit)):
        predicted[place[part == k]] = design.X[part == k] @ b
    at = np.minimum(np.arange(len(blind)) // every, len(whole) - 1)
    of_row = part[np.minimum(np.searchsorted(place, at), len(part) - 1)]
    used = recording.used
    before, after = (
        np.bincount(of_row[used], series[used] ** 2, parts).astype(np.float64)
        for series in (blind, blind - predicted[at])
    )
    low, high = _gain_interval(before, after)
    total = float(np.count_nonzero(used))
    gain = float((before - after).sum()) / total
    beyond = max(0.0, float(before.sum()) / total - floor**2)
    least = max(material, GAIN_SHARE * math.sqrt(beyond))  # as of a cause
    log_decision(
        "learner",
        "residual learned over coordinates of the motion, where it gains on held-out data",
        rows_of_one=fit.tau,
        gain_interval=(low, high),
        gain_N=math.copysign(math.sqrt(abs(gain)), gain),
        least_gain_N=least,
    )
    if not (low > 0.0 and gain > least**2):
        return None
    return Learned(
        terms=_solve_terms(terms, residual, part, design, fit),
        held_out_before=math.sqrt(float(before.sum()) / total),
        held_out_after=math.sqrt(float(after.sum()) / total),
        gain_interval=(low, high),
        unseen=predicted[at],
    )


def _count_parts(residual: Array) -> int:
    """Count the parts of a residual (m) that are long beside the rows over which its autocorrelation falls."""
    e = residual - residual.mean()
    correlation = np.fft.irfft(np.abs(np.fft.rfft(e, 2 * len(e))) ** 2)[: len(e)]
    below = correlation < CORRELATION * correlation[0]
    return int(len(e) / (LONG * max(1, int(np.argmax(below))))) if below.any() else 0


@dataclass(frozen=True, eq=False)
class _SplineTerm:
    """A function to be fitted: its splines (m, k) along the rows learned from."""

    coordinates: tuple[Coordinate, ...]
    splines: Array


def _make_terms(recording: Recording, every: int, whole: Mask) -> list[_SplineTerm]:
    """Return all functions of a record's motion, means over `every` rows of which `whole` are learned from.

    A memory begins where the axis has moved its length, and a lag where it has passed: how the axis came to its first
    place is not known.
    """
    position, velocity = (row_means(np.nan_to_num(x), every) for x in (recording.position, recording.velocity))
    step = every / recording.rate
    warped = {warp: x[whole] for warp, x in warp_motion(position, velocity, step).items()}
    moved, passed = (np.cumsum(x)[whole] * step for x in (np.abs(velocity), np.ones(len(velocity))))
    terms = []
    for block in BLOCKS:
        choices = ([warp for warp in warped if warp.kind == kind] for kind, _ in block)
        for warps in itertools.product(*choices):
            coordinates = tuple(
                Coordinate(w, *((-1.0, 1.0) if w.kind == "travel" else (float(x.min()), float(x.max()))), n)
                for w, x, (_, n) in zip(warps, map(warped.__getitem__, warps), block, strict=True)
            )
            own = [c.splines(warped[c.warp]) for c in coordinates]
            B = own[0] if len(own) == 1 else (own[0][:, :, None] * own[1][:, None, :]).reshape(len(moved), -1)
            B[moved < max((w.scale for w in warps if w.kind == "travel"), default=0.0)] = 0.0
            B[passed < max(w.lag for w in warps)] = 0.0
            terms.append(_SplineTerm(coordinates, B))
    return terms


def _penalise(sizes: Sequence[int]) -> Array:
    """Return the penalty of second differences along each axis of a table (k, k)."""
    total = np.zeros((math.prod(sizes),) * 2)
    for axis, size in enumerate(sizes):
        D = np.diff(np.eye(size), 2, axis=0)
        before, behind = np.eye(math.prod(sizes[:axis])), np.eye(math.prod(sizes[axis + 1 :]))
        total += np.kron(np.kron(before, D.T @ D), behind)
    return total


def _fit(terms: Sequence[_SplineTerm], residual: Array, part: Index) -> tuple[Design, EvidenceFit]:
    """Fit all functions, and a force that wanders with time, to a residual (m) of numbered parts (m)."""
    wander = Coordinate(Warp("place", 1.0), 0.0, float(len(part)), WANDER)
    groups = [SmoothGroup(term.splines, _penalise([c.size for c in term.coordinates])) for term in terms]
    groups.append(
        SmoothGroup(wander.splines(np.arange(len(part), dtype=np.float64)), _penalise((wander.size,)), nuisance=True)
    )
    design = Design.of(groups)
    return design, fit_evidence(design, design.sum_parts(residual, part))


def _solve_terms(
    terms: Sequence[_SplineTerm], residual: Array, part: Index, design: Design, fit: EvidenceFit
) -> tuple[LearnedTerm, ...]:
    """Return the functions with a force worth a table, fitted without the others.

    A spline without data is limited to the range between the least and the largest force of its function on the data.
    """
    least = SMALL * float(np.sqrt(np.mean(residual**2)))
    own = zip(terms, design.split(fit.b), strict=False)  # the last ones are of time
    kept = [term for term, b in own if float(np.sqrt(np.mean((term.splines @ b) ** 2))) > least]
    design, fit = _fit(kept, residual, part)
    found = []
    for term, b in zip(kept, design.split(fit.b), strict=False):
        force = term.splines @ b
        told = term.splines.sum(axis=0) > SUPPORT
        held = np.where(told, b, np.clip(b, force.min(), force.max()))
        found.append(LearnedTerm(term.coordinates, held.reshape([c.size for c in term.coordinates])))
    return tuple(found)


def _gain_interval(before: Array, after: Array) -> tuple[float, float]:
    """Interval of 1 - sqrt(sum after / sum before), as wide as the test of the losses per part is unsure."""
    there = before > 0.0
    count, statistic = int(there.sum()), difference_statistic(after[there], before[there])
    if count < 3 or statistic == 0.0:
        return math.nan, math.nan
    share = 1.0 - math.sqrt(float(after.sum() / before.sum()))
    reach = float(stats.t.ppf(0.5 * (1.0 + SURE), count - 1)) * abs(share / statistic)
    return share - reach, share + reach
