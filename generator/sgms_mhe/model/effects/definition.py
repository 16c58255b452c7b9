"""Definition of an effect: a property of an axis beyond the S-GMS friction law."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from sgms_mhe.machine.units import Kind
from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects.causes import CauseDefinition
from sgms_mhe.model.effects.parameters import EffectParameter
from sgms_mhe.model.effects.scales import Scales
from sgms_mhe.model.effects.search import CurveColumns, Derivative, Harmonic, Periodic, Search, Unsearched, Values

Stage = Literal["signal", "level", "force", "motor", "log", "actuator"]
STAGES: Final[tuple[Stage, ...]] = ("signal", "level", "force", "motor", "log", "actuator")
"""The order in which effects contribute, whatever their order in the machine file: what the sensors see of the motion;
factors on friction; forces; from force to motor current; from current to the log; the current loop behind the log."""

ReadAs = Literal["load", "curve"]
READ_AS: Final[tuple[ReadAs, ...]] = ("load", "curve")
"""Sums of effects' forces that other effects may read: `SymbolicAxis.load` and `.curve`."""
Contribution = Callable[[SymbolicAxis, Expressions, Values], None]
Value = float | tuple[float, ...]
"""Of a parameter in a machine file: a number, or a list of them."""


@dataclass(frozen=True)
class Fault:
    """Number of a machine file that does not go with the others: its parameter, and the allowed values."""

    parameter: str
    allowed: str


PlantForce = Callable[[float, float, float, Values], float]


