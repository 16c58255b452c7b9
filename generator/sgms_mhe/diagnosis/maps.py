"""The search for a force that repeats with position: its period, and which orders of it the record carries.

At a given period the force is linear in the amplitudes. Sums over bins of the period, per fold of the cross-validation,
then stand for all rows: the orders are taken up one after the other, the one that explains most first, as long as folds
that did not see them gain by it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Final, Self

import numpy as np

from sgms_mhe.diagnosis.harmonics import CUTOFF_BAND, PITCH_BAND, STEP, search_harmonic
from sgms_mhe.diagnosis.proposals import Proposal, Residual, energy, nearest_peak, propose
from sgms_mhe.model.effects import EffectDefinition
from sgms_mhe.model.effects.search import Periodic
from sgms_mhe.recordings.evidence import Nuisance, score_test
from sgms_mhe.recordings.series import bin_sums
from sgms_mhe.support.arrays import Array, Index, Mask
from sgms_mhe.support.parallel import run_parallel

BINS_PER_PERIOD: Final = 16  # of the shortest: a bin then loses 0.6 % of a sine
MOST_SINES: Final = 32
LARGEST_PART: Final = 12  # the strongest sine's order in the map, at most, where no turn says what the period is
FAST_ROWS: Final = 0.2  # share of the rows that may be too fast for the highest order
LEAST_SHARE: Final = 0.02  # of what the orders before it gained: RMS on unseen folds that an order must gain
SAME_PERIOD: Final = 3e-3
PERIODS_REFINED: Final = 3
FEW: Final = 3  # sines of a map, one of them its first, whose period is not doubted
RELATED_REFINED: Final = 8
STRONGEST: Final = 3  # of a map's sines: those that may be of other orders at the right period
PASSES: Final = 1.6  # of a period that a record must hold: of less a sine is a trend, told by nothing but itself
NOTHING: Final = 1e-8  # of a column's square: what must be left of it beside the others
ENTRY_GAIN: Final = 0.4
"""RMS that an entry of an effect's lists must gain on unseen folds [gain that matters]: a sine of a map that gains less
is none."""


@dataclass(frozen=True)
class _Carried:
    """A period, the orders the record carries at it, the one that explains most first, and their residual.

    `left`: sum of squares on unseen folds [N^2].
    """

    period: float
    orders: tuple[int, ...]
    left: float


@dataclass(frozen=True, eq=False)
class _BinMoments:
    """Sums over the bins of a period, by fold, from which products of its columns come, the nuisance projected out.

    Attributes:
        columns: sine and cosine of every order at the bins' middles (bins, 2 n).
        count: rows in a bin (folds, bins).
        target: products with the residual (folds, 2 n).
        mixed: with the nuisance (folds, p, 2 n).
        own: of the nuisance with itself (folds, p, p).
    """

    columns: Array
    count: Array
    target: Array
    mixed: Array
    own: Array

    def square(self) -> Array:
        """Products of all columns over all rows (2 n, 2 n)."""
        C = self.mixed.sum(axis=0)
        return np.asarray(self.columns.T @ (self.count.sum(axis=0)[:, None] * self.columns) - C.T @ C)

    def squares(self, places: list[int]) -> Array:
        """Those of some columns by fold (folds, k, k)."""
        F, mixed = self.columns[:, places], self.mixed[:, :, places]
        C = mixed.sum(axis=0)
        cross = mixed.transpose(0, 2, 1) @ C
        found = (self.count[:, None, :] * F.T) @ F - cross - cross.transpose(0, 2, 1) + C.T @ self.own @ C
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class _Beside:
    """Part of a search no period changes.

    Attributes:
        fold: of each used row.
        own: products of the nuisance with itself (folds, p, p).
        target: with the residual (folds, p).
    """

    fold: Index
    own: Array
    target: Array

    @classmethod
    def of(cls, seen: Residual) -> Self:
        """Return those of a residual and the nuisance beside it."""
        recording = seen.recording
        fold = recording.fold[recording.block[recording.used]]
        rows = [fold == f for f in range(int(recording.fold.max()) + 1)]
        parts = [(seen.free.basis[inside], seen.e[inside]) for inside in rows]
        return cls(fold, np.stack([Q.T @ Q for Q, _ in parts]), np.stack([Q.T @ e for Q, e in parts]))


@dataclass(frozen=True, eq=False)
class _Search:
    """A record that maps are looked for in.

    Attributes:
        kind: names of the map's parameters.
        seen: the residual.
        beside: sums no period changes.
        x: position on used rows [m].
        slow: rows that are not too fast for the finest sine.
        finest: the most periods per metre that rows and filters let pass [1/m].
        material: RMS gain that matters [N].
    """

    kind: Periodic
    seen: Residual
    beside: _Beside
    x: Array
    slow: Mask
    finest: float
    material: float

    @property
    def travel(self) -> float:
        """Range of position [m]."""
        return float(np.ptp(self.x))

    @cached_property
    def longest(self) -> float:
        """The longest period of a sine [m], from the way out and from how far the axis came back."""
        rise = float(np.max(self.x - np.minimum.accumulate(self.x)))
        fall = float(np.max(np.maximum.accumulate(self.x) - self.x))
        return min(self.kind.room * self.travel, (self.travel + min(rise, fall)) / PASSES)

    @property
    def least_gain(self) -> float:
        """Sum of squares one order has to explain [N^2]."""
        return (ENTRY_GAIN * self.material) ** 2 * len(self.x)

    def carried(self, period: float) -> _Carried:
        """Orders of a period that gain on unseen folds, one after the other."""
        highest = min(int(self.kind.order.upper), int(period * self.finest))
        lowest = math.ceil(period / self.longest)
        start = left = float(self.seen.e @ self.seen.e)
        taken: list[int] = []
        if highest < lowest:
            return _Carried(period, (), left)
        moments = _moments(self.seen, self.beside, self.x, self.slow, period, highest)
        H, b = moments.square(), moments.target.sum(axis=0)
        while len(taken) < min(highest + 1 - lowest, MOST_SINES):
            best = _most(H, b, taken, lowest)
            if best is None:
                break
            trial = start - _unseen_gain(moments, _places([*taken, best]))
            enough = max(self.least_gain, LEAST_SHARE**2 * (start - left))
            if left - trial < enough:
                break
            taken.append(best)
            left = trial
        return _Carried(period, tuple(n + 1 for n in taken), left)

    def refined(self, carried: _Carried) -> float:
        """The period near a carried one that explains most; of one half a period off over the travel others begin."""
        best = carried.period
        if not carried.orders:
            return best
        width = STEP * best**2 / (self.travel * max(carried.orders[:STRONGEST]))
        gathered, x, root = _gather(self.seen, self.x, best / (BINS_PER_PERIOD * max(carried.orders)))

        def columns(period: float) -> Array:
            return np.asarray(root[:, None] * _columns(x, period, carried.orders))

        return nearest_peak(gathered, columns, best, width, self.longest * min(carried.orders))

    def nearest(self, carried: _Carried) -> _Carried:
        """Return the orders the record carries at the refined period."""
        return self.carried(self.refined(carried))

    def simplest(self, found: Sequence[_Carried]) -> _Carried:
        """The one of the fewest sines that is nearly as good as the best; of equals the one of the shortest period."""
        least = min(c.left for c in found)
        explained = float(self.seen.e @ self.seen.e) - least
        enough = max(self.material**2 * len(self.x), LEAST_SHARE**2 * explained)
        good = [c for c in found if c.left - least <= enough]
        few = [c for c in good if len(c.orders) == min(len(g.orders) for g in good)]
        least = min(c.left for c in few)
        return min((c for c in few if c.left - least <= self.least_gain), key=lambda c: c.period)

    def search_related(self, best: _Carried) -> list[_Carried]:
        """Return the orders the record carries at other periods of the same force.

        All multiples of a period are periods too. And where a period is wrong, its sines are none the less about where
        those of the right one are, though of other orders.
        """
        wide = max(best.orders, default=1)
        parts = {best.period / g for g in range(2, wide + 1) if sum(n % g == 0 for n in best.orders) > 1}
        exact = run_parallel([partial(self.carried, period) for period in sorted(parts)])
        if len(best.orders) <= FEW and 1 in best.orders:
            return exact
        strongest = best.orders[:STRONGEST]
        periods = {best.period * k / n for n in strongest for k in range(1, LARGEST_PART + 1) if k != n}
        tried = sorted(period for period in periods if period <= self.longest)
        about = run_parallel([partial(self.carried, period) for period in tried])
        nearby = sorted((c for c in about if c.orders), key=lambda c: c.left)[:RELATED_REFINED]
        return exact + run_parallel([partial(self.nearest, c) for c in nearby])


def _most(H: Array, b: Array, taken: Sequence[int], lowest: int) -> int | None:
    """The order (from 0) that explains most beside those taken, of the `lowest` (from 1) on; None where none does."""
    inside = _places(taken)
    W = np.linalg.lstsq(H[np.ix_(inside, inside)], H[inside], rcond=1e-12)[0] if taken else H[:0]
    rest, square = b - W.T @ b[inside], H - H[:, inside] @ W
    gains = _pair_energies(rest, square, NOTHING * float(np.diag(H).max()) ** 2)
    gains[: lowest - 1] = 0.0
    gains[list(taken)] = 0.0
    best = int(np.argmax(gains))
    return best if gains[best] > 0.0 else None


def search_periodic(definition: EffectDefinition, kind: Periodic, seen: Residual) -> Proposal | None:
    """The map that explains most on data it has not seen; None where one sine does as well."""
    search = _make_search(kind, seen)
    if search is None:
        return None
    periods = _periods(definition, search)
    found = run_parallel([partial(search.carried, period) for period in periods])
    found = sorted((c for c in found if c.orders), key=lambda c: c.left)[:PERIODS_REFINED]
    if not found:
        return None
    best = min(run_parallel([partial(search.nearest, c) for c in found]), key=lambda c: c.left)
    chosen = search.nearest(search.simplest([best, *search.search_related(best)]))
    orders = tuple(sorted(chosen.orders))
    if len(orders) < 2:
        return None
    Z = seen.free.project(_columns(search.x, chosen.period, orders))

    def parameters(size: Array) -> Mapping[str, float]:
        values = {kind.sine.period: chosen.period}
        for i, order in enumerate(orders, start=1):
            values[kind.order.entry(i)] = float(order)
            values[definition.parameter(kind.sine.size).entry(i)] = float(size[2 * i - 2])
            values[definition.parameter(kind.cosine).entry(i)] = float(size[2 * i - 1])
        return values

    tests = max(1.0, search.travel * search.finest)
    proposal = propose(definition, seen, Z, tests, parameters)
    # The strongest of its sines proves that it is there; a map has more columns than blocks can tell apart.
    energies = [energy(Z[:, 2 * i : 2 * i + 2], seen.e) for i in range(len(orders))]
    strongest = int(np.argmax(energies))
    p, _ = score_test(seen.recording, Z[:, 2 * strongest : 2 * strongest + 2], seen.e)
    return replace(proposal, p_value=min(1.0, p * tests))


def _make_search(kind: Periodic, seen: Residual) -> _Search | None:
    """Return the part of a record a search can use; None where nothing moves."""
    used, motion = seen.recording.used, seen.motion
    x, speed = motion.position[used], np.abs(motion.velocity[used])
    slow = speed <= float(np.quantile(speed, 1.0 - FAST_ROWS))
    fastest = float(speed[slow].max(initial=0.0))
    if float(np.ptp(x)) <= 0.0 or fastest <= 0.0:
        return None
    machine = seen.recording.machine
    limit = min(PITCH_BAND * motion.extents.rate, CUTOFF_BAND * machine.sampling.velocity_cutoff)
    return _Search(
        kind, seen, _Beside.of(seen), x, slow, limit / fastest, machine.diagnosis.material * machine.friction.coulomb
    )


def _periods(definition: EffectDefinition, search: _Search) -> list[float]:
    """Periods to try, the shortest first: small multiples of the strongest sines', the whole travel, and a turn.

    A record may show a turn's shorter sines alone.
    """
    kind, seen = search.kind, search.seen
    sines = search_harmonic(definition, kind.sine, seen)
    periods = [p.parameters[kind.sine.period] * k for p in sines for k in range(1, LARGEST_PART + 1)]
    periods = [p for p in (*periods, search.travel, kind.room * search.travel) if p <= search.longest]
    if seen.recording.machine.plant.kind == "rotary":
        periods += [math.tau]
    kept: list[float] = []
    for period in sorted(periods):
        if not kept or period > (1.0 + SAME_PERIOD) * kept[-1]:
            kept.append(period)
    return kept


def _columns(x: Array, period: float, orders: Sequence[int]) -> Array:
    """Sine and cosine of every order (rows, 2 orders)."""
    angle = math.tau / period * x
    return np.column_stack([f(order * angle) for order in orders for f in (np.sin, np.cos)])


@lru_cache(maxsize=8)
def _middle_columns(highest: int) -> Array:
    """The columns of all orders at the middles of a period's bins; not to be written to: most periods have the same."""
    bins = BINS_PER_PERIOD * highest
    return _columns((np.arange(bins) + 0.5) / bins, 1.0, range(1, highest + 1))


