"""Worst-case operations of the blocks of a group: over a step of the series, and ahead of the signal chain."""

import math
from itertools import pairwise

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


class GroupWork:
    """Operations of a group's blocks, at most.

    Attributes:
        step: of a step of the series, whose signals all blocks see.
        ahead: of the propagation ahead.
        substeps: Runge-Kutta substeps of a step of the block that takes most of them; 0 where elements switch.
    """

    def __init__(self, g: GroupView, of: PackageView) -> None:
        m, n_q, rows = g.sizes.m, g.sizes.n_q, g.sizes.rows
        self.g, self.of = g, of
        self.rates = [{rate.name: rate.values[k] for rate in g.rates} for k in range(len(g.blocks))]
        self.level = operations_of(g.level)
        self.rhs = LAW + 6 * n_q + self.level if g.obeys_law else operations_of(g.rhs)
        self.drive = DRIVE + self.level if g.obeys_law else 0
        stage = self.rhs + m * m * (2 * m - 1) + 2 * m * m * n_q
        self.substep = len(RK4) * (stage + ROW_OF_STAGE * rows) + (ROW_OF_LAST_STAGE - ROW_OF_STAGE) * rows
        # Times within a step at which terms are interpolated; the start of a substep is the end of the one before.
        times = 1 + sum(before.c != after.c for before, after in pairwise(RK4))
        self.interpolated = 6 + 3 * len(of.signals.raw) + operations_of(of.model.sample_terms)
        self.substep_of_line = self.substep + times * (self.interpolated + self.drive)
        # The states that set a level, over one step.
        self.upstream = operations_of(g.upstream) + (m - 1) * (3 * m + 4 * n_q)
        substeps = [self._most_substeps(k) for k in range(len(g.blocks))]
        self.substeps = max(substeps)
        self.step = self._step(substeps)
        # Over the lag, with the samples that are in no step yet, and over the delay where there is one.
        sampling = of.machine.sampling
        lag = of.compensation.lag + (sampling.merged * sampling.step if of.variant.merges else 0.0)
        durations = (lag, of.machine.compensation.delay)[: of.compensation.moves]
        self.ahead = sum(self._move(k, duration) for k in range(len(g.blocks)) for duration in durations)

    # --- a step of the series ---

    def _runge_kutta(self, substeps: int, each: int) -> int:
        return 1 + self.drive + substeps * each

    def _most_substeps(self, k: int) -> int:
        g, sizes = self.g, self.of.sizes
        if g.switches:
            return 0
        if g.follows_flow:
            return max(self._slow_steps(k), sizes.merged - 1)
        return max(sizes.least_substeps, math.ceil(self.rates[k]["MOST"]))

    def _slow_steps(self, k: int) -> int:
        """Substeps of block k below the flow's gate."""
        return self.g.slow_steps or int(self.rates[k]["SLOW"])

    def _step(self, substeps: list[int]) -> int:
        g, merges = self.g, self.of.variant.merges
        if g.switches:
            return len(g.blocks) * self._switching_step()
        if g.follows_flow and merges:
            return self._merged_step()
        if g.follows_flow:
            return sum(self._sample(self._slow_steps(k)) for k in range(len(g.blocks)))
        if not merges:
            return sum(8 + self._runge_kutta(most, self.substep) for most in substeps)
        # Cut in two, of which each takes a substep more.
        cut = 28 + 6 * self.interpolated + self.drive
        pieces = (max(most + 2, 2 * self.of.sizes.least_substeps) for most in substeps)
        return sum(cut + self._runge_kutta(count, self.substep_of_line) for count in pieces)

    def _merged_step(self) -> int:
        """A step of merged samples by the flow.

        Blocks of one group want substeps in a fixed ratio, at any speed. Those that want MERGED or more go sample by
        sample, which costs less than a step that is cut in two just below it: they are not all there at once. The
        larger of the two pieces' speeds decides.
        """
        g, merged, blocks = self.g, self.of.sizes.merged, range(len(self.g.blocks))
        above = self._sample(0)
        fast = merged * (self.interpolated + 2 + above)
        alone = [fast + self._most_slow(k) * (self._sample(self._slow_steps(k)) - above) for k in blocks]
        most = sum(alone)
        for own in {rates["SUBSTEPS"] for rates in self.rates}:
            for count in range(1, merged):
                taken = 0
                for k, rates in enumerate(self.rates):
                    wanted = math.ceil(count * rates["SUBSTEPS"] / own + rates["AT_REST"])
                    cut = 12 + 6 * self.interpolated + 2 * self._runge_kutta(wanted, self.substep_of_line)
                    taken += alone[k] if wanted >= merged else max(cut, fast if 2 * wanted > merged else 0)
                most = max(most, taken)
        once, each = (3 * self.level + 45, self.level + 17 + 4 * g.sizes.n_q + self._slide()) if g.slides else (0, 0)
        return once + len(blocks) * (27 + each) + most

    def _switching_step(self) -> int:
        """A step of the series of an element that switches: on its way, with the states that set its level."""
        g, m, n_q, merged = self.g, self.g.sizes.m, self.g.sizes.n_q, self.of.sizes.merged
        clip = self.level + 6 + 3 * n_q
        if g.n_upstream:
            clip = self.upstream + self.level + 4 + max(1 + (m + n_q) * (2 * m - 1), 2 * n_q)
        if not self.of.variant.merges:
            return WAY + clip
        if g.at_once:
            return 4 + 3 * WAY + 14 + self.interpolated + 2 * clip
        return merged * (self.interpolated + 5 + WAY + clip)

    def _most_slow(self, k: int) -> int:
        """Return how many merged samples of block k that are taken one by one are below the flow's gate, at most.

        Below the gate, samples go one by one where their line wants more than MERGED - 1 substeps, which takes a mean
        speed of `speed`; where it changes sign, one of its pieces wants them, and its velocity changes by 2 `speed` or
        more over the step. Either way it is below the gate for gate / speed of the step, at most.
        """
        merged, gate = self.of.sizes.merged, self.of.flow.gate_velocity if self.of.flow else 0.0
        speed = (merged - 1 - self.rates[k]["AT_REST"]) / self.rates[k]["SUBSTEPS"]
        return min(merged, int(merged * gate / speed) + 1) if speed > 0.0 else merged

    def _sample(self, slow_steps: int) -> int:
        """A step at constant signals by the flow, below its gate in so many Runge-Kutta steps or (0) above it."""
        g, m, n_q = self.g, self.g.sizes.m, self.g.sizes.n_q
        slow = self._runge_kutta(slow_steps, self.substep) + 2 * (g.paced and g.slow_steps != 1) if slow_steps else 0
        flow = self._flow(EXP, 4)
        if g.n_upstream:
            sensitivities = n_q * (10 + 2 * (m - 1)) + m * (5 + 2 * (m - 1))
            return 2 + max(slow, self.upstream + self.level + 15 + flow + sensitivities)
        return 2 * self.level + 18 + 4 * n_q + max(slow, self._slide(), self.level + 4 + flow + 12 + 9 * n_q)

    def _slide(self) -> int:
        """The short polynomial near the fixed point."""
        flow = self.of.flow
        near = 4 * (len(flow.table.near_forward) + len(flow.table.near_inverse)) if flow else 0
        return self.level + 80 + EXP + near + 9 * self.g.sizes.n_q

    def _flow(self, inverse: int, polynomials: int) -> int:
        """psi, its inverse (an exponential of this cost) and so many polynomials, or the part beside the table."""
        degree = self.of.flow.table.degree if self.of.flow else 0
        return 42 + EXP + LOG + inverse + 2 * polynomials * degree

    # --- ahead ---

    def _move(self, k: int, duration: float) -> int:
        """A move of block k ahead."""
        g, ahead, sampling = self.g, self.of.compensation.ahead, self.of.machine.sampling
        upstream = operations_of(g.upstream) * (1 + round(duration * sampling.rate))
        if ahead is None:
            return upstream + self.level + 10
        per_metre, per_second = g.blocks[k].ahead_steps
        flowed = self._flow(EXP2, 2)
        speed = sampling.max_velocity
        if g.slow_ahead:
            steps = 1 + int(ahead.gate_velocity * ahead.longest * per_metre)
            return 2 * self.level + 12 + max(flowed + 6, 4 + self.drive + steps * (self.rhs + 6))
        if g.follows_flow:
            speed = min(speed, self.of.flow.gate_velocity if self.of.flow else speed)
        moved = ahead.farthest / ahead.displacement if g.is_slider else speed * duration * per_metre
        steps = 1 + int(moved + duration * per_second)
        taken = 10 + self.drive + steps * (4 * (self.rhs + 7 * g.sizes.m) + g.sizes.m + 6)
        if g.follows_flow:
            taken = max(taken, upstream + self.level + flowed + 8)
        return self.level + 6 + taken
