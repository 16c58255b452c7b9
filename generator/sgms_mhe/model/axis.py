"""The symbolic axis under construction: the S-GMS law and the effects contribute to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import casadi as ca

SIGNAL_NAMES = ("position", "velocity", "acceleration", "force", "time")
"""Order of the measured signals w of docs/model.md."""
Expressions = Mapping[str, ca.SX]
"""Parameters of an effect by name."""
MEAN_ACCELERATION: Final = "mean_acceleration"
"""One more signal, where the mass is uncertain: its noise is not that of the measured friction."""


SETTABLE: Final = (
    "velocity_ratio",
    "coulomb_factor",
    "viscous_factor",
    "micro_viscous",
    "level_force",
    "engagement",
    "load",
    "curve",
    "mean_curve",
    "stribeck_level",
    "rest_level",
    "element_force",
    "output",
)
"""What effects may set on an axis, besides what is really there of the signals."""


@dataclass(frozen=True)
class StateSpec:
    """One integration state and the estimator's assumptions on it.

    Attributes:
        name: name in reports and comments.
        element: index of the Maxwell-slip element it belongs to, None for an effect's state.
        rate_per_metre: fastest nominal rate over |v| [1/m] (an element: rho_i).
        rate_per_second: fastest nominal rate that motion does not set [1/s].
        noise: standard deviation of the state noise per update, node state units.
        initial_state: standard deviation of the first node's state, node state units.
        noise_travel: length [m] along which the noise comes up to `noise`; 0: every update has it.
    """

    name: str
    element: int | None
    rate_per_metre: float
    rate_per_second: float
    noise: float
    initial_state: float
    noise_travel: float = 0.0


@dataclass(frozen=True)
class FreeParameter:
    """A parameter the estimator estimates: p = nominal + scale (theta - 1).

    Attributes:
        name: machine-file name of the group (`stiffness`, `force_ripple.amplitude_N`).
        column: name in results (`stiffness_1`, `coulomb`, `force_ripple.amplitude_N`).
        nominal: value of the machine file [unit].
        scale: meaning of theta - 1 = 1 [unit].
        lower: bound on theta, -inf if none.
        upper: bound on theta, inf if none.
    """

    name: str
    column: str
    nominal: float
    scale: float
    lower: float
    upper: float


@dataclass
class AxisState:
    """A state under construction: chi, its rate d(chi)/dt [1/s], and the node state that the estimator keeps for it."""

    spec: StateSpec
    chi: ca.SX
    node: ca.SX
    rate: ca.SX | None = None
    node_scale: ca.SX = field(default_factory=lambda: ca.SX(1.0))
    names: dict[str, ca.SX] = field(default_factory=dict)

    @property
    def to_node(self) -> ca.SX:
        """The node state of (chi, theta)."""
        return self.node_scale * self.chi

    @property
    def from_node(self) -> ca.SX:
        """chi of (node state, theta)."""
        return self.node / self.node_scale


class SymbolicAxis:
    """Signals, levels, forces and states of one axis as CasADi expressions.

    Attributes:
        mean_acceleration: over the time in which the signal chain settles [m/s^2]; None: no such signal is asked for.
        nominal_mass: of the machine file [kg], where it is no more than a scale.
        reads_mass: whether an effect has asked for the mass.
        coulomb: nominal f_C [N], the unit of the states that are forces.
        step: time between samples [s], for which a sample's value counts, up to its own time.
        measured: the signals w as the machine logs them; `position` [m], `velocity` [m/s], `acceleration` [m/s^2],
            `force` [N], `time` [s] start as these, and an effect may replace them by the real ones.
        velocity_ratio: real over measured velocity.
        coulomb_factor, viscous_factor: multiply f_C and sigma_v.
        micro_viscous: damping [N s/m] shared out to the elements by nu_i, on top of their own sigma_i.
        curve, mean_curve: friction over speed of any shape that effects add [N], at a sample's own time and at the mean
            velocity before it; complete from the stage `level` on.
        stribeck_level: s(v) / f_C, which an effect may replace by the level the elements really have.
        rest_level: the same at v = 0, 1 + beta.
        stribeck_share: exp(-(v/v_s)^2), the share of the Stribeck effect that is there at this speed.
        gate_per_velocity: gamma / v_s [s/m], how sharply directions are distinguished.
        coulomb_force, damping: f_C [N] and sigma_v [N s/m], before any factor.
        level_force: part of the elements' level beyond its factors [N].
        engagement: share of the velocity that reaches the friction elements.
        load: force from outside, and of the mass beyond the machine file's [N]; friction-like
            in sign, complete from the stage `level` on.
        output: prediction of the model, the logged force minus mass * measured acceleration [N].
        element_force: sum of nu_i chi_i, the elements' force over f_C, from when they are declared.
        states: elements first.
        scope: label of the effect that contributes at the moment; its states are named after it.
        shared: states that effects have in common, by name and numbers.
    """

    def __init__(
        self, mass: float, coulomb: float, step: float, gate_per_velocity: float, names: Sequence[str] = SIGNAL_NAMES
    ) -> None:
        self.gate_per_velocity = gate_per_velocity
        self.nominal_mass = mass
        self.reads_mass = False
        self.shared: dict[tuple[str | float, ...], AxisState] = {}
        self.coulomb = coulomb
        self.step = step
        self.measured = ca.SX.sym("w", len(names))
        signals = ca.vertsplit(self.measured)
        self.position, self.velocity, self.acceleration, self.force, self.time = signals[: len(SIGNAL_NAMES)]
        self.mean_acceleration: ca.SX | None = signals[-1] if MEAN_ACCELERATION in names else None
        self.velocity_ratio: ca.SX = ca.SX(1.0)
        self.coulomb_factor: ca.SX = ca.SX(1.0)
        self.viscous_factor: ca.SX = ca.SX(1.0)
        self.micro_viscous: ca.SX = ca.SX(0.0)
        self.coulomb_force: ca.SX = ca.SX(coulomb)
        self.damping: ca.SX = ca.SX(0.0)
        self.level_force: ca.SX = ca.SX(0.0)
        self.engagement: ca.SX = ca.SX(1.0)
        self.load: ca.SX = ca.SX(0.0)
        self.curve: ca.SX = ca.SX(0.0)
        self.mean_curve: ca.SX = ca.SX(0.0)
        self.stribeck_level: ca.SX = ca.SX(1.0)
        self.rest_level: ca.SX = ca.SX(1.0)
        self.stribeck_share: ca.SX = ca.SX(0.0)
        self.element_force: ca.SX = ca.SX(0.0)
        self.output: ca.SX = ca.SX(0.0)
        self.states: list[AxisState] = []
        self.scope = ""

    @property
    def mass(self) -> float:
        """The machine file's [kg]; quantities made of it do not follow a payload."""
        self.reads_mass = True
        return self.nominal_mass

    @property
    def drive(self) -> ca.SX:
        """The logged force the model predicts [N]."""
        return self.output + self.mass * self.measured[2]

    @drive.setter
    def drive(self, force: ca.SX) -> None:
        self.output = force - self.mass * self.measured[2]

    @property
    def transmitted_force(self) -> ca.SX:
        """Return the drive's force behind friction, mass * acceleration + load [N]: of known signals alone."""
        return self.mass * self.acceleration + self.load

    @property
    def sliding_friction(self) -> ca.SX:
        """Size of the friction of an axis that slides, as far as effects have set it [N]."""
        level = self.coulomb_force * self.coulomb_factor * self.stribeck_level + self.level_force
        beside = self.damping * self.viscous_factor * ca.fabs(self.velocity) + ca.sign(self.velocity) * self.curve
        return level + beside

    def forget(self) -> dict[str, ca.SX]:
        """Put a symbol in the place of everything that effects may set but the signals, and return them by name."""
        symbols = {name: ca.SX.sym(name) for name in SETTABLE}
        for name, symbol in symbols.items():
            setattr(self, name, symbol)
        return symbols

    def add_force(self, force: ca.SX) -> None:
        """Add a force [N] to the friction force the axis shows."""
        self.output = self.output + force

    def add_mass(self, mass: ca.SX, nominal: float) -> None:
        """Add the inertial force of a mass [kg].

        Its estimated part has the mean acceleration for a regressor, where there is one: the noise of the
        acceleration is in the measured friction too, and would draw the estimate.
        """
        if self.mean_acceleration is None:
            self.add_force(mass * self.acceleration)
        else:
            self.add_force(nominal * self.acceleration + (mass - nominal) * self.mean_acceleration)

    def add_state(self, spec: StateSpec) -> AxisState:
        """Declare an integration state; its rate must be set before the model is complete.

        Its node state is the integration state itself unless `node_scale` is set.
        """
        state = AxisState(spec, ca.SX.sym(f"chi_{spec.name}"), ca.SX.sym(f"x_{spec.name}"))
        self.states.append(state)
        return state
