"""Origin of an axis's position after a power-up, found by the forces over place along a first stretch of motion.

The machine's friction is run with its position counted from many origins; offset, level and damping, which belong to
the power-up, are projected out. The origin that leaves least is stated where three things hold:

- on blocks that had no say in it, it leaves less than the mean of the forces at all origins, which knows no place;
- every other origin that was tried leaves more, by more than the scatter of that difference over blocks;
- it is not at the end of the tried range.

Otherwise it is not determined, and the reason is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from scipy import stats

from sgms_mhe.diagnosis.alignment import decimate, find_sampling_columns, in_step
from sgms_mhe.diagnosis.fits import Subject
from sgms_mhe.diagnosis.other_record import Origin
from sgms_mhe.diagnosis.parametrisation import TIMING, TIMING_MOST
from sgms_mhe.diagnosis.record_fit import RecordFit, shift_position
from sgms_mhe.diagnosis.uncertainty import FLOOR_SURE, HOLD_TIMING
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.evidence import (
    UNSEEN_ERROR,
    Nuisance,
    find_nuisance,
    gain_force,
    gain_interval,
    invert_information,
    noise_floor,
    robust_covariance,
)
from sgms_mhe.recordings.excerpt import make_excerpt
from sgms_mhe.recordings.recording import Recording, prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.parallel import run_parallel

A_PERIOD: Final = 8
"""Origins tried per period of the shortest sine [1]: the nearest one leaves 4 % of its power."""
A_SPAN: Final = 64
"""Origins tried, at least, where nothing repeats [1]."""
MOST: Final = 800
"""Origins tried, at most [1]: a run of the model each."""
SETTLED: Final = 3
"""Steps of an origin together with what belongs to the record [1]: each by the model's derivatives."""
FORCE_OF_PLACE: Final = 1e-9
"""Change of friction by another origin, from which on it depends on the place [Coulomb level]."""
LENGTH: Final = "_m"
"""End of the name of a period in position."""
FINER: Final = 8
"""Times that an origin is refined, each to half of the distance [1]."""
CONTENDERS: Final = 12
"""Least residuals along the origins tried that are refined, at most [1]."""
CHANCE: Final = 1e-3
"""Chance that the right origin is excluded though it is another one's equal [1], over all that were tried."""
GROUPS: Final = 6
"""Groups of neighbouring blocks that a scatter is taken over, at least [1]: errors of a model last longer than one."""


def find_origin(machine: Machine, log: Log, within: float | None = None) -> Origin:
    """Find the position the forces over place of a machine count from in a log.

    Args:
        machine: whose effects read the place.
        log: a first stretch of motion after a power-up.
        within: how far from position 0 the origin may be [m]; None: anywhere, where the forces repeat.

    Raises:
        InputError: a log that does not fit the machine; no `within` where the forces over place do not repeat.
        FitError: the model is not finite along it.
    """
    reach = math.inf if within is None else within
    return search_origin(machine, log, -reach, reach)


def search_origin(machine: Machine, log: Log, least: float, most: float) -> Origin:
    """Find the origin between two positions [m]; see `find_origin`."""
    search = _OriginSearch.of(machine, log)
    pitches = find_pitches(machine)
    shortest, period = min(pitches, default=0.0), max(pitches, default=0.0)
    probe = (shortest or min(most - least, search.travel)) / A_PERIOD
    if search.is_same(probe) and search.is_same(math.pi * probe):
        return _leave_open(f"no force of {machine.name} tells the origin along this motion")
    repeats = most - least >= period > 0.0 and search.is_same(period)
    if repeats:
        middle = min(max(0.0, least + 0.5 * period), most - 0.5 * period)
        least, most = middle - 0.5 * period, middle + 0.5 * period
    if math.isinf(most - least):
        allowed = "how far from 0 the origin may be: the forces over place do not repeat"
        raise InputError(machine.name, "within", "none", allowed)
    tried = search.try_origins(least, most, shortest, repeats=repeats)
    if tried is None:
        return _leave_open(f"its forces change too fast over place for {MOST} origins within that range")
    return _judge(search, tried, period if repeats else None)


