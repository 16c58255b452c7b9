"""A log prepared for diagnosis: aligned signals, their reduction to the rate of the fit, usable samples, blocks."""

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import Extents
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.path import bridge_gaps, misread_paths, reading_error, smooth_path
from sgms_mhe.recordings.series import find_runs, row_means
from sgms_mhe.signals.chain import Signals, find_lost, readings, settle_samples, signals_from_log, signals_of_record
from sgms_mhe.signals.logs import Log, align_velocity
from sgms_mhe.signals.noise import encoder_step, position_noise
from sgms_mhe.support.arrays import Array, Index, Mask
from sgms_mhe.support.errors import InputError

Run = tuple[Array, Array | None]
"""Friction (m) and its derivatives (m, n_p), None where not asked for."""
RUNS_CACHED: Final = 12  # runs: a fit begins where another one ended, an alignment runs what a fit ended with
INPUTS_KEPT: Final = 1_000_000  # samples, 40 MB
SEED: Final = 20240229  # of folds and held-out blocks: the same log gives the same verdict
RATE_MAX: Final = 1000.0
"""Rows of a fit per second, at most [Hz]: friction has nothing to say above it."""
RATE_MIN: Final = 200.0
"""Rows of a fit per second, at least; otherwise twice the velocity cutoff [Hz]: reversals still show behind a slow
filter."""
ROWS_MAX: Final = 150_000
"""Rows of a record; a longer one has coarser rows [1]: bounds the memory of derivatives."""
ROWS_MIN: Final = 100
"""Rows that a record must have, and as many that count [1]: blocks of a shorter one hold next to nothing."""
BLOCKS: Final = 48
"""Blocks that a record is cut into, the independent units of all tests [1]: enough for tests of several numbers."""
BLOCK_MIN: Final = 0.1
"""Shortest block [s]: what a model gets wrong at a reversal is over within it."""
BLOCK_MAX: Final = 2.0
"""Longest block [s]: a long record gives more units, not longer ones."""
BLOCK_ROWS_MIN: Final = 5
"""Rows that count in a block, at least [1]: fewer are no unit."""
BLOCK_USED_MIN: Final = 0.2
"""Share of its rows that count in a block, at least [block]: a block that is mostly gap is no unit."""
FORGET_EXTENT: Final = 4.0
"""Extent of a motion after which elements do not remember where they started [deflection scales]: all of them slip by
then."""
REMEMBERED_MIN: Final = 0.5
"""Share that must stay where samples are left out at which a gap makes states unknown [good samples]: presliding alone
never forgets; it is kept, and taken to start from relaxed elements."""
SATURATED_RUN: Final = 5
"""Run of exactly the largest force that is a saturation [samples]: noise does not repeat a number so often."""
SWITCHING: Final = 0.5
"""Share of the samples at the largest or smallest force beyond which these are the two values of a switched one."""


class Runs:
    """The newest results, at most so many, by the code that ran, the signals it ran along (by identity), and theta."""

    def __init__(self, most: int = RUNS_CACHED) -> None:
        self._most, self._lock = most, threading.Lock()
        self._kept: OrderedDict[tuple[int, int, bytes], tuple[object, object, Run]] = OrderedDict()

    def get(self, code: object, signals: object, theta: Array, derivatives: bool, run: Callable[[], Run]) -> Run:
        """Return the result of `run`, cached where it is known; one with derivatives serves requests without."""
        key = (id(code), id(signals), np.ascontiguousarray(theta, dtype=np.float64).tobytes())
        with self._lock:
            known = self._kept.get(key)
            if known is not None and (known[2][1] is not None or not derivatives):
                self._kept.move_to_end(key)
                return known[2] if derivatives else (known[2][0], None)
        found = run()
        for array in found:
            if array is not None:
                array.setflags(write=False)
        with self._lock:
            # With what identities stand for, so that they stay its own.
            self._kept[key] = code, signals, found
            self._kept.move_to_end(key)
            while len(self._kept) > self._most:
                self._kept.popitem(last=False)
        return found


