"""A learned residual: its functions, their tables, and their gain."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sgms_mhe.diagnosis.coordinates import Coordinate, Kind
from sgms_mhe.model.effects.definition import Value
from sgms_mhe.model.effects.learned_residual import TableCoordinate, table_entry
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.statements import Rule, Statement


@dataclass(frozen=True, eq=False)
class LearnedTerm:
    """A function of one coordinate or two, as coefficients of splines (size) or (size, size) [N]: a force."""

    coordinates: tuple[Coordinate, ...]
    coefficients: Array

    def at(self, *warped: Array) -> Array:
        """Force (m) [N] at warped coordinates (m)."""
        first = self.coordinates[0].splines(warped[0])
        if len(self.coordinates) == 1:
            return np.asarray(first @ self.coefficients)
        second = self.coordinates[1].splines(warped[1])
        return np.asarray(np.einsum("mi,ij,mj->m", first, self.coefficients, second))

    def along(self, position: Array, velocity: Array, step: float) -> Array:
        """Force (m) [N] along a motion (m) with rows of `step` [s]."""
        return self.at(*(c.warp.along(position, velocity, step) for c in self.coordinates))

    def entry(self, share: float) -> dict[str, Value | str]:
        """Return its entry of [[effects]], names of a linear axis; `share`: logged force per force on the axis [1]."""
        coordinates = []
        for c in self.coordinates:
            low, high = c.warp.unwarp(np.array([c.low, c.high])).tolist()
            over = "speed" if c.kind == "late speed" else c.kind
            coordinates.append(TableCoordinate(over, c.warp.scale, low, high, c.cells, c.warp.lag))
        return table_entry(coordinates, self.coefficients / share)


@dataclass(frozen=True)
class LearnedRecord:
    """Another record with the learned tables, its own offset, level and damping fitted; RMS on held-out blocks [N].

    Attributes:
        name: source of its log.
        before, after: residual without and with it.
        plain: residual of Coulomb and viscous friction by least squares on this record.
    """

    name: str
    before: float
    after: float
    plain: float

    @property
    def is_worse(self) -> bool:
        """Return True if it leaves more than the machine without it, or than Coulomb and viscous friction alone."""
        return self.after > min(self.before, self.plain)


@dataclass(frozen=True, eq=False)
class Learned:
    """A learned residual and its gain.

    Attributes:
        terms: of its sum.
        held_out_before, held_out_after: RMS of the residual without and with it, on data it has not seen [N].
        gain_interval: 98 % interval of the share by which it falls [1].
        unseen: force along the record (m) [N], each part of it as the others predict it.
        records: others that it was judged on.
        in_file: whether the extended machine has it: run along the record it gains, and on no other record it loses.
    """

    terms: tuple[LearnedTerm, ...]
    held_out_before: float
    held_out_after: float
    gain_interval: tuple[float, float]
    unseen: Array
    records: tuple[LearnedRecord, ...] = ()
    in_file: bool = False

    @property
    def over(self) -> tuple[Kind, ...]:
        """Coordinates it depends on."""
        return tuple(dict.fromkeys(c.kind for term in self.terms for c in term.coordinates))

    @property
    def gain(self) -> float:
        """Share by which the RMS of the residual falls on held-out data [1]."""
        return 1.0 - self.held_out_after / self.held_out_before

    def along(self, position: Array, velocity: Array, step: float) -> Array:
        """Force (m) [N] along a motion (m) with rows of `step` [s]."""
        return np.asarray(np.sum([term.along(position, velocity, step) for term in self.terms], axis=0))

    def state(self, unit: str) -> Iterator[Statement]:
        """Yield the statements on it, and on each other record, in the unit of a force."""
        over = " and ".join(filter(None, (", ".join(self.over[:-1]), self.over[-1])))
        low, high = self.gain_interval
        numbers = {"percent": 100.0 * self.gain, "least": low, "most": high}
        yield Statement(Rule.LEARNED if self.in_file else Rule.LEARNED_OUT, over, self.gain, numbers=numbers)
        for r in self.records:
            rule = Rule.LEARNED_WORSE if r.is_worse else Rule.LEARNED_THERE
            yield Statement(rule, r.name, r.after, None, unit, {"before_N": r.before, "plain_N": r.plain})

    def to_json(self) -> dict[str, object]:
        """Content of diagnosis.json."""
        return {
            "over": list(self.over),
            "held_out_before": self.held_out_before,
            "held_out_after": self.held_out_after,
            "gain_interval": list(self.gain_interval),
            "other_records": {r.name: {"before": r.before, "after": r.after, "plain": r.plain} for r in self.records},
            "in_file": self.in_file,
        }
