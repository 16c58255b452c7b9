"""Self-test vectors of a package: a short motion and the reference solver's estimates from it."""

import math
from dataclasses import dataclass, replace
from itertools import accumulate

import casadi as ca
import numpy as np

from sgms_mhe.emission.compensation import compensation_of
from sgms_mhe.emission.selftest_drive import DriveVectors, drive_vectors
from sgms_mhe.emission.selftest_motion import CountedMotion, round_values, selftest_motion
from sgms_mhe.emission.variant import variant_of
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model
from sgms_mhe.reference import NodeRecord, ReferenceIntegrator, UpdateStatus, Weights, run_ekf, run_mhe
from sgms_mhe.signals.chain import (
    Bridge,
    Signals,
    apply_chain,
    hold_last,
    mean_samples,
    settle_samples,
    signal_array,
    signals_from_log,
)
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.arrays import Array, Index

_MOST_STEPS = 5000
"""Steps of the series that the reference integrates for the vectors, at most, in jumps of the flow."""
_RUNGE_KUTTA = 4
"""Jumps of the flow that take the reference as long as a Runge-Kutta step."""
_STATES = 6
"""States of which a step takes no longer."""
_BEYOND_WINDOW = 3
"""Updates with a full window."""
_SECOND = 5
"""Updates of the second run, with other settings."""
_SET_PART = 0.25
"""Set-point of the second run over the largest speed; its acceleration takes the Coulomb level. Every other is slow."""
_SUBSTEPS = 100
"""Runge-Kutta steps of each move of the force ahead."""


@dataclass(frozen=True)
class ReferenceRun:
    """Estimates of the reference solver along the motion, or its beginning; rounded, so that every machine prints them.

    Attributes:
        rows: at each update friction, estimated and as last measured [N]; of the newest measurement the innovation [N],
            test ratio and noise scale; deflections of the elements [m]; parameters and their deviations, 1 sigma [SI].
        statuses: of the updates.
        forces: fed forward after each update [N], by each way to call the axis.
    """

    rows: tuple[tuple[float, ...], ...]
    statuses: tuple[int, ...]
    forces: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Vectors:
    """The motion, and two runs of the reference along it.

    Attributes:
        motion: segments, the first run is along all of them.
        largest: friction of the first run [N]. farthest: deflection in it [m].
        span: intervals in which the signal chain settles and an update comes after that.
        velocity: at which the force of the model at rest is far beyond its limit [m/s]; 0: at none.
        set_velocity: set-points after odd and after even updates of the second run by sample() [m/s].
        set_acceleration: with them [m/s^2].
        first: with the machine file's settings.
        second: with other noise everywhere and all parameters within `bound` of nominal; by sample() and insert().
        bound: of the second run, about nominal, over nominal.
        other: growth of the second run's settings from one state, and one parameter, to the next.
        drive: of a commanded axis.
    """

    motion: CountedMotion
    largest: float
    farthest: float
    span: int
    velocity: float
    set_velocity: tuple[float, float]
    set_acceleration: float
    first: ReferenceRun
    second: ReferenceRun
    drive: DriveVectors | None
    bound: float = 0.03
    other: float = 0.25

    @property
    def intervals(self) -> int:
        """Intervals of all parts of the self-test, at most."""
        return self.updates + 2 * len(self.second.rows) + 40 * self.span + 40

    @property
    def updates(self) -> int:
        """Updates of the first run."""
        return len(self.first.rows)


