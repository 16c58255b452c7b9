"""Compensation as templates see it: times, limits, and the constants of the propagation ahead."""

import math
from dataclasses import dataclass

from sgms_mhe.machine import Machine
from sgms_mhe.model import gate_ratio
from sgms_mhe.signals.chain import chain_delay

AHEAD_SLOW_DISPLACEMENT = 0.01
"""Largest move in deflection scales per linearly implicit midpoint step, taken below the gate of the propagation."""
LIMIT_OF_FRICTION = 2.0
"""Largest force fed forward over the largest that the model's friction can have, where none is stated."""


@dataclass(frozen=True)
class Ahead:
    """Constants of the propagation ahead.

    Attributes:
        elastic: relative deflection below which slip is less than `equal` of the motion; not positive: there is none.
        gate_velocity: speed above which the gate counts as saturated [m/s].
        longest: duration of the longest move [s].
        curve: a / k of du/dxi = -k u + a u^2 about the fixed point.
        powers: k / ln 2 of the same.
        forgotten: powers of two after which the past makes no difference.
        displacement: largest move per Runge-Kutta step, in deflection scales: no sensitivity hangs on it.
        farthest: move in deflection scales after which an element slides, wherever it was.
        equal: slip, and relative deflections, that may be neglected.
    """

    elastic: float
    gate_velocity: float
    longest: float
    curve: float
    powers: float
    forgotten: float
    displacement: float = 0.05
    farthest: float = 10.0
    equal: float = 4e-6


@dataclass(frozen=True)
class FeedForward:
    """Force an axis feeds forward, and the conditions for it.

    Attributes:
        moves: of the propagation ahead: over the lag, over the delay.
        lag: of the signal chain [s].
        over_delay: extrapolation of the velocity to the middle of the delay, per difference between the mean velocity
            over the lag and the filtered one.
        at_end: the same to the end of the delay.
        gain_step: share a ramp adds per sample.
        carry: share of the difference after standstill that remains from one sample to the next.
        limit: largest force [N], or None.
        ahead: constants of the propagation; None where elements switch, which asks for none.
    """

    moves: int
    lag: float
    over_delay: float
    at_end: float
    gain_step: float
    ramped: tuple[str, ...]
    carry: float
    limit: float | None
    ahead: Ahead | None


def compensation_of(machine: Machine) -> FeedForward:
    """Return the machine file's compensation in the form of the emitted code."""
    compensation, rate = machine.compensation, machine.sampling.rate
    lag, h = chain_delay(machine), machine.sampling.step
    # At constant acceleration the filtered velocity is that of lag + h/2 ago (a difference is the velocity of half a
    # sample ago). The mean velocity since, the displacement beyond the filtered position over the lag, is later by:
    later = 0.5 * (lag + h)
    return FeedForward(
        moves=2 if compensation.delay else 1,
        lag=lag,
        over_delay=(lag + 0.5 * h + 0.5 * compensation.delay) / later,
        at_end=(lag + 0.5 * h + compensation.delay) / later,
        gain_step=min(1.0, 1.0 / (rate * compensation.ramp)) if compensation.ramp else 1.0,
        ramped=("OVERRUN", "DOUBT") if compensation.on_doubt == "ramp" else ("OVERRUN",),
        carry=math.exp(-1.0 / machine.sampling.samples_per_update),
        limit=force_limit(machine),
        ahead=None if machine.friction.switches else _ahead(machine),
    )


def force_limit(machine: Machine) -> float | None:
    """Largest force [N] fed forward: as stated, or from the friction the model can have; None: there is none."""
    stated, friction, estimator = machine.compensation.limit, machine.friction, machine.estimator
    if stated is not None or machine.effects:  # the forces of effects may be of any size
        return stated

    def most(name: str) -> float:
        high = estimator.bounds.get(name, (0.0, math.inf))[1]
        return high if name in estimator.parameters else 1.0

    level = friction.coulomb * most("coulomb") * (1.0 + friction.stribeck_ratio * most("stribeck_ratio"))
    damping = friction.viscous * most("viscous") + sum(friction.micro_viscous)
    force = LIMIT_OF_FRICTION * (level + damping * machine.sampling.max_velocity)
    return force if math.isfinite(force) else None


def ahead_elastic(machine: Machine) -> float:
    """Relative deflection below which slip is less than `Ahead.equal` of the motion; not positive: there is none."""
    smoothing = machine.friction.smoothed
    return smoothing.zeta + math.log(Ahead.equal) / (2.0 * smoothing.lambda_)


def _ahead(machine: Machine) -> Ahead:
    friction, smoothing, sampling = machine.friction, machine.friction.smoothed, machine.sampling
    zeta, lambda_, gamma = smoothing.zeta, smoothing.lambda_, smoothing.gamma
    longest = chain_delay(machine) + machine.compensation.delay + sampling.merged * sampling.step
    # Taken as saturated, a gate whose tail is left out moves an element's force by kappa |v| T tail at most.
    saturated = gate_ratio(zeta, lambda_, gamma)
    stroke = saturated * friction.stribeck_velocity * longest * sum(friction.stiffness) / friction.coulomb
    gate = min(saturated, gate_ratio(zeta, lambda_, gamma, Ahead.equal / stroke))
    r = 1.0
    for _ in range(60):  # 1 - etaA(r) r = 0
        window = 1.0 / (1.0 + math.exp(-2.0 * lambda_ * (r - zeta)))
        first = 2.0 * lambda_ * window * (1.0 - window)
        r += (1.0 - window * r) / (window + first * r)
    second = 2.0 * lambda_ * first * (1.0 - 2.0 * window)
    return Ahead(
        elastic=ahead_elastic(machine),
        gate_velocity=gate * friction.stribeck_velocity,
        longest=longest,
        curve=-0.5 * (2.0 * first + second * r) / (window + first * r),
        powers=(window + first * r) / math.log(2.0),
        forgotten=-math.log2(Ahead.equal),
    )
