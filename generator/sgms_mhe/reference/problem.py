"""Common parts of all reference estimators: the numbers of docs/estimation.md, the record at its nodes, results."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property
from typing import Self

import numpy as np

from sgms_mhe.model import Model
from sgms_mhe.reference.integrator import ReferenceIntegrator
from sgms_mhe.reference.lasting import BLOCK, LastingErrors
from sgms_mhe.reference.plan import Plan, inner_readings, motion_of
from sgms_mhe.reference.readings import Gaussian, MeasurementResult, Scaling
from sgms_mhe.signals.chain import Signals, mean_samples, signal_array
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.arrays import Array, Index, Mask

Progress = Callable[[int, int], None]
"""Called as progress(updates done, updates in all)."""

HOLD_PART = 0.1
IMPLAUSIBLE = 1e4
"""A state so many standard deviations of the first node's away from zero is no solution."""
MOVE = 0.3
CLEARLY = 1.01
"""So many times as far as any newer one an interval has to have moved, to be linearised anew in its stead."""
LEAST_NOISE = 1e-6
"""Share of its variance that the noise of a state with a length has where the axis stands."""
REFUSED = -1
NOT_FINITE = -2


class UpdateStatus(IntFlag):
    """Status of an update; 0 is good."""

    FILLING = 1
    MISSING = 2
    HOLD = 4
    BOUND = 8
    SPEED = 16
    DOUBT = 64


@dataclass(frozen=True)
class Weights:
    """Standard deviations and bounds of the estimation problem.

    Attributes:
        horizon: N, intervals in the window.
        drift_interval: shifts of the window between two growths of the arrival cost by the drift.
        move: how far the end of an interval may move before it is linearised anew (n_x), node state units.
        sigma_y: measurement [N].
        sigma_x: state noise per interval (n_x), node state units.
        noise_travel: length along which that of a state comes up to it (n_x) [m]; 0: every interval has it.
        initial_state: first node's state (n_x).
        parameter: prior of theta (n_p).
        drift: random walk of theta per update (n_p).
        lower, upper: bounds on theta (n_p), infinite where there are none.
        self_scaling: whether measurements are weighed by how well they were predicted.
        colour: of their innovations, as the axis is known for: a squared sum over its number.
        hold_path: motion since an interval that counted, below which one does not count [m].
        max_velocity: speed beyond which the estimate is flagged [m/s].
        lasting_block: intervals after which a block of errors that stay ends.
    """

    horizon: int
    drift_interval: int
    move: Array
    sigma_y: float
    sigma_x: Array
    noise_travel: Array
    initial_state: Array
    parameter: Array
    drift: Array
    lower: Array
    upper: Array
    self_scaling: bool
    colour: float
    hold_path: float
    max_velocity: float
    lasting_block: int = BLOCK

    @classmethod
    def of(cls, model: Model) -> Self:
        """Read them from a model and its machine."""
        machine, noise = model.machine, model.machine.estimator.noise
        friction = machine.friction
        scales = np.array(friction.fraction) * friction.coulomb / np.array(friction.stiffness)
        step = np.sqrt(model.state_noise / friction.smoothing.lambda_) if friction.smoothing else model.state_noise
        return cls(
            horizon=machine.estimator.horizon,
            drift_interval=machine.estimator.drift_interval,
            # What has its noise along travel is linear: never far from where it was linearised.
            move=np.where(model.noise_travel > 0.0, np.inf, MOVE * step),
            sigma_y=noise.measurement,
            sigma_x=model.state_noise,
            noise_travel=model.noise_travel,
            initial_state=model.initial_state,
            parameter=model.prior,
            drift=model.drift,
            lower=np.array([p.lower for p in model.parameters]),
            upper=np.array([p.upper for p in model.parameters]),
            self_scaling=noise.self_scaling,
            colour=noise.colour,
            hold_path=HOLD_PART * float(scales.min()),
            max_velocity=machine.sampling.max_velocity,
        )

    def is_plausible(self, x: Array) -> bool:
        """Return True if a state (n_x) is finite and one that an axis can have."""
        return bool(np.all(np.abs(x) < IMPLAUSIBLE * self.initial_state))

    @property
    def prior(self) -> tuple[Array, Array]:
        """Mean and covariance of (x_0, theta) before any measurement."""
        mean = np.concatenate([np.zeros(len(self.sigma_x)), np.ones(len(self.parameter))])
        return mean, np.diag(np.concatenate([self.initial_state, self.parameter]) ** 2)

    def drift_variance(self, variance: Array, owed: int) -> Array:
        """d_j^2 of docs/estimation.md: growth of the variances of theta over so many intervals that moved."""
        return np.minimum(owed * self.drift**2, np.maximum(0.0, self.parameter**2 - variance))


@dataclass(frozen=True)
class Start:
    """Distribution before a record's first sample, where that is not the machine file's prior.

    Attributes:
        x: node state (n_x), known as well as any first node's.
        theta: scaled parameters (n_p).
        covariance: of theta (n_p, n_p).
        slow: slow mean of the test ratios of measurements.
    """

    x: Array
    theta: Array
    covariance: Array
    slow: float = 1.0


def noise_along(path: Array, weights: Weights) -> Array:
    """State noise (k, n_x) of k intervals of these paths [m], node state units.

    That of a state with a length l comes up to its own along the path: its variance is (u + LEAST_NOISE) / (1 + u) of
    it, u = 2 path / l, that of a first-order process with little error and of none without motion.
    """
    travels = weights.noise_travel > 0.0
    u = 2.0 * path[:, None] / np.where(travels, weights.noise_travel, 1.0)
    return weights.sigma_x * np.where(travels, np.sqrt((u + LEAST_NOISE) / (1.0 + u)), 1.0)


