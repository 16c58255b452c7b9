"""Constants of templates: the S-GMS law in logistic functions, the displacement flow, numbers of substeps."""

import math
from dataclasses import dataclass
from typing import Final

from sgms_mhe.emission.structure import Block, Group
from sgms_mhe.machine import Machine
from sgms_mhe.model import FlowTable, flow_table, gate_ratio
from sgms_mhe.model.friction import SATURATED

FARTHEST = 5.0
"""Relative deflection that no element comes near: a level is reached at 1."""


@dataclass(frozen=True)
class ElementLaw:
    """Constants of an element's right side; exponents are powers of two of |r| and r v (docs/emission.md).

    Exponents must stay in range. Either r is limited to `farthest`, where the range reaches far beyond every
    deflection there is, and the gate's velocity within `fastest`, beyond which the gate is saturated wherever the
    window is not shut; the two clamps come doubled. Or (`farthest` is 0) both exponents are limited to `deepest`,
    where the logistic functions have reached 0 or 1 to rounding.

    Attributes:
        farthest: clamp of |r| [1]; 0: none.
        deepest: largest exponent that matters.
        fastest: clamp of the gate's velocity [m/s].
        window: exponent of the window per |r|, doubled or not.
        offset: exponent of the window at r = 0.
        gate: exponent of the gate per r v [s/m], v doubled or not.
        ln2: d(2^x)/dx at 0.
    """

    farthest: float
    deepest: float
    fastest: float
    window: float
    offset: float
    gate: float
    ln2: float


def element_law(machine: Machine) -> ElementLaw | None:
    """The law's constants; None where the window's own exponent leaves the range of the package's numbers.

    The window depends on |r| alone where its two sides do not overlap (`SATURATED`).
    """
    smoothing, friction = machine.friction.smoothed, machine.friction
    single = machine.code.precision == "single"
    fastest = max(1.0, smoothing.lambda_ / smoothing.gamma)
    per_power = 1.0 / math.log(2.0)
    deepest, largest = (30.0, 125.0) if single else (60.0, 1000.0)
    offset = 2.0 * smoothing.lambda_ * smoothing.zeta * per_power
    farthest = largest / (2.0 * max(smoothing.lambda_, smoothing.gamma * fastest) * per_power)
    if smoothing.lambda_ * smoothing.zeta < SATURATED or offset + deepest > largest:
        return None
    shared = farthest >= FARTHEST
    return ElementLaw(
        farthest=farthest if shared else 0.0,
        deepest=deepest,
        fastest=fastest * friction.stribeck_velocity,
        window=(1.0 if shared else 2.0) * smoothing.lambda_ * per_power,
        offset=offset,
        gate=-(0.5 if shared else 2.0) * smoothing.gamma / friction.stribeck_velocity * per_power,
        ln2=math.log(2.0),
    )


LEVEL_CHANGE = 0.0175
"""Change of the level over merged samples, times lambda, up to which an element slides through them at once."""


@dataclass(frozen=True)
class EmittedFlow:
    """Constants of the displacement flow of one machine.

    Attributes:
        table: psi and its inverse.
        gate: |v| / v_s above which the gate is saturated.
        gate_velocity: the same speed [m/s].
        level_change: of the level over merged samples, over the level, up to which an element slides through at once.
        farthest: xi from which on exp(-k xi) counts as zero; it is still a normal number.
        phi, d_phi: coefficients of the alternating series of phi(x) and x phi'(x) (docs/integration.md), from x^2 on.
    """

    table: FlowTable
    gate: float
    gate_velocity: float
    level_change: float
    farthest: float
    phi: tuple[float, ...]
    d_phi: tuple[float, ...]


def flow_of(machine: Machine) -> EmittedFlow:
    """Constants of a machine whose elements follow the flow.

    Raises:
        InputError: the smoothing is too soft for it.
    """
    smoothing, precision = machine.friction.smoothed, machine.code.precision
    gate = gate_ratio(smoothing.zeta, smoothing.lambda_, smoothing.gamma)
    table = flow_table(smoothing.zeta, smoothing.lambda_, precision, str(machine.source))
    exponent, relaxation = (60.0, 64.0) if precision == "single" else (600.0, 640.0)
    orders = range(2, 9)
    return EmittedFlow(
        table=table,
        gate=gate,
        gate_velocity=gate * machine.friction.stribeck_velocity,
        level_change=LEVEL_CHANGE / smoothing.lambda_,
        farthest=min(exponent, relaxation / table.k),
        phi=tuple((n - 1.0) / math.factorial(n + 1) for n in orders),
        d_phi=tuple(n * (n - 1.0) / math.factorial(n + 1) for n in orders),
    )


