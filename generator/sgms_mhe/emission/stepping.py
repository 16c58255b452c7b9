"""How many substeps the blocks of a group take: numbers that every block carries, and what they mean."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from sgms_mhe.emission.structure import Block, Group, Structure
from sgms_mhe.model import gate_ratio

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


def follows_flow(group: Group, structure: Structure) -> bool:
    """Whether the group's steps are taken by the displacement flow."""
    return structure.model.machine.sampling.integrator.scheme == "flow" and group.is_elements


def step_rates(group: Group, structure: Structure) -> tuple[StepRate, ...]:
    """The numbers that decide how many substeps a step of the series takes, in the order of their rows."""
    machine = structure.model.machine
    sampling, integrator = machine.sampling, machine.sampling.integrator
    metre = tuple(block.rate_per_metre for block in group.blocks)
    second = tuple(block.rate_per_second for block in group.blocks)
    step_time = sampling.merged * sampling.step
    if group.switches:
        return ()
    per_speed, at_rest = "substeps per speed, s/m", "and at standstill"
    if not follows_flow(group, structure):
        per_step = step_time / integrator.displacement
        most = (sampling.max_velocity * m + s for m, s in zip(metre, second, strict=True))
        return (
            StepRate("SUBSTEPS", per_speed, tuple(m * per_step for m in metre)),
            StepRate("AT_REST", at_rest, tuple(s * per_step for s in second)),
            StepRate("MOST", "and at most", tuple(rate * per_step for rate in most)),
        )
    rates = []
    if sampling.merged > 1:
        slow = slow_displacement(structure)
        rates.append(StepRate("SUBSTEPS", per_speed, tuple(step_time * m / slow for m in metre)))
        rates.append(StepRate("AT_REST", at_rest, tuple(step_time * s / integrator.displacement for s in second)))
    if common_slow_steps(group, structure) is None:
        steps = tuple(float(slow_steps(block, structure)) for block in group.blocks)
        rates.append(StepRate("SLOW", "Runge-Kutta steps at the gate", steps))
    return tuple(rates)


def common_slow_steps(group: Group, structure: Structure) -> int | None:
    """Runge-Kutta steps of constant signals below the gate, where they are the same for all blocks."""
    steps = {slow_steps(block, structure) for block in group.blocks}
    return steps.pop() if len(steps) == 1 else None


def slow_steps(block: Block, structure: Structure) -> int:
    """Runge-Kutta steps of constant signals at the flow's gate, the highest speed at which they are taken."""
    machine = structure.model.machine
    sampling, friction = machine.sampling, machine.friction
    smoothing = friction.smoothed
    gate = gate_ratio(smoothing.zeta, smoothing.lambda_, smoothing.gamma) * friction.stribeck_velocity
    moved = gate * sampling.step * block.rate_per_metre / slow_displacement(structure)
    aged = sampling.step * block.rate_per_second / sampling.integrator.displacement
    return max(1, math.ceil(moved + aged))


def slow_displacement(structure: Structure) -> float:
    """Largest move of a Runge-Kutta step below the gate, where r moves slowly, in deflection scales.

    The slip window, 1 / lambda wide in r, bounds a step even there.
    """
    machine = structure.model.machine
    return machine.sampling.integrator.slow_displacement * min(1.0, SLOW_LAMBDA / machine.friction.smoothed.lambda_)
