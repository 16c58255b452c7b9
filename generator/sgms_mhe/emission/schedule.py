"""The work of an update as a list of units with costs, shared out over the samples of an interval."""

import bisect
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from sgms_mhe.emission.budget import Costs
from sgms_mhe.emission.least_squares_work import LeastSquaresWork


class Unit(NamedTuple):
    """Unit of prepare(): its cost to the schedule, its operations at most, and whether it is a step of the series."""

    cost: int
    operations: int
    is_step: bool = False


def units_of(update: LeastSquaresWork, costs: Costs, step: int, condensed: int) -> list[Unit]:
    """Return the units of prepare() in their order; so many intervals are condensed."""
    sizes, variant = update.sizes, update.variant
    nodes = [Unit(costs.expand, update.expand)] * (sizes.slots - 1)
    if nodes and update.kept:
        nodes[0] = Unit(costs.readings, update.expand + update.kept)
    sweep = [Unit(costs.readings, update.readings()), Unit(costs.condense, update.condense)] * condensed
    if variant.thins and condensed == variant.most_condensed:  # drift enters at the end of what has left the window
        sweep[1] = Unit(costs.condense, update.condensed + update.drift)
    return [
        *nodes,
        Unit(costs.condense, update.start),
        *(Unit(costs.step, operations, is_step=True) for operations in update.steps(step)),
        *[Unit(costs.readings, update.ended)] * bool(update.ended),
        *sweep,
        *[Unit(costs.fold, update.folded)] * sizes.inner,
    ]


def schedules_of(update: LeastSquaresWork, most: int) -> list[Costs]:
    """Share the work of an update out over the samples of an interval but its first.

    Args:
        update: operations of its units.
        most: operations of a step of the series at most.

    Returns:
        With steps as they are in most samples, and as they are at most.
    """
    sizes, relinearise = update.sizes, update.variant.relinearise
    reading = sizes.states * (sizes.states + sizes.parameters) * (2 + sizes.states) if sizes.inner else 0
    usual = sum(g.cost * g.rows * g.n_blocks for g in sizes.groups) + reading
    return [_schedule(update, step) for step in (usual * (sizes.slots if relinearise == "all" else 1), most)]


def _schedule(update: LeastSquaresWork, step: int) -> Costs:
    sizes, variant = update.sizes, update.variant
    readings = max(update.readings(), update.expand + update.kept, update.ended)
    costs = Costs(update.expand, step, readings, update.condense, update.folded, 0)
    units = units_of(update, costs, step, variant.most_condensed)
    # The first sample has the feedback of the interval before, one that completes a merged one a step of its own.
    samples = sizes.samples - 1 - (sizes.steps if variant.merges else 0)
    return replace(costs, per_sample=_least_per_sample([unit.cost for unit in units], samples))


def _least_per_sample(units: Sequence[int], samples: int) -> int:
    """The smallest cost per sample with which units of these costs are done within `samples`, in their order.

    A sample does units as long as they fit; more per sample never takes longer.
    """

    def is_enough(per_sample: int) -> bool:
        used = left = 0
        for cost in units:
            if cost > left:
                used, left = used + 1, per_sample
            left -= cost
        return used <= samples

    possible = range(max(units), sum(units))
    return possible.start + bisect.bisect_left(possible, True, key=is_enough)
