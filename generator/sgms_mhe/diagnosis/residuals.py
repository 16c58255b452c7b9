"""A log prepared for diagnosis: aligned signals, their reduction to the rate of the fit, usable samples, blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import Extents
from sgms_mhe.signals.chain import Signals, settle_samples, signals_of_record
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

LARGEST_RATE: Final = 1000.0  # Hz; friction has nothing to say above it
LEAST_RATE: Final = 200.0
MOST_ROWS: Final = 150_000
BLOCK_S: Final = (0.1, 2.0)
BLOCKS: Final = 48
FOLDS: Final = 5
FORGET: Final = 4.0  # deflection scales of motion after which a state does not remember where it started
SATURATED_RUN: Final = 5  # samples
FITTED_S: Final = 60.0  # of a record that models are fitted to; a longer one is fitted in pieces
LEAD_S: Final = (0.5, 2.0)  # of motion before a piece: at least, and at most, until states know where they are
LEAD_TRAVEL: Final = 0.3  # of the record's range of position: a lead that slow hysteresis is known after
SEAM: Final = 2  # rows at the end of a piece that derivatives of a row's neighbours would mix with the next
SLOW: Final = 0.02  # of the largest speed
PLACES: Final = 60  # that the range of position is divided into


@dataclass(frozen=True)
class Recording:
    """One log, ready to be fitted.

    Attributes:
        machine: whose chain it went through.
        signals: at the log's rate (n).
        clock: the model's time (n) [s], from the log's first sample to what the signals tell of; a piece of a record
            keeps that of the record.
        factor: samples of the log per row.
        time, position, velocity, acceleration, force, friction: means over `factor` samples (m).
        used: rows that count (m).
        block: block of each row (m), 0 to blocks - 1; -1 where unused. Blocks are the independent units of all tests.
        fold: cross-validation fold of each block (blocks).
        held_out: blocks that the fit behind the reported gain does not see (blocks).
        warnings: what a user should know about the record.
    """

    machine: Machine
    signals: Signals
    clock: Array
    factor: int
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    force: Array
    friction: Array
    used: Mask
    block: Index
    fold: Index
    held_out: Mask
    warnings: tuple[str, ...]

    @property
    def rate(self) -> float:
        """Rows per second [Hz]."""
        return self.machine.sampling.rate / self.factor

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.fold)

    @property
    def extents(self) -> Extents:
        """How far the rows reach that count."""
        return Extents(
            travel=float(np.ptp(self.position[self.used])),
            speed=float(np.max(np.abs(self.velocity[self.used]))),
            duration=float(np.ptp(self.time)),
            end=float(self.time[-1]),
            rate=self.rate,
        )

    def reduce(self, series: Array) -> Array:
        """Mean over `factor` samples: (n, ...) to (m, ...)."""
        m = len(self.time)
        return np.asarray(series[: m * self.factor].reshape(m, self.factor, *series.shape[1:]).mean(axis=1))

    def rows_held_out(self) -> Mask:
        """Used rows in held-out blocks (m)."""
        return self.used & np.where(self.block >= 0, self.held_out[self.block], False)

    def sum_blocks(self, series: Array) -> Array:
        """Sum over the used rows of each block: (m,) to (blocks)."""
        return np.asarray(
            np.bincount(self.block[self.used], weights=series[self.used], minlength=self.blocks), dtype=np.float64
        )


def prepare(machine: Machine, log: Log, held_out_s: Sequence[tuple[float, float]] | None = None) -> Recording:
    """Send a log through the signal chain and say which rows count.

    Args:
        machine: the axis.
        log: the record.
        held_out_s: intervals of time since the log's start [s] to hold out; None: a third of the record in blocks.

    Raises:
        InputError: fewer usable samples than a fit needs.
    """
    signals = signals_of_record(log, machine)
    warnings: list[str] = []
    good = signals.valid.copy()
    settle = settle_samples(machine)
    n = len(signals)
    gaps = int(signals.missing.sum())
    if gaps:
        warnings.append(f"{gaps} of {n} samples are missing; they and {settle} samples after each gap are left out")
    saturated = _saturated(log.force_N)
    if saturated.any():
        near = _dilate(saturated, settle)
        warnings.append(f"the force is saturated in {int(saturated.sum())} of {n} samples; they are left out")
        good &= ~near
    fast = np.abs(signals.velocity) > machine.sampling.max_velocity
    if fast.any():
        warnings.append(
            f"faster than max_velocity = {machine.sampling.max_velocity:g} m/s in {int(fast.sum())} samples: left out"
        )
        good &= ~fast
    good &= _remembered(signals, machine, good)

    rate = machine.sampling.rate
    factor = _finest(machine)
    factor *= math.ceil(n / factor / MOST_ROWS)
    m = n // factor
    if m < 100:
        raise InputError(log.source or "log", "samples", n, f"at least {100 * factor} for a diagnosis")
    used = np.asarray(good[: m * factor].reshape(m, factor).all(axis=1))
    if used.sum() < 100:
        raise InputError(log.source or "log", "usable samples", int(good.sum()), f"at least {100 * factor}")
    block, count = _blocks(used, factor / rate)
    fold, held_out = _split(count)
    clock = np.arange(n) / rate - signals.delay
    recording = _reduced(machine, signals, clock, factor, np.where(used, block, -1), fold, held_out, tuple(warnings))
    if held_out_s is not None:
        time = recording.time
        # A block belongs to the held-out part with its middle.
        middle = np.array([float(time[recording.block == b].mean()) for b in range(count)])
        inside = np.zeros(count, dtype=np.bool_)
        for low, high in held_out_s:
            inside |= (middle >= low) & (middle <= high)
        if inside.all() or not inside.any():
            raise InputError("diagnosis", "held_out", list(held_out_s), "intervals that leave data on both sides")
        recording = replace(recording, held_out=inside)
    return recording


def _finest(machine: Machine) -> int:
    """Samples of the log per row of a fit."""
    rate = machine.sampling.rate
    wanted = min(rate, LARGEST_RATE, max(2.0 * machine.sampling.velocity_cutoff, LEAST_RATE))
    return max(1, int(rate / wanted + 1e-9))


def _reduced(
    machine: Machine,
    signals: Signals,
    clock: Array,
    factor: int,
    block: Index,
    fold: Index,
    held_out: Mask,
    warnings: tuple[str, ...],
) -> Recording:
    """Rows of means over `factor` samples; `block` (m) is -1 where a row does not count."""
    m = len(block)

    def reduce(series: Array) -> Array:
        return np.asarray(series[: m * factor].reshape(m, factor).mean(axis=1))

    return Recording(
        machine=machine,
        signals=signals,
        clock=clock,
        factor=factor,
        time=reduce(signals.time) - float(signals.time[0] - clock[0]),
        position=reduce(signals.position),
        velocity=reduce(signals.velocity),
        acceleration=reduce(signals.acceleration),
        force=reduce(signals.force),
        friction=reduce(signals.friction),
        used=block >= 0,
        block=block,
        fold=fold,
        held_out=held_out,
        warnings=warnings,
    )


def excerpt(recording: Recording, seconds: float = FITTED_S) -> Recording:
    """What models are fitted to: the record, or of a longer one pieces from all over it, `seconds` in all.

    A piece is a block and the motion before it, which the fit runs through and does not see: as long as states need to
    forget what was before. The record is cut into as many stretches of time as there are to be pieces. Each gives the
    one of its blocks that is richest in something, taking turns: reversals, acceleration, speed, slow motion, and
    places that no piece has been to. So drifts and steps are seen from the first stretch to the last, pitches over the
    whole range, and what an axis does rarely is seen too. Rows are as fine as those of a short record.
    """
    step = recording.factor / recording.machine.sampling.rate
    m = len(recording.time)
    if m * step <= seconds:
        return recording
    pieces = _pieces(recording, seconds)
    if not pieces:  # nothing ever moves far enough to forget where it started: the beginning of the record
        pieces = [(b, 0) for b in range(recording.blocks) if float(recording.time[recording.block == b][-1]) < seconds]
    wanted, chosen = np.zeros(m, dtype=np.bool_), np.full(m, -1, dtype=np.int64)
    parts = math.ceil(BLOCKS / len(pieces))
    for number, (piece, first) in enumerate(pieces):
        rows = np.flatnonzero(recording.block == piece)
        wanted[first : rows[-1] + 1] = True
        chosen[rows] = number * parts + np.arange(len(rows)) * parts // len(rows)
    ends = np.flatnonzero(wanted & ~np.append(wanted[1:], True))
    for back in range(SEAM):
        chosen[np.maximum(ends - back, 0)] = -1
    numbers, block = np.unique(chosen[wanted], return_inverse=True)
    block = np.where(chosen[wanted] >= 0, block - int(numbers[0] < 0), -1)
    kept = numbers[numbers >= 0]
    fine = _finest(recording.machine)
    finer = recording.factor // fine
    samples = np.flatnonzero(np.repeat(wanted, recording.factor))
    fitted = _reduced(
        recording.machine,
        recording.signals.part(samples),
        recording.clock[samples],
        fine,
        np.repeat(block, finer).astype(np.int64),
        _split(len(kept))[0],
        recording.held_out[[pieces[k // parts][0] for k in kept.tolist()]],
        recording.warnings,
    )
    note = (
        f"models are fitted to {float(fitted.used.sum()) / fitted.rate:.0f} s of the record's {m * step:.0f} s, in "
        f"{len(pieces)} pieces from all over it; what is left is stated for the whole record"
    )
    return replace(fitted, warnings=(*recording.warnings, note))


def _pieces(recording: Recording, seconds: float) -> list[tuple[int, int]]:
    """Blocks of an excerpt and the row that the motion before each begins at; none where no state forgets."""
    step = recording.factor / recording.machine.sampling.rate
    velocity, speed = recording.velocity, np.abs(recording.velocity)
    path = np.concatenate(([0.0], np.cumsum(speed) * step))
    low, high = float(np.min(recording.position)), float(np.max(recording.position))
    forget = _forgotten_after(recording.machine)
    way = max(forget, LEAD_TRAVEL * (high - low))
    least, most = (math.ceil(lead / step) for lead in LEAD_S)
    place = np.minimum(PLACES - 1, (recording.position - low) / max(high - low, 1e-12) * PLACES).astype(np.int64)
    sign = np.sign(np.where(speed > SLOW * SLOW * float(speed.max()), velocity, 0.0))
    turns = np.append(sign[1:] * sign[:-1] < 0.0, False) | np.append((sign[1:] != 0.0) & (sign[:-1] == 0.0), False)
    slow = (sign != 0.0) & (speed < SLOW * float(speed.max()))

    first: dict[int, int] = {}
    last: dict[int, int] = {}
    for block in range(recording.blocks):
        rows = np.flatnonzero(recording.block == block)
        start = int(rows[0])
        begin = int(np.searchsorted(path, path[start] - way, side="right")) - 1
        begin = max(0, start - most, min(begin, start - least))
        if begin == 0 or path[start] - path[begin] >= forget:
            first[block], last[block] = begin, int(rows[-1])
    if len(first) < 2:
        return []
    length = float(np.mean([last[b] + 1 - first[b] for b in first])) * step
    count = max(2, min(len(first), int(seconds / length)))
    seen = np.zeros(PLACES, dtype=np.bool_)

    def new_places(rows: slice) -> float:
        return float(np.count_nonzero(~seen[np.unique(place[rows])]))

    turn = (
        lambda rows: float(np.count_nonzero(turns[rows])),
        lambda rows: float(np.sum(recording.acceleration[rows] ** 2)),
        lambda rows: float(np.sum(velocity[rows] ** 2)),
        lambda rows: float(np.count_nonzero(slow[rows])),
        new_places,
    )
    pieces = []
    for k, stretch in enumerate(np.array_split(np.array(sorted(first)), count)):
        # A third of them, as of the record, is held out.
        same = [b for b in stretch.tolist() if bool(recording.held_out[b]) == (k % 3 == 1)] or stretch.tolist()
        span = {b: slice(first[b], last[b] + 1) for b in same}
        riches = {b: turn[k % len(turn)](span[b]) for b in same}
        best = max(same, key=lambda b: riches[b])
        seen[place[span[best]]] = True
        pieces.append((best, first[best]))
    return pieces


def noise_floor(recording: Recording, residual: Array) -> float:
    """RMS of the noise at the fit's rate, from what a smooth curve through 16 rows leaves (N).

    Model errors are smooth over so few rows but where the axis is fast; the quieter half of the pieces decides, with
    the expectation of the median of chi-squared in place of the mean.
    """
    width, order = 16, 2
    k = len(residual) // width
    pieces = residual[: k * width].reshape(k, width)
    whole = recording.used[: k * width].reshape(k, width).all(axis=1)
    if whole.sum() < 4:
        return float(np.std(residual[recording.used]))
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), order + 1))[0]
    pieces = pieces[whole]
    rest = pieces - pieces @ basis @ basis.T
    freedom = width - order - 1
    variance = np.sum(rest**2, axis=1) / freedom
    # Median of chi-squared over its mean, Wilson-Hilferty.
    return math.sqrt(float(np.quantile(variance, 0.5)) / (1.0 - 2.0 / (9.0 * freedom)) ** 3)


def _saturated(force: Array) -> Mask:
    """Samples in runs of exactly the largest or smallest force."""
    finite = np.isfinite(force)
    mask = np.zeros(len(force), dtype=np.bool_)
    if not finite.any():
        return mask
    low, high = float(np.min(force[finite])), float(np.max(force[finite]))
    if high - low <= 0.0:
        return mask
    for edge in (low, high):
        at = force == edge
        starts = np.flatnonzero(np.diff(np.concatenate(([False], at)).astype(np.int8)) == 1)
        ends = np.flatnonzero(np.diff(np.concatenate((at, [False])).astype(np.int8)) == -1) + 1
        for start, end in zip(starts, ends, strict=True):
            if end - start >= SATURATED_RUN:
                mask[start:end] = True
    return mask


def _dilate(mask: Mask, samples: int) -> Mask:
    """The mask and as many samples after each of its entries."""
    total = np.cumsum(mask)
    earlier = np.concatenate(
        (np.zeros(min(samples, len(mask)), dtype=total.dtype), total[: max(0, len(mask) - samples)])
    )
    return np.asarray((total - earlier > 0) | mask)


def _remembered(signals: Signals, machine: Machine, good: Mask) -> Mask:
    """Samples at which the model's state is known: some motion after the start and after each gap in the record.

    A record of presliding alone never forgets its start; it is kept, and taken to start from relaxed elements.
    """
    scale = _forgotten_after(machine)
    path = np.cumsum(np.abs(signals.velocity)) * machine.sampling.step
    known = np.ones(len(signals), dtype=np.bool_)
    starts = np.flatnonzero(np.diff(signals.missing.astype(np.int8)) == -1) + 1
    for start in starts:
        end = int(np.searchsorted(path, path[start] + scale))
        known[start:end] = False
    return known if (known & good).sum() >= 0.5 * good.sum() else np.ones(len(signals), dtype=np.bool_)


def _forgotten_after(machine: Machine) -> float:
    """Way [m] after which elements do not remember where they started."""
    friction = machine.friction
    return FORGET * max(nu * friction.coulomb / k for nu, k in zip(friction.fraction, friction.stiffness, strict=True))


def _blocks(used: Mask, step: float) -> tuple[Index, int]:
    """Cut the record into pieces of equal time; those with too few usable rows get no number."""
    m = len(used)
    length = float(np.clip(m * step / BLOCKS, *BLOCK_S))
    raw = (np.arange(m) * step / length).astype(np.int64)
    count = np.bincount(raw[used], minlength=int(raw[-1]) + 1)
    rows = np.bincount(raw)
    keep = count >= np.maximum(5, 0.2 * rows)
    number = np.where(keep, np.cumsum(keep) - 1, -1)
    return np.asarray(number[raw], dtype=np.int64), int(keep.sum())


def _split(count: int) -> tuple[Index, Mask]:
    """Folds and held-out blocks: drawn at random within neighbours, so that no lap time falls into step with them."""
    random = np.random.default_rng(20240229)
    fold = np.concatenate([random.permutation(FOLDS) for _ in range(-(-count // FOLDS))])[:count]
    held_out = np.concatenate([random.permutation(3) == 0 for _ in range(-(-count // 3))])[:count]
    return fold.astype(np.int64), held_out