@dataclass(frozen=True, eq=False)
class Recording:
    """One log, ready to be fitted.

    Attributes:
        machine: whose chain it went through.
        signals: at the log's rate (n).
        clock: the model's time (n) [s], from the log's first sample to the instant of the signals; a piece of a record
            keeps that of the record.
        factor: samples of the log per row.
        time, position, velocity, acceleration, force, friction: means over `factor` samples (m).
        used: rows that count (m).
        block: block of each row (m), 0 to blocks - 1; -1 where unused. Blocks are the independent units of all tests.
        fold: cross-validation fold of each block (blocks).
        held_out: blocks the fit behind the reported gain does not see (blocks).
        warnings: to the user about the record.
        noise: of an encoder of these steps in position, velocity and acceleration (n, 3), its lines being
            elsewhere; None where its steps do not show, and where nobody asked (`add_encoder`).
        unfiltered: position, velocity, acceleration and force before the chain (n, 4), the position between the
            encoder's steps; None where speeds do not come from it, and where nobody asked (`add_encoder`).
        misread: its velocity along a trajectory without the encoder's steps, and along those that encoders make of it
            (`misread_paths`) (n, 1 + ENCODERS); None as `noise`.
        acceleration_noise: variance of the encoder's noise in an acceleration [m^2/s^4]; 0 where not computed.
        has_own_speeds: whether its log brings a velocity or an acceleration, which then do not come from its position.
        is_filtered: whether friction has passed the chain's low-passes; not that of a log that brings velocity as well.
        is_smeared: whether the chain's low-passes change friction more than the noise hides: its force then passes
            them, not its motion.
        has_payload: whether each log moves a mass of its own beside the axis.
        of_log: which of several logs, one behind the other, each row is of (m); None: there is one.
        runs: the newest ones of models along it; copies share them.
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
    noise: Array | None = None
    unfiltered: Array | None = None
    misread: Array | None = None
    acceleration_noise: float = 0.0
    has_own_speeds: bool = False
    is_filtered: bool = True
    is_smeared: bool = True
    has_payload: bool = False
    of_log: Index | None = None
    runs: Runs = field(default_factory=Runs, repr=False)

    @property
    def rate(self) -> float:
        """Rows per second [Hz]."""
        return self.machine.sampling.rate / self.factor

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.fold)

    @cached_property
    def extents(self) -> Extents:
        """Extents of the used rows."""
        return Extents(
            travel=float(np.ptp(self.position[self.used])),
            speed=float(np.max(np.abs(self.velocity[self.used]))),
            duration=float(np.ptp(self.time)),
            end=float(self.time[-1]),
            rate=self.rate,
        )

    @cached_property
    def largest_friction(self) -> float:
        """Largest magnitude of measured friction on used rows [N], whatever alignment has taken from it since."""
        return float(np.max(np.abs(self.reduce(self.signals.friction)[self.used]), initial=0.0))

    def inputs(self, start: int, end: int) -> Array:
        """Position, velocity, acceleration, force and the model's time of samples (k, 5); not to be written to."""
        if len(self.signals) <= INPUTS_KEPT:
            return self._inputs[start:end]
        return self._stacked(slice(start, end))

    @cached_property
    def _inputs(self) -> Array:
        """Those of all samples: models run along them many times."""
        return self._stacked(slice(None))

    def _stacked(self, part: slice) -> Array:
        s = self.signals
        return np.column_stack([a[part] for a in (s.position, s.velocity, s.acceleration, s.force, self.clock)])

    def reduce(self, series: Array) -> Array:
        """Mean over `factor` samples: (n, ...) to (m, ...)."""
        return row_means(series[: len(self.time) * self.factor], self.factor)

    def rms(self, series: Array) -> float:
        """RMS over used rows of a series (m)."""
        return float(np.sqrt(np.mean(series[self.used] ** 2)))

    @cached_property
    def inertia(self) -> float:
        """Mass whose acceleration the measured friction holds [kg]: none where friction itself was recorded."""
        is_friction = np.array_equal(self.signals.force, self.signals.friction, equal_nan=True)
        return 0.0 if is_friction else self.machine.plant.moved

    @property
    def steps_inertia(self) -> Array | None:
        """Force of the acceleration the encoder's steps make (m) [N]; None where they do not show."""
        return None if self.noise is None else self.inertia * self.reduce(self.noise[:, 2])

    def misread_motions(self) -> Iterator[Array]:
        """Yield motions as `unfiltered` (n, 4) along each column of `misread`; none where there are none."""
        if self.unfiltered is None or self.misread is None:
            return
        for velocity in self.misread.T:
            position, _, acceleration, force = self.unfiltered.T
            yield np.column_stack((position, velocity, acceleration, force))

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
    log = align_velocity(log)
    signals = signals_of_record(log, machine)
    good, warnings = _find_usable(machine, log, signals)
    n, rate = len(signals), machine.sampling.rate
    factor = samples_per_row(machine)
    factor *= math.ceil(n / factor / ROWS_MAX)
    m = n // factor
    if m < ROWS_MIN:
        raise InputError(log.source or "log", "samples", n, f"at least {ROWS_MIN * factor} for a diagnosis")
    used = np.asarray(good[: m * factor].reshape(m, factor).all(axis=1))
    if used.sum() < ROWS_MIN:
        few = InputError(log.source or "log", "usable samples", int(good.sum()), f"at least {ROWS_MIN * factor}")
        raise few.add_notes(warnings)
    block, count = _blocks(used, factor / rate)
    if not count:
        allowed = f"at least {BLOCK_ROWS_MIN * factor} of them within {BLOCK_MAX:g} s: a higher rate, or fewer gaps"
        raise InputError(log.source or "log", "usable samples", int(used.sum()) * factor, allowed).add_notes(warnings)
    fold, held_out = split_blocks(count, machine)
    clock = np.arange(n) / rate - signals.delay
    recording = reduce_signals(machine, signals, clock, factor, np.where(used, block, -1), fold, held_out, warnings)
    recording = replace(
        recording,
        has_own_speeds=log.velocity_m_s is not None or log.acceleration_m_s2 is not None,
        is_filtered=log.velocity_m_s is None or log.friction_N is None,
        has_payload=log.payload and not log.is_friction_alone,
    )
    return recording if held_out_s is None else _hold_out(recording, held_out_s)


