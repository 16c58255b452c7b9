"""Worst-case work of a package, in operations, from its structure: nothing that comes in makes more of it.

Counted as a processor without vector registers does them. With vectors several are done at once, also in lanes that no
one needs; docs/emission.md defines an operation.
"""

from bisect import bisect_right
from itertools import accumulate
from typing import NamedTuple

from sgms_mhe.emission.block_work import GroupWork
from sgms_mhe.emission.budget import Part, Work
from sgms_mhe.emission.context import PackageView
from sgms_mhe.emission.operations import (
    SQRT,
    added_row,
    back_substitution,
    box_least_squares,
    grown,
    operations_of,
    reflection,
    variances,
)
from sgms_mhe.machine import Drive

FILTERS = 200
"""Signal chain, and the lag of the newest position."""
SAMPLE = 60
"""What a sample takes beside: checks, path, course ahead, ramp, limit."""


class Unit(NamedTuple):
    """Unit of prepare(): its cost to the schedule, its operations at most, and whether it is a step of the series."""

    cost: int
    operations: int
    is_step: bool = False


def work_of(of: PackageView) -> Work:
    """The work of a package."""
    sizes, variant = of.sizes, of.variant
    groups = [(g, GroupWork(g, of)) for g in of.groups]
    terms, signals = operations_of(of.model.sample_terms), len(of.signals.raw)
    least_squares = _LeastSquaresCost(of)
    without_step = (
        FILTERS + SAMPLE + of.compensation.moves * terms + operations_of(of.model.feed_forward) + sizes.states
    )
    without_step += of.signals.mean_samples + 4 * signals + sum(work.ahead for _, work in groups)
    at_nodes = sizes.nodes * (terms + 3 * signals)
    newest_step = at_nodes + sum(work.step for _, work in groups)
    reading = least_squares.taken if sizes.inner else 0
    sample = without_step + newest_step + reading
    intervals = {"all": sizes.slots, "auto": 1, "newest": 0}[variant.relinearise]
    anew = intervals * (newest_step - at_nodes) + (at_nodes if variant.relinearise == "auto" else 0)
    feedback = least_squares.feedback()
    units, in_sample, left_over = [], [], 0
    if variant.horizon:
        units = least_squares.units(anew, variant.most_condensed)
        in_sample = _dearest_in_sample(least_squares, anew)
        left_over = sizes.inner * least_squares.folded
    prepare, at_once = (sum(unit.operations for unit in some) for some in (units, in_sample))
    if sizes.samples == 1:  # every sample is an update: nothing to share out over
        tick = sample + prepare + feedback
    elif variant.merges:  # a sample that takes a step does no units
        tick = max(without_step + at_once, sample, sample - reading + feedback)
    else:  # the sample that ends an interval has no measurement inside it
        tick = max(sample + at_once, sample - reading + feedback)
    steps = 1 + intervals * sum(unit.is_step for unit in in_sample)
    shares = [work.ahead + steps * work.step for _, work in groups]
    g, work = groups[shares.index(max(shares))]
    of_samples = sizes.samples * without_step + sizes.steps * newest_step + sizes.inner * reading
    return Work(
        sample=sample,
        tick=tick,
        unit=max((unit.operations for unit in units), default=0),
        prepare=prepare,
        feedback=feedback + left_over,
        update=of_samples + prepare + feedback,
        command=_count_command(of.machine.drive),
        largest=Part(
            states=tuple(of.model.state_names[i] for b in g.blocks for i in b.states),
            operations=max(shares),
            substeps=work.substeps,
            in_closed_form=g.follows_flow or g.switches,
        ),
    )


def _count_command(drive: Drive) -> int:
    """Operations of both calls of a drive: checks, velocity and back-EMF; clamp, loop, least share, way of the goal."""
    if drive.kind == "force":
        return 0
    of_goal = 3 * (drive.kind == "position_loop") + 4 * bool(drive.start) + 14 * bool(drive.speed_limit)
    return 13 + 2 * bool(drive.clamp) + of_goal


