"""Record of an axis: the origin of its position, and the causes of the first one as it judges them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from sgms_mhe.machine import Units


@dataclass(frozen=True)
class TransferredCause:
    """A cause of the first record on one of them, its numbers by the others.

    Attributes:
        label: of the cause.
        gain_N: RMS of the force it explains there, on held-out blocks; negative: it makes the residual larger.
        gain_interval_N: 95 % interval over these blocks.
        is_shown: whether its force there is one that matters.
    """

    label: str
    gain_N: float
    gain_interval_N: tuple[float, float]
    is_shown: bool


@dataclass(frozen=True)
class Origin:
    """Position a machine's forces over place count from, as one record tells it; keys of a linear axis.

    Attributes:
        position_m: argument of `NAME_set_origin`; None: not determined.
        deviation_m: of it, one standard deviation; None likewise.
        period_m: that all forces over place repeat with: the origin is known but for whole multiples of it; None: they
            do not repeat, or not within the allowed range.
        candidates_m: origins that fit as well as each other, best first: this one, or several that the record does not
            tell apart; none where it tells nothing of the place.
        gain_N: RMS of force the place explains on held-out blocks, beside not knowing it.
        reason: why it is not determined; empty where it is.
    """

    position_m: float | None
    deviation_m: float | None
    period_m: float | None
    candidates_m: tuple[float, ...]
    gain_N: float
    reason: str

    @property
    def is_determined(self) -> bool:
        """Return True if the record tells the origin."""
        return not self.reason

    def to_json(self) -> dict[str, Any]:
        """Return its entry in a file, keys of a linear axis."""
        return {"determined": self.is_determined, **asdict(self), "candidates_m": list(self.candidates_m)}

    def describe(self, units: Units) -> str:
        """Return it in a sentence."""
        unit = units.position
        if self.position_m is None or self.deviation_m is None:
            return f"origin: not determined: {self.reason}"
        text = f"origin: {self.position_m:.8g} {unit}, one standard deviation {self.deviation_m:.2g} {unit}"
        if self.period_m is not None:
            text += f", or any whole multiple of {self.period_m:.8g} {unit} from there"
        return text


@dataclass(frozen=True)
class JudgedRecord:
    """A record of the axis by the numbers of the others, its own fitted; RMS on its held-out blocks [N].

    Attributes:
        name: source of its log.
        held_out_before, held_out_after: residual of the machine and of the extended machine.
        plain: of Coulomb and viscous friction by least squares on this record.
        force: RMS of the force.
        noise_floor_N: of its measured friction.
        origin_m: to be added to its position, so that the forces over place fit; 0: nothing.
        origin: by this record, its `position_m` the negative of it; None: not asked, the axis is homed.
        common_after: of the extended machine without causes of the first record alone.
        own: numbers that belong to the record, by name.
        causes: those of the first record.
    """

    name: str
    held_out_before: float
    held_out_after: float
    plain: float
    force: float
    noise_floor_N: float
    origin_m: float
    origin: Origin | None
    common_after: float
    own: Mapping[str, float]
    causes: tuple[TransferredCause, ...]

    @property
    def errors(self) -> dict[str, float]:
        """Return the simulation error over the RMS of the force: before, after, of plain friction [1]."""
        return relative_errors(self.held_out_before, self.held_out_after, self.plain, self.force)

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
            "origin": None if self.origin is None else self.origin.to_json(),
            "own": dict(self.own),
            "gains": [
                {"name": t.label, "gain_N": t.gain_N, "gain_interval_N": list(t.gain_interval_N), "shown": t.is_shown}
                for t in self.causes
            ],
        }


def relative_errors(before: float, after: float, plain: float, force: float) -> dict[str, float]:
    """Return residuals before, after and of plain friction over the RMS of the force [1]; none where that is 0."""
    residuals = {"before": before, "after": after, "plain": plain}
    return {key: value / force for key, value in residuals.items()} if force > 0.0 else {}
