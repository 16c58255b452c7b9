"""A log prepared for diagnosis: aligned signals, their reduction to the rate of the fit, usable samples, blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.errors import InputError
from sgms_mhe.kinematics import Signals, settle_samples, signals_of_record
from sgms_mhe.logs import Log
from sgms_mhe.machine import Machine

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


@dataclass(frozen=True)
class Recording:
    """One log, ready to be fitted.

    Attributes:
        machine: whose chain it went through.
        signals: at the log's rate (n).
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
    wanted = min(rate, LARGEST_RATE, max(2.0 * machine.sampling.velocity_cutoff, LEAST_RATE))
    factor = max(1, int(rate / wanted + 1e-9), math.ceil(n / MOST_ROWS))
    m = n // factor
    if m < 100:
        raise InputError(log.source or "log", "samples", n, f"at least {100 * factor} for a diagnosis")
    used = np.asarray(good[: m * factor].reshape(m, factor).all(axis=1))
    if used.sum() < 100:
        raise InputError(log.source or "log", "usable samples", int(good.sum()), f"at least {100 * factor}")

    def reduce(series: Array) -> Array:
        return np.asarray(series[: m * factor].reshape(m, factor).mean(axis=1))

    time = reduce(signals.time) - float(signals.time[0])
    block, count = _blocks(used, factor / rate)
    fold, held_out = _split(count)
    recording = Recording(
        machine=machine,
        signals=signals,
        factor=factor,
        time=time,
        position=reduce(signals.position),
        velocity=reduce(signals.velocity),
        acceleration=reduce(signals.acceleration),
        force=reduce(signals.force),
        friction=reduce(signals.friction),
        used=used & (block >= 0),
        block=np.where(used, block, -1),
        fold=fold,
        held_out=held_out,
        warnings=tuple(warnings),
    )
    if held_out_s is not None:
        # A block belongs to the held-out part with its middle.
        middle = np.array([float(time[recording.block == b].mean()) for b in range(count)])
        inside = np.zeros(count, dtype=np.bool_)
        for low, high in held_out_s:
            inside |= (middle >= low) & (middle <= high)
        if inside.all() or not inside.any():
            raise InputError("diagnosis", "held_out", list(held_out_s), "intervals that leave data on both sides")
        recording = replace(recording, held_out=inside)
    return recording


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
    friction = machine.friction
    scale = FORGET * max(nu * friction.coulomb / k for nu, k in zip(friction.fraction, friction.stiffness, strict=True))
    path = np.cumsum(np.abs(signals.velocity)) * machine.sampling.step
    known = np.ones(len(signals), dtype=np.bool_)
    starts = np.flatnonzero(np.diff(signals.missing.astype(np.int8)) == -1) + 1
    for start in starts:
        end = int(np.searchsorted(path, path[start] + scale))
        known[start:end] = False
    return known if (known & good).sum() >= 0.5 * good.sum() else np.ones(len(signals), dtype=np.bool_)


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
