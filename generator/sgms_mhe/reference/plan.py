"""Steps of a record, and how many substeps each block takes in them: set by the signals alone."""

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from sgms_mhe.machine import Sampling
from sgms_mhe.reference.blocks import Blocks, IntegratedBlock
from sgms_mhe.signals.chain import Signals, mean_samples, signal_array
from sgms_mhe.support.arrays import Array, Index, Mask

Counts = Index

# Largest lambda up to which a slow RK4 substep is as long as the settings say: the slip window is 1 / lambda wide.
WIDE_LAMBDA = 35.0

# Largest lambda |delta| / s_m with which an element that slides takes merged samples at once.
NEARLY_CONSTANT = 0.0175

# Where an element that switches has its level up to a change of the velocity's sign, over the time until then.
BEFORE_TURN = 1.0 - 2.0**-20


@dataclass(frozen=True)
class Plan:
    """Steps of a record, set by its signals alone.

    A step takes a block along the line from `start` to `end`, in two pieces where the velocity changes sign, or up K
    samplewise steps of constant signals; an element that slides may take it at once. Where samples are not merged K is
    1, and the stair has the signals of the step's end. An element that switches takes a step or a stair by a clip.

    Attributes:
        steps: steps per interval.
        h: duration of a step [s].
        start: signals w at the beginning of each step (intervals * steps, 5).
        end: signals w at its end; equal to `start` where velocity is constant.
        substeps: Runge-Kutta substeps along the line (intervals * steps, blocks); 0 are samplewise steps. Of elements
            that switch 1 is the step at once.
        cut: share of the step before its velocity changes sign (intervals * steps); 0 where it does not.
        piece_substeps: Runge-Kutta substeps along the pieces before and after that (intervals * steps, blocks, 2);
            0 are samplewise steps, or a step that is not cut. Of elements that switch 1 is the piece at once.
        stairs: K, samplewise steps of a step; each lasts h / K.
        stair: signals w of each stair (intervals * steps * K, 5).
        stair_substeps: Runge-Kutta substeps of each (intervals * steps * K, blocks); 0 is one jump of the displacement
            flow, or a clip.
        slide: displacement [m], mean level s_m and delta of each step (intervals * steps, 3); zero where the signals do
            not let an element slide through it.
        path: sum |v_k| h of each interval [m].
        displacement: sum v_k h of each interval [m].
        fastest: largest |v_k| of each interval [m/s].
        readings: R, friction measurements of an interval at equal distances, the last one at its end.
        inner_w: signals w at those inside (intervals, R - 1, 5).
    """

    steps: int
    h: float
    start: Array
    end: Array
    substeps: Counts
    cut: Array
    piece_substeps: Counts
    stairs: int
    stair: Array
    stair_substeps: Counts
    slide: Array
    path: Array
    displacement: Array
    fastest: Array
    readings: int
    inner_w: Array


def motion_of(path: Array, displacement: Array, least: float) -> Array:
    """Motion [m] that decides whether each interval counts: `least` or more does.

    It is the path of the interval, or the displacement since the last one that counted where that is larger: slow
    motion counts too, once it has come as far, and an axis that trembles on one spot does not.

    Args:
        path: sum |v_k| h of each interval [m].
        displacement: sum v_k h of each [m].
        least: motion that counts [m].
    """
    motion, net = path.copy(), 0.0
    for k, moved in enumerate(displacement):
        net += float(moved)
        motion[k] = max(motion[k], abs(net))
        net = 0.0 if motion[k] >= least else net
    return motion


def inner_readings(sampling: Sampling) -> slice:
    """The samples of an interval (0 is the first after its start) at which its measurements but the last one stand."""
    spacing = sampling.samples_per_update // sampling.readings_per_update
    return slice(spacing - 1, sampling.samples_per_update - 1, spacing)


