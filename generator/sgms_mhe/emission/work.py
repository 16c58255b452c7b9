"""Worst-case work of a package, in operations, from its structure: nothing that comes in makes more of it.

Counted as a processor without vector registers does them. With vectors several are done at once, also in lanes that no
one needs; docs/emission.md defines an operation.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate

from sgms_mhe.emission.block_work import GroupWork
from sgms_mhe.emission.budget import Costs, Part, Work
from sgms_mhe.emission.context import PackageView
from sgms_mhe.emission.least_squares_work import LeastSquaresWork
from sgms_mhe.emission.operations import operations_of
from sgms_mhe.emission.schedule import Unit, schedules_of, units_of
from sgms_mhe.machine import Drive

FILTERS = 200
"""Signal chain, and the lag of the newest position."""
SAMPLE = 60
"""What a sample takes beside: checks, path, course ahead, ramp, limit."""


def work_of(of: PackageView) -> Work:
    """The work of a package."""
    sizes, variant = of.sizes, of.variant
    groups = [(g, GroupWork(g, of)) for g in of.groups]
    terms, signals = operations_of(of.model.sample_terms), len(of.signals.raw)
    update = LeastSquaresWork(of)
    without_step = (
        FILTERS + SAMPLE + of.compensation.moves * terms + operations_of(of.model.feed_forward) + sizes.states
    )
    without_step += of.signals.mean_samples + 4 * signals + sum(work.ahead for _, work in groups)
    at_nodes = sizes.nodes * (terms + 3 * signals)
    newest_step = at_nodes + sum(work.step for _, work in groups)
    reading = update.taken if sizes.inner else 0
    sample = without_step + newest_step + reading
    intervals = {"all": sizes.slots, "auto": 1, "newest": 0}[variant.relinearise]
    anew = intervals * (newest_step - at_nodes) + (at_nodes if variant.relinearise == "auto" else 0)
    feedback = update.feedback()
    schedules = schedules_of(update, max(update.steps(anew), default=0))
    costs, units, in_sample, left_over = schedules[0], [], [], 0
    if variant.horizon:
        costs = min(schedules, key=lambda costs: _operations(_dearest_in_sample(update, costs, anew)))
        in_sample = _dearest_in_sample(update, costs, anew)
        units = units_of(update, costs, anew, variant.most_condensed)
        left_over = sizes.inner * update.folded
    prepare, at_once = _operations(units), _operations(in_sample)
    if sizes.samples == 1:  # every sample is an update: nothing to share out over
        tick = sample + prepare + feedback
    elif variant.merges:  # a sample that takes a step does no units, and the one after the feedback takes none
        tick = max(without_step + at_once, sample, without_step + feedback)
    else:
        tick = max(sample + at_once, sample - (reading if sizes.spacing > 1 else 0) + feedback)
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
        costs=costs,
        largest=Part(
            states=tuple(of.model.state_names[i] for b in g.blocks for i in b.states),
            operations=max(shares),
            substeps=work.substeps,
            in_closed_form=g.follows_flow or g.switches,
        ),
    )


def _operations(units: Sequence[Unit]) -> int:
    return sum(unit.operations for unit in units)


def _count_command(drive: Drive) -> int:
    """Operations of both calls of a drive: checks, velocity and back-EMF; clamp, loop, least share, way of the goal."""
    if drive.kind == "force":
        return 0
    of_goal = 3 * (drive.kind == "position_loop") + 4 * bool(drive.start) + 14 * bool(drive.speed_limit)
    return 13 + 2 * bool(drive.clamp) + of_goal


def _dearest_in_sample(update: LeastSquaresWork, costs: Costs, step: int) -> list[Unit]:
    """Return the units of most operations that tick() does in one sample: as many in a row as the schedule lets it.

    Intervals are condensed from any one on, and where none is linearised anew there are no steps.
    """
    dearest: list[Unit] = []
    for condensed in range(1 + update.variant.most_condensed):
        every = units_of(update, costs, step, condensed)
        for units in (every, [unit for unit in every if not unit.is_step]):
            so_far = [0, *accumulate(unit.cost for unit in units)]
            ends = [bisect_right(so_far, cost + costs.per_sample) - 1 for cost in so_far]
            rows = (units[first:end] for first, end in enumerate(ends))
            dearest = max(dearest, *rows, key=_operations)
    return dearest
