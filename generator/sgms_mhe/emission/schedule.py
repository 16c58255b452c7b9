"""The work of an update as a list of units with costs, shared out over the samples of an interval."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass

from sgms_mhe.emission.sizes import Sizes
from sgms_mhe.emission.variant import Variant


@dataclass(frozen=True)
class Costs:
    """Work in multiplications or so: of one unit of each kind, and of the units one sample does at most.

    Attributes:
        expand: the node of an older interval from its successor's.
        step: a step of the series of the intervals linearised anew.
        readings: those of an older interval into the sweep's factor.
        condense: a node out of that.
        fold: a measurement inside the newest interval into it.
        per_sample: of the units in one sample.
    """

    expand: int
    step: int
    readings: int
    condense: int
    fold: int
    per_sample: int


def schedule_of(sizes: Sizes, variant: Variant) -> Costs:
    """Share the work of an update out over the samples of an interval but its last."""
    n_x, n_p, slots, width = sizes.states, sizes.parameters, sizes.slots, sizes.factor_rows + 1
    intervals = {"all": slots, "auto": 1, "newest": 0}[variant.relinearise]
    reading = n_x * (n_x + n_p) * (2 + n_x) if sizes.inner else 0
    expand = 2 * (1 + (variant.relinearise == "auto")) * n_x * (n_x + n_p)
    fold = 3 * width * width
    readings = 2 * sizes.factor_rows * width + sizes.inner * sizes.factor_rows * width
    condense = 2 * n_x * (n_x + 2) * sizes.kept_width + 2 * sizes.factor_rows * width
    step = (sum(g.cost * g.rows * g.n_blocks for g in sizes.groups) + reading) * max(1, intervals)
    # In the order in which they are done: nodes of the last solution, the start of the sweep, steps, condensing.
    units = [expand] * (slots - 1) + [condense] + [step] * (sizes.steps if intervals else 0)
    units += [readings, condense] * variant.most_condensed + [fold] * sizes.inner
    # A sample that completes a merged one has a step of its own to take.
    samples = sizes.samples - (sizes.steps if variant.merges else 1)
    return Costs(expand, step, readings, condense, fold, _least_per_sample(units, samples))


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