def _gather(seen: Residual, x: Array, width: float) -> tuple[Residual, Array, Array]:
    """Rows that are so near to each other in x that no column changes between them, as one each: (bins) of them.

    Their mean x, and the root of their count. Columns at the one times the other have the products the rows' own
    ones have.
    """
    _, place, count = np.unique(np.floor((x - x.min()) / width), return_inverse=True, return_counts=True)
    root = np.sqrt(count)

    def summed(series: Array) -> Array:
        return np.asarray(np.bincount(place, weights=series) / root)

    basis = np.array([summed(column) for column in seen.free.basis.T]).reshape(-1, len(root)).T
    gathered = replace(seen, free=Nuisance(basis), e=summed(seen.e))
    return gathered, np.asarray(summed(x) / root), root


def _places(orders: Sequence[int]) -> list[int]:
    return [2 * n + k for n in orders for k in (0, 1)]


def _pair_energies(target: Array, square: Array, least: float) -> Array:
    """Return the gain of each sine and its cosine; `least`: determinant that separates them from it."""
    s, c = target[0::2], target[1::2]
    diagonal = np.diag(square)
    ss, cc, sc = diagonal[0::2], diagonal[1::2], np.diag(square, 1)[0::2]
    determinant = ss * cc - sc**2
    good = (ss > 0.0) & (determinant > least)
    found = (cc * s**2 - 2.0 * sc * s * c + ss * c**2) / np.where(good, determinant, 1.0)
    return np.asarray(np.where(good, found, 0.0))


