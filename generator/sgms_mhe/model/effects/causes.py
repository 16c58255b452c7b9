"""Definition of a cause for a diagnosis: an effect or a wrong number."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from sgms_mhe.model.effects.excitation import Excitation
from sgms_mhe.model.effects.motion import Extents
from sgms_mhe.support.notebooks import Presentation, Shown

Move = Literal["loops", "speeds", "travel", "jerks", "rests", "places", "again"]
MOVES: Final[Mapping[Move, str]] = {
    "loops": "presliding loops at two speeds",
    "speeds": "constant speeds in both directions",
    "travel": "the whole travel at two speeds",
    "jerks": "hard accelerations and sines",
    "rests": "rests of different length",
    "places": "loops at places far apart",
    "again": "the same moves once more, later",
}
"""Parts of an experiment, in the order in which it makes them."""


@dataclass(frozen=True)
class Simpler:
    """Simpler causes an effect has as a limit.

    Attributes:
        causes: their names. One of them is meant unless the effect explains something more that matters.
        reached: whether these parameters (by name, SI) make the effect one of them over a record.
    """

    causes: tuple[str, ...] = ()
    reached: Callable[[Mapping[str, float], Extents], bool] = lambda _, __: False


@dataclass(frozen=True, kw_only=True, repr=False)
class CauseDefinition(Shown):
    """Common part of effects and wrong numbers.

    Attributes:
        name: as in diagnosis.json, and of an effect in the machine file.
        summary: one line for reports.
        excitation: needed in a log for the cause to be identified.
        confused_with: its rivals: names of the causes that look alike, and the move that tells them apart.
        moves: parts of an experiment that show it.
        inertial: it acts where the axis accelerates. There the model's errors at break-away are mixed with it, and its
            constancy over a record is judged by time alone.
        over_speed: in steady sliding its force is a curve over speed, the same in either direction, and nothing else.
            Any other such curve is nearly a sum of these.
        excludes: causes that never stand beside it, because together they cancel.
        simpler: limits in which it is another cause.
        of_record: whether it belongs to a record more than to the axis: other records of the axis have another size.
    """

    name: str
    summary: str
    excitation: Excitation
    confused_with: Mapping[str, str]
    moves: tuple[Move, ...]
    inertial: bool = False
    over_speed: bool = False
    excludes: tuple[str, ...] = ()
    simpler: Simpler = Simpler()
    of_record: bool = False

    def _shown(self) -> Presentation:
        return f"{self.name}, {self.summary}", (), ()