class NodeRecord:
    """A record as the estimators see it: plan of its intervals, signals and measurements.

    sigma_x (updates, n_x): state noise of each interval, node state units.
    Measurements y, valid: at the nodes 0 .. updates; inner_y, inner_valid (updates, R - 1): inside of the intervals.
    noise, inner_noise: factors on their stated deviations, by samples the chain has bridged.
    """

    def __init__(
        self,
        model: Model,
        signals: Signals,
        integrator: ReferenceIntegrator,
        *,
        weights: Weights | None = None,
        start: Start | None = None,
    ) -> None:
        self.model = model
        self.integrator = integrator
        self.weights = weights or Weights.of(model)
        self.start = start
        samples = model.machine.sampling.samples_per_update
        self.plan: Plan = integrator.plan(signals)
        self._signals = signals
        self.updates = len(self.plan.path)
        self._motion = motion_of(self.plan.path, self.plan.displacement, self.weights.hold_path)
        self.sigma_x: Array = noise_along(self.plan.path, self.weights)
        nodes = samples * np.arange(self.updates + 1)
        self.w: Array = signal_array(signals, model.machine.sampling.step, mean=mean_samples(model.machine))[nodes]
        self.time: Array = signals.time[nodes]
        self.y: Array = signals.friction[nodes]
        self.valid: Mask = signals.valid[nodes] & np.isfinite(self.y)
        inside = (slice(None), inner_readings(model.machine.sampling))
        after = slice(1, self.updates * samples + 1)
        self.inner_y: Array = signals.friction[after].reshape(self.updates, samples)[inside]
        valid = signals.valid[after].reshape(self.updates, samples)[inside]
        self.inner_valid: Mask = valid & np.isfinite(self.inner_y)
        noise = np.ones(len(signals)) if signals.noise is None else signals.noise
        self.noise: Array = noise[nodes]
        self.inner_noise: Array = noise[after].reshape(self.updates, samples)[inside]

    @cached_property
    def kept_plan(self) -> Plan:
        """The plan of intervals that are linearised anew, from what an axis keeps of them."""
        return self.integrator.plan(self._signals, rounded=True) if self.model.rounding else self.plan

    @property
    def first(self) -> Gaussian:
        """Belief of (x_0, theta) before any measurement."""
        mean, covariance = self.weights.prior
        if self.start is None:
            return Gaussian(mean, covariance)
        covariance[self.model.n_x :, self.model.n_x :] = self.start.covariance
        return Gaussian(np.concatenate([self.start.x, self.start.theta]), covariance)

    @property
    def scaling(self) -> Scaling:
        """How measurements are weighed before any measurement."""
        return Scaling(self.weights.self_scaling, slow=self.start.slow if self.start else 1.0)

    def start_lasting(self, *, drifts: bool = True) -> LastingErrors:
        """Errors of the model that stay, before any measurement; `drifts`: whether the drift of theta enters at all."""
        weights = self.weights
        return LastingErrors(
            drifts * weights.drift,
            1 + self.inner_y.shape[1],
            colour=weights.colour,
            enabled=weights.self_scaling,
            length=weights.lasting_block,
        )

    def moves(self, interval: int) -> bool:
        """Return True if an interval counts as motion: theta drifts, and its innovations tell of errors that stay."""
        return not self._motion[interval] < self.weights.hold_path

    def status(self, node: int) -> int:
        """Return the status of the update at a node, from the newest interval and measurement."""
        is_whole = self.valid[node] and self.noise[node] == 1.0
        status = 0 if is_whole else int(UpdateStatus.MISSING)
        if not self.moves(node - 1):
            status |= UpdateStatus.HOLD
        if self.plan.fastest[node - 1] > self.weights.max_velocity:
            status |= UpdateStatus.SPEED
        return int(status)


def estimates(
    record: NodeRecord,
    x: Array,
    theta: Array,
    std: Array,
    status: Index,
    readings: Sequence[MeasurementResult] | None = None,
) -> Estimates:
    """Results of all updates: x (u, n_x), theta, std in scaled units (u, n_p); the newest reading of each, if known."""
    model, u = record.model, record.updates
    chi = model.function("from_node").map(max(u, 1))
    output, deflection = (model.function(name).map(max(u, 1)) for name in ("output", "deflection"))
    friction, z = np.empty(0), np.empty((0, model.n_z))
    if u > 0:
        states = chi(x.T, theta.T)
        friction = np.array(output(states, record.w[1:].T, theta.T)).reshape(u)
        z = np.array(deflection(states, theta.T)).T
    newest = np.full((u, 3), np.nan) if readings is None else np.array(readings, dtype=float).reshape(u, 3)
    return Estimates(
        time_s=record.time[1:],
        friction_measured_N=record.y[1:],
        friction_N=friction,
        z_m=z,
        parameters=model.to_si(theta),
        std=std * np.abs([p.scale for p in model.parameters]),
        status=status,
        innovation_N=newest[:, 0],
        test_ratio=newest[:, 1],
        noise_scale=newest[:, 2],
        parameter_names=tuple(p.column for p in model.parameters),
        kind=model.machine.plant.kind,
        extra={"x": x, "theta": theta, "theta_std": std},
    )