@dataclass(frozen=True, kw_only=True, repr=False)
class EffectDefinition(CauseDefinition):
    """The one definition of an effect that reference, generator and diagnosis read.

    Attributes:
        parameters: in the order of reports.
        contribute: adds the effect to the axis, given its parameters as expressions and their nominal values.
        stage: see STAGES.
        kinds: of axis that may have it.
        states: names of its own states; a table may have some of them, as its coordinates ask for.
        search: how a diagnosis looks for it; by its derivative in its first size unless something says more.
        loads: whether its force acts on the load, so that the drive transmits it (`SymbolicAxis.transmitted_force`).
        linear: whether the search's columns times its sizes are all of its force: its gain is then known
            without a refit.
        repeatable: whether an axis may have two of it.
        companion: whether an identification from nothing looks for it beside friction; its search's columns need no
            model, or of the stage `level` the torque transmitted alone.
        full_rate: whether it is about as fast as a sample of the record, or jumps: fitted at the record's full rate,
            never on means.
        plant_force: the simulated plant's own version of a force, friction-like in sign, written a second time in plain
            numbers: of position [m], velocity [m/s], time [s] and the parameters. Only effects of other distributions
            have one; the plant knows this package's.
        fault: the first number of a machine file that does not go with the others, each within its own limits and the
            lists of one length.
        possible: whether an axis of these scales can have it with these parameters (by name, SI), beyond their limits:
            a force that takes power from a motion has no size, within both, that drives one.
        smooth_only: why it cannot stand where elements switch instead of going over smoothly; empty: it can.
        fit_displacement: largest step of a fit of it where the elements are integrated exactly, in deflection scales of
            its states; None: 1, they settle within it. Below 1: its states are derivatives of the force, and a long
            step makes a jerk half as large again. Above 1: its states are so fast that shorter steps cost too many.
    """

    parameters: tuple[EffectParameter, ...]
    contribute: Contribution
    stage: Stage = "force"
    kinds: tuple[Kind, ...] = ("linear", "rotary")
    states: tuple[str, ...] = ()
    loads: bool = False
    search: Search = field(default_factory=Derivative)
    linear: bool = False
    repeatable: bool = False
    full_rate: bool = False
    companion: bool = False
    fit_displacement: float | None = None
    fault: Callable[[Mapping[str, Value]], Fault | None] = lambda _: None
    possible: Callable[[Values, Scales], bool] = lambda _, __: True
    smooth_only: str = ""
    plant_force: PlantForce | None = None

    def parameter(self, name: str) -> EffectParameter:
        """Return the parameter called `name`, or the one with an entry of this name; KeyError if there is none."""
        for parameter in self.parameters:
            if parameter.holds(name):
                return parameter
        raise KeyError(name)

    def entries(self, values: Mapping[str, Value]) -> dict[str, float]:
        """Parameters as results name them: every entry of a list by itself, beside those that were so already."""
        found: dict[str, float] = {}
        for key, value in values.items():
            parameter = self.parameter(key)
            if isinstance(value, Sequence):
                found |= {parameter.entry(i): float(number) for i, number in enumerate(value, start=1)}
            else:
                found[parameter.entry(1) if key == parameter.name else key] = float(value)
        return found

    def lists(self, values: Values) -> dict[str, Value]:
        """Parameters as a machine file has them, from their entries: lists joined again."""
        found: dict[str, Value] = {}
        for key, value in values.items():
            parameter = self.parameter(key)
            if parameter.array:
                entries = sorted((parameter.index(name), number) for name, number in values.items())
                found[parameter.name] = tuple(number for index, number in entries if index > 0)
            else:
                found[key] = value
        return found

    def names(self, values: Values) -> tuple[str, ...]:
        """Names of all parameters in the order of reports, of the lists as many entries as the values have."""
        count = max((1, *(p.index(name) for p in self.parameters for name in values)))
        return tuple(p.entry(i) for p in self.parameters for i in range(1, count + 1 if p.array else 2))

    @property
    def main(self) -> tuple[str, ...]:
        """Names of the parameters a fit frees."""
        return tuple(parameter.name for parameter in self.parameters if parameter.main)

    @property
    def acts_on_timing(self) -> bool:
        """Return True if it moves force against position in time: sampling alone resembles a little of it."""
        return any(parameter.timing for parameter in self.parameters)

    @property
    def drives_elements(self) -> bool:
        """Return True if elements move with its states, not with the axis: their step has no closed form then."""
        return bool(self.smooth_only and self.states)

    @property
    def learned(self) -> bool:
        """Return True if its numbers are a table a diagnosis learns at once."""
        return isinstance(self.search, Unsearched)

    @property
    def any_curve(self) -> bool:
        """Return True if it is friction over speed of any shape."""
        return isinstance(self.search, CurveColumns)

    @property
    def elastic(self) -> bool:
        """Return True if it is a stiffness without states: its force goes with the position alone.

        Over a short travel it looks like an element that has not broken away.
        """
        return not self.states and any(parameter.unit == "stiffness" for parameter in self.parameters)

    @property
    def adds_mass(self) -> str:
        """The parameter, if any, that is the true mass minus the machine file's: a mass without states."""
        masses = (parameter.name for parameter in self.parameters if parameter.unit == "mass")
        return "" if self.states else next(masses, "")

    @property
    def delays(self) -> str:
        """The time, if any, that all of the logged force is late [s]: the force is proportional to it, no lag's is.

        A diagnosis shifts the model's force along the record, exactly, where an estimator can but expand it.
        """
        return next((p.name for p in self.parameters if p.timing and p.is_proportional), "")

    @property
    def read_as(self) -> ReadAs | None:
        """Return the sum of forces, if any, that other effects may read its own in."""
        return "load" if self.loads else "curve" if self.any_curve else None

    @property
    def costly(self) -> bool:
        """Return True if its search runs models many times: made only where the residual supports the effect."""
        return self.search.costly

    @property
    def periodic(self) -> bool:
        """Return True if its force repeats, in place or in time."""
        return isinstance(self.search, Harmonic | Periodic) or any(p.is_angle for p in self.parameters)

    @property
    def sine(self) -> Harmonic | None:
        """Names of size, period and phase where the effect is a sine."""
        return self.search if isinstance(self.search, Harmonic) else None

    def tidy(self, values: Values) -> dict[str, float]:
        """Parameters as a report states them: of a sine the size positive, the phase within one turn."""
        tidy = dict(values)
        angle = next((parameter.name for parameter in self.parameters if parameter.is_angle), "")
        if angle in tidy:
            size = next(parameter.name for parameter in self.parameters if parameter.is_size)
            if tidy.get(size, 0.0) < 0.0:
                tidy[size], tidy[angle] = -tidy[size], tidy[angle] + math.pi
            tidy[angle] = math.remainder(tidy[angle], 2.0 * math.pi)
        return tidy