def selftest_vectors(model: Model) -> Vectors:
    """Make the vectors: strokes of growing length through presliding, with a gap, until the window is full.

    Where the reference would take too long for that, there are fewer updates; the chain's filters have settled in all.
    """
    machine = model.machine
    updates = _updates(model)
    settle = settle_samples(machine)
    motion = selftest_motion(machine, updates, settle)
    log = motion.log(machine)
    signals = signals_from_log(log, machine)
    integrator = ReferenceIntegrator(model, compiled=False)
    weights = Weights.of(model)
    first = _run(model, signals, integrator, weights)
    least = min(updates - 1, max(_least_updates(model), _SECOND))
    end = least * machine.sampling.samples_per_update + 1
    bounded = bool(np.any(np.isfinite([weights.lower, weights.upper])))
    states, parameters = (1.0 + Vectors.other * np.arange(n) for n in (model.n_x, model.n_p))
    other = replace(
        weights,
        sigma_y=2.0 * weights.sigma_y,
        sigma_x=states * weights.sigma_x,
        move=weights.move * (np.sqrt(states) if machine.friction.smoothing else states),
        parameter=weights.parameter / parameters,
        drift=weights.drift * parameters,
        lasting_block=1,
    )
    if bounded:
        ones = np.ones(model.n_p)
        other = replace(other, lower=(1.0 - Vectors.bound) * ones, upper=(1.0 + Vectors.bound) * ones)
    second = _run(model, signals.part(slice(0, end)), integrator, other)
    ahead = _set_velocities(machine), machine.friction.coulomb / machine.plant.moved
    tick, sample, insert = (
        _force_ahead(model, *of, signals, log.position_m, lags, ahead if of is second and lags else None)
        for of, lags in ((first, True), (second, True), (second, False))
    )
    largest, farthest = round_values(np.array([np.abs(each).max() for each in (first[0].friction_N, first[0].z_m)]))
    return Vectors(
        motion=motion,
        largest=largest,
        farthest=farthest,
        span=_least_updates(model) - 1,
        velocity=_velocity_beyond_limit(model),
        set_velocity=ahead[0],
        set_acceleration=ahead[1],
        first=_round_run(*first, tick),
        second=_round_run(*second, sample, insert),
        drive=drive_vectors(machine),
    )


def _set_velocities(machine: Machine) -> tuple[float, float]:
    """Velocities to come: sliding, and, where there is one, within the gate that slow motion opens [m/s]."""
    fast, of = _SET_PART * machine.sampling.max_velocity, compensation_of(machine)
    return fast, max(0.5 * of.ahead.gate_velocity if of.ahead else 0.01 * fast, 2.0 * machine.compensation.hold)


def _velocity_beyond_limit(model: Model) -> float:
    """Velocity at which the force of the model at rest is far beyond its limit both ways [m/s]; 0: at none."""
    limit = compensation_of(model.machine).limit
    output = ca.Function("f", [model.chi, model.w, model.theta], [model.feed_forward])
    if limit is None or model.machine.compensation.delay:
        return 0.0
    rest, nominal = np.zeros(model.n_x), np.ones(model.n_p)
    for velocity in (10.0**k for k in range(-3, 8)):
        there, back = (float(output(rest, [0, v, 0, 0, 0], nominal)) for v in (velocity, -velocity))
        if min(there, -back) > 4.0 * limit:
            return velocity
    return 0.0


def _least_updates(model: Model) -> int:
    """Updates until the signal chain has settled, and three more."""
    sampling = model.machine.sampling
    return math.ceil((settle_samples(model.machine) + 1) / sampling.samples_per_update) + 3