def add_encoder(recording: Recording, log: Log) -> Recording:
    """Return the recording with its motion before the chain and its encoder's steps, where its log shows them.

    Where its speeds do not come from its position it shows neither.
    """
    log, machine = readings(log), recording.machine
    if recording.has_own_speeds or not (np.isfinite(log.position_m).any() and np.isfinite(log.force_N).any()):
        return recording
    position, force = bridge_gaps(log.position_m), bridge_gaps(log.force_N)
    step, error = encoder_step(log.position_m), position_error(log.position_m)
    way = smooth_path(position, error)
    unfiltered = _unfiltered_motion(machine, way, force)
    if step == 0.0:
        return replace(recording, unfiltered=unfiltered)
    true, *read = misread_paths(position, step, error)
    noise = filter_position(machine, reading_error(true, step))
    return replace(recording, unfiltered=unfiltered, misread=_velocities(machine, [true, *read]), noise=noise)


def _unfiltered_motion(machine: Machine, way: Array, force: Array) -> Array:
    """Return `Recording.unfiltered` of a trajectory (n) [m] and a force (n); the velocity is that before a sample."""
    velocity = _velocities(machine, [way])[:, 0]
    return np.column_stack((way, velocity, np.diff(velocity, append=velocity[-1:]) * machine.sampling.rate, force))


def _velocities(machine: Machine, ways: Sequence[Array]) -> Array:
    """Return the velocities before each sample of trajectories (k) of (n) [m]: (n, k) [m/s]."""
    return np.column_stack([np.diff(way, prepend=way[:1]) * machine.sampling.rate for way in ways])


def position_error(position: Array) -> float:
    """Return the error of a measured position [m], one standard deviation: the larger of noise and encoder steps."""
    return max(position_noise(position), encoder_step(position) / math.sqrt(12.0))


def filter_position(machine: Machine, position: Array) -> Array:
    """Return a position (n) [m] behind the chain: position, velocity and acceleration (n, 3)."""
    n, rate = len(position), machine.sampling.rate
    log = Log(np.arange(n) / rate, position, np.zeros(n), rate, kind=machine.plant.kind)
    signals = signals_from_log(log, machine)
    return np.column_stack((signals.position, signals.velocity, signals.acceleration))


def _find_usable(machine: Machine, log: Log, signals: Signals) -> tuple[Mask, tuple[str, ...]]:
    """Samples a model can be compared with (n), and warnings on the others."""
    warnings: list[str] = []
    good = signals.valid.copy()
    settle, n, units = settle_samples(machine), len(signals), machine.plant.units
    for name, jumped in find_lost(log).items():
        if jumped.any():
            warnings.append(
                f"{units.named(name)} jumps away and back in {int(jumped.sum())} samples, the first at "
                f"{log.time_s[np.argmax(jumped)]:.6g} s: samples lost; they count as missing"
            )
    gaps = int(signals.missing.sum())
    if gaps:
        warnings.append(f"{gaps} of {n} samples are missing; they and {settle} samples after each gap are left out")
    saturated = _find_saturated(log.force_N)
    if saturated.any():
        warnings.append(f"the {units.push} is saturated in {int(saturated.sum())} of {n} samples; they are left out")
        for start, end in find_runs(saturated):
            good[start : end - 1 + settle] = False
    fast = np.abs(signals.velocity) > machine.sampling.max_velocity
    if fast.any():
        warnings.append(
            f"faster than max_velocity = {machine.sampling.max_velocity:g} {units.velocity} in {int(fast.sum())} "
            "samples: left out"
        )
        good &= ~fast
    good &= _find_remembered(signals, machine, good)
    return good, tuple(warnings)