class Planner:
    """Makes the plans of one model."""

    def __init__(self, blocks: Blocks) -> None:
        self._blocks = blocks
        self._sampling = blocks.model.machine.sampling

    def plan(self, signals: Signals, *, rounded: bool = False) -> Plan:
        """Steps and substeps of every complete interval of a record; `rounded`: as steps are kept in 24 bits."""
        precision = np.float32 if rounded else np.float64
        samples, h, stairs = self._sampling.samples_per_update, self._sampling.step, self._sampling.merged
        intervals = (len(signals) - 1) // samples
        mean = mean_samples(self._blocks.model.machine)
        w = signal_array(signals, h, mean=mean)[: intervals * samples + 1]
        if stairs == 1:
            stair = start = end = w[1:].astype(precision).astype(float)
            substeps = stair_substeps = self._held(np.abs(end[:, 1]), h)
            cut, piece_substeps = np.zeros(len(end)), np.zeros((len(end), len(self._blocks.all), 2), dtype=np.int64)
            slide = np.zeros((len(end), 3))
        else:
            # Lines by least squares through samples at the middles of their times: displacement is exact.
            tau = (2.0 * np.arange(stairs) + 1.0) / stairs - 1.0
            merged = w[1:].reshape(-1, stairs, w.shape[1])
            middle = merged.mean(axis=1).astype(precision).astype(float)
            change = (np.einsum("k,ski->si", tau, merged) / np.sum(tau * tau)).astype(precision).astype(float)
            start, end = middle - change, middle + change
            stair = (middle[:, None, :] + tau[:, None] * change[:, None, :]).reshape(-1, w.shape[1])
            reverses = np.abs(change[:, 1]) > np.abs(middle[:, 1])
            fast = np.abs(middle[:, 1]) - np.abs(change[:, 1]) > self._slow
            substeps = np.where(reverses[:, None], 0, self._line_substeps(np.abs(middle[:, 1]), h * stairs, fast))
            cut = np.zeros(len(end))
            piece_substeps = np.zeros((len(end), len(self._blocks.all), 2), dtype=np.int64)
            before, after = np.abs(start[reverses, 1]), np.abs(end[reverses, 1])
            cut[reverses] = share = before / (before + after)
            pieces = np.stack(
                [
                    self._line_substeps(0.5 * before, h * stairs * share, fast[reverses]),
                    self._line_substeps(0.5 * after, h * stairs * (1.0 - share), fast[reverses]),
                ],
                axis=2,
            )
            piece_substeps[reverses] = np.where(np.any(pieces == 0, axis=2, keepdims=True), 0, pieces)
            stair_substeps = self._held(np.abs(stair[:, 1]), h)
            slide = self._slide(middle, change, h * stairs)
        velocities = w[1:, 1].reshape(intervals, samples)
        speeds = np.abs(velocities)
        return Plan(
            steps=samples // stairs,
            h=h * stairs,
            start=np.ascontiguousarray(start),
            end=np.ascontiguousarray(end),
            substeps=substeps,
            cut=cut,
            piece_substeps=piece_substeps,
            stairs=stairs,
            stair=np.ascontiguousarray(stair),
            stair_substeps=stair_substeps,
            slide=slide,
            path=speeds.sum(axis=1) * h,
            displacement=velocities.sum(axis=1) * h,
            fastest=speeds.max(axis=1, initial=0.0),
            readings=self._sampling.readings_per_update,
            inner_w=np.ascontiguousarray(
                w[1:].reshape(intervals, samples, w.shape[1])[:, inner_readings(self._sampling)]
            ),
        )

    @property
    def _over_lambda(self) -> float:
        """Width of the slip window of elements that follow the flow."""
        return 1.0 / self._blocks.model.machine.friction.smoothed.lambda_

    @property
    def _slow(self) -> float:
        """Speed up to which elements that follow the flow take Runge-Kutta steps [m/s]."""
        return self._blocks.gate_ratio * self._blocks.model.machine.friction.stribeck_velocity

    def _slow_substeps(self, block: IntegratedBlock, speed: Array | float, h: Array | float) -> Array:
        """RK4 substeps, not rounded, of an element that follows the flow, for a move at some speed over h."""
        settings = self._sampling.integrator
        longest = settings.slow_displacement * min(1.0, WIDE_LAMBDA * self._over_lambda)
        moved = np.asarray(speed) * h * block.rate_per_metre / longest
        return np.asarray(moved + h * block.rate_per_second / settings.displacement)

    def _runge_kutta_substeps(self, block: IntegratedBlock, speed: Array, h: Array | float, least: int) -> Counts:
        settings, limit = self._sampling.integrator, self._sampling.max_velocity

        def count_substeps(v: Array) -> Counts:
            moved = (v * block.rate_per_metre + block.rate_per_second) * h
            return np.maximum(least, np.ceil(moved / settings.displacement)).astype(np.int64)

        most = count_substeps(np.full_like(speed, limit))
        return np.asarray(np.minimum(count_substeps(np.minimum(speed, 1e3 * limit)), most))

    def _held(self, speed: Array, h: float) -> Counts:
        """Substeps where signals are constant over h, 0 a jump of the flow or a clip (n, blocks)."""
        least = max(1, self._sampling.integrator.substeps // self._sampling.samples_per_update)
        counts = np.empty((len(speed), len(self._blocks.all)), dtype=np.int64)
        for b, block in enumerate(self._blocks.all):
            if block.switches:
                counts[:, b] = 0
            elif block.saturates:
                most = max(1, math.ceil(self._slow_substeps(block, self._slow, h)))
                # What moves with the axis alone moves the less the slower it is.
                paced = most if block.rate_per_second else np.minimum(most, 1.0 + np.floor(most * speed / self._slow))
                counts[:, b] = np.where(speed > self._slow, 0, paced)
            else:
                counts[:, b] = self._runge_kutta_substeps(block, speed, h, least)
        return counts

    def _line_substeps(self, speed: Array, h: Array | float, fast: Mask) -> Counts:
        """Substeps along lines of this mean speed and duration, 0 where samplewise steps are less work (n, blocks).

        `fast`: the gate is saturated all along.
        """
        counts = np.empty((len(speed), len(self._blocks.all)), dtype=np.int64)
        for b, block in enumerate(self._blocks.all):
            if block.switches:
                counts[:, b] = int(block.at_once)
            elif block.saturates:
                needed = np.maximum(1.0, np.ceil(self._slow_substeps(block, speed, h)))
                most = np.where(fast, max(1, self._sampling.merged // 2), self._sampling.merged - 1)
                counts[:, b] = np.where(needed <= most, needed, 0.0)
            else:
                counts[:, b] = self._runge_kutta_substeps(block, speed, h, 1)
        return counts

    def _slide(self, middle: Array, change: Array, h: float) -> Array:
        """Displacement, mean level and delta of the steps whose signals let elements slide, zeros elsewhere (n, 3)."""
        slide = np.zeros((len(middle), 3))
        fast = np.flatnonzero(np.abs(middle[:, 1]) - np.abs(change[:, 1]) > self._slow)
        if len(fast) == 0 or not any(block.slides for block in self._blocks.all):
            return slide
        middle, change = middle[fast], change[fast]
        v, v_s = middle[:, 1], change[:, 1]
        low, mid, high = (self._level(w) for w in (middle - change, middle, middle + change))
        # Simpson's rule over displacement, which runs from -1 to 1; the middle of the time is at `at_mid`.
        weight_low, weight_mid, weight_high = np.abs((v - v_s) / (6.0 * v)), 2.0 / 3.0, np.abs((v + v_s) / (6.0 * v))
        at_mid = -0.5 * v_s / v
        mean = 1.0 / (weight_low / low + weight_mid / mid + weight_high / high)
        delta = 3.0 * (weight_high * (high - mean) + weight_mid * at_mid * (mid - mean) - weight_low * (low - mean))
        constant = np.abs(delta) <= NEARLY_CONSTANT * self._over_lambda * mean
        slide[fast[constant]] = np.column_stack([v * h, mean, delta])[constant]
        return slide

    def _level(self, w: Array) -> Array:
        """s~ of signals (n, 5), where it depends on nothing else."""
        function = ca.Function("level", [self._blocks.model.w], [self._blocks.model.level])
        return np.array(function(w.T)).reshape(len(w))
