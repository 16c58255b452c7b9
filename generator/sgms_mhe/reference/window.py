"""Shooting intervals side by side about one point: those linearised by an update, and the measurements of one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sgms_mhe.reference.linearised import Linearised, Outputs
from sgms_mhe.reference.plan import Plan
from sgms_mhe.reference.problem import NodeRecord
from sgms_mhe.reference.readings import Gaussian, MeasurementResult, Scaling, take_reading
from sgms_mhe.support.arrays import Array


@dataclass(frozen=True)
class Window:
    """One update's problem, linearised at (x, theta): n intervals, n + 1 nodes, the oldest one `first`."""

    first: int
    x: Array
    theta: Array
    intervals: Linearised
    outputs: Outputs

    @property
    def before_newest(self) -> Window:
        """Without the newest interval."""
        older = slice(0, -1)
        return Window(self.first, self.x[older], self.theta, self.intervals.part(older), self.outputs.part(older))

    @property
    def newest(self) -> Window:
        """The newest interval alone."""
        ends, first = slice(-2, None), self.first + len(self.x) - 2
        intervals = self.intervals.part(slice(-1, None))
        return Window(first, self.x[ends], self.theta, intervals, self.outputs.part(ends))


def linearise(record: NodeRecord, first: int, x: Array, theta: Array) -> Window:
    """Integrate from every node of x; the newest node starts where the newest interval leads."""
    return window_of(record, first, x, theta, integrate(record, record.plan, first, x, theta))


def integrate(record: NodeRecord, plan: Plan, first: int, x: Array, theta: Array) -> Linearised:
    """Intervals from the nodes x, the first of them from node `first`."""
    with np.errstate(all="ignore"):
        return record.integrator.intervals(plan, first, x, theta)


def window_of(record: NodeRecord, first: int, x: Array, theta: Array, intervals: Linearised) -> Window:
    """The problem about (x, theta) and the end of the newest interval, outputs linearised there."""
    with np.errstate(all="ignore"):
        nodes = np.vstack([x, intervals.x1[-1:]])
        outputs = record.integrator.outputs(nodes, record.w[first : first + len(nodes)], theta)
    return Window(first, nodes, theta, intervals, outputs)


class NoiseFactors(NamedTuple):
    """Factors on the stated standard deviation that measurements are taken with.

    Attributes:
        end: at the nodes (updates + 1); infinite where a measurement is left out.
        inner: inside of the intervals (updates, R - 1).
    """

    end: Array
    inner: Array

    @classmethod
    def of(cls, record: NodeRecord) -> NoiseFactors:
        """As stated, before any measurement was looked at."""
        return cls(np.ones(record.updates + 1), np.ones(record.inner_y.shape))


class Taken(NamedTuple):
    """An interval's measurements, each predicted from all before it.

    Attributes:
        belief: of the node where the interval ends and theta, after all of them.
        readings: the valid ones, in their order.
        inner_scales: factors of those inside (R - 1), 1 where a measurement is not valid.
        end_scale: of the last one.
    """

    belief: Gaussian
    readings: tuple[MeasurementResult, ...]
    inner_scales: Array
    end_scale: float

    def newest(self, before: MeasurementResult) -> MeasurementResult:
        """The last of them; `before` where there is none."""
        return self.readings[-1] if self.readings else before


def take_interval(record: NodeRecord, window: Window, belief: Gaussian, scaling: Scaling, *, drift: int = 0) -> Taken:
    """Fold the measurements of a window of one interval into a belief of its start; predict over it in between.

    theta drifts for `drift` intervals.
    """
    weights, k, n_x = record.weights, window.first, window.x.shape[1]
    point = np.concatenate([window.x[0], window.theta])
    readings = []
    inner, inner_scales = window.intervals.inner, np.ones(record.inner_y.shape[1])
    for r in np.flatnonzero(record.inner_valid[k]):
        C = np.concatenate([inner.C[0, r], inner.D[0, r]])
        innovation = float(record.inner_y[k, r] - inner.y[0, r] - C @ (belief.mean - point))
        belief, reading = take_reading(belief, C, innovation, weights.sigma_y, scaling, record.inner_noise[k, r])
        inner_scales[r] = reading.scale
        readings.append(reading)
    growth = weights.drift_variance(np.diag(belief.covariance)[n_x:], drift)
    belief = predict(window, 0, belief)
    belief = Gaussian(belief.mean, belief.covariance + np.diag(np.concatenate([record.sigma_x[k] ** 2, growth])))
    end_scale = 1.0
    if record.valid[k + 1]:
        # The output is linearised where the interval leads, not where the measurements inside have moved it.
        C = np.concatenate([window.outputs.C[1], window.outputs.D[1]])
        image = np.concatenate([window.intervals.x1[0], window.theta])
        innovation = float(record.y[k + 1] - window.outputs.y[1] - C @ (belief.mean - image))
        belief, reading = take_reading(belief, C, innovation, weights.sigma_y, scaling, record.noise[k + 1])
        end_scale = reading.scale
        readings.append(reading)
    return Taken(belief, tuple(readings), inner_scales, end_scale)


def predict(window: Window, k: int, belief: Gaussian) -> Gaussian:
    """The belief of (x, theta) at the start of interval k carried to its end, without noise."""
    n_x = window.x.shape[1]
    mean, P = belief
    F = np.eye(len(mean))
    F[:n_x, :n_x], F[:n_x, n_x:] = window.intervals.A[k], window.intervals.B[k]
    point = np.concatenate([window.x[k], window.theta])
    image = np.concatenate([window.intervals.x1[k], window.theta])
    return Gaussian(image + F @ (mean - point), F @ P @ F.T)
