"""Worst-case work of a package, in operations, from its structure: nothing that comes in makes more of it.

Counted as a processor without vector registers does them. With vectors several are done at once, also in lanes that no
one needs; docs/emission.md tells what an operation is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sgms_mhe.emission.block_work import GroupWork, group_work
from sgms_mhe.emission.budget import Part, Work
from sgms_mhe.emission.context import PackageView
from sgms_mhe.emission.groups import GroupView
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

FILTERS = 200
"""Signal chain, and the lag of the newest position."""
SAMPLE = 60
"""What a sample takes beside: checks, path, course ahead, ramp, limit."""


@dataclass(frozen=True)
class Unit:
    """Unit of prepare(): its cost to the schedule, its operations at most, and whether it is a step of the series."""

    cost: int
    operations: int
    is_step: bool = False


def work_of(of: PackageView) -> Work:
    """The work of a package."""
    sizes, variant = of.sizes, of.variant
    groups = [(g, group_work(g, of)) for g in of.groups]
    terms, signals = operations_of(of.model.sample_terms), len(of.signals.raw)
    least_squares = _LeastSquares(of)
    newest = {g.name: work.shared + work.together for g, work in groups}
    ahead = {g.name: work.ahead for g, work in groups}
    without_step = (
        FILTERS + SAMPLE + of.compensation.moves * terms + operations_of(of.model.feed_forward) + sizes.states
    )
    without_step += of.signals.mean_samples + 4 * signals + sum(ahead.values())
    at_nodes = sizes.nodes * (terms + 3 * signals)
    newest_step = at_nodes + sum(newest.values())
    reading = least_squares.taken() if sizes.inner else 0
    sample = without_step + newest_step + reading
    of_step = _step(groups, of)
    anew = sum(of_step.values()) + (at_nodes if variant.relinearise == "auto" else 0)
    feedback = least_squares.feedback()
    units, in_sample, left_over = [], [], 0
    if variant.horizon:
        units = least_squares.units(anew, sizes.slots - 1)
        in_sample = _dearest_in_sample(least_squares, anew)
        left_over = sizes.inner * least_squares.folded
    prepare, at_once = (sum(unit.operations for unit in some) for some in (units, in_sample))
    if sizes.samples == 1:  # every sample is an update: nothing to share out over
        tick = sample + prepare + feedback
    elif variant.merges:  # a sample that takes a step does no units
        tick = max(without_step + at_once, sample, sample - reading + feedback)
    else:  # the sample that ends an interval has no measurement inside it
        tick = max(sample + at_once, sample - reading + feedback)
    steps_in_sample = sum(unit.is_step for unit in in_sample)
    parts = tuple(
        Part(
            states=tuple(of.model.state_names[i] for b in g.blocks for i in b.states),
            operations=newest[g.name] + ahead[g.name] + steps_in_sample * of_step.get(g.name, 0),
            substeps=max(work.substeps),
            in_closed_form=g.follows_flow or g.switches,
        )
        for g, work in groups
    )
    of_samples = sizes.samples * without_step + sizes.steps * newest_step + sizes.inner * reading
    return Work(
        sample=sample,
        tick=tick,
        unit=max((unit.operations for unit in units), default=0),
        prepare=prepare,
        feedback=feedback + left_over,
        update=of_samples + prepare + feedback,
        parts=tuple(sorted(parts, key=lambda part: -part.operations)),
    )


def _step(groups: Sequence[tuple[GroupView, GroupWork]], of: PackageView) -> dict[str, int]:
    """Return the operations of each group in one step of the series of older intervals."""
    intervals = {"all": of.sizes.slots, "auto": 1, "newest": 0}[of.variant.relinearise]
    return {g.name: intervals * (work.shared + work.together) for g, work in groups}


class _LeastSquares:
    """Costs of measurements, of the sweep and of the feedback."""

    def __init__(self, of: PackageView) -> None:
        self.of, self.sizes, self.variant = of, of.sizes, of.variant
        sizes, n_x, n_p = of.sizes, of.sizes.states, of.sizes.parameters
        kept, factor = sizes.kept_width, sizes.factor_rows
        width = factor + 1
        self.condensed = sum(reflection(rows, kept, c) for c, rows in enumerate(of.couplings.reach))
        self.condensed += sum(reflection(n_x - 1 - c, width, c) for c in range(n_x - 1)) + n_x
        self.output = operations_of(of.model.output)
        self.node_row = self.output + 2 * factor + 1
        self.inner_row = self.output + 1 + 2 * n_x * (sizes.coupled + sizes.entered + 1) + 2 * n_p
        # A self-scaled measurement takes its innovation in besides, and an update the factors on variances.
        self.lasting = 24 + 19 * n_p if of.variant.self_scaling else 0
        weighed = sum(2 * i + 5 for i in range(factor)) + 30 + SQRT + (7 + SQRT if of.variant.self_scaling else 0)
        self.folded = weighed + width + added_row(factor)
        self.start_row = self.node_row + width
        self.fold_start = self.start_row + added_row(factor)
        self.defect = 3 * sizes.coupled + 4 * sizes.entered + 3
        self.drift = variances(n_p) + 6 * n_p + 30 * n_p + grown(factor, n_p) if of.variant.drifts else 0
        self.map = sum(g.n_blocks * self._end(g.m, g.n_q) for g in sizes.groups)

    def _end(self, m: int, n_q: int) -> int:
        entered = self.sizes.entered
        return m * (1 + entered + n_q * (1 + 2 * entered) + m * (4 + 2 * entered))

    def ends(self) -> int:
        """Map of an interval from its blocks, and its defects."""
        return self.map + self.sizes.states * self.defect

    def taken(self) -> int:
        """A measurement inside the newest interval; a filter folds it at once."""
        return self.map + self.inner_row + (0 if self.variant.horizon else self.folded)

    def kept(self) -> int:
        """The triangle of an interval's rows."""
        rows, width = self.sizes.inner, self.sizes.factor_rows + 1
        return sum(reflection(rows - 1 - c, width, c) for c in range(min(rows, width - 1)))

    def steps(self, step: int) -> list[int]:
        """Return the operations of each step of the older intervals: measurements inside, the start and the end."""
        sizes, relinearise = self.sizes, self.variant.relinearise
        if relinearise == "newest" or sizes.slots == 1:
            return []
        renewed = self.map + self.inner_row + sizes.factor_rows + 1
        steps = [step] * sizes.steps
        for j in range(sizes.inner):
            steps[(j + 1) * sizes.spacing - 1] += renewed * (sizes.slots - 1 if relinearise == "all" else 1)
        if relinearise == "auto":
            steps[0] += sum(len(own) for own in sizes.block_states)
            steps[-1] += self.ends() + (self.kept() if sizes.inner else 0)
        return steps

    def readings(self) -> int:
        """Measurements of an older interval into the factor."""
        sizes, width = self.sizes, self.sizes.factor_rows + 1
        if not sizes.inner:
            return self.fold_start
        is_triangle = self.variant.relinearise != "all"
        rows = 1 + (sizes.inner_rows if is_triangle else sizes.inner)
        reach = (min(c + 2, rows) if is_triangle else rows for c in range(sizes.factor_rows))
        folded: int = sum(reflection(below, width, c) for c, below in enumerate(reach))
        return self.start_row + folded

    def units(self, step: int, condensed: int) -> list[Unit]:
        """Return the units of prepare() in their order; so many intervals are condensed."""
        sizes, variant = self.sizes, self.variant
        n_x, n_p = sizes.states, sizes.parameters
        expand = 2 * n_x * (n_x + n_p) + back_substitution(n_x)
        if variant.relinearise == "auto":
            expand += n_x * (2 * sizes.coupled + 2 * sizes.entered + 6) + 2
        start = self.fold_start + self.drift + (2 * n_x + n_p if variant.fixed else 0)
        if variant.relinearise == "all":
            start += sizes.slots * sum(len(own) for own in sizes.block_states)
        elif sizes.inner:
            start += self.kept()
        condense = self.condensed + self.fold_start + (self.ends() if variant.relinearise == "all" else 0)
        costs = self.of.schedule
        swept = [Unit(costs.readings, self.readings()), Unit(costs.condense, condense)]
        return [
            *[Unit(costs.expand, expand)] * (sizes.slots - 1),
            Unit(costs.condense, start),
            *(Unit(costs.step, operations, is_step=True) for operations in self.steps(step)),
            *swept * condensed,
            *[Unit(costs.fold, self.folded)] * sizes.inner,
        ]

    def feedback(self) -> int:
        """An update whose preparation is done."""
        sizes, variant = self.sizes, self.variant
        n_x, n_p = sizes.states, sizes.parameters
        solved = box_least_squares(n_p) if variant.bounded else back_substitution(n_p)
        checked = variances(n_p) + 3 * n_x + 4 * n_p + 14 + self.output
        again = n_x + n_p + operations_of(self.of.model.parameter_terms) + sum(map(len, sizes.block_states))
        if variant.bounded and not variant.horizon:  # the posterior's mean moves into the bounds
            again += sizes.factor_rows * (sizes.factor_rows + 1)
        newest = self.ends() + self.condensed + (0 if variant.horizon else self.drift)
        reading = self.node_row + self.folded
        # Noise that comes with the path.
        checked += self.lasting + (8 + SQRT if self.of.weights.noise_length > 0.0 else 0)
        return newest + reading + solved + 2 * n_x * (n_p + n_x) + back_substitution(n_x) + checked + again


def _dearest_in_sample(least_squares: _LeastSquares, step: int) -> list[Unit]:
    """Return the units of most operations that tick() does in one sample: as many in a row as the schedule lets it.

    Intervals are condensed from any one on, and where none is linearised anew there are no steps.
    """
    dearest: list[Unit] = []
    most = 0
    for condensed in range(least_squares.sizes.slots):
        every = least_squares.units(step, condensed)
        for units in (every, [unit for unit in every if not unit.is_step]):
            first = cost = operations = 0
            for last, unit in enumerate(units):
                cost, operations = cost + unit.cost, operations + unit.operations
                while cost > least_squares.of.schedule.per_sample:
                    cost, operations = cost - units[first].cost, operations - units[first].operations
                    first += 1
                if operations > most:
                    most, dearest = operations, units[first : last + 1]
    return dearest