def _updates(model: Model) -> int:
    """Updates of the motion: until the window is full, as far as the reference gets in time."""
    sampling, variant = model.machine.sampling, variant_of(model)
    least = _least_updates(model)
    wanted = max(least, min(max(1, variant.horizon), 100) + _BEYOND_WINDOW)
    is_jump = model.machine.friction.switches or sampling.integrator.scheme == "flow"
    each = sampling.samples_per_update // sampling.merged * (1 if is_jump else _RUNGE_KUTTA)
    each *= max(1, model.n_x // _STATES)
    steps = updates = 0
    while updates < wanted and (updates < least or steps < _MOST_STEPS):
        updates += 1
        intervals = {"all": min(updates, variant.horizon), "auto": min(updates, 2), "newest": 1}[variant.relinearise]
        steps += intervals * each
    return updates


def _run(
    model: Model, signals: Signals, integrator: ReferenceIntegrator, weights: Weights
) -> tuple[Estimates, NodeRecord]:
    record = NodeRecord(model, signals, integrator, weights=weights)
    solve = run_mhe if model.machine.estimator.kind == "mhe" else run_ekf
    return solve(record), record


def _round_run(found: Estimates, record: NodeRecord, *forces: Array) -> ReferenceRun:
    measured = hold_last(np.where(record.valid[1:], found.friction_measured_N, np.nan), 0.0)
    readings = found.innovation_N, found.test_ratio, found.noise_scale
    numbers = np.column_stack([found.friction_N, measured, *readings, found.z_m, found.parameters, found.std])
    rows, statuses = tuple(map(round_values, numbers)), tuple(map(int, found.status))
    return ReferenceRun(rows, statuses, tuple(map(round_values, forces)))


def _force_ahead(
    model: Model,
    found: Estimates,
    record: NodeRecord,
    signals: Signals,
    position_m: Array,
    lags: bool,
    set_point: tuple[tuple[float, float], float] | None,
) -> Array:
    """Return the force of the sample after each update (u) [N]: the model, moved on over that, the lag and the delay.

    By plain Runge-Kutta steps of the symbolic model, at constant velocity over each of the moves.

    Args:
        model: of the axis.
        found: estimates from the record.
        record: of the nodes.
        signals: of all samples.
        position_m: of all samples, as recorded.
        lags: through the machine's own chain, whose lag is made up for.
        set_point: velocities to come, after odd and even updates, and acceleration [m/s, m/s^2]; None: none is set.
    """
    machine, ahead, delay = model.machine, compensation_of(model.machine), model.machine.compensation.delay
    step, samples = machine.sampling.step, machine.sampling.samples_per_update
    nodes = samples * np.arange(1, record.updates + 1) + 1
    x, theta = found.extra["x"].T, found.extra["theta"].T
    w = signal_array(signals, step, mean=mean_samples(machine))[nodes].T
    filled = Bridge(machine).take(position_m, np.zeros(len(position_m)))[0]
    measured = w[1].copy()
    lag_m = (filled - apply_chain(machine, filled))[nodes] if lags else measured * ahead.lag
    mean = lag_m / ahead.lag
    w[[0, 4]] -= np.array([measured * step, step * np.ones(len(nodes))])
    w[2] = w[5:] = set_point[1] if set_point else 0.0
    moves = [(measured * step, step), (lag_m, ahead.lag)] if lags else [(measured * step, step)]
    if machine.sampling.merged > 1:  # samples that are in no step yet and the lag are one move
        moves = [(sum(distance for distance, _ in moves), sum(duration for _, duration in moves))]
    over_delay, at_end = (
        np.resize(set_point[0], len(nodes)) if set_point else measured + (mean - measured) * part
        for part in (ahead.over_delay, ahead.at_end)
    )
    moves.append((over_delay * delay, delay))
    chi = np.array(model.function("from_node").map(record.updates)(x, theta))
    for distance, duration in moves:
        if duration > 0.0:
            w[0] += distance
            w[1] = distance / duration
            w[4] += duration
            chi = _move_states(model, chi, w, theta, duration)
    w[1] = at_end
    output = ca.Function("f", [model.chi, model.w, model.theta], [model.feed_forward]).map(record.updates)
    force = np.array(output(chi, w, theta)).reshape(record.updates)
    force = force * _ramp(machine, found.status, int(nodes[-1]) + 1)[nodes]
    return np.asarray(force if ahead.limit is None else np.clip(force, -ahead.limit, ahead.limit))


def _ramp(machine: Machine, statuses: Index, count: int) -> Array:
    """Share that is on after each of so many samples (count), from off on: in the runs DOUBT alone ramps it down."""
    step, samples = compensation_of(machine).gain_step, machine.sampling.samples_per_update
    falls = (np.append(0, statuses) & UpdateStatus.DOUBT) * ("DOUBT" in compensation_of(machine).ramped)
    changes = np.where(falls[np.maximum(np.arange(count) - 1, 0) // samples], -step, step)
    shares = accumulate(changes, lambda share, change: min(1.0, max(0.0, share + change)), initial=0.0)
    return np.array(list(shares)[1:])


def _move_states(model: Model, chi: Array, w: Array, theta: Array, duration: float) -> Array:
    """States (n_x, u) after a move at the signals w (5, u); elements that switch go no further than their level."""
    updates, h = chi.shape[1], duration / _SUBSTEPS
    rhs = model.function("rhs").map(updates)
    level = model.function("level").map(updates) if model.machine.friction.switches else None
    for _ in range(_SUBSTEPS):
        k1 = np.array(rhs(chi, w, theta))
        k2 = np.array(rhs(chi + 0.5 * h * k1, w, theta))
        k3 = np.array(rhs(chi + 0.5 * h * k2, w, theta))
        k4 = np.array(rhs(chi + h * k3, w, theta))
        chi = chi + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        if level is not None:
            most, way = np.abs(np.array(level(chi, w, theta))), np.sign(w[1])
            chi[: model.n_z] = way * np.minimum(way * chi[: model.n_z], most)
    return chi
