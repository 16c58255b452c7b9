"""Groups of blocks as templates see them: functions, step counts, and which way of integration each takes."""

import math
from dataclasses import dataclass

from sgms_mhe.emission.c_source import Function, FunctionPrinter, Output, scalar
from sgms_mhe.emission.compensation import AHEAD_SLOW_DISPLACEMENT, Ahead, ahead_elastic
from sgms_mhe.emission.element_law import StepRate, common_slow_steps, element_law, follows_flow, step_rates
from sgms_mhe.emission.sizes import GroupSizes, Sizes
from sgms_mhe.emission.structure import Group, Structure
from sgms_mhe.machine import Machine


@dataclass(frozen=True)
class BlockView:
    """One block of a group.

    Attributes:
        states: its states among those of the model.
        constants: numbers in which it differs from the others of its group, and those of its substeps.
        ahead_steps: steps of the propagation ahead, per metre and per second.
    """

    states: tuple[int, ...]
    constants: tuple[float, ...]
    ahead_steps: tuple[float, float]


@dataclass(frozen=True)
class GroupView:
    """A group of blocks that are the same function.

    Attributes:
        name: C name.
        sizes: of the group.
        blocks: in the order of their states.
        rates: numbers of the blocks' substeps.
        most_substeps: Runge-Kutta substeps of a step at max_velocity, of a group without steps in closed form.
        slow_steps: Runge-Kutta steps of constant signals at the flow's gate, where all blocks take as many.
        paced: the slower a block moves below the gate, the fewer of them it takes.
        rhs: d(chi)/dt and its derivatives in chi and q.
        level: of Maxwell-slip elements, rho and f_C / s(v), or s(v) / f_C where they switch, with their derivatives;
            None where nothing asks for them.
        upstream: of elements that take steps in closed form, the states that set their level, over one step.
        follows_flow: steps are taken by the displacement flow.
        switches: steps are taken by clips.
        at_once: an element that switches takes merged samples in one clip.
        obeys_law: the right side is emitted as the law of one element.
        level_in_q: a parameter changes the level.
        slides: an element that slides through merged samples takes them at once.
        is_elements: the blocks are Maxwell-slip elements.
        elastic_ahead: the propagation ahead moves elements with the axis below some deflection.
    """

    name: str
    sizes: GroupSizes
    blocks: tuple[BlockView, ...]
    rates: tuple[StepRate, ...]
    most_substeps: int | None
    slow_steps: int | None
    paced: bool
    rhs: Function
    level: Function | None
    upstream: Function | None
    follows_flow: bool
    switches: bool
    at_once: bool
    obeys_law: bool
    level_in_q: bool
    slides: bool
    is_elements: bool
    elastic_ahead: bool

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
        """Return True if a block is a Maxwell-slip element and nothing else."""
        return self.is_elements and self.sizes.m == 1

    @property
    def slow_ahead(self) -> bool:
        """Return True if the propagation ahead takes linearly implicit steps below its gate, and the flow above."""
        return self.follows_flow and self.is_slider

    @property
    def step(self) -> str:
        """How a step is taken: by a clip, by the flow, by the flow at a level with states of its own, by substeps."""
        if self.switches:
            return "clip"
        if not self.follows_flow:
            return "substeps"
        return "upstream" if self.n_upstream else "flow"


def group_views(structure: Structure, sizes: Sizes, printer: FunctionPrinter) -> tuple[GroupView, ...]:
    """All groups of a model."""
    return tuple(
        _view(g, s, structure.model.machine, printer) for g, s in zip(structure.groups, sizes.groups, strict=True)
    )


def _view(group: Group, sizes: GroupSizes, machine: Machine, printer: FunctionPrinter) -> GroupView:
    flow = follows_flow(group, machine)
    law = group.obeys_law and element_law(machine) is not None
    rates = step_rates(group, machine)
    per_move = 1.0 / (AHEAD_SLOW_DISPLACEMENT if flow and group.m == 1 else Ahead.displacement)
    level_in_q = any(node.op != "const" for node in group.d_level)
    return GroupView(
        name=group.name,
        sizes=sizes,
        blocks=tuple(
            BlockView(
                states=block.states,
                constants=block.data + tuple(rate.values[k] for rate in rates),
                ahead_steps=(
                    block.rate_per_metre * per_move,
                    block.rate_per_second / machine.sampling.integrator.displacement,
                ),
            )
            for k, block in enumerate(group.blocks)
        ),
        rates=rates,
        most_substeps=None if flow or group.switches else max(math.ceil(most) for most in rates[-1].values),
        slow_steps=common_slow_steps(group, machine) if flow else None,
        paced=flow and not any(block.rate_per_second for block in group.blocks),
        rhs=printer.group_function(
            group, [Output("rhs.rate", group.rhs), Output("rhs.d_chi", group.d_chi), Output("rhs.d_q", group.d_q)]
        ),
        level=_level(group, printer, in_q=level_in_q) if flow or law or group.switches else None,
        upstream=_upstream(group, printer) if flow or group.switches else None,
        follows_flow=flow,
        switches=group.switches,
        at_once=group.at_once,
        obeys_law=law,
        level_in_q=level_in_q,
        slides=flow and group.obeys_law and not level_in_q,
        is_elements=group.is_elements,
        elastic_ahead=(flow or law) and group.is_elements and group.m == 1 and ahead_elastic(machine) > 0.0,
    )


def _level(group: Group, printer: FunctionPrinter, *, in_q: bool) -> Function:
    name = "reach" if group.switches else "over_level"
    outputs = [
        scalar("level.rho", group.rate[0]),
        scalar(f"level.{name}", group.level[0]),
        Output("level.d_rho", group.d_rate),
        Output(f"level.d_{name}", group.d_level if in_q else ()),
        Output("level.by_state", group.level_by_state),
    ]
    return printer.group_function(group, outputs)


def _upstream(group: Group, printer: FunctionPrinter) -> Function:
    outputs = [
        Output("upstream.end", group.upstream),
        Output("upstream.by_state", group.upstream_by_state),
        Output("upstream.by_q", group.upstream_by_q),
    ]
    return printer.group_function(group, outputs)
