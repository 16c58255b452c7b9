"""Another record of an axis, on which the causes of the first one are judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class TransferredCause:
    """A cause of one record on another one, its numbers as they stand.

    Attributes:
        label: of the cause.
        gain_N: RMS of the force that it explains there, on held-out blocks; negative: it makes the residual larger.
        gain_interval_N: 95 % interval over these blocks.
        is_shown: whether its force there is one that matters.
    """

    label: str
    gain_N: float
    gain_interval_N: tuple[float, float]
    is_shown: bool


@dataclass(frozen=True)
class OtherRecord:
    """Another record of the same axis, its offset, level, damping and origin fitted; RMS on held-out blocks [N].

    Attributes:
        name: source of its log.
        held_out_before, held_out_after: residual of the machine and of the extended machine.
        plain: of Coulomb and viscous friction by least squares on this record.
        force: RMS of the force.
        noise_floor_N: of its measured friction.
        origin_m: what its position is behind that of the first record, as the forces over place say; 0: nothing.
        causes: those of the first record.
    """

    name: str
    held_out_before: float
    held_out_after: float
    plain: float
    force: float
    noise_floor_N: float
    origin_m: float
    causes: tuple[TransferredCause, ...]

    @property
    def errors(self) -> dict[str, float]:
        """Return the simulation error over the RMS of the force: before, after, of plain friction [1]."""
        if not self.force > 0.0:
            return {}
        errors = {"before": self.held_out_before, "after": self.held_out_after, "plain": self.plain}
        return {key: value / self.force for key, value in errors.items()}

    @property
    def is_worse_than_plain(self) -> bool:
        """Return True if the extended machine leaves more than Coulomb and viscous friction alone."""
        return self.held_out_after > self.plain

    def to_json(self) -> dict[str, Any]:
        """Return its entry in diagnosis.json, keys of a linear axis."""
        return {
            "name": self.name,
            "residual_rms_N": {
                "held_out_before": self.held_out_before,
                "held_out_after": self.held_out_after,
                "noise_floor": self.noise_floor_N,
            },
            "plain_N": self.plain,
            "simulation_error": self.errors,
            "origin_m": self.origin_m,
            "gains": [
                {"name": t.label, "gain_N": t.gain_N, "gain_interval_N": list(t.gain_interval_N), "shown": t.is_shown}
                for t in self.causes
            ],
        }


def list_contradictions(alone: Sequence[str], records: Sequence[OtherRecord], unit: str) -> tuple[str, ...]:
    """Return the sentences on causes, and on an extended machine, that do not hold on other records.

    Args:
        alone: labels of causes that do not transfer.
        records: others that the extended machine was judged on.
        unit: of a force.
    """
    sentences = (
        [f"{', '.join(alone)}: of the first record alone, on another one it gains nothing significant"] if alone else []
    )
    sentences += [
        f"the extended machine is not recommended: on {record.name} it leaves {record.held_out_after:.3g} {unit}, "
        f"Coulomb and viscous friction alone {record.plain:.3g} {unit}"
        for record in records
        if record.is_worse_than_plain
    ]
    return tuple(sentences)
