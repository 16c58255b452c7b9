"""What an effect is: something the axis has beyond the S-GMS friction law."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import casadi as ca

from sgms_mhe.model.axis import AxisState, StateSpec, SymbolicAxis
from sgms_mhe.model.effects.causes import CauseDefinition
from sgms_mhe.model.effects.motion import SHORTEST_TRAVEL, Extents
from sgms_mhe.model.effects.scales import Scales, Unit
from sgms_mhe.model.effects.search import Derivative, Harmonic, Search
from sgms_mhe.model.effects.specimen import Specimen

Stage = Literal["signal", "level", "force", "motor", "log", "actuator"]
STAGES: Final[tuple[Stage, ...]] = ("signal", "level", "force", "motor", "log", "actuator")
"""The order in which effects contribute, whatever their order in the machine file: what the sensors see of the motion;
factors on friction; forces; from force to motor current; from current to the log; the current loop behind the log."""

Role = Literal["size", "shape", "place", "period"]

LAG_DISPLACEMENT: Final = 0.2
"""`fit_displacement` of delays and lags: the states behind them are the derivatives of the force."""
_LONGEST_LAG = 0.05  # s; a current loop that is later does not hold an axis
_LAG_PER_SUBSTEP = 0.2
"""A lag decays by exp(-0.5) in a substep of rk4: it is linear, so the error is 3e-4 of what is left of a transient."""
_SHORTEST_LAG = 0.25  # of a sample


StepLimit = Callable[[float, float, Extents], float]
"""(value, scale, extents) -> how far a parameter may move in one step of a fit, all SI but the extents."""
RecordLimit = Callable[[Extents], float]
"""The farthest value [SI] that a record of these extents can tell from something simpler."""


def any_step(_: float, __: float, ___: Extents) -> float:
    """What the force is linear in may move as far as the step says."""
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
        unit: what `scale` counts in.
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
        step: how far one step of a fit may move it.
        least, most: what a record can tell of it, beyond `lower` and `upper`.
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
    step: StepLimit = any_step
    least: RecordLimit | None = None
    most: RecordLimit | None = None

    @property
    def is_size(self) -> bool:
        """Whether the effect is none where the parameter is `none`."""
        return self.role == "size"

    @property
    def is_proportional(self) -> bool:
        """Whether the force is proportional to it."""
        return self.is_size and self.proportional

    @property
    def allowed(self) -> str:
        """The limits in words."""
        if math.isinf(self.upper):
            return "a finite number" if math.isinf(self.lower) else f"a number from {self.lower:g} on"
        return f"a number from {self.lower:g} to {self.upper:g}"

    def size(self, scales: Scales) -> float:
        """Typical size [SI] on a machine of these scales."""
        return self.scale * scales.of(self.unit)

    def estimation_scale(self, scales: Scales, nominal: float) -> float:
        """What theta - 1 = 1 means [SI]."""
        if self.role == "place" or nominal == 0.0:
            return self.size(scales)
        return 0.03 * nominal if self.role == "period" else nominal


def longest_lag(_: Extents) -> float:
    """The longest delay or lag of a force that an axis is held with [s]."""
    return _LONGEST_LAG


def pitch(default: float, scale: float) -> EffectParameter:
    """`pitch_m`, a period in position."""
    return EffectParameter(
        "pitch_m",
        default,
        scale,
        "period in position",
        lower=1e-6,
        role="period",
        step=step_of_pitch,
        most=lambda extents: extents.longest_pitch,
    )


def phase(zero: str) -> EffectParameter:
    """`phase_rad`, the angle of a sine at a `zero` of its coordinate."""
    return EffectParameter("phase_rad", 0.0, 0.1, f"phase at {zero} zero", role="place", step=step_of_angle)


@dataclass(frozen=True)
class EffectState:
    """A state of an effect's own.

    `rate_per_metre` [1/m] and `rate_per_second` [1/s] bound how fast it moves at nominal parameters; they set the
    number of Runge-Kutta substeps. `noise` (per update) and `initial_state` are standard deviations in the state's own
    unit. States that are forces count in f_C, so that 1 is large and 1e-3 is nothing.
    """

    name: str
    rate_per_metre: float = 0.0
    rate_per_second: float = 0.0
    noise: float = 1e-3
    initial_state: float = 1e-2


Contribution = Callable[[SymbolicAxis, Mapping[str, ca.SX], Mapping[str, float]], None]


@dataclass(frozen=True, kw_only=True)
class EffectDefinition(CauseDefinition):
    """The one definition of an effect that reference, generator and diagnosis read.

    Attributes:
        parameters: in the order of reports.
        contribute: adds the effect to the axis, given its parameters as expressions and their nominal values.
        stage: see STAGES.
        states: names of its own states.
        search: how a diagnosis looks for it; by its derivative in its first size unless something says more.
        linear: whether the search's columns times its sizes are all of its force: what it would gain is then known
            without a refit.
        repeatable: whether an axis may have two of it.
        full_rate: whether it is about as fast as a sample of the record, or jumps: fitted at the record's full rate,
            never on means.
        specimen: how a benchmark hides it; None: not at all.
        fit_displacement: largest step of a fit of it where the elements are integrated exactly, in deflection scales of
            its states; None: 1, they settle within it. Below 1: its states are derivatives of the force, and a long
            step makes a jerk half as large again. Above 1: its states are so fast that shorter steps cost too many.
    """

    parameters: tuple[EffectParameter, ...]
    contribute: Contribution
    stage: Stage = "force"
    states: tuple[str, ...] = ()
    search: Search = field(default_factory=Derivative)
    linear: bool = False
    repeatable: bool = False
    full_rate: bool = False
    fit_displacement: float | None = None
    specimen: Specimen | None = None

    def parameter(self, name: str) -> EffectParameter:
        """Return the parameter called `name`; KeyError if there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def main(self) -> tuple[str, ...]:
        """Names of the parameters that a fit frees."""
        return tuple(parameter.name for parameter in self.parameters if parameter.main)

    @property
    def timed(self) -> bool:
        """Whether it moves force against position in time: sampling alone looks like a little of it."""
        return any(parameter.timing for parameter in self.parameters)

    @property
    def costly(self) -> bool:
        """Whether its search runs models many times: made only where something speaks for the effect."""
        return self.search.costly

    @property
    def sine(self) -> Harmonic | None:
        """Names of size, period and phase where the effect is a sine."""
        return self.search if isinstance(self.search, Harmonic) else None

    def tidy(self, values: Mapping[str, float]) -> dict[str, float]:
        """Parameters as a report states them: of a sine the size positive, the phase within one turn."""
        tidy = dict(values)
        if self.sine is not None and self.sine.phase in tidy:
            size, angle = self.sine.size, self.sine.phase
            if tidy.get(size, 0.0) < 0.0:
                tidy[size], tidy[angle] = -tidy[size], tidy[angle] + math.pi
            tidy[angle] = math.remainder(tidy[angle], 2.0 * math.pi)
        return tidy


