"""Statuses of an update as a package states them: the header's comments and the package's page say the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from sgms_mhe.emission.variant import Variant
from sgms_mhe.machine import Machine
from sgms_mhe.signals.status import FLAGS

REFUSALS: Final[Mapping[str, int]] = MappingProxyType(
    {"early": -1, "numeric": -2, "overlap": -3, "mismatch": -4, "refused": -5}
)
"""Statuses by which a call is refused."""


@dataclass(frozen=True)
class Status:
    """One status.

    Attributes:
        name: of its constant, without the machine's prefix.
        value: a power of two, or negative where a call is refused.
        meaning: what has happened.
        remedy: what the application does about it.
    """

    name: str
    value: int
    meaning: str
    remedy: str


def statuses_of(machine: Machine, variant: Variant) -> tuple[Status, ...]:
    """All statuses but OK: flags first, then refusals."""
    limit, unit = machine.sampling.max_velocity, machine.plant.units.velocity
    said = {
        "filling": ("the window is not full yet", "Nothing: it is over by itself."),
        "missing": (
            "the newest measurement was left out",
            "Nothing for single ones. Many: check encoder, drive and what the fast task hands over.",
        ),
        "hold": ("the axis hardly moved: parameters hold", "Nothing: friction goes on, parameters wait for motion."),
        "bound": (
            "a parameter is at its bound",
            "Do not trust that parameter. Where it stays: another axis's machine file, or bounds too narrow.",
        ),
        "speed": (
            f"faster than max_velocity, {limit} {unit}",
            "Do not learn from it. Where the axis may be so fast, raise `max_velocity` and generate again.",
        ),
        "overrun": (
            "samples were lost: feedback was not called in time",
            "Give the slow task more time: it has to be done once in an interval. The force ramps to zero meanwhile.",
        ),
        "doubt": (
            "the readings contradict the model beyond their stated noise"
            + (": they count less" if variant.self_scaling else ""),
            "Where it lasts: record a log and ask `sgms-mhe diagnose`; something on the axis is not in its model.",
        ),
        "early": ("feedback before the interval was complete", "Call it only when due() says so."),
        "numeric": (
            "the solution was not finite or absurd: the window starts anew from the last good estimate",
            "Nothing for one. Often: the machine file does not describe this axis.",
        ),
        "overlap": (
            "calls of two tasks overlapped, as feedback while prepare was under way; see above",
            "Call feedback again once prepare has returned. Often: the slow task is too slow.",
        ),
        "mismatch": (
            "the application was compiled against another header than this package's",
            "Do not start. Compile all of the application against the header of this folder.",
        ),
        "refused": (
            "of a call that sets or loads: a number out of its range, or saved data damaged or another machine's",
            "The header says at each call what it leaves behind. After load(): a fresh start, that has to learn again.",
        ),
    }
    values = {**FLAGS, **REFUSALS}
    return tuple(Status(name.upper(), values[name], *texts) for name, texts in said.items())
