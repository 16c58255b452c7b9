"""Parameters of an effect, and how far a fit of it may go."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

from sgms_mhe.machine.units import suffix_of
from sgms_mhe.model.effects.motion import SHORTEST_TRAVEL, Extents
from sgms_mhe.model.effects.scales import Scales, Unit

Role = Literal["size", "shape", "place", "period"]

StepLimit = Callable[[float, float, Extents], float]
"""(value, scale, extents) -> how far a parameter may move in one step of a fit, all SI but the extents."""
RecordLimit = Callable[[Extents], float]
"""The farthest value [SI] that a record of these extents can tell from something simpler."""


def any_step(_: float, __: float, ___: Extents) -> float:
    """Allow any step: the force is linear in the parameter."""
    return math.inf


def step_by_factor(value: float, scale: float, _: Extents) -> float:
    """Up to a factor of two, or off zero by a tenth of the scale: derivatives of times and widths hold no farther."""
    return max(abs(value), 0.1 * scale)


def step_of_share(value: float, _: float, __: Extents) -> float:
    """A fifth: about the width of a resonance."""
    return 0.2 * value


def step_of_angle(_: float, __: float, ___: Extents) -> float:
    """Half a radian, within which a sine is nearly a line."""
    return 0.5


def step_of_pitch(value: float, _: float, extents: Extents) -> float:
    """A fifth of a period over the whole travel: beyond half of one the next minimum begins."""
    return min(0.3 * abs(value), 0.2 * value**2 / max(extents.travel, SHORTEST_TRAVEL))


def step_of_frequency(_: float, __: float, extents: Extents) -> float:
    """The same over the whole duration."""
    return 0.2 / extents.duration


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect; its unit stands at the end of its name (`amplitude_N`, `pitch_m`).

    Attributes:
        name: as in the machine file.
        default: value where the machine file gives none; the defaults of an effect together change nothing.
        scale: a typical size in `unit`s of the machine.
        description: one line.
        lower, upper: absolute limits [SI].
        unit: of `scale`.
        role: `size`: the effect is none where it is `none`; `shape`: how it looks (a time constant, a corner); `place`:
            of arbitrary zero (phase, position, time); `period`: known to a few percent. For estimation sizes and
            shapes are scaled by their nominal value (by `scale` where that is 0), places always by `scale`, periods by
            3 % of their nominal value.
        none: value [SI] of a size at which the effect is none.
        proportional: whether the force is proportional to a size (from `none` on, to first order); that of a lag or a
            gap is not.
        main: whether a fit of the effect frees it.
        frozen: whether its search decides it: the force jumps in it, so that no fit moves it.
        timing: whether it is a time that force and position are apart; no log is surer of that than of its sampling.
        array: whether it is a list, whose entries results name one by one; the lists of an effect are equally long.
        whole: whether it counts something.
        step: how far one step of a fit may move it.
        times: the size it is multiplied with: the force is linear in their product, which a fit moves.
        least, most: limits of its identifiability, beyond `lower` and `upper`.
    """

    name: str
    default: float
    scale: float
    description: str
    lower: float = -math.inf
    upper: float = math.inf
    unit: Unit = "one"
    role: Role = "size"
    none: float = 0.0
    proportional: bool = True
    main: bool = True
    frozen: bool = False
    timing: bool = False
    array: bool = False
    whole: bool = False
    step: StepLimit = any_step
    times: str = ""
    least: RecordLimit | None = None
    most: RecordLimit | None = None

    @property
    def is_size(self) -> bool:
        """Return True if the effect is zero where the parameter is `none`."""
        return self.role == "size"

    @property
    def is_angle(self) -> bool:
        """Return True if it is the phase of a sine."""
        return self.role == "place" and self.name.endswith("_rad")

    @property
    def is_choice(self) -> bool:
        """Return True if it is a list a search chooses, each entry another one."""
        return self.array and self.frozen

    @property
    def is_optional(self) -> bool:
        """Return True if an effect is complete without it: a parameter that neither makes it up nor is fitted."""
        return self.role == "shape" and not self.main

    @property
    def is_proportional(self) -> bool:
        """Return True if the force is proportional to it."""
        return self.is_size and self.proportional

    def entry(self, index: int) -> str:
        """Name in results of entry `index` from 1 on, its unit still at the end (`sine_2_N`); of no list, the name."""
        if not self.array:
            return self.name
        unit = suffix_of(self.name)
        return f"{self.name.removesuffix(unit)}_{index}{unit}"

    def index(self, name: str) -> int:
        """Return the index of the entry a name of results is of, from 1 on; 0: of none."""
        unit = suffix_of(self.name)
        stem, _, index = name.removesuffix(unit).rpartition("_")
        own = self.array and name.endswith(unit) and stem == self.name.removesuffix(unit)
        return int(index) if own and index.isdecimal() else 0

    def holds(self, name: str) -> bool:
        """Return True if a name of results is this parameter or an entry of it."""
        return name == self.name or self.index(name) > 0

    @property
    def allowed(self) -> str:
        """The limits in words."""
        if self.whole:
            return f"a whole number from {self.lower:g} to {self.upper:g}"
        if math.isinf(self.upper):
            return "a finite number" if math.isinf(self.lower) else f"a number from {self.lower:g} on"
        return f"a number from {self.lower:g} to {self.upper:g}"

    def size(self, scales: Scales) -> float:
        """Typical size [SI] on a machine of these scales."""
        return self.scale * scales.of(self.unit)

    def estimation_scale(self, scales: Scales, nominal: float) -> float:
        """Return the change of the parameter at theta - 1 = 1 [SI]."""
        if self.role == "place" or nominal == 0.0:
            return self.size(scales)
        return 0.03 * nominal if self.role == "period" else nominal


decided = partial(EffectParameter, main=False, frozen=True)
"""A parameter that its search decides: an effect is complete without it, and no fit moves it."""

shape = partial(EffectParameter, role="shape", step=step_by_factor)
"""How an effect looks, a time constant or a corner: derivatives hold up to a factor."""
