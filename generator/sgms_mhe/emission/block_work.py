"""Worst-case operations of the blocks of a group: over a step of the series, and ahead of the signal chain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from sgms_mhe.emission.compensation import FARTHEST_MOVE
from sgms_mhe.emission.context import PackageView
from sgms_mhe.emission.element_law import RK4
from sgms_mhe.emission.groups import GroupView
from sgms_mhe.emission.operations import EXP, EXP2, LOG, operations_of

LAW = 70
"""The law of one element beside its level, and what it needs of the signals."""
DRIVE = 10
"""What the law needs of the signals."""
WAY = 2
"""How far an element goes in a step, and which way."""
ROW_OF_STAGE, ROW_OF_LAST_STAGE = 5, 12
"""State and sum of a row that moves in one Runge-Kutta stage; in the last one its end as well."""


@dataclass(frozen=True)
class GroupWork:
    """Operations of a group, at most.

    Attributes:
        shared: of a step of the series, once for blocks that see the same signals.
        steps: of a step of the series, block by block.
        together: of a step of the series, all blocks at the same signals.
        ahead: of the propagation ahead, all blocks.
        substeps: Runge-Kutta substeps of a step, block by block; 0 where elements switch.
    """

    shared: int
    steps: tuple[int, ...]
    together: int
    ahead: int
    substeps: tuple[int, ...]


def group_work(g: GroupView, of: PackageView) -> GroupWork:
    """The work of a group's blocks."""
    costs = _Costs(g, of)
    return GroupWork(
        shared=3 * costs.level + 45 if g.slides and of.variant.merges else 0,
        steps=tuple(costs.step(k) for k in range(len(g.blocks))),
        together=costs.together(),
        ahead=sum(costs.ahead(k) for k in range(len(g.blocks))),
        substeps=tuple(costs.most_substeps(k) for k in range(len(g.blocks))),
    )


