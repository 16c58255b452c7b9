"""Signal chain: from position and force to velocity, acceleration and measured friction (docs/signals.md).

Every signal leaves the chain with the delay of the acceleration, two low-passes and one sample, so that friction =
force - mass * acceleration carries no transient that is not friction.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np
from scipy.signal import lfilter

from sgms_mhe.machine import COMMANDS, Machine
from sgms_mhe.signals.logs import Log, check_rate
from sgms_mhe.signals.noise import find_jumps
from sgms_mhe.support.arrays import Array, Index, Mask

SETTLE_TOLERANCE = 0.01
"""The chain has settled when the step response of both low-passes stays within this fraction."""


_NEVER = int(np.iinfo(np.int64).max)
"""Samples since a sample that was missing, where none was."""

FARTHEST_m = 4e6
OFF = 0.5
"""Of a column that says at which samples a drive is on: up to it the drive is off."""
BACK_S = 0.02
"""A position that jumps away and is back within this time [s] has not moved."""
LARGEST_SIGNAL = 1e9
"""A position, or any other channel [N, m/s, m/s^2], at or beyond these is no measurement: it counts as missing."""

UNKNOWN = 1000.0
"""Error of friction over its stated noise where the filters know nothing."""
MOST_BRIDGED = 3.0
"""Largest error of a measurement by bridged samples, over the stated noise: it has a tenth of its information."""


@dataclass(frozen=True)
class Signals:
    """Signals of the observer, one entry per sample; all arrays (n,), all numbers finite.

    time of the sample [s], position [m], velocity [m/s], acceleration [m/s^2], force [N], friction [N]; `valid`:
    friction may be used as a measurement; `missing`: a recorded channel had no finite value. `delay`: how far they are
    behind the sample [s]; they describe the instant time - delay. `noise`: factor on friction's stated deviation, >= 1.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    force: Array
    friction: Array
    valid: Mask
    missing: Mask
    delay: float = 0.0
    noise: Array | None = None

    def __len__(self) -> int:
        return len(self.time)

    @property
    def certainty(self) -> Array:
        """1 / noise where friction is valid, 0 elsewhere (n)."""
        return self.valid / (np.ones(len(self)) if self.noise is None else self.noise)

    def part(self, which: slice | Index) -> Self:
        """Some of the samples, with the delay of all of them."""
        parts: dict[str, Any] = {name: a[which] for name, a in vars(self).items() if isinstance(a, np.ndarray)}
        return replace(self, **parts)

    def before_chain(self, motion: Array) -> Self:
        """The same samples with a motion before the chain: position, velocity, acceleration, force (n, 4)."""
        names = ("position", "velocity", "acceleration", "force")
        return replace(self, delay=0.0, **dict(zip(names, np.ascontiguousarray(motion.T), strict=True)))


def signal_array(signals: Signals, h: float, first: int = 0, mean: int = 0) -> Array:
    """Signals w = (position, velocity, acceleration, force, time) of every sample (n, 5).

    Time counts from a log's sample 0, the first one here being its sample `first`, and is that of the instant the
    signals describe. With `mean` a sixth column is the mean acceleration over so many samples; the first velocity here
    has been there before.
    """
    time = np.arange(first, first + len(signals)) * h - signals.delay
    columns = [signals.position, signals.velocity, signals.acceleration, signals.force, time]
    if mean:
        before = np.concatenate([np.full(mean, signals.velocity[0]), signals.velocity])[: len(signals)]
        columns.append((signals.velocity - before) * (1.0 / (mean * h)))
    return np.column_stack(columns)


def mean_samples(machine: Machine) -> int:
    """Samples the mean acceleration of an uncertain mass is over; 0: the machine has no such signal.

    Of two velocities so far apart the noise is independent, so that their difference has none of the acceleration's.
    """
    return max(1, settle_samples(machine)) if machine.estimator.disturbance.inertia > 0.0 else 0


def signals_from_log(log: Log, machine: Machine) -> Signals:
    """Send a log through the chain, or past it where the log brings velocity and friction of its own."""
    check_rate(log, machine)
    return Chain(machine).take(log)


