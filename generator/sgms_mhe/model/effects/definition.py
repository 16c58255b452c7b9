"""What an effect is: something the axis has beyond the S-GMS friction law."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal

import casadi as ca

from sgms_mhe.model.axis import AxisState, StateSpec, SymbolicAxis
from sgms_mhe.model.effects.excitation import Excitation

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine

Stage = Literal["signal", "level", "force", "motor", "log", "actuator"]
STAGES: Final[tuple[Stage, ...]] = ("signal", "level", "force", "motor", "log", "actuator")
"""The order in which effects contribute, whatever their order in the machine file: what the sensors see of the motion;
factors on friction; forces; from force to motor current; from current to the log; the current loop behind the log."""

Unit = Literal["one", "coulomb", "damping", "stiffness", "mass", "sample", "deflection"]
Role = Literal["size", "place", "period"]
Extent = Literal[
    "one",
    "travel",
    "sample_travel",
    "duration",
    "per_duration",
    "sample",
    "rate",
    "speed",
    "deflection",
    "level_over_travel",
]
"""What the limits of a search count in. one: SI; travel: range of position; sample_travel: largest speed times the time
between samples; duration of the log; per_duration: its inverse; sample: time between samples; rate: its inverse;
speed: the largest; deflection: of the element that breaks away last; level_over_travel: f_C over the range of
position."""

_LAG_PER_SUBSTEP = 0.2
"""A lag decays by exp(-0.5) in a substep of rk4: it is linear, so the error is 3e-4 of what is left of a transient."""
_SHORTEST_LAG = 0.25  # of a sample


def machine_unit(machine: Machine, unit: Unit) -> float:
    """Size of a unit that the machine itself sets, in SI.

    one: 1; coulomb: f_C [N]; damping: sigma_v, or f_C over the maximum speed where there is none [N s/m];
    stiffness: sum of kappa_i [N/m]; mass [kg]; sample: time between samples [s]; deflection: that of the element which
    breaks away last, nu_i f_C / kappa_i [m].
    """
    friction = machine.friction
    sizes: dict[Unit, float] = {
        "one": 1.0,
        "coulomb": friction.coulomb,
        "damping": friction.viscous or friction.coulomb / machine.sampling.max_velocity,
        "stiffness": math.fsum(friction.stiffness),
        "mass": machine.plant.mass,
        "sample": machine.sampling.step,
        "deflection": max(
            nu * friction.coulomb / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True)
        ),
    }
    return sizes[unit]


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
        role: `size`: scaled by its nominal value for estimation, by `scale` where that is 0; `place`: of arbitrary zero
            (phase, position, time), always scaled by `scale`; `period`: known to a few percent, scaled by 3 % of it.
        main: whether a fit of the effect frees it.
    """

    name: str
    default: float
    scale: float
    description: str
    lower: float = -math.inf
    upper: float = math.inf
    unit: Unit = "one"
    role: Role = "size"
    main: bool = True

    @property
    def allowed(self) -> str:
        """The limits in words."""
        if math.isinf(self.upper):
            return "a finite number" if math.isinf(self.lower) else f"a number from {self.lower:g} on"
        return f"a number from {self.lower:g} to {self.upper:g}"

    def size(self, machine: Machine) -> float:
        """Typical size [SI] on this machine."""
        return self.scale * machine_unit(machine, self.unit)

    def estimation_scale(self, machine: Machine, nominal: float) -> float:
        """What theta - 1 = 1 means [SI]."""
        if self.role == "place" or nominal == 0.0:
            return self.size(machine)
        return 0.03 * nominal if self.role == "period" else nominal


@dataclass(frozen=True)
class Search:
    """A parameter whose fit needs trial values: the residual has many minima over it.

    Attributes:
        parameter: its name.
        low, high: first and last trial value, in `low_of` and `high_of` (see `Extent`).
        spacing: of the trial values; `reciprocal`: equal steps of 1 / value.
        points: how many; 0: as many as resolve the data, half a period over the travel or the duration from one to the
            next.
        harmonic: (amplitude, phase) of a sine. It is linear in its two quadratures, so that a trial value of the period
            or frequency costs one linear fit.
    """

    parameter: str
    low: float
    high: float
    low_of: Extent = "one"
    high_of: Extent = "one"
    spacing: Literal["linear", "log", "reciprocal"] = "log"
    points: int = 8
    harmonic: tuple[str, str] | None = None


def pitch_search(amplitude: str) -> Search:
    """Search of `pitch_m` from ten samples' way at the largest speed up to twice the travel."""
    return Search("pitch_m", 10.0, 2.0, "sample_travel", "travel", "reciprocal", 0, (amplitude, "phase_rad"))


@dataclass(frozen=True)
class Start:
    """How a fit starts.

    Attributes:
        values: first trial of parameters, in multiples of their `size`; the others start at their defaults.
        searches: parameters to try on a grid.
        note: what else there is to know.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    searches: tuple[Search, ...] = ()
    note: str = ""


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


@dataclass(frozen=True)
class EffectDefinition:
    """The one definition of an effect that reference, generator and diagnosis read.

    Attributes:
        name: as in the machine file; the module's name.
        summary: one line for reports.
        parameters: in the order of reports.
        contribute: adds the effect to the axis, given its parameters as expressions and their nominal values.
        stage: see STAGES.
        excitation: what a log must hold for the effect to be identified.
        confused_with: names of effects and wrong-number causes that look alike, and the move that tells them apart.
        start: how its fit starts.
        states: names of its own states.
    """

    name: str
    summary: str
    parameters: tuple[EffectParameter, ...]
    contribute: Contribution
    excitation: Excitation
    confused_with: Mapping[str, str]
    start: Start
    stage: Stage = "force"
    states: tuple[str, ...] = ()

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
