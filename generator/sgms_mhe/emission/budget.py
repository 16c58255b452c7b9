"""Largest work of the calls, and the budget of a tick: a machine whose longest takes more is refused."""

from dataclasses import dataclass
from typing import Final

from sgms_mhe.machine import Machine
from sgms_mhe.support.errors import InputError

OPERATION_RATE: Final = 250e6
"""Operations per second of the default budget: a Cortex-M7 at 600 MHz, single precision, 2.4 cycles each."""


@dataclass(frozen=True)
class Part:
    """Share of one group of blocks in the longest tick.

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
class Costs:
    """Work in operations: of one unit of each kind, and of the units one sample does at most.

    Attributes:
        expand: the node of an older interval from its successor's.
        step: a step of the series of the intervals linearised anew, with as many substeps as most take.
        readings: those of an older interval into the sweep's factor, or its triangle of them.
        condense: a node out of that, and the start of the sweep.
        fold: a measurement inside the newest interval into it.
        per_sample: of the units in one sample.
    """

    expand: int
    step: int
    readings: int
    condense: int
    fold: int
    per_sample: int


@dataclass(frozen=True)
class Work:
    """Operations at most.

    Attributes:
        sample: of sample() or insert().
        tick: of tick().
        unit: of the largest unit of prepare().
        prepare: of prepare(). feedback: of feedback() where prepare() ran before any measurement inside the interval
            came.
        update: of all calls of one interval.
        command: of drive_force() and drive_command(); 0 without a drive.
        costs: by which tick() shares an update out.
        largest: share of the group of blocks that takes most of a tick.
    """

    sample: int
    tick: int
    unit: int
    prepare: int
    feedback: int
    update: int
    command: int
    costs: Costs
    largest: Part

    @property
    def stated(self) -> tuple[tuple[str, int, str], ...]:
        """(call, operations, remark), as header and page state them."""
        return (
            ("tick()", self.tick, ""),
            ("sample()", self.sample, "insert() too"),
            ("prepare()", self.prepare, f"in units of at most {self.unit}"),
            ("feedback()", self.feedback, "after prepare()"),
            ("an update", self.update, "all calls of an interval"),
            *([("a command", self.command, "drive_force() and drive_command()")] if self.command else []),
        )


def check_budget(machine: Machine, work: Work) -> None:
    """Refuse a machine whose longest tick takes more than its budget.

    Raises:
        InputError: it does; the message names the largest part, and the remedy.
    """
    budget = machine.code.tick_budget or OPERATION_RATE / machine.sampling.rate
    if work.tick <= budget:
        return
    part = work.largest
    share = 100.0 * part.operations / work.tick
    default = "" if machine.code.tick_budget else f", what {OPERATION_RATE:g} operations per second leave at this rate"
    allowed = (
        f"at least the {work.tick:.4g} operations that the longest tick takes{default}; most of them ({share:.0f} %) "
        f"go into {_group_name(machine, part)}. {_remedies(machine, part)}; or state code.tick_budget for the "
        "processor that it runs on"
    )
    raise InputError(machine.source, "code.tick_budget", budget, allowed)


def _group_name(machine: Machine, part: Part) -> str:
    """A group by the effects in it and its states."""
    effects = [e.label for e in machine.effects if any(state.startswith(f"{e.label}_") for state in part.states)]
    title = f"the block of {', '.join(effects)}" if effects else "the elements"
    return f"{title} (states {', '.join(part.states)})"


def _remedies(machine: Machine, part: Part) -> str:
    """Name the changes that make it smaller."""
    sampling, estimator = machine.sampling, machine.estimator
    if part.in_closed_form:
        what = ["lower sampling.integrator.substeps, so that samples merge"]
    else:
        what = [
            f"{part.substeps} Runge-Kutta substeps of a step at max_velocity: lower sampling.max_velocity "
            f"({sampling.max_velocity:g} m/s), raise sampling.integrator.displacement "
            f"({sampling.integrator.displacement:g})"
        ]
        effects = any(not state.startswith("z_") for state in part.states)
        what.append("leave the effect out" if effects else 'take scheme = "flow"')
    if estimator.kind == "mhe" and estimator.relinearise != "newest":
        what.append(f'take relinearise = "{"auto" if estimator.relinearise == "all" else "newest"}"')
    text = ", ".join(what)
    return text[0].upper() + text[1:]
