"""Sizes of a package: counts, and the layout of the arrays of an axis's memory."""

from dataclasses import dataclass

import casadi as ca

from sgms_mhe.emission.couplings import Couplings
from sgms_mhe.emission.element_law import step_rates
from sgms_mhe.emission.structure import Structure
from sgms_mhe.emission.variant import Variant
from sgms_mhe.model import Model

VECTOR_BYTES = 32
"""Lanes are padded to vectors of this size, so that a compiler needs no scalar remainder loop."""
LEAST_LANES = 4
"""So many lanes or fewer are padded to a vector of that many: a wider one would be half empty, here and in memory."""
STEP_COST = 30
"""Multiplications, or so, of a sample for each of chi and its sensitivities."""
CLIP_COST = 2
"""The same of elements that switch."""
TURN_COST = 3
"""And of a step of merged samples more, where their velocity changes sign."""


@dataclass(frozen=True)
class GroupSizes:
    """Sizes of one group of blocks.

    Attributes:
        m: states of a block.
        n_q: numbers through which parameters enter a block.
        n_data: numbers in which a block differs from the others.
        n_constants: numbers of a block that never change: these, and those of its substeps.
        n_blocks: blocks of the group.
        cost: multiplications, or so, of one step of the series for each row, at worst.
        first, first_q: the group's first block, and its first parameter term, among those of all groups.
        first_row: its first row where blocks stand side by side.
        first_lane_row: its first row where they stand one behind the other.
    """

    m: int
    n_q: int
    n_data: int
    n_constants: int
    n_blocks: int
    cost: int
    first: int
    first_q: int
    first_row: int
    first_lane_row: int

    @property
    def rows(self) -> int:
        """Rows of a block: chi, d(chi)/d(chi at the start) and d(chi)/dq."""
        return self.m * (1 + self.m + self.n_q)

    @property
    def all_rows(self) -> int:
        """Rows of a block, those constant over an interval behind those that move."""
        return self.rows + self.n_q + self.n_constants


@dataclass(frozen=True)
class Sizes:
    """Sizes of a package.

    Attributes:
        states, elements, parameters, signals: n_x, n_z, n_p, and entries of w.
        slots: intervals kept, the one that is filling included.
        vector: scalars in the widest vector register that is made use of. half_vector: in one of half the size.
        lane_stride: scalars side by side: intervals of one block, or blocks of one interval, padded to whole vectors.
        series_stride: numbers of a row of the series side by side, where older intervals are integrated so.
        series_signals: names of the signals the sample terms are functions of.
        samples: per interval. merged: samples per step of the series. steps: of the series, per interval.
        nodes: of a step of the series, at which its signals are given. terms: sample terms of a node.
        coupled: states that a state depends on over an interval, at most.
        entered: parameters a state depends on over an interval, at most.
        block_states: states of each block, group by group.
        groups: sizes of each group.
        least_substeps: Runge-Kutta substeps of a step of the series, at least.
        inner: measurements inside an interval, besides the one at its end.
        spacing: steps of the series from one measurement to the next.
    """

    states: int
    elements: int
    parameters: int
    signals: int
    slots: int
    vector: int
    half_vector: int
    lane_stride: int
    series_stride: int
    series_signals: tuple[str, ...]
    samples: int
    merged: int
    steps: int
    nodes: int
    terms: int
    coupled: int
    entered: int
    block_states: tuple[tuple[int, ...], ...]
    groups: tuple[GroupSizes, ...]
    least_substeps: int
    inner: int
    spacing: int

    @property
    def lanes_rows(self) -> int:
        """Rows of all blocks of an interval, one behind the other."""
        return sum(g.all_rows * g.n_blocks for g in self.groups)

    @property
    def parameter_terms(self) -> int:
        """Parameter terms of all blocks."""
        return sum(g.n_q * g.n_blocks for g in self.groups)

    @property
    def series_rows(self) -> int:
        """Numbers a step of one interval is known by: its signals, or their means and slopes."""
        return len(self.series_signals) * (2 if self.merged > 1 else 1)

    @property
    def factor_rows(self) -> int:
        """Unknowns at a node: its state and theta."""
        return self.states + self.parameters

    @property
    def kept_width(self) -> int:
        """Numbers of a row that gives a node back: its state, the next node's, theta, right side."""
        return 2 * self.states + self.parameters + 1

    @property
    def inner_rows(self) -> int:
        """Rows over (x, theta) equivalent to all measurements inside an interval."""
        return min(self.inner, self.factor_rows)

    @property
    def root(self) -> int:
        """Numbers of the upper triangle of the information on the parameters alone."""
        return self.parameters * (self.parameters + 1) // 2

    def triangle_row(self, row: int) -> int:
        """Where a row of that triangle begins."""
        return row * (2 * self.factor_rows + 3 - row) // 2


def sizes_of(structure: Structure, variant: Variant, couplings: Couplings) -> Sizes:
    """Sizes of the package of a model."""
    model = structure.model
    sampling = model.machine.sampling
    groups = _groups(structure)
    slots = max(1, variant.horizon)
    numbers = VECTOR_BYTES // (4 if variant.single else 8)
    lanes = max(slots if variant.relinearise == "all" else 1, *(g.n_blocks for g in groups))
    vector = min(numbers, LEAST_LANES) if lanes <= LEAST_LANES else numbers
    lane_stride = -(-lanes // vector) * vector
    steps = sampling.samples_per_update // sampling.merged
    return Sizes(
        states=model.n_x,
        elements=model.n_z,
        parameters=model.n_p,
        signals=len(model.signal_names),
        slots=slots,
        vector=vector,
        half_vector=min(vector, numbers // 2),
        lane_stride=lane_stride,
        series_stride=lane_stride if variant.relinearise == "all" else 1,
        series_signals=names_read(ca.vertcat(*(t.expression for t in structure.sample_terms)), model),
        samples=sampling.samples_per_update,
        merged=sampling.merged,
        steps=steps,
        nodes=3 if variant.merges else 1,
        terms=len(structure.sample_terms),
        coupled=max(couplings.counts),
        entered=max(1, *couplings.entered),
        block_states=tuple(b.states for g in structure.groups for b in g.blocks),
        groups=groups,
        least_substeps=max(1, sampling.integrator.substeps // sampling.samples_per_update),
        inner=sampling.readings_per_update - 1,
        spacing=steps // sampling.readings_per_update,
    )


def names_read(expression: ca.SX, model: Model) -> tuple[str, ...]:
    """Names of the signals an expression depends on, in the order of w."""
    depends = ca.which_depends(expression, model.w)
    return tuple(name for name, does in zip(model.signal_names, depends, strict=True) if does)


def _groups(structure: Structure) -> tuple[GroupSizes, ...]:
    """Sizes of the groups, one behind the other."""
    groups: list[GroupSizes] = []
    merged = structure.model.machine.sampling.merged  # at worst a step is taken sample by sample
    for group in structure.groups:
        sizes = GroupSizes(
            m=group.m,
            n_q=group.n_q,
            n_data=group.n_data,
            n_constants=group.n_data + len(step_rates(group, structure.model.machine)),
            n_blocks=len(group.blocks),
            cost=CLIP_COST + TURN_COST * (merged > 1) if group.at_once else merged * STEP_COST,
            first=sum(g.n_blocks for g in groups),
            first_q=sum(g.n_q * g.n_blocks for g in groups),
            first_row=sum(g.all_rows for g in groups),
            first_lane_row=sum(g.all_rows * g.n_blocks for g in groups),
        )
        groups.append(sizes)
    return tuple(groups)