class _LeastSquaresCost:
    """Costs of measurements, of the sweep and of the feedback.

    Attributes:
        folded: of a measurement into the factor.
        taken: of one inside the newest interval; a filter folds it at once.
    """

    def __init__(self, of: PackageView) -> None:
        self.of, self.sizes, self.variant = of, of.sizes, of.variant
        sizes, n_x, n_p = of.sizes, of.sizes.states, of.sizes.parameters
        entered, factor, width = sizes.entered, sizes.factor_rows, sizes.factor_rows + 1
        self.condensed = sum(reflection(rows, sizes.kept_width, c) for c, rows in enumerate(of.couplings.reach))
        self.condensed += sum(reflection(n_x - 1 - c, width, c) for c in range(n_x - 1)) + n_x
        self.output = operations_of(of.model.output)
        self.start_row = self.output + 2 * factor + 1 + width
        weighed = sum(2 * i + 5 for i in range(factor)) + 30 + SQRT + (7 + SQRT if of.variant.self_scaling else 0)
        self.folded = weighed + width + added_row(factor)
        self.fold_start = self.start_row + added_row(factor)
        self.drift = variances(n_p) + 36 * n_p + grown(factor, n_p) if of.variant.drifts else 0
        # The map of an interval from its blocks, a measurement inside by it, its defects, the triangle of its rows.
        by_state = (1 + entered + g.n_q * (1 + 2 * entered) + g.m * (4 + 2 * entered) for g in sizes.groups)
        blocks = sum(g.n_blocks * g.m * each for g, each in zip(sizes.groups, by_state, strict=True))
        inner_row = blocks + self.output + 1 + 2 * n_x * (sizes.coupled + entered + 1) + 2 * n_p
        self.taken = inner_row + (0 if of.variant.horizon else self.folded)
        self.renewed = inner_row + width
        self.ends = blocks + n_x * (3 * sizes.coupled + 4 * entered + 3)
        self.kept = sum(reflection(sizes.inner - 1 - c, width, c) for c in range(min(sizes.inner, factor)))

    def steps(self, step: int) -> list[int]:
        """Return the operations of each step of the older intervals: measurements inside, the start and the end."""
        sizes, relinearise = self.sizes, self.variant.relinearise
        if relinearise == "newest" or sizes.slots == 1:
            return []
        steps = [step] * sizes.steps
        for j in range(sizes.inner):
            steps[(j + 1) * sizes.spacing - 1] += self.renewed * (sizes.slots - 1 if relinearise == "all" else 1)
        if relinearise == "auto":
            steps[0] += sum(map(len, sizes.block_states))
            steps[-1] += self.ends + self.kept
        return steps

    def readings(self) -> int:
        """Measurements of an older interval into the factor."""
        sizes, width = self.sizes, self.sizes.factor_rows + 1
        if not sizes.inner:
            return self.fold_start
        is_triangle = self.variant.relinearise != "all"
        rows = 1 + (sizes.inner_rows if is_triangle else sizes.inner)
        reach = (min(c + 2, rows) if is_triangle else rows for c in range(sizes.factor_rows))
        return self.start_row + sum(reflection(below, width, c) for c, below in enumerate(reach))

    def units(self, step: int, condensed: int) -> list[Unit]:
        """Return the units of prepare() in their order; so many intervals are condensed."""
        sizes, variant, costs = self.sizes, self.variant, self.of.schedule
        n_x, n_p = sizes.states, sizes.parameters
        expand = 2 * n_x * (n_x + n_p) + back_substitution(n_x)
        start = self.fold_start + self.drift + (2 * n_x + n_p if variant.fixed else 0)
        condense = self.condensed + self.fold_start
        if variant.relinearise == "auto":
            expand += n_x * (2 * sizes.coupled + 2 * sizes.entered + 6) + 2
        if variant.relinearise == "all":
            start += sizes.slots * sum(map(len, sizes.block_states))
            condense += self.ends
        else:
            start += self.kept
        sweep = [Unit(costs.readings, self.readings()), Unit(costs.condense, condense)] * condensed
        if variant.thins and condensed == variant.most_condensed:  # drift enters at the end of what has left the window
            sweep[1] = Unit(costs.condense, self.condensed + self.drift)
        return [
            *[Unit(costs.expand, expand)] * (sizes.slots - 1),
            Unit(costs.condense, start),
            *(Unit(costs.step, operations, is_step=True) for operations in self.steps(step)),
            *sweep,
            *[Unit(costs.fold, self.folded)] * sizes.inner,
        ]

    def feedback(self) -> int:
        """An update whose preparation is done."""
        sizes, variant, model = self.sizes, self.variant, self.of.model
        n_x, n_p, factor = sizes.states, sizes.parameters, sizes.factor_rows
        newest = self.ends + self.condensed + (0 if variant.horizon else self.drift)
        reading = self.start_row - factor - 1 + self.folded
        solved = box_least_squares(n_p) if variant.bounded else back_substitution(n_p)
        solved += 2 * n_x * factor + back_substitution(n_x)
        checked = variances(n_p) + 3 * n_x + 4 * n_p + 14 + self.output
        if variant.self_scaling:  # the measurement takes its innovation in, the update the factors on variances
            checked += 24 + 19 * n_p
        if self.of.weights.noise_length > 0.0:  # noise that comes with the path
            checked += 8 + SQRT
        again = n_x + n_p + operations_of(model.parameter_terms) + sum(map(len, sizes.block_states))
        if variant.bounded and not variant.horizon:  # the posterior's mean moves into the bounds
            again += factor * (factor + 1)
        return newest + reading + solved + checked + again


def _dearest_in_sample(least_squares: _LeastSquaresCost, step: int) -> list[Unit]:
    """Return the units of most operations that tick() does in one sample: as many in a row as the schedule lets it.

    Intervals are condensed from any one on, and where none is linearised anew there are no steps.
    """
    dearest: list[Unit] = []
    for condensed in range(1 + least_squares.variant.most_condensed):
        every = least_squares.units(step, condensed)
        for units in (every, [unit for unit in every if not unit.is_step]):
            costs = [0, *accumulate(unit.cost for unit in units)]
            ends = [bisect_right(costs, cost + least_squares.of.schedule.per_sample) - 1 for cost in costs]
            rows = (units[first:end] for first, end in enumerate(ends))
            dearest = max(dearest, *rows, key=lambda row: sum(unit.operations for unit in row))
    return dearest