def sine(position: ca.SX, pitch: ca.SX, phase: ca.SX) -> ca.SX:
    """sin(2 pi q / pitch + phase)."""
    return ca.sin(2.0 * math.pi / pitch * position + phase)


def add_effect_state(axis: SymbolicAxis, state: EffectState) -> AxisState:
    """Declare a state of the effect that contributes at the moment."""
    # Rates are round numbers: without this, the number of substeps would hang on the rounding of a quotient.
    nudge = 1.0 + 1e-9
    return axis.add_state(
        StateSpec(
            name=f"{axis.scope}_{state.name}",
            element=None,
            rate_per_metre=nudge * state.rate_per_metre,
            rate_per_second=nudge * state.rate_per_second,
            noise=state.noise,
            initial_state=state.initial_state,
        )
    )


def add_lag(axis: SymbolicAxis, name: str, signal: ca.SX, time_constant: ca.SX | float, nominal: float) -> ca.SX:
    """A first-order lag of a signal, in a state of its own that counts in f_C; returns the lagged signal [N].

    The integrator holds the signal's value at the end of a step of length h all through it. At the steps' ends the
    rate ln(1 + h/T)/h then gives x1 = (T x0 + h u1) / (T + h): its ramp response lags by exactly T, for any T >= 0.
    """
    h = axis.hold

    def rate(t: ca.SX | float) -> ca.SX:
        return ca.log(1.0 + h / ca.SX(t)) / h if h > 0.0 else 1.0 / ca.SX(t)

    state = add_effect_state(
        axis,
        EffectState(name, rate_per_second=_LAG_PER_SUBSTEP * float(ca.evalf(rate(nominal))), initial_state=1.0),
    )
    state.rate = rate(time_constant) * (signal / axis.coulomb - state.chi)
    return state.chi * axis.coulomb


def shortest_lag(axis: SymbolicAxis) -> float:
    """The shortest time constant [s] that is integrated as it is."""
    return _SHORTEST_LAG * max(axis.hold, axis.step)


def no_shorter(axis: SymbolicAxis, time_constant: ca.SX) -> ca.SX:
    """A time constant as it is, but never shorter than the integrator can follow: a smooth maximum."""
    return ca.sqrt(time_constant * time_constant + shortest_lag(axis) ** 2)