def _hold_out(recording: Recording, intervals: Sequence[tuple[float, float]]) -> Recording:
    """The recording with the blocks held out whose middle is in one of the intervals [s]."""
    time = recording.time
    middle = np.array([float(time[recording.block == b].mean()) for b in range(recording.blocks)])
    inside = np.zeros(recording.blocks, dtype=np.bool_)
    for low, high in intervals:
        inside |= (middle >= low) & (middle <= high)
    if inside.all() or not inside.any():
        raise InputError("diagnosis", "held_out", list(intervals), "intervals that leave data on both sides")
    return replace(recording, held_out=inside)


def samples_per_row(machine: Machine) -> int:
    """Samples of the log per row of a fit, as few as make a difference."""
    rate = machine.sampling.rate
    wanted = min(rate, RATE_MAX, max(2.0 * machine.sampling.velocity_cutoff, RATE_MIN))
    return max(1, int(rate / wanted + 1e-9))


def reduce_signals(
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
        return row_means(series[: m * factor], factor)

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


def _find_saturated(force: Array) -> Mask:
    """Samples in runs of exactly the largest or smallest force, SATURATED_RUN samples or more.

    A force that is at either for most of the record switches between them: it moves the axis as any other does.
    """
    finite, mask = force[np.isfinite(force)], np.zeros(len(force), dtype=np.bool_)
    if not len(finite) or np.ptp(finite) == 0.0:
        return mask
    for edge in (finite.min(), finite.max()):
        for start, end in find_runs(force == edge):
            if end - start >= SATURATED_RUN:
                mask[start:end] = True
    return mask & (np.count_nonzero(mask) <= SWITCHING * len(mask))


def _find_remembered(signals: Signals, machine: Machine, good: Mask) -> Mask:
    """Samples at which the model's state is known: some motion after the start and after each gap in the record.

    A record of presliding alone never forgets its start; it is kept, and taken to start from relaxed elements.
    """
    scale = forget_extent(machine)
    known = np.ones(len(signals), dtype=np.bool_)
    starts = np.flatnonzero(np.diff(signals.missing.astype(np.int8)) == -1) + 1
    for start in starts:
        known[start : start + count_spanning(signals.position[start:], scale)] = False
    least = REMEMBERED_MIN * good.sum()
    return known if (known & good).sum() >= least else np.ones(len(signals), dtype=np.bool_)


def forget_extent(machine: Machine) -> float:
    """Extent [m] of a motion after which elements do not remember where they started.

    Not its way: loops below break-away never forget, however many there are.
    """
    return FORGET_EXTENT * scales_of(machine).deflection


def count_spanning(position: Array, extent: float) -> int:
    """Rows from the first on until the position [m] has covered an extent [m]; all where it never does."""
    seen = 256
    while True:
        part = position[:seen]
        span = np.maximum.accumulate(part) - np.minimum.accumulate(part)
        rows = int(np.searchsorted(span, extent))
        if rows < len(part) or len(part) == len(position):
            return rows
        seen *= 4


def _blocks(used: Mask, step: float) -> tuple[Index, int]:
    """Cut the record into pieces of equal time; those with too few usable rows get no number."""
    m = len(used)
    length = float(np.clip(m * step / BLOCKS, BLOCK_MIN, BLOCK_MAX))
    raw = (np.arange(m) * step / length).astype(np.int64)
    count = np.bincount(raw[used], minlength=int(raw[-1]) + 1)
    rows = np.bincount(raw)
    keep = count >= np.maximum(BLOCK_ROWS_MIN, BLOCK_USED_MIN * rows)
    number = np.where(keep, np.cumsum(keep) - 1, -1)
    return np.asarray(number[raw], dtype=np.int64), int(keep.sum())


def split_blocks(count: int, machine: Machine) -> tuple[Index, Mask]:
    """Folds and held-out blocks: drawn at random within neighbours, so that no lap time falls into step with them."""
    random = np.random.default_rng(SEED)
    folds, one_in = machine.diagnosis.folds, machine.diagnosis.held_out_one_in
    fold = np.concatenate([random.permutation(folds) for _ in range(-(-count // folds))])[:count]
    held_out = np.concatenate([random.permutation(one_in) == 0 for _ in range(-(-count // one_in))])[:count]
    return fold.astype(np.int64), held_out