class Chain:
    """The chain along a log, whole or in pieces: the output is the same to the last bit.

    But for measurements that are missing at the very start: until the first one comes, its value counts as having been
    there before, and it has to be in the first piece.

    Args:
        machine: whose log it is.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._coefficients, self._settle = lowpass_coefficients(machine), settle_samples(machine)
        self._memory: dict[str, Array] = {}
        self._bases: dict[str, float] = {}
        self._held: dict[str, float] = {}
        self._before: dict[str, float] = {}
        self._bridge = Bridge(machine)
        self._since = 0

    def take(self, log: Log) -> Signals:
        """Return the signals of the samples that follow; of the same columns throughout."""
        rate = self._machine.sampling.rate
        log = _drop_far(log)
        missing = _missing(log)
        position, delayed_position, difference, force, error = self._bridge.take(log.position_m, log.force_N)
        since = self._samples_since(missing)

        if log.velocity_m_s is not None and log.friction_N is not None:
            velocity = self._hold("velocity", log.velocity_m_s, 0.0)
            if log.acceleration_m_s2 is None:
                acceleration = (velocity - self._delay("velocity", velocity, float(velocity[0]))) * rate
            else:
                acceleration = self._hold("acceleration", log.acceleration_m_s2, 0.0)
            force, friction = self._hold("force", log.force_N), self._hold("friction", log.friction_N, 0.0)
            return Signals(log.time_s, position, velocity, acceleration, force, friction, ~missing, missing)

        given = log.velocity_m_s
        raw_velocity = difference * rate if given is None else self._hold("velocity", given, 0.0)
        once = self._lowpass("velocity, once", raw_velocity)
        later = self._delay("velocity", once, 0.0)
        velocity = self._lowpass("velocity, twice", later)
        if log.acceleration_m_s2 is None:
            acceleration = self._lowpass("acceleration", (once - later) * rate)
        else:
            held = self._delay("acceleration", self._hold("acceleration", log.acceleration_m_s2, 0.0), 0.0)
            acceleration = self._lowpass("acceleration, twice", self._lowpass("acceleration", held))
        position, force = self._start_at_rest("position", delayed_position), self._behind("force", force)
        if log.friction_N is None:
            friction = force - self._machine.plant.moved * acceleration
        else:
            friction = self._behind("friction", self._hold("friction", log.friction_N, 0.0))
        if given is not None or log.acceleration_m_s2 is not None or log.friction_N is not None:
            error = np.where(since > self._settle, 0.0, UNKNOWN)
        valid = error <= MOST_BRIDGED
        noise = np.hypot(1.0, np.where(valid, error, 0.0))
        delay = chain_delay(self._machine)
        return Signals(log.time_s, position, velocity, acceleration, force, friction, valid, missing, delay, noise)

    def _hold(self, name: str, signal: Array, before: float | None = None) -> Array:
        """Hold the last finite value; `before` the first one, or that one itself."""
        held = hold_last(signal, self._held.get(name, before))
        self._held[name] = float(held[-1])
        return held

    def _delay(self, name: str, signal: Array, first: float) -> Array:
        """One sample later, `first` standing before the log's first sample."""
        delayed = _delay(signal, self._before.get(name, first))
        self._before[name] = float(signal[-1])
        return delayed

    def _lowpass(self, name: str, signal: Array) -> Array:
        filtered, self._memory[name] = _lowpass(self._coefficients, signal, self._memory.get(name))
        return filtered

    def _start_at_rest(self, name: str, delayed: Array) -> Array:
        """Behind both low-passes, at rest on the log's first value before it."""
        base = self._bases.setdefault(name, float(delayed[0]))
        return np.asarray(base + self._lowpass(f"{name}, twice", self._lowpass(f"{name}, once", delayed - base)))

    def _behind(self, name: str, series: Array) -> Array:
        """`apply_chain`, piece by piece."""
        return self._start_at_rest(name, self._delay(name, series, float(series[0])))

    def _samples_since(self, missing: Mask) -> Index:
        """Samples since the last one that was missing, in this piece or before it."""
        since = _samples_since(missing)
        before = since == _NEVER
        since[before] = self._since + 1 + np.flatnonzero(before)
        self._since = int(since[-1])
        return since


