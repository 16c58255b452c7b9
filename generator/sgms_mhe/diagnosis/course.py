"""How far a diagnosis is: the share of its work that is done when a step begins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

Progress = Callable[[str, float], None]
"""Called with what is done now and the share of the work that was done before it, never less than the last time."""

BASE: Final = 0.02
SEARCH: Final = 0.05
RIVALS: Final = 0.5
JUDGEMENT: Final = 0.8
"""Where the stages begin, as a share of the time of a whole diagnosis: about what records with causes take."""
_LEFT: Final = 0.6
"""Of a stage, after each of its rounds: nobody knows how many there will be."""
_REFITS: Final = 0.4
"""Of a round: where refits begin."""


@dataclass(frozen=True)
class Course:
    """Tells `report` how far a diagnosis is."""

    report: Progress

    def begun(self) -> None:
        """The log is made ready."""
        self.report("preparing the log", 0.0)

    def base(self) -> None:
        """The machine's own numbers are fitted."""
        self.report("refitting the base model", BASE)

    def search(self, number: int) -> None:
        """A round of the search begins; `number` from 1."""
        self.report(f"searching effects, round {number}", _within(SEARCH, RIVALS, number - 1.0))

    def refits(self, number: int, names: Sequence[str]) -> None:
        """Effects are refitted in a round."""
        self.report(f"refitting {', '.join(names)}", _within(SEARCH, RIVALS, number - 1.0 + _REFITS))

    def rivals(self, number: int, share: float, cause: str, names: Sequence[str]) -> None:
        """Others are put in a cause's place, `share` of a round's causes having been tried; `number` from 1."""
        text = f"comparing {cause} with {', '.join(names)}" if names else "comparing rivals"
        self.report(text, _within(RIVALS, JUDGEMENT, number - 1.0 + share))

    def judgement(self) -> None:
        """Causes are measured."""
        self.report("measuring the gain on held-out data", JUDGEMENT)


def _within(begin: float, end: float, rounds: float) -> float:
    """Share of the work after so many rounds of a stage."""
    return end - (end - begin) * float(_LEFT**rounds)