SLOW_LAMBDA = 35.0
"""Largest lambda up to which `slow_displacement` holds as it stands: the slip window is 1 / lambda wide."""


@dataclass(frozen=True)
class Stage:
    """Stage of a Runge-Kutta step: Y = y + a h k with the slope k of the stage before, at the time t + c h.

    Its state has the weight `w` in the result: y_1 = (1 - sum of w) y + sum of w Y + h k / 6, k of the last stage. So
    the slopes of the stages before need not be summed.
    """

    a: float
    c: float
    w: float


RK4: Final = (Stage(0.0, 0.0, 0.0), Stage(0.5, 0.5, 1.0 / 3.0), Stage(0.5, 0.5, 2.0 / 3.0), Stage(1.0, 1.0, 1.0 / 3.0))
"""Classical Runge-Kutta, fourth order."""


@dataclass(frozen=True)
class StepRate:
    """A number that says how many substeps a block takes.

    Attributes:
        name: of its row among a block's rows, in capitals.
        meaning: for a comment.
        values: of each block of the group.
    """

    name: str
    meaning: str
    values: tuple[float, ...]


def follows_flow(group: Group, machine: Machine) -> bool:
    """Return True if the group's steps are taken by the displacement flow."""
    return machine.sampling.integrator.scheme == "flow" and group.is_elements


def step_rates(group: Group, machine: Machine) -> tuple[StepRate, ...]:
    """The numbers that decide how many substeps a step of the series takes, in the order of their rows."""
    sampling, integrator = machine.sampling, machine.sampling.integrator
    metre = tuple(block.rate_per_metre for block in group.blocks)
    second = tuple(block.rate_per_second for block in group.blocks)
    step_time = sampling.merged * sampling.step
    if group.switches:
        return ()
    per_speed, at_rest = "substeps per speed, s/m", "and at standstill"
    if not follows_flow(group, machine):
        per_step = step_time / integrator.displacement
        most = (sampling.max_velocity * m + s for m, s in zip(metre, second, strict=True))
        return (
            StepRate("SUBSTEPS", per_speed, tuple(m * per_step for m in metre)),
            StepRate("AT_REST", at_rest, tuple(s * per_step for s in second)),
            StepRate("MOST", "and at most", tuple(rate * per_step for rate in most)),
        )
    rates = []
    if sampling.merged > 1:
        slow = slow_displacement(machine)
        rates.append(StepRate("SUBSTEPS", per_speed, tuple(step_time * m / slow for m in metre)))
        rates.append(StepRate("AT_REST", at_rest, tuple(step_time * s / integrator.displacement for s in second)))
    if common_slow_steps(group, machine) is None:
        steps = tuple(float(slow_steps(block, machine)) for block in group.blocks)
        rates.append(StepRate("SLOW", "Runge-Kutta steps at the gate", steps))
    return tuple(rates)


def common_slow_steps(group: Group, machine: Machine) -> int | None:
    """Runge-Kutta steps of constant signals below the gate, where they are the same for all blocks."""
    steps = {slow_steps(block, machine) for block in group.blocks}
    return steps.pop() if len(steps) == 1 else None


def slow_steps(block: Block, machine: Machine) -> int:
    """Runge-Kutta steps of constant signals at the flow's gate, the highest speed at which they are taken."""
    sampling, friction = machine.sampling, machine.friction
    smoothing = friction.smoothed
    gate = gate_ratio(smoothing.zeta, smoothing.lambda_, smoothing.gamma) * friction.stribeck_velocity
    moved = gate * sampling.step * block.rate_per_metre / slow_displacement(machine)
    aged = sampling.step * block.rate_per_second / sampling.integrator.displacement
    return max(1, math.ceil(moved + aged))


def slow_displacement(machine: Machine) -> float:
    """Largest move of a Runge-Kutta step below the gate, where r moves slowly, in deflection scales.

    The slip window, 1 / lambda wide in r, bounds a step even there.
    """
    return machine.sampling.integrator.slow_displacement * min(1.0, SLOW_LAMBDA / machine.friction.smoothed.lambda_)