def signals_of_record(log: Log, machine: Machine) -> Signals:
    """Send a whole record through the chain, its gaps bridged from both sides.

    A controller meets a gap without knowing the samples after it, and the step back to the measurement leaves a
    transient as large as the missed move. A record is known to its end: position goes through a gap with the speeds on
    both sides of it, everything else in a line. Friction stays invalid in a gap, and behind the filters twice as long
    after it as they settle.
    """
    log = readings(log)
    missing = _missing(log)
    if not missing.any() or missing.all():
        return signals_from_log(log, machine)
    bypassed = log.velocity_m_s is not None and log.friction_N is not None
    signals = signals_from_log(_bridge(log), machine)
    after = 0 if bypassed else 2 * settle_samples(machine)
    return replace(signals, valid=signals.valid & (_samples_since(missing) > after), missing=missing)


def apply_chain(machine: Machine, series: Array) -> Array:
    """Return forces (n, ...) behind the chain: both low-passes and one sample, at rest before the first sample."""
    coefficients, base = lowpass_coefficients(machine), series[0]
    delayed = np.concatenate((series[:1], series[:-1])) - base
    # Both filters are linear: about the first value they start at zero, which is at rest to the last bit.
    return np.asarray(base + _lowpass(coefficients, _lowpass(coefficients, delayed)[0])[0])


def lowpass_coefficients(machine: Machine) -> tuple[float, float, float, float, float]:
    """(b0, b1, b2, a1, a2) of the low-pass: y[k] = b0 u[k] + b1 u[k-1] + b2 u[k-2] - a1 y[k-1] - a2 y[k-2].

    Second-order Butterworth by the bilinear transform, prewarped to `velocity_cutoff`.
    """
    return _coefficients(machine.sampling.velocity_cutoff / machine.sampling.rate)


def chain_delay(machine: Machine) -> float:
    """How late a slow signal leaves the chain [s]: the mean of its impulse response, two low-passes and one sample.

    A Butterworth's impulse response has no variance, |H|^2 being flat: parabolas are late by this too, not only lines.
    """
    b0, b1, b2, a1, a2 = lowpass_coefficients(machine)
    # Means add under multiplication of polynomials in 1/z and are subtracted under division.
    mean = (b1 + 2.0 * b2) / (b0 + b1 + b2) - (a1 + 2.0 * a2) / (1.0 + a1 + a2)
    return (1.0 + 2.0 * mean) * machine.sampling.step


def settle_samples(machine: Machine) -> int:
    """Samples until the step response of two low-passes in series stays within 1 % of its final value."""
    return _settle(machine.sampling.velocity_cutoff / machine.sampling.rate)


def readings(log: Log) -> Log:
    """The log with NaN for whatever is no measurement, as a record known to its end shows it.

    A controller knows less: it meets a position that jumped away before those that come back.
    """
    log = _drop_far(log)
    spoilt: dict[str, Any] = {
        name: np.where(jumped, np.nan, log.columns[name]) for name, jumped in find_lost(log).items() if jumped.any()
    }
    if log.enabled is not None:  # the windings are open: what stands for the force then is another thing
        spoilt["force_N"] = np.where(log.enabled > OFF, spoilt.get("force_N", log.force_N), np.nan)
    return replace(log, **spoilt) if spoilt else log


def find_lost(log: Log) -> dict[str, Mask]:
    """Return the samples (n) of position and force that jumped away and came back: readings lost, by column.

    A position is back within 20 ms, in which no axis goes and returns; a force after one sample.
    """
    longest = {"position_m": int(BACK_S * log.rate), "force_N": 1}
    return {name: find_jumps(log.columns[name], samples) for name, samples in longest.items()}


def _drop_far(log: Log) -> Log:
    """The log with NaN for values not finite, or too large for the chain."""
    spoilt: dict[str, Any] = {}
    for name, channel in _channels(log).items():
        limit = FARTHEST_m if name == "position_m" else LARGEST_SIGNAL
        if np.any(np.abs(channel) >= limit):
            spoilt[name] = np.where(np.abs(channel) < limit, channel, np.nan)
    return replace(log, **spoilt) if spoilt else log


def _channels(log: Log) -> dict[str, Array]:
    """The columns the chain takes."""
    return {
        name: values for name, values in log.columns.items() if name not in COMMANDS | {"time_s", "temperature_degC"}
    }