@dataclass(frozen=True, eq=False)
class _OriginSearch:
    """A machine along a record, counted from one origin or another.

    Attributes:
        fit: the machine, its own numbers fixed.
        free: columns of the record's own numbers (rows used, p), orthonormal.
        here: friction with the origin at 0 (m) [N].
        columns: its derivatives in the record's own numbers (m, p), first in the age of the force, but for the sign.
    """

    fit: RecordFit
    free: Nuisance
    here: Array
    columns: Array

    @classmethod
    def of(cls, machine: Machine, log: Log) -> _OriginSearch:
        """Prepare a log, its force in step with its position, and the machine's model along it."""
        search = cls._along(machine, log)
        age, most = search.find_age(), TIMING_MOST * machine.sampling.step
        return cls._along(machine, in_step(log, age)) if TIMING * machine.sampling.step < abs(age) <= most else search

    @classmethod
    def _along(cls, machine: Machine, log: Log) -> _OriginSearch:
        fit = RecordFit.of(decimate(Subject.of(machine, make_excerpt(prepare(machine, log)))))
        recording = fit.subject.recording
        here, jacobian = fit.model.run(recording, fit.theta)
        if jacobian is None or not np.all(np.isfinite(jacobian)):
            raise InputError(log.source or "log", "friction", "not finite", "a motion that the model follows")
        sampled = find_sampling_columns(fit.subject, here)
        columns = np.column_stack((sampled, jacobian[:, fit.free()]))
        return cls(fit, find_nuisance(columns[recording.used]), here, columns)

    def find_age(self) -> float:
        """Return the age of the logged force against the position [s]."""
        recording = self.recording
        rest = (recording.friction - self.here)[recording.used]
        return -float(np.linalg.lstsq(self.columns[recording.used], rest, rcond=None)[0][0])

    @property
    def recording(self) -> Recording:
        """The record, as it was logged."""
        return self.fit.subject.recording

    @property
    def travel(self) -> float:
        """Range of its positions [m]."""
        return float(np.ptp(self.recording.position[self.recording.used]))

    def at(self, origin: float) -> RecordFit:
        """Return the machine and its record counted from an origin [m]."""
        subject = self.fit.subject
        return replace(self.fit, subject=replace(subject, recording=shift_position(subject.recording, -origin)))

    def friction(self, origin: float, theta: Array | None = None) -> Array:
        """Return the friction (m) [N] counted from an origin [m], of the machine or of other numbers (n_p)."""
        shifted = shift_position(self.recording, -origin)
        return self.fit.model.run(shifted, self.fit.theta if theta is None else theta, derivatives=False)[0]

    def rest(self, origin: float) -> Array:
        """Return the residual of an origin (rows used) [N]."""
        return self.free.project((self.recording.friction - self.friction(origin))[self.recording.used])

    def is_same(self, origin: float) -> bool:
        """Return True if the friction from another origin is that from 0, but for the record's own numbers."""
        change = (self.friction(origin) - self.here)[self.recording.used]
        largest = float(np.max(np.abs(self.free.project(change))))
        return largest < FORCE_OF_PLACE * self.fit.subject.machine.friction.coulomb

    def try_origins(self, least: float, most: float, pitch: float, *, repeats: bool) -> _Tried | None:
        """Run the model from origins between two [m], close enough that neighbours are alike.

        Returns None where that takes too many.
        """
        count = math.ceil(max((most - least) * A_PERIOD / pitch if pitch > 0.0 else A_SPAN, A_PERIOD))
        while count <= MOST:
            origins = np.linspace(least, most, count + 1)[: count if repeats else count + 1]
            rests = np.array(run_parallel([partial(self.rest, float(origin)) for origin in origins]))
            spread = float(np.mean(np.sum((rests - rests.mean(axis=0)) ** 2, axis=1)))
            if float(np.max(np.sum(np.diff(rests, axis=0) ** 2, axis=1))) <= spread:
                return _Tried(origins, rests, (most - least) / count, repeats)
            count *= 2
        return None

    def refine(self, origin: float, step: float, rows: Mask) -> float:
        """Return the origin [m] near one that leaves least on some of the used rows."""

        def left(at: float) -> float:
            return float(np.sum(self.rest(at)[rows] ** 2))

        best, cost = origin, left(origin)
        for _ in range(FINER):
            step *= 0.5
            best, cost = min(
                [(best, cost), *((at, left(at)) for at in (best - step, best + step))], key=lambda pair: pair[1]
            )
        return best

    def sum_blocks(self, series: Array) -> Array:
        """Sum over each block: (rows used) to (blocks)."""
        recording = self.recording
        sums = np.bincount(recording.block[recording.used], weights=series, minlength=recording.blocks)
        return np.asarray(sums, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Tried:
    """Origins that were tried.

    Attributes:
        origins: in ascending order (k) [m]. step: between them [m].
        rests: residual of each (k, rows used) [N].
        repeats: the last one is the first one's neighbour.
    """

    origins: Array
    rests: Array
    step: float
    repeats: bool

    def distance(self, one: float, other: float) -> float:
        """Return the distance of two origins [m], the short way round where they repeat."""
        apart, span = abs(one - other), self.step * len(self.origins)
        return min(apart, abs(span - apart)) if self.repeats else apart

    def minima(self, rows: Mask) -> list[float]:
        """Return origins that leave less than both neighbours on some rows, least first."""
        costs = np.sum(self.rests[:, rows] ** 2, axis=1)
        before, after = np.roll(costs, 1), np.roll(costs, -1)
        if not self.repeats:
            before[0] = after[-1] = math.inf
        found = np.flatnonzero((costs <= before) & (costs <= after))
        return [float(self.origins[k]) for k in found[np.argsort(costs[found], kind="stable")]]


def _judge(search: _OriginSearch, tried: _Tried, period: float | None) -> Origin:
    """Return the best origin, or why there is none."""
    every, held = np.ones(tried.rests.shape[1], dtype=np.bool_), search.recording.rows_held_out()[search.recording.used]
    gain, lower = _held_out_gain(search, tried, held)
    starts = tried.minima(every)[:CONTENDERS]
    refined = run_parallel([partial(search.refine, start, tried.step, every) for start in starts])
    rests = {origin: search.rest(origin) for origin in refined}
    best = min(rests, key=lambda origin: float(rests[origin] @ rests[origin]))
    if not lower > 0.0:
        return _leave_open("knowing the place gains nothing on held-out blocks of this motion", gain)
    others = _equals(search, tried, rests, best)
    if others:
        named = ", ".join(f"{origin:.6g}" for origin in others[:3])
        return _leave_open(f"other origins fit as well: {named} beside {best:.6g}", gain, (best, *others))
    if not tried.repeats and not tried.origins[1] <= best <= tried.origins[-2]:
        return _leave_open("the best one is at the end of the range that was tried", gain)
    found, deviation = _settle(search, best, tried.step)
    return Origin(found, deviation, period, (found,), gain, "")


def _leave_open(reason: str, gain: float = 0.0, candidates: tuple[float, ...] = ()) -> Origin:
    return Origin(None, None, None, candidates, gain, reason)


def _held_out_gain(search: _OriginSearch, tried: _Tried, held: Mask) -> tuple[float, float]:
    """Return the gain [N] of the origin the other blocks choose, on the held-out ones, and its lower end."""
    recording = search.recording
    chosen = search.refine(tried.minima(~held)[0], tried.step, ~held)
    blind, seeing = (search.sum_blocks(rest**2) for rest in (tried.rests.mean(axis=0), search.rest(chosen)))
    rows, blocks = search.sum_blocks(np.ones(len(held))), recording.held_out
    part = blind[blocks], seeing[blocks], rows[blocks]
    return gain_force(*part), gain_interval(*part)[0]


def _equals(search: _OriginSearch, tried: _Tried, rests: dict[float, Array], best: float) -> list[float]:
    """Return origins that leave no more than the best one, but for the scatter of that over blocks: one of each valley.

    Its own valley does not count: the deviation describes it.
    """
    at_best = rests[best]
    quantile = float(stats.t.isf(CHANCE / len(tried.origins), GROUPS - 1))

    def is_excluded(rest: Array) -> bool:
        more = float(rest @ rest - at_best @ at_best)
        return more > 2.0 * quantile * math.sqrt(_scatter(search.sum_blocks(at_best * (rest - at_best))))

    excluded = [is_excluded(rest) for rest in tried.rests]
    count, here = len(excluded), int(np.argmin(np.abs(tried.origins - best)))
    valley = {here}
    for way in (-1, 1):
        for k in range(1, count):
            at = here + way * k
            if (not tried.repeats and not 0 <= at < count) or excluded[at % count]:
                break
            valley.add(at % count)
    found = {float(tried.origins[k]): tried.rests[k] for k in range(count) if not excluded[k] and k not in valley}
    found |= {at: rest for at, rest in rests.items() if tried.distance(at, best) > tried.step and not is_excluded(rest)}
    if len(valley) == count:
        found |= {float(tried.origins[0]): tried.rests[0]}
    valleys: list[list[float]] = []
    for origin in sorted(found):
        if valleys and origin - valleys[-1][-1] < 1.5 * tried.step:
            valleys[-1].append(origin)
        else:
            valleys.append([origin])
    lowest = [min(origins, key=lambda at: float(found[at] @ found[at])) for origins in valleys]
    return sorted(lowest, key=lambda at: float(found[at] @ found[at]))


def _scatter(series: Array) -> float:
    """Return the variance of a sum over blocks: the largest that groups of neighbouring ones state, at least GROUPS."""
    found, width = 0.0, 1
    while len(series) // width >= GROUPS:
        sums = np.add.reduceat(series, np.arange(0, len(series), width))
        found = max(found, len(sums) * float(np.var(sums, ddof=1)))
        width *= 2
    return found if width > 1 else math.inf


def _settle(search: _OriginSearch, origin: float, step: float) -> tuple[float, float]:
    """Fit an origin and the record's own numbers together; return the origin [m] and one standard deviation [m].

    Noise and the model's error make the deviation as they make that of every number of a diagnosis; and the
    timing of force against position does, with the mean speed of the rows that tell: to and fro it cancels.
    """
    near = replace(search, fit=search.at(origin).align())
    recording, free, theta = near.recording, near.fit.free(), near.fit.theta
    used, move, h = recording.used, 0.0, step * 0.5**4
    for _ in range(SETTLED):
        fit = near.at(move).fit(theta, free)
        theta = fit.theta
        slope = (near.friction(move + h, theta) - near.friction(move - h, theta)) / (2.0 * h)
        sampled = find_sampling_columns(near.fit.subject, recording.friction - fit.residual)
        X = np.column_stack((sampled, fit.jacobian[:, free], slope))
        H = X[used].T @ X[used]
        inverse = invert_information(H)
        moves = inverse @ (X[used].T @ fit.residual[used])
        move = float(np.clip(move + moves[-1], -step, step))
    residual = fit.residual - X @ moves
    floor = noise_floor(recording, residual)
    wrong = math.sqrt(max(0.0, recording.rms(residual) ** 2 - (FLOOR_SURE * floor) ** 2))
    covariance = robust_covariance(recording, X, residual, H, inverse, max(wrong, UNSEEN_ERROR * floor))
    speed = float(slope[used] ** 2 @ recording.velocity[used]) / float(slope[used] @ slope[used])
    timing = HOLD_TIMING * near.fit.subject.whole.machine.sampling.step / math.sqrt(3.0)
    return origin + move, math.hypot(math.sqrt(float(covariance[-1, -1])), timing * speed)


def find_reach(machine: Machine) -> float:
    """Return the largest range of origins tried for a machine [m]."""
    return MOST * min(find_pitches(machine), default=math.inf) / A_PERIOD


def find_pitches(machine: Machine) -> list[float]:
    """Periods of a machine's effects in position, and that of the shortest sine of each [m]."""
    found: list[float] = []
    for effect in machine.effects:
        definition = effect_definition(effect.name)
        numbers = definition.entries(effect.parameters)
        orders = [value for name, value in numbers.items() if definition.parameter(name).whole]
        for name, value in numbers.items():
            if definition.parameter(name).role == "period" and name.endswith(LENGTH):
                found += [value, value / max(orders, default=1.0)]
    return found
