"""The work of an update as a list of units with costs, shared out over the samples of an interval."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass

from sgms_mhe.emission.sizes import Sizes
from sgms_mhe.emission.variant import Variant


@dataclass(frozen=True)
class Costs:
    """Work in multiplications or so: of one unit of each kind, and of the units that one sample does at most.

    Attributes:
        expand: the node of an older interval from its successor's.
        step: a step of the series of what is linearised anew.
        condense: a node out of the sweep's factor.
        per_sample: of the units in one sample.
    """

    expand: int
    step: int
    condense: int
    per_sample: int


@dataclass(frozen=True)
class Schedule:
    """Costs where compilers vectorise, and where they do not: there blocks go one after the other, not side by side."""

    vector: Costs
    scalar: Costs


def schedule_of(sizes: Sizes, variant: Variant) -> Schedule:
    """Share the work of an update out over the samples of an interval but its last."""
    return Schedule(
        vector=_costs(sizes, variant, sizes.step_cost, batches=1),
        scalar=_costs(sizes, variant, sizes.largest_step_cost, batches=sizes.chosen),
    )


def _costs(sizes: Sizes, variant: Variant, step: int, *, batches: int) -> Costs:
    """Costs where a step of one interval costs `step`, and "auto" takes every one `batches` times."""
    n_x, n_p, slots = sizes.states, sizes.parameters, sizes.slots
    expand = (1 + (variant.relinearise == "auto")) * n_x * (n_x + n_p)
    condense = 2 * n_x * (n_x + 2) * sizes.kept_width + 2 * (n_x + n_p) * (n_x + n_p + 1)
    step *= slots if variant.relinearise == "all" else 1
    steps = {"all": 1, "auto": batches, "newest": 0}[variant.relinearise] * sizes.steps
    # In the order in which they are done: nodes of the last solution, the start of the sweep, steps, condensing.
    units = [(expand, slots - 1), (condense, 1), (step, steps), (condense, slots - 1)]
    return Costs(expand, step, condense, _least_per_sample(units, sizes.samples - 1))


def _least_per_sample(units: Sequence[tuple[int, int]], samples: int) -> int:
    """The smallest cost per sample with which all `units` (cost, count) are done within `samples`, in their order.

    A sample does units as long as they fit; more per sample never takes longer.
    """
    total = sum(cost * count for cost, count in units)

    def is_enough(per_sample: int) -> bool:
        used = left = 0
        for cost, count in units:
            count, left = max(0, count - left // cost), left - min(count, left // cost) * cost
            if count > 0:
                whole = per_sample // cost
                used += -(-count // whole)
                left = per_sample - ((count - 1) % whole + 1) * cost
        return used <= samples

    possible = range(max(cost for cost, count in units if count > 0), total)
    return possible.start + bisect.bisect_left(possible, True, key=is_enough)