def _missing(log: Log) -> Mask:
    """Samples at which a channel has no measurement."""
    finite: Mask = np.logical_and.reduce([np.isfinite(channel) for channel in _channels(log).values()])
    return ~finite


def _bridge(log: Log) -> Log:
    """The log with every gap between two measurements filled."""
    filled: dict[str, Any] = {}
    for name, channel in _channels(log).items():
        good = np.flatnonzero(np.isfinite(channel))
        absent = np.flatnonzero(~np.isfinite(channel))
        if len(good):
            absent = absent[(absent > good[0]) & (absent < good[-1])]
        if not len(good) or not len(absent):
            continue
        bridged, readings = channel.copy(), channel[good]
        bridged[absent] = _cubic(absent, good, readings) if name == "position_m" else np.interp(absent, good, readings)
        filled[name] = bridged
    return replace(log, **filled)


def _cubic(at: Index, good: Index, values: Array) -> Array:
    """Values between measurements that keep the speeds on both sides, each over the two samples next to the gap."""
    left = np.searchsorted(good, at) - 1
    right = left + 1
    width = (good[right] - good[left]).astype(np.float64)

    def slope(first: Index) -> Array:
        first = np.clip(first, 0, len(good) - 2)
        return np.asarray((values[first + 1] - values[first]) / (good[first + 1] - good[first]))

    start, end = slope(left - 1) * width, slope(right) * width
    rise, t = values[right] - values[left], (at - good[left]) / width
    second, third = 3.0 * rise - 2.0 * start - end, start + end - 2.0 * rise
    return np.asarray(values[left] + t * (start + t * (second + t * third)))


def bridge_fading(settle: int) -> float:
    """Factor per sample on the error that bridged samples leave: to `SETTLE_TOLERANCE` while the filters settle."""
    return float(SETTLE_TOLERANCE ** (1.0 / max(1, settle)))


def _coefficients(cutoff: float) -> tuple[float, float, float, float, float]:
    warped = math.tan(math.pi * cutoff)
    scale = 1.0 / (1.0 + math.sqrt(2.0) * warped + warped * warped)
    b0 = warped * warped * scale
    a1 = 2.0 * (warped * warped - 1.0) * scale
    a2 = (1.0 - math.sqrt(2.0) * warped + warped * warped) * scale
    return b0, 2.0 * b0, b0, a1, a2


@lru_cache(maxsize=64)
def _settle(cutoff: float) -> int:
    coefficients = _coefficients(cutoff)
    # sqrt(a2) is the poles' radius: after this many samples the response has decayed far below the tolerance.
    length = 64 + math.ceil(math.log(1e-6) / (0.5 * math.log(coefficients[4])))
    step = _lowpass(coefficients, _lowpass(coefficients, np.ones(length))[0])[0]
    outside = np.flatnonzero(np.abs(step - 1.0) > SETTLE_TOLERANCE)
    return int(outside[-1]) + 1 if len(outside) else 0  # none outside: a cutoff close to rate / 2


def _lowpass(
    coefficients: tuple[float, float, float, float, float], signal: Array, memory: Array | None = None
) -> tuple[Array, Array]:
    """Signals (n, ...) behind the low-pass, and its memory (2, ...) after them; `memory`: before, None for rest."""
    b0, b1, b2, a1, a2 = coefficients
    before = np.zeros((2, *signal.shape[1:])) if memory is None else memory
    filtered, after = lfilter([b0, b1, b2], [1.0, a1, a2], signal, axis=0, zi=before)
    return np.asarray(filtered), np.asarray(after)


def _delay(signal: Array, first: float) -> Array:
    """One sample later, `first` standing before the first sample."""
    return np.concatenate(([first], signal[:-1]))


def _samples_since(mask: Mask) -> Index:
    """Samples since the last true entry of mask: 0 at a true entry, the largest integer before the first one."""
    index = np.arange(len(mask))
    last = np.maximum.accumulate(np.where(mask, index, -1))
    return np.where(last < 0, _NEVER, index - last)


def hold_last(signal: Array, before: float | None = None) -> Array:
    """Hold the last finite value over missing samples; `before` the first one, or that one itself."""
    good = np.isfinite(signal)
    if good.all():
        return signal
    if not good.any():
        return np.full_like(signal, 0.0 if before is None else before)
    last = np.maximum.accumulate(np.where(good, np.arange(len(signal)), -1))
    start = signal[np.argmax(good)] if before is None else before
    return np.where(last >= 0, signal[last], start)


