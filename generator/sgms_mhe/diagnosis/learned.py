"""A learned residual: its functions, their tables, and what they gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sgms_mhe.diagnosis.coordinates import Coordinate, Kind
from sgms_mhe.model.effects.definition import Value
from sgms_mhe.model.effects.learned_residual import TableCoordinate, table_entry
from sgms_mhe.support.arrays import Array


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
    """Another record with what was learned, its own offset, level and damping fitted; RMS on held-out blocks [N].

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
    def gain(self) -> float:
        """Share by which the RMS of the residual falls [1]; negative where it grows."""
        return 1.0 - self.after / self.before

    @property
    def is_worse(self) -> bool:
        """Return True if it leaves more than the machine without it, or than Coulomb and viscous friction alone."""
        return self.after > min(self.before, self.plain)


@dataclass(frozen=True, eq=False)
class Learned:
    """A learned residual and what it gains.

    Attributes:
        terms: of its sum.
        held_out_before, held_out_after: RMS of the residual without and with it, on data that it has not seen [N].
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
        """Coordinates that it depends on."""
        return tuple(dict.fromkeys(c.kind for term in self.terms for c in term.coordinates))

    @property
    def gain(self) -> float:
        """Share by which the RMS of the residual falls on held-out data [1]."""
        return 1.0 - self.held_out_after / self.held_out_before

    @property
    def words(self) -> str:
        """A line beside a verdict."""
        over = " and ".join(filter(None, (", ".join(self.over[:-1]), self.over[-1])))
        names = ["the other record"] if len(self.records) == 1 else [record.name for record in self.records]
        there = "".join(f", {100.0 * r.gain:.0f} % on {name}" for r, name in zip(self.records, names, strict=True))
        share = f"{100.0 * self.gain:.0f} % of the residual on held-out data{there}"
        return f"learned, no name: over {over}, {share}{'' if self.in_file else '; left out of the extended machine'}"

    def along(self, position: Array, velocity: Array, step: float) -> Array:
        """Force (m) [N] along a motion (m) with rows of `step` [s]."""
        return np.asarray(np.sum([term.along(position, velocity, step) for term in self.terms], axis=0))

    def list_contradictions(self, unit: str) -> tuple[str, ...]:
        """Return the sentences on records that it does not hold on, in the unit of a force."""
        return tuple(
            f"what was learned is left out: on {r.name} it leaves {r.after:.3g} {unit}, the machine without it "
            f"{r.before:.3g} {unit}, Coulomb and viscous friction alone {r.plain:.3g} {unit}"
            for r in self.records
            if r.is_worse
        )

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
