"""Groups of blocks as templates see them: functions, step counts, and which way of integration each takes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from sgms_mhe.emission.compensation import AHEAD_DISPLACEMENT, AHEAD_SLOW_DISPLACEMENT, ahead_elastic
from sgms_mhe.emission.element_law import element_law
from sgms_mhe.emission.functions import Function, FunctionPrinter, Output, scalar
from sgms_mhe.emission.sizes import GroupSizes, Sizes
from sgms_mhe.emission.structure import Block, Group, Structure
from sgms_mhe.integration.flow_table import gate_ratio

SLOW_LAMBDA = 35.0
"""Largest lambda up to which `slow_displacement` holds as it stands: the slip window is 1 / lambda wide."""


@dataclass(frozen=True)
class BlockView:
    """One block of a group.

    Attributes:
        states: its states among those of the model.
        data: numbers in which it differs from the others of its group.
        substeps: Runge-Kutta substeps of a step of the series: per speed [s/m], at standstill, and at most.
        slow_steps: Runge-Kutta steps of constant signals below the flow's gate.
        line_substeps: substeps of merged samples, per speed [s/m] and at standstill, where the flow would apply.
        ahead_steps: steps of the propagation ahead, per metre and per second.
    """

    states: tuple[int, ...]
    data: tuple[float, ...]
    substeps: tuple[float, float, float]
    slow_steps: int
    line_substeps: tuple[float, float]
    ahead_steps: tuple[float, float]


@dataclass(frozen=True)
class GroupView:
    """A group of blocks that are the same function.

    Attributes:
        name: C name.
        sizes: of the group.
        terms: names of the sample terms, which its functions take.
        blocks: in the order of their states.
        rhs: d(chi)/dt and its derivatives in chi and q.
        level: of Maxwell-slip elements, rho and f_C / s(v) with their derivatives; None where nothing asks for them.
        upstream: of elements that follow the flow, the states that set their level, over one step.
        follows_flow: steps are taken by the displacement flow.
        obeys_law: the right side is emitted as the law of one element.
        level_in_q: a parameter changes the level.
        slides: an element that slides through merged samples takes them at once.
        is_elements: the blocks are Maxwell-slip elements.
        has_elastic_range: an element below some deflection moves with the axis, as far as the propagation ahead cares.
    """

    name: str
    sizes: GroupSizes
    terms: tuple[str, ...]
    blocks: tuple[BlockView, ...]
    rhs: Function
    level: Function | None
    upstream: Function | None
    follows_flow: bool
    obeys_law: bool
    level_in_q: bool
    slides: bool
    is_elements: bool
    has_elastic_range: bool

    @property
    def NAME(self) -> str:
        """Prefix of its constants."""
        return self.name.upper()

    @property
    def n_upstream(self) -> int:
        """States of an element's block that set its level."""
        return self.sizes.m - 1 if self.level else 0

    @property
    def is_slider(self) -> bool:
        """Whether a block is a Maxwell-slip element and nothing else."""
        return self.is_elements and self.sizes.m == 1

    @property
    def slow_ahead(self) -> bool:
        """Whether the propagation ahead takes linearly implicit steps below its gate, and the flow above."""
        return self.follows_flow and self.is_slider

    @property
    def elastic_ahead(self) -> bool:
        """Whether the propagation ahead moves elastic elements with the axis."""
        return self.is_slider and self.level is not None and self.has_elastic_range

    @cached_property
    def slow_steps(self) -> int | None:
        """Steps below the gate, where they are the same for all blocks."""
        steps = {block.slow_steps for block in self.blocks}
        return steps.pop() if len(steps) == 1 else None


def group_views(structure: Structure, sizes: Sizes, printer: FunctionPrinter) -> tuple[GroupView, ...]:
    """All groups of a model."""
    return tuple(_view(g, s, structure, printer) for g, s in zip(structure.groups, sizes.groups, strict=True))


def _view(group: Group, sizes: GroupSizes, structure: Structure, printer: FunctionPrinter) -> GroupView:
    machine = structure.model.machine
    flow = machine.sampling.integrator.scheme == "flow" and group.is_elements
    law = group.obeys_law and element_law(machine) is not None
    slow_ahead = flow and group.m == 1
    level_in_q = any(node.op != "const" for node in group.d_inverse_level)
    return GroupView(
        name=group.name,
        sizes=sizes,
        terms=tuple(term.name for term in structure.sample_terms),
        blocks=tuple(_block(b, structure, flow=flow, slow_ahead=slow_ahead) for b in group.blocks),
        rhs=_rhs(group, printer),
        level=_level(group, printer) if flow or law else None,
        upstream=_upstream(group, printer) if flow else None,
        follows_flow=flow,
        obeys_law=law,
        level_in_q=level_in_q,
        slides=flow and group.obeys_law and not level_in_q,
        is_elements=group.is_elements,
        has_elastic_range=ahead_elastic(machine) > 0.0,
    )


def _rhs(group: Group, printer: FunctionPrinter) -> Function:
    return printer.of_group(group, [Output("rate", group.rhs), Output("d_chi", group.d_chi), Output("d_q", group.d_q)])


def _level(group: Group, printer: FunctionPrinter) -> Function:
    outputs = [
        scalar("*rho", group.rate[0]),
        scalar("*over_level", group.inverse_level[0]),
        Output("d_rho", group.d_rate),
        Output("d_over_level", group.d_inverse_level),
        Output("level_by_state", group.level_by_state),
    ]
    return printer.of_group(group, outputs, first_state=1)


def _upstream(group: Group, printer: FunctionPrinter) -> Function:
    outputs = [
        Output("end", group.upstream),
        Output("by_state", group.upstream_by_state),
        Output("by_q", group.upstream_by_q),
    ]
    return printer.of_group(group, outputs, first_state=1)


def _block(block: Block, structure: Structure, *, flow: bool, slow_ahead: bool) -> BlockView:
    machine = structure.model.machine
    sampling, smoothing = machine.sampling, machine.friction.smoothing
    integrator = sampling.integrator
    metre, second = block.rate_per_metre, block.rate_per_second
    step_time = sampling.merged * sampling.step
    per_step = step_time / integrator.displacement
    # At most slow_displacement per RK4 step below the gate, where r moves slowly; the slip window, 1 / lambda wide in
    # r, bounds a step even there.
    slow = integrator.slow_displacement * min(1.0, SLOW_LAMBDA / smoothing.lambda_)
    per_move = 1.0 / (AHEAD_SLOW_DISPLACEMENT if slow_ahead else AHEAD_DISPLACEMENT)
    return BlockView(
        states=block.states,
        data=block.data,
        substeps=(
            metre * per_step,
            second * per_step,
            (sampling.max_velocity * metre + second) * per_step,
        ),
        slow_steps=_slow_steps(block, structure, slow) if flow else 0,
        line_substeps=(step_time * metre / slow, step_time * second / integrator.displacement),
        ahead_steps=(metre * per_move, second / integrator.displacement),
    )


def _slow_steps(block: Block, structure: Structure, displacement: float) -> int:
    """Runge-Kutta steps of constant signals at the gate, the highest speed at which they are taken."""
    machine = structure.model.machine
    sampling, friction = machine.sampling, machine.friction
    smoothing = friction.smoothing
    gate = gate_ratio(smoothing.zeta, smoothing.lambda_, smoothing.gamma) * friction.stribeck_velocity
    moved = gate * sampling.step * block.rate_per_metre / displacement
    aged = sampling.step * block.rate_per_second / sampling.integrator.displacement
    return max(1, math.ceil(moved + aged))
