"""The S-GMS law, equations (1) to (3), and its limit that switches, in chi_i = z_i kappa_i / (nu_i f_C)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from sgms_mhe.machine import Smoothing
from sgms_mhe.model.axis import StateSpec, SymbolicAxis

LEAST_REST = 0.02
"""Share of its nominal that the largest fraction keeps, however large the others become: a level stays positive."""

WIDE_SWITCH = 1e-3
"""Share of the level over which elements that switch go over to slipping, where a solver has to follow them."""

STICKS = 1.0 - 2.0**-16
"""Share of the level below which an element sticks: one that slips is at its level but for rounding, which must not
decide, in single precision neither."""

# tanh(18.5) differs from 1 by less than half a unit in the last place of a double.
SATURATED = 18.5


@dataclass(frozen=True)
class FrictionSymbols:
    """Parameters of the law: each a free symbol's expression or a constant."""

    stiffness: Sequence[ca.SX]
    fraction: Sequence[ca.SX]
    micro_viscous: Sequence[ca.SX]
    coulomb: ca.SX
    viscous: ca.SX
    stribeck_ratio: ca.SX
    stribeck_velocity: ca.SX


@dataclass(frozen=True)
class Elements:
    """Elements as the rest of the model sees them.

    Attributes:
        deflection: z [m] (n_z).
        level: s(v) / f_C times the effects' factors, the level every element slips at.
        rho: d(chi_i)/dt of an element that sticks, over the measured velocity [1/m] (n_z): kappa_i / (nu_i f_C).
    """

    deflection: ca.SX
    level: ca.SX
    rho: ca.SX


def whole_shares(fraction: Sequence[float], nominal: Sequence[float]) -> tuple[list[float], float]:
    """Fractions that sum to 1, and the sum of levels over f_C: 1 but where the largest keeps its least.

    `fraction`: the identified ones of all but the largest nominal one, whose entry does not count.
    """
    largest = max(range(len(nominal)), key=nominal.__getitem__)
    others = sum(value for i, value in enumerate(fraction) if i != largest)
    rest = max(1.0 - others, LEAST_REST * nominal[largest])
    total = 1.0 if rest == 1.0 - others else others + rest
    return [(rest if i == largest else value) / total for i, value in enumerate(fraction)], total


def window(r: ca.SX, smoothing: Smoothing) -> ca.SX:
    """etaA of equation (3), the window in the relative deflection r that starts slip near |r| = zeta.

    The two hyperbolic tangents act on opposite signs of r. Where they do not overlap within double precision
    (lambda zeta >= 18.5, as with the paper's values) one of |r| says the same with one exponential less.
    """
    zeta, lambda_ = smoothing.zeta, smoothing.lambda_
    if lambda_ * zeta >= SATURATED:
        return 0.5 + 0.5 * ca.tanh(lambda_ * (ca.fabs(r) - zeta))
    return 1.0 - 0.5 * ca.tanh(lambda_ * (r + zeta)) + 0.5 * ca.tanh(lambda_ * (r - zeta))


def stribeck_share(velocity: ca.SX, symbols: FrictionSymbols) -> ca.SX:
    """exp(-(v/v_s)^2): s(v) / f_C, the Stribeck curve over the Coulomb level, is 1 + beta times it."""
    ratio = velocity / symbols.stribeck_velocity
    return ca.exp(-ratio * ratio)


def declare_elements(
    axis: SymbolicAxis,
    nominal_fraction: Sequence[float],
    nominal_stiffness: Sequence[float],
    symbols: FrictionSymbols,
    *,
    state_as: str,
    state_noise: float,
    position_noise: float,
    initial_state: float,
) -> None:
    """Declare the states of the n_z elements, so that effects may refer to them before their rates are known.

    An axis may move by `position_noise` [m] that is not measured: it is part of an element's noise in every interval.
    """
    for i, (nu, fraction) in enumerate(zip(nominal_fraction, symbols.fraction, strict=True)):
        per_metre = nominal_stiffness[i] / (nu * axis.coulomb)
        state = axis.add_state(
            StateSpec(
                name=f"z_{i + 1}",
                element=i,
                rate_per_metre=per_metre,
                rate_per_second=0.0,
                noise=math.hypot(state_noise, per_metre * position_noise),
                initial_state=initial_state,
            )
        )
        force_scale = symbols.coulomb / axis.coulomb * (fraction / nu)
        state.node_scale = (
            force_scale if state_as == "force" else force_scale * nominal_stiffness[i] / symbols.stiffness[i]
        )
        axis.element_force = axis.element_force + fraction * state.chi
    axis.coulomb_force, axis.damping = symbols.coulomb, symbols.viscous
    axis.stribeck_share = stribeck_share(axis.velocity, symbols)
    axis.stribeck_level = 1.0 + symbols.stribeck_ratio * axis.stribeck_share
    axis.rest_level = 1.0 + symbols.stribeck_ratio


def add_friction(
    axis: SymbolicAxis, symbols: FrictionSymbols, smoothing: Smoothing | None, switch_width: float = 0.0
) -> Elements:
    """Give the declared elements their rates, and add their forces and the viscous force to the axis.

    Without smoothing they switch: an element moves with the axis, and slips where the axis pushes it on at its level.
    With a `switch_width`, a share of the level, it does so gradually, and comes back along a level that falls.
    """
    v = axis.engagement * axis.velocity
    level = axis.stribeck_level * axis.coulomb_factor + axis.level_force / symbols.coulomb
    deflections: list[ca.SX] = []
    rhos: list[ca.SX] = []
    for i, nu in enumerate(symbols.fraction):
        state = axis.states[i]
        chi = state.chi
        rho = symbols.stiffness[i] / (nu * symbols.coulomb)
        if smoothing is None:
            along = ca.sign(v) * chi
            rate = rho * v * (ca.fmin(1.0, (level - along) / switch_width) if switch_width else along < STICKS * level)
        else:
            r = chi / level
            slip = window(r, smoothing)
            gate = 0.5 + 0.5 * ca.tanh(smoothing.gamma * (v / symbols.stribeck_velocity) * r)
            eta = slip * gate
            rate = rho * (v - ca.fabs(v) * (eta * r))
            state.names.update(r=r, window=slip, gate=gate, eta=eta, speed=ca.fabs(v))
        state.rate = rate
        deflections.append(chi / rho)
        rhos.append(rho * axis.velocity_ratio)
        axis.add_force(nu * symbols.coulomb * chi + (symbols.micro_viscous[i] + nu * axis.micro_viscous) * rate / rho)
    axis.add_force(symbols.viscous * axis.viscous_factor * v)
    return Elements(ca.vertcat(*deflections), level, ca.vertcat(*rhos))
