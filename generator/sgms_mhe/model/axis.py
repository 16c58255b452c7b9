"""The symbolic axis under construction: what the S-GMS law and the effects contribute to."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class StateSpec:
    """One integration state and what the estimator assumes of it.

    Attributes:
        name: name in reports and comments.
        element: index of the Maxwell-slip element it belongs to, None for an effect's state.
        rate_per_metre: fastest nominal rate over |v| [1/m] (an element: rho_i).
        rate_per_second: fastest nominal rate that motion does not set [1/s].
        noise: standard deviation of the state noise per update, node state units.
        initial_state: standard deviation of the first node's state, node state units.
    """

    name: str
    element: int | None
    rate_per_metre: float
    rate_per_second: float
    noise: float
    initial_state: float


class SymbolicAxis:
    """Signals, levels, forces and states of one axis as CasADi expressions.

    The signals (`position` [m], `velocity` [m/s], `acceleration` [m/s^2], `force` [N], `time` [s]) start as the
    measured ones and may be replaced by an effect that says what the sensors really see. `coulomb_factor` and
    `viscous_factor` multiply f_C and sigma_v. Forces add up in the model's output, the friction force u - m a.
    """

    def __init__(self, mass: float) -> None:
        self.mass = mass
        self.measured = ca.SX.sym("w", len(SIGNAL_NAMES))
        self.position, self.velocity, self.acceleration, self.force, self.time = ca.vertsplit(self.measured)
        self.coulomb_factor: ca.SX = ca.SX(1.0)
        self.viscous_factor: ca.SX = ca.SX(1.0)
        self.output: ca.SX = ca.SX(0.0)
        self.states: list[StateSpec] = []
        self.symbols: list[ca.SX] = []
        self.rates: list[ca.SX] = []
        self.to_node: list[ca.SX] = []
        self.from_node: list[ca.SX] = []
        self.nodes: list[ca.SX] = []
        self.names: list[dict[str, ca.SX]] = []

    def add_force(self, force: ca.SX) -> None:
        """Add a force [N] to the friction force that the axis shows."""
        self.output = self.output + force

    def add_state(self, spec: StateSpec) -> ca.SX:
        """Declare an integration state and return its symbol; `set_rate` must follow, in the same order.

        Its node state is the integration state itself until `set_node_map` says otherwise.
        """
        chi = ca.SX.sym(f"chi_{spec.name}")
        x = ca.SX.sym(f"x_{spec.name}")
        self.states.append(spec)
        self.symbols.append(chi)
        self.nodes.append(x)
        self.to_node.append(chi)
        self.from_node.append(x)
        self.names.append({})
        return chi

    def name(self, **expressions: ca.SX) -> None:
        """Name intermediate values of the last declared state's rate; the emitted C uses the names."""
        self.names[-1].update(expressions)

    def set_rate(self, rate: ca.SX) -> None:
        """Give d(chi)/dt [1/s] of the state declared last without a rate."""
        self.rates.append(rate)

    def set_node_map(self, scale: ca.SX) -> None:
        """Let the node state of the last declared state be `scale` (a function of parameters) times chi."""
        self.to_node[-1] = scale * self.symbols[-1]
        self.from_node[-1] = self.nodes[-1] / scale


SIGNAL_NAMES = ("position", "velocity", "acceleration", "force", "time")
"""Order of the measured signals w of DESIGN section 1."""
