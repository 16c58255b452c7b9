"""Dependence of states on each other and on parameters over an interval, as the sweep over intervals uses it."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from sgms_mhe.emission.structure import Structure
from sgms_mhe.model import Model


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


def couplings_of(structure: Structure) -> Couplings:
    """The couplings of a model."""
    model = structure.model
    rows, entering = _find_coupled(structure), _find_entering(structure)
    reach = tuple(max(max(row) for row in rows[: c + 1]) + 1 for c in range(model.n_x))
    kept, size = [], 0
    for c, below in enumerate(reach):
        own = model.n_x - c
        kept.append(KeptRow(size, own, size + own, size + own + below))
        size += own + below + model.n_p + 1
    return Couplings(
        counts=tuple(len(row) for row in rows),
        columns=_pad_rows(rows),
        reach=reach,
        entered=tuple(len(row) for row in entering),
        enters=_pad_rows(entering),
        kept=tuple(kept),
        kept_size=size,
    )


def _pad_rows(rows: Sequence[tuple[int, ...]]) -> tuple[tuple[int, ...], ...]:
    """Rows of one length, in which the last entry of each repeats."""
    width = max(1, *map(len, rows))
    return tuple((row + (row or (0,))[-1:] * width)[:width] for row in rows)


def _find_coupled(structure: Structure) -> tuple[tuple[int, ...], ...]:
    """Per state the states that share a block with it, itself included: the columns of A that may not be zero."""
    blocks = [block.states for group in structure.groups for block in group.blocks]
    states = range(structure.model.n_x)
    return tuple(tuple(sorted({state for block in blocks if i in block for state in block})) for i in states)


def node_scale(model: Model, i: int) -> ca.SX:
    """x_i / chi_i, a function of the parameters."""
    return ca.substitute(ca.gradient(model.to_node[i], model.chi)[i], model.chi, ca.SX.zeros(model.n_x))


def _find_entering(structure: Structure) -> tuple[tuple[int, ...], ...]:
    """Per state the parameters that enter a block of it: the columns of B that may not be zero."""
    model = structure.model
    found: list[set[int]] = [set() for _ in range(model.n_x)]
    for block in (block for group in structure.groups for block in group.blocks):
        entering = ca.vertcat(*block.parameter_terms, *(node_scale(model, i) for i in block.states))
        enters = {p for p, does in enumerate(ca.which_depends(entering, model.theta)) if does}
        for i in block.states:
            found[i] |= enters
    return tuple(tuple(sorted(row)) for row in found)