class Bridge:
    """Position and force with their missing samples bridged as a controller does, whole or in pieces.

    The axis is where it was as long as readings are within `position_step` of that.
    """

    def __init__(self, machine: Machine) -> None:
        self._settle, self._step = settle_samples(machine), machine.sampling.position_step
        self._coefficients = lowpass_coefficients(machine)
        self._filter = np.zeros(2)
        self._position: float | None = None
        self._difference = self._force = self._once = self._turn = 0.0
        self._gaps = [math.inf, math.inf]  # of position and force: none has been there
        self._error, self._since = UNKNOWN, 0

    def take(self, position: Array, force: Array) -> Array:
        """Return (5, n): position at k, that before as the chain sees it, their difference, force, friction's error.

        Position before and difference are stated apart because after a gap of more than `settle` samples the earlier
        position is replaced by the new one: the unseen travel does not appear as a velocity. The error is
        over the stated noise.
        """
        missing = np.flatnonzero(~(np.isfinite(position) & np.isfinite(force)))
        if self._position is None:
            self._position, self._force = _first(position), _first(force)
        disturbed = max(self._settle - self._since, int(missing[-1]) + 1 + self._settle if len(missing) else 0)
        count = min(len(position), disturbed) if self._step == 0.0 else len(position)
        rows = self._bridge_samples(position[:count].tolist(), force[:count].tolist())
        rest = position[count:]
        if not len(rest):
            return rows
        earlier = _delay(rest, self._position)
        once, self._filter = _lowpass(self._coefficients, rest - earlier, self._filter)
        self._turn = float(once[-1]) - (float(once[-2]) if len(once) > 1 else self._once)
        self._position, self._difference = float(rest[-1]), float(rest[-1] - earlier[-1])
        self._once, self._force, self._error = float(once[-1]), float(force[-1]), 0.0
        self._since += len(rest)
        undisturbed = np.stack((rest, earlier, rest - earlier, force[count:], np.zeros(len(rest))))
        return np.concatenate((rows, undisturbed), axis=1)

    def _bridge_samples(self, position: list[float], force: list[float]) -> Array:
        """`take` sample by sample, as rows (5, n)."""
        (b0, b1, b2, a1, a2), (z0, z1) = self._coefficients, self._filter.tolist()
        settle, step, fading = self._settle, self._step, bridge_fading(self._settle)
        now, moved, push = self._position or 0.0, self._difference, self._force
        once, turn, error, since, (gap, force_gap) = self._once, self._turn, self._error, self._since, self._gaps
        rows = np.empty((len(position), 5))
        for k, (reading, pushed) in enumerate(zip(position, force, strict=True)):
            before, used = now, push
            error = 0.0 if since >= settle else error
            since += 1
            if reading == reading:
                now = min(max(before, reading - step), reading + step)
                before, error = (now, UNKNOWN) if gap > settle else (before, error)
                moved, gap = now - before, 0.0
            else:
                moved += turn if gap <= settle else 0.0
                gap += gap <= settle
                now, since = before + moved, 0
            if pushed == pushed:
                # The mean of the forces on both sides is that of the gap: its impulse is made up for.
                used = pushed + (0.5 * force_gap * (pushed - push) if force_gap <= settle else 0.0)
                push, error, force_gap = pushed, UNKNOWN if force_gap > settle else error, 0.0
            else:
                force_gap += force_gap <= settle
                since = 0
            error = fading * error + 2.0 * (1.0 - fading) * max(gap, force_gap) ** 2
            rows[k] = now, before, moved, used, error
            filtered = z0 + b0 * moved
            z0, z1 = z1 + b1 * moved - a1 * filtered, b2 * moved - a2 * filtered
            once, turn = filtered, filtered - once
        self._filter = np.array([z0, z1])
        self._position, self._difference, self._force = now, moved, push
        self._once, self._turn, self._error, self._since, self._gaps = once, turn, error, since, [gap, force_gap]
        return rows.T.copy()


def _first(signal: Array) -> float:
    """The first finite value, 0 where there is none."""
    good = np.isfinite(signal)
    return float(signal[np.argmax(good)]) if good.any() else 0.0
