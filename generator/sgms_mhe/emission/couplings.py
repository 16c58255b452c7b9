"""Dependence of states on each other and on parameters over an interval, as the sweep over intervals uses it."""

from __future__ import annotations

from dataclasses import dataclass

from sgms_mhe.emission.sizes import Sizes, couplings, entries_of
from sgms_mhe.emission.structure import Structure


@dataclass(frozen=True)
class KeptRow:
    """Places of a kept row: of its pivot and the `own` numbers of its node's state, of the next one's, of theta."""

    start: int
    own: int
    next: int
    theta: int


@dataclass(frozen=True)
class Couplings:
    """Dependence of states on each other, and on parameters, over an interval.

    Attributes:
        counts: per state, how many states it depends on, itself included.
        columns: which they are, in rows of one length; the last one repeats.
        reach: per state, how many rows its column of the condensing spans.
        entered: per state, how many parameters enter its blocks.
        enters: which they are, as the columns.
        kept: rows that give a node's state back, without their zeros. kept_size: their numbers.
    """

    counts: tuple[int, ...]
    columns: tuple[tuple[int, ...], ...]
    reach: tuple[int, ...]
    entered: tuple[int, ...]
    enters: tuple[tuple[int, ...], ...]
    kept: tuple[KeptRow, ...]
    kept_size: int


def couplings_of(structure: Structure, sizes: Sizes) -> Couplings:
    """The couplings of a model."""
    rows = couplings(structure)
    entering = entries_of(structure)
    reach = tuple(max(max(row) for row in rows[: c + 1]) + 1 for c in range(sizes.states))
    kept, size = [], 0
    for c, below in enumerate(reach):
        own = sizes.states - c
        kept.append(KeptRow(size, own, size + own, size + own + below))
        size += own + below + sizes.parameters + 1
    return Couplings(
        counts=tuple(len(row) for row in rows),
        columns=tuple(row + (row[-1],) * (sizes.coupled - len(row)) for row in rows),
        reach=reach,
        entered=tuple(len(row) for row in entering),
        enters=tuple(row + (row[-1] if row else 0,) * (sizes.entered - len(row)) for row in entering),
        kept=tuple(kept),
        kept_size=size,
    )