def _unseen_gain(moments: _BinMoments, places: list[int]) -> float:
    """Sum of squares that columns explain, each fold by a fit of the others."""
    H, b = moments.squares(places), moments.target[:, places, None]
    size = np.linalg.pinv(H.sum(axis=0) - H, rcond=1e-10, hermitian=True) @ (b.sum(axis=0) - b)
    return float(np.sum(size * (2.0 * b - H @ size)))


def _moments(seen: Residual, beside: _Beside, x: Array, slow: Mask, period: float, highest: int) -> _BinMoments:
    """Products of the columns of a period, from sums over its bins; rows too fast for its orders have columns of 0."""
    Q, fold = seen.free.basis, beside.fold
    folds, bins = len(beside.own), BINS_PER_PERIOD * highest
    turns = x / period
    place = np.minimum(bins - 1, (bins * (turns - np.floor(turns))).astype(np.int64))
    key, counts = fold * bins + place, slow.astype(np.float64)

    def binned(series: Array) -> Array:
        """Sums of series (rows, k) over the slow rows of each bin (folds, k, bins)."""
        return np.asarray(bin_sums(series, counts, key, folds * bins).reshape(folds, bins, -1).transpose(0, 2, 1))

    F = _middle_columns(highest)
    count, target = binned(np.ones((len(x), 1)))[:, 0], binned(seen.e[:, None])[:, 0]
    mixed = np.asarray(binned(Q) @ F)
    product = target @ F - beside.target @ mixed.sum(axis=0)
    return _BinMoments(F, count, product, mixed, beside.own)