class _Costs:
    """Costs of one group."""

    def __init__(self, g: GroupView, of: PackageView) -> None:
        m, n_q, rows = g.sizes.m, g.sizes.n_q, g.sizes.rows
        self.g, self.of = g, of
        self.level = operations_of(g.level)
        self.rhs = LAW + 6 * n_q + self.level if g.obeys_law else operations_of(g.rhs)
        self.drive = DRIVE + self.level if g.obeys_law else 0
        stage = self.rhs + m * m * (2 * m - 1) + 2 * m * m * n_q
        self.substep = len(RK4) * (stage + ROW_OF_STAGE * rows) + (ROW_OF_LAST_STAGE - ROW_OF_STAGE) * rows
        # Times within a step at which terms are interpolated; the start of a substep is the end of the one before.
        self.times = 1 + sum(before.c != after.c for before, after in pairwise(RK4))
        self.interpolated = 6 + 3 * len(of.signals.raw) + operations_of(of.model.sample_terms)

    # --- a step of the series ---

    def runge_kutta(self, substeps: int) -> int:
        """Substeps at constant signals."""
        return 1 + self.drive + substeps * self.substep

    def count_line_substeps(self, substeps: int) -> int:
        """Substeps along the line of a step."""
        return 1 + self.drive + substeps * (self.substep + self.times * (self.interpolated + self.drive))

    def most_substeps(self, k: int) -> int:
        """Runge-Kutta substeps that block k takes of a step, at most."""
        g, sizes = self.g, self.of.sizes
        if g.switches:
            return 0
        if not g.follows_flow:
            return max(sizes.least_substeps, math.ceil(self._rate(k, "MOST")))
        return max(self.slow_steps(k), sizes.merged - 1)

    def slow_steps(self, k: int) -> int:
        """Substeps of block k below the flow's gate."""
        return self.g.slow_steps or int(self._rate(k, "SLOW"))

    def step(self, k: int) -> int:
        """A step of the series of block k."""
        g, variant, merged = self.g, self.of.variant, self.of.sizes.merged
        if g.switches:
            return self._switching_step()
        if not variant.merges:
            if g.follows_flow:
                return self._sample(k)
            return 8 + self.runge_kutta(self.most_substeps(k))
        if not g.follows_flow:
            most = self.most_substeps(k)
            pieces = max(most + 2, 2 * self.of.sizes.least_substeps)
            return 16 + max(
                self.count_line_substeps(most),
                12 + 6 * self.interpolated + self.drive + self.count_line_substeps(pieces),
            )
        return self._merged_rest() + max(self._samplewise(k, self._most_slow(k)), self._cut(merged - 1))

    def together(self) -> int:
        """A step of the series of all blocks, whose signals are the same.

        Where samples merge, blocks of one group want substeps in a fixed ratio, at any speed. Those that want MERGED or
        more go sample by sample, which costs less than a step that is cut in two just below it: they are not all there
        at once. The larger of the two pieces' speeds decides.
        """
        merged, blocks = self.of.sizes.merged, range(len(self.g.blocks))
        steps = [self.step(k) for k in blocks]
        if not (self.of.variant.merges and self.g.follows_flow):
            return sum(steps)
        wanted = [self._rate(k, "SUBSTEPS") for k in blocks]
        samplewise = [self._samplewise(k, self._most_slow(k)) for k in blocks]
        fast = [self._samplewise(k, 0) for k in blocks]
        most = sum(samplewise)
        for own in set(wanted):
            for count in range(1, merged):
                counts = [math.ceil(count * w / own + self._rate(k, "AT_REST")) for k, w in enumerate(wanted)]
                taken = [
                    alone if c >= merged else max(self._cut(c), above if 2 * c > merged else 0)
                    for c, alone, above in zip(counts, samplewise, fast, strict=True)
                ]
                most = max(most, sum(taken))
        return len(steps) * self._merged_rest() + most

    def _switching_step(self) -> int:
        """A step of the series of an element that switches."""
        g, merged = self.g, self.of.sizes.merged
        if not self.of.variant.merges:
            return WAY + self._clip()
        if g.at_once:
            return 4 + 3 * WAY + 14 + self.interpolated + 2 * self._clip()
        return merged * (self.interpolated + 5 + WAY + self._clip())

    def _clip(self) -> int:
        """An element on its way, and the states that set its level."""
        g, m, n_q = self.g, self.g.sizes.m, self.g.sizes.n_q
        if not g.n_upstream:
            return self.level + 6 + 3 * n_q
        slips = 1 + (m + n_q) * (1 + 2 * (m - 1))
        return self._upstream() + self.level + 4 + max(slips, 2 * n_q)

    def _upstream(self) -> int:
        """The states that set a level, over one step."""
        m = self.g.sizes.m
        return operations_of(self.g.upstream) + (m - 1) * (3 * m + 4 * self.g.sizes.n_q)

    def _samplewise(self, k: int, slow: int) -> int:
        """Merged samples of block k, one by one, of which so many are below the flow's gate."""
        merged = self.of.sizes.merged
        fast = self._sample(k, is_slow=False)
        return merged * (self.interpolated + 2 + fast) + slow * (self._sample(k) - fast)

    def _most_slow(self, k: int) -> int:
        """Return how many merged samples of block k that are taken one by one are below the flow's gate, at most.

        Below the gate, samples go one by one where their line wants more than MERGED - 1 substeps, which takes a mean
        speed of `speed`; where it changes sign, one of its pieces wants them, and its velocity changes by 2 `speed` or
        more over the step. Either way it is below the gate for gate / speed of the step, at most.
        """
        merged, gate = self.of.sizes.merged, self.of.flow.gate_velocity if self.of.flow else 0.0
        speed = (merged - 1 - self._rate(k, "AT_REST")) / self._rate(k, "SUBSTEPS")
        return min(merged, int(merged * gate / speed) + 1) if speed > 0.0 else merged

    def _cut(self, count: int) -> int:
        """A step cut in two, each piece of `count` substeps."""
        return 12 + 6 * self.interpolated + 2 * self.count_line_substeps(count)

    def _merged_rest(self) -> int:
        """Count the work of a block in a step of merged samples, beside its Runge-Kutta steps or samples."""
        slide = self.level + 17 + 4 * self.g.sizes.n_q + self._slide() if self.g.slides else 0
        return 27 + slide

    def _rate(self, k: int, name: str) -> float:
        """A number of block k's substeps."""
        place = [rate for rate, _ in self.g.rates].index(name)
        return self.g.blocks[k].constants[self.g.sizes.n_data + place]

    def _sample(self, k: int, *, is_slow: bool = True) -> int:
        """A step at constant signals by the flow, below its gate or above it."""
        g, m, n_q = self.g, self.g.sizes.m, self.g.sizes.n_q
        slow = self.runge_kutta(self.slow_steps(k)) + (2 if g.paced and g.slow_steps != 1 else 0) if is_slow else 0
        if g.n_upstream:
            sensitivities = n_q * (10 + 2 * (m - 1)) + m * (5 + 2 * (m - 1))
            return 2 + max(slow, self._upstream() + self.level + 15 + self._flow_step() + sensitivities)
        moving = self.level + 4 + self._flow_step() + 12 + 9 * n_q
        return 2 * self.level + 18 + 4 * n_q + max(slow, self._slide(), moving)

    def _slide(self) -> int:
        """The short polynomial near the fixed point."""
        flow = self.of.flow
        near = 4 * (len(flow.table.near_forward) + len(flow.table.near_inverse)) if flow else 0
        return self.level + 80 + EXP + near + 9 * self.g.sizes.n_q

    def _flow_step(self) -> int:
        """psi, its inverse and their derivatives, or what lies beside the table."""
        return self._psi_and_back(EXP, 4)

    def _psi_and_back(self, inverse: int, polynomials: int) -> int:
        """psi, its inverse (an exponential of this cost) and so many polynomials, or what lies beside the table."""
        return 12 + EXP + LOG + 30 + inverse + polynomials * self._degree()

    def _degree(self) -> int:
        """Multiplications and additions of one polynomial of the table."""
        return 2 * self.of.flow.table.degree if self.of.flow else 0

    # --- ahead ---

    def ahead(self, k: int) -> int:
        """The propagation ahead of block k, over the lag and over the delay."""
        compensation = self.of.compensation
        lag = compensation.lag + (self.of.signals.step_time if self.of.variant.merges else 0.0)
        durations = [lag, compensation.delay][: compensation.moves]
        return sum(self._move(k, duration) for duration in durations)

    def _move(self, k: int, duration: float) -> int:
        """One move of block k."""
        g, ahead, signals = self.g, self.of.compensation.ahead, self.of.signals
        upstream = operations_of(g.upstream) * (1 + round(duration * signals.rate))
        if ahead is None:
            return upstream + self.level + 10
        per_metre, per_second = g.blocks[k].ahead_steps
        flowed = self._psi_and_back(EXP2, 2)
        speed = signals.max_velocity
        if g.slow_ahead:
            steps = 1 + int(ahead.gate_velocity * ahead.longest * per_metre)
            return 2 * self.level + 12 + max(flowed + 6, 4 + self.drive + steps * (self.rhs + 6))
        if g.follows_flow:
            speed = min(speed, self.of.flow.gate_velocity if self.of.flow else speed)
        moved = FARTHEST_MOVE / ahead.displacement if g.is_slider else speed * duration * per_metre
        steps = 1 + int(moved + duration * per_second)
        taken = 10 + self.drive + steps * (4 * (self.rhs + 7 * g.sizes.m) + g.sizes.m + 6)
        if g.follows_flow:
            taken = max(taken, upstream + self.level + flowed + 8)
        return self.level + 6 + taken
