"""Worst-case work of a package, in operations, from its structure: nothing that comes in makes more of it.

Counted as a processor without vector registers does them. With vectors several are done at once, also in lanes that no
one needs; docs/emission.md tells what an operation is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sgms_mhe.emission.block_work import GroupWork, Ingredients, group_work
from sgms_mhe.emission.groups import GroupView
from sgms_mhe.emission.operations import (
    added_row,
    back_substitution,
    box_least_squares,
    grown,
    reflection,
    variances,
)
from sgms_mhe.emission.schedule import Costs

FILTERS = 150
"""Signal chain, and the lag of the newest position."""
SAMPLE = 60
"""What a sample takes beside: checks, path, course ahead, ramp, limit."""


@dataclass(frozen=True)
class Part:
    """What one group of blocks adds to the longest tick.

    Attributes:
        states: of its blocks, by name.
        operations: of a tick.
        substeps: Runge-Kutta substeps of a step of the block that takes most of them.
        in_closed_form: steps are taken by the displacement flow or by clips.
    """

    states: tuple[str, ...]
    operations: int
    substeps: int
    in_closed_form: bool


@dataclass(frozen=True)
class Work:
    """Operations at most.

    Attributes:
        sample: of sample() or insert().
        tick: of tick().
        unit: of the largest unit of prepare().
        prepare: of prepare(). feedback: of feedback() where prepare() has run.
        update: of all calls of one interval.
        parts: what of a tick the groups of blocks take, largest first.
    """

    sample: int
    tick: int
    unit: int
    prepare: int
    feedback: int
    update: int
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Units:
    """Operations of the units of prepare(), and how many of each there are at most."""

    expand: int
    start: int
    step: int
    condense: int
    nodes: int
    steps: int


def work_of(views: Sequence[GroupView], of: Ingredients) -> Work:
    """The work of a package."""
    sizes, variant = of.sizes, of.variant
    groups = [(g, group_work(g, of)) for g in views]
    least_squares = _LeastSquares(of)
    newest = {g.name: work.shared + work.together for g, work in groups}
    ahead = {g.name: work.ahead for g, work in groups}
    without_step = FILTERS + SAMPLE + of.compensation.moves * of.terms + of.feed_forward + sizes.states
    without_step += 4 * of.signals + sum(ahead.values())
    newest_step = sizes.nodes * (of.terms + 3 * of.signals) + sum(newest.values())
    sample = without_step + newest_step
    step, of_step = _step(groups, of, least_squares)
    costs = of.schedule.scalar if variant.relinearise == "auto" else of.schedule.vector
    names = [state.name for state in of.structure.model.states]
    units = least_squares.units(step)
    prepare = units.nodes * (units.expand + units.condense) + units.start + units.steps * units.step
    feedback = least_squares.feedback()
    in_sample, steps_in_sample = _most_in_sample(units, costs)
    if not variant.horizon:
        in_sample = steps_in_sample = prepare = 0
    alone = sizes.samples == 1  # every sample is an update: nothing to share out over
    tick = sample + (prepare + feedback if alone else max(in_sample, feedback))
    parts = tuple(
        Part(
            states=tuple(names[i] for b in g.blocks for i in b.states),
            operations=newest[g.name] + ahead[g.name] + steps_in_sample * of_step.get(g.name, 0),
            substeps=max(work.substeps),
            in_closed_form=g.follows_flow or g.switches,
        )
        for g, work in groups
    )
    return Work(
        sample=sample,
        tick=tick,
        unit=max(units.expand, units.start, units.step, units.condense) if variant.horizon else 0,
        prepare=prepare,
        feedback=feedback,
        update=sizes.samples * without_step + sizes.steps * newest_step + prepare + feedback,
        parts=tuple(sorted(parts, key=lambda part: -part.operations)),
    )


def _step(
    groups: Sequence[tuple[GroupView, GroupWork]], of: Ingredients, least_squares: _LeastSquares
) -> tuple[int, dict[str, int]]:
    """A unit of the steps of older intervals, and what of it the groups take."""
    sizes, variant = of.sizes, of.variant
    if variant.relinearise == "newest":
        return 0, {}
    if variant.relinearise == "all":
        parts = {g.name: sizes.slots * (work.shared + work.together) for g, work in groups}
        return sum(parts.values()), parts
    parts = {g.name: work.shared + max(work.steps) for g, work in groups}
    most = max(parts, key=lambda name: parts[name])
    return parts[most] + least_squares.chosen_end(), {most: parts[most]}


class _LeastSquares:
    """Costs of the sweep and of the feedback."""

    def __init__(self, of: Ingredients) -> None:
        self.of, self.sizes, self.variant = of, of.sizes, of.variant
        sizes, n_x, n_p = of.sizes, of.sizes.states, of.sizes.parameters
        kept, factor = sizes.kept_width, sizes.factor_rows
        self.condensed = sum(reflection(rows, kept, c) for c, rows in enumerate(of.reach))
        self.condensed += sum(reflection(n_x - 1 - c, factor + 1, c) for c in range(n_x - 1))
        self.folded = of.output + 2 * factor + 1 + factor + 1 + added_row(factor)
        self.defect = 3 * sizes.coupled + 4 * n_p + 2
        self.drift = variances(n_p) + 6 * n_p + 30 * n_p + grown(factor, n_p) if of.variant.drifts else 0

    def chosen_end(self) -> int:
        """Start and end of a block that is linearised anew."""
        m = self.sizes.largest_block
        return 2 * m + self._ends(m, max(g.n_q for g in self.sizes.groups)) + m * self.defect

    def ends(self) -> int:
        """Map of an interval from its blocks, and its defects."""
        blocks = sum(g.n_blocks * self._ends(g.m, g.n_q) for g in self.sizes.groups)
        return blocks + self.sizes.states * self.defect

    def _ends(self, m: int, n_q: int) -> int:
        n_p = self.sizes.parameters
        return m * (1 + n_p + n_q * (1 + 2 * n_p) + m * (4 + 2 * n_p))

    def units(self, step: int) -> Units:
        """Units of prepare()."""
        sizes, variant = self.sizes, self.variant
        n_x, n_p = sizes.states, sizes.parameters
        expand = 2 * n_x * (n_x + n_p) + back_substitution(n_x)
        if variant.relinearise == "auto":
            states = sum(len(own) for own in sizes.block_states)
            expand += states * (2 * sizes.coupled + 2 * n_p + 4) + sizes.blocks * (2 + sizes.chosen)
        start = self.folded + self.drift + (n_x + n_p if variant.fixed else 0)
        if variant.relinearise == "all":
            start += sizes.slots * sum(len(own) for own in sizes.block_states)
        condense = self.condensed + self.folded + (self.ends() if variant.relinearise == "all" else 0)
        steps = {"all": 1, "auto": sizes.chosen, "newest": 0}[variant.relinearise] * sizes.steps
        return Units(expand, start, step, condense, sizes.slots - 1, steps if sizes.slots > 1 else 0)

    def feedback(self) -> int:
        """An update whose preparation is done."""
        sizes, variant = self.sizes, self.variant
        n_x, n_p = sizes.states, sizes.parameters
        solved = box_least_squares(n_p) if variant.bounded else back_substitution(n_p)
        checked = variances(n_p) + 3 * n_x + 4 * n_p + 12 + self.of.output
        again = n_x + n_p + sizes.factor_rows**2 * 2 + self.of.parameter_terms + sum(map(len, sizes.block_states))
        newest = self.ends() + self.condensed + (0 if variant.horizon else self.drift)
        return newest + self.folded + solved + 2 * n_x * (n_p + n_x) + back_substitution(n_x) + checked + again


def _most_in_sample(units: Units, costs: Costs) -> tuple[int, int]:
    """Operations of the units that tick() does in one sample, and how many of them are steps."""
    most, steps_of_most = 0, 0
    budget = costs.per_sample
    for started in (0, 1):
        for nodes in range(min(units.nodes, budget // costs.expand) + 1):
            left = budget - nodes * costs.expand - started * costs.condense
            for steps in range(min(units.steps, max(left, 0) // costs.step) + 1):
                condensed = min(units.nodes, (left - steps * costs.step) // costs.condense)
                if condensed < 0:
                    continue
                total = nodes * units.expand + started * units.start + steps * units.step + condensed * units.condense
                if total > most:
                    most, steps_of_most = total, steps
    return most, steps_of_most
