"""Machine file to symbolic model: the three functions of docs/model.md and the estimator's assumptions on them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from sgms_mhe.machine import Machine
from sgms_mhe.model.axis import MEAN_ACCELERATION, SIGNAL_NAMES, FreeParameter, StateSpec, SymbolicAxis
from sgms_mhe.model.effects import EFFECT_NAMES, EffectDefinition, Stage, effect_definition
from sgms_mhe.model.effects.definition import READ_AS, ReadAs
from sgms_mhe.model.friction import LEAST_REST, WIDE_SWITCH, FrictionSymbols, add_friction, declare_elements
from sgms_mhe.model.place_force import add_place_force
from sgms_mhe.model.scales import scales_of
from sgms_mhe.model.switching import check_switching
from sgms_mhe.support.errors import InputError


@dataclass(frozen=True)
class Model:
    """Symbolic model of one machine; w = (position, velocity, acceleration, force, time).

    Attributes:
        rhs: d(chi)/dt (n_x); of elements that switch, that at a level which does not change.
        to_node: node state x (n_x) of (chi, theta).
        from_node: chi (n_x) of (x, theta).
        output: friction force [N] of (chi, w, theta).
        feed_forward: force of the drive beyond mass * acceleration [N], of (chi, w, theta): `output` without
            the delays of the log, and with states that acceleration or drive force move at rest where these hold.
        deflection: z [m] (n_z) of (chi, theta).
        level: s(v) / f_C times the effects' factors, of (w, theta), and of chi where an effect's state sets it.
        rho: d(chi_i)/dt of an element that sticks over the measured velocity [1/m] (n_z), of (w, theta):
            kappa_i / (nu_i f_C), times real over measured velocity where an effect tells them apart.
        names: per state, names of intermediate values of its rate.
        reads_mass: whether the mass stands in these equations; otherwise only the logged friction depends on it.
    """

    machine: Machine
    states: tuple[StateSpec, ...]
    parameters: tuple[FreeParameter, ...]
    chi: ca.SX
    x: ca.SX
    theta: ca.SX
    w: ca.SX
    rhs: ca.SX
    to_node: ca.SX
    from_node: ca.SX
    output: ca.SX
    feed_forward: ca.SX
    deflection: ca.SX
    level: ca.SX
    rho: ca.SX
    names: tuple[dict[str, ca.SX], ...]
    reads_mass: bool = False

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Names of the signals, in the order of w."""
        return SIGNAL_NAMES + (MEAN_ACCELERATION,) * (self.w.numel() - len(SIGNAL_NAMES))

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def n_z(self) -> int:
        """Number of Maxwell-slip elements; they are the first states."""
        return sum(state.element is not None for state in self.states)

    @property
    def n_p(self) -> int:
        """Number of estimated parameters."""
        return len(self.parameters)

    @property
    def state_noise(self) -> NDArray[np.float64]:
        """Standard deviation of the state noise per update (n_x), node state units."""
        return np.array([state.noise for state in self.states])

    @property
    def noise_travel(self) -> NDArray[np.float64]:
        """Length [m] along which the noise of each state comes up to that (n_x); 0: every update has it."""
        return np.array([state.noise_travel for state in self.states])

    @property
    def initial_state(self) -> NDArray[np.float64]:
        """Standard deviation of the first node's state (n_x)."""
        return np.array([state.initial_state for state in self.states])

    @property
    def prior(self) -> NDArray[np.float64]:
        """Standard deviation of theta before any data (n_p)."""
        return np.array([self.machine.estimator.prior_of(p.name, p.scale) for p in self.parameters])

    @property
    def prior_std(self) -> NDArray[np.float64]:
        """Standard deviation of every parameter before any data [SI] (n_p)."""
        return self.prior * np.abs([p.scale for p in self.parameters])

    @property
    def drift(self) -> NDArray[np.float64]:
        """Standard deviation of the random walk of theta per update (n_p), in proportion to the prior."""
        noise = self.machine.estimator.noise
        return noise.parameter_drift * (self.prior / noise.parameter)

    @cached_property
    def output_is_affine(self) -> bool:
        """Return True if the output is affine in (node state, theta) jointly, whatever the signals are.

        Its Jacobian is then the same at any two points, up to rounding. It is compared at random ones of all sizes:
        terms that cancel on paper (the Coulomb level of a node state that is a force) still stand in the expression.
        """
        variables = ca.vertcat(self.x, self.theta)
        output = ca.substitute(self.output, self.chi, self.from_node)
        function = ca.Function("slopes", [variables, self.w], [ca.densify(ca.jacobian(output, variables))])
        rng = np.random.default_rng(3)

        def draw(count: int, low: float, high: float) -> NDArray[np.float64]:
            return np.asarray(rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(low, high, count))

        def draw_node() -> NDArray[np.float64]:
            theta = [rng.uniform(max(p.lower, 0.9), min(p.upper, 1.1)) for p in self.parameters]
            return np.concatenate([draw(self.n_x, -2.0, 1.0), theta])

        points = [(w, draw_node(), draw_node()) for w in (draw(self.w.numel(), -6.0, 2.0) for _ in range(100))]
        w, *nodes = (np.column_stack(drawn) for drawn in zip(*points, strict=True))
        here, there = (np.array(function(node, w)).reshape(len(points), -1) for node in nodes)
        return bool(np.all(np.abs(there - here).max(axis=1) <= 1e-11 * np.abs(here).max(axis=1)))

    @cached_property
    def rounding(self) -> float:
        """Share of a measurement's stated noise that past velocities of 24 bits cost at most; 0: they are kept in full.

        A displacement is then off by 2^-24 of itself, and moves an element by that share of its level at most: one that
        moves farther than it holds slips, and forgets. At worst all samples of an interval are off to the same side.
        They are rounded where `[code] accuracy` allows that much, and older intervals need no other signals.
        """
        machine, friction = self.machine, self.machine.friction
        level = friction.coulomb * (1.0 + friction.stribeck_ratio)
        share = machine.sampling.samples_per_update * 2.0**-24 * level / machine.estimator.noise.measurement
        read = ca.which_depends(self.rhs, self.w)
        reads_more = any(read[k] for k, name in enumerate(self.signal_names) if name != "velocity")
        return 0.0 if machine.code.precision == "single" or reads_more or share > machine.code.accuracy else share

    def to_si(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Parameters in SI units from scaled ones, shape (..., n_p)."""
        nominal = np.array([p.nominal for p in self.parameters])
        scale = np.array([p.scale for p in self.parameters])
        return np.asarray(nominal + scale * (theta - 1.0))

    def function(self, name: str) -> ca.Function:
        """CasADi function of `rhs`, `to_node`, `from_node`, `output`, `deflection`, `level` or `rho`, by that name."""
        arguments = {
            "rhs": [self.chi, self.w, self.theta],
            "to_node": [self.chi, self.theta],
            "from_node": [self.x, self.theta],
            "output": [self.chi, self.w, self.theta],
            "deflection": [self.chi, self.theta],
            "level": [self.chi, self.w, self.theta],
            "rho": [self.w, self.theta],
        }[name]
        return ca.Function(name, arguments, [getattr(self, name)])


class _Parameters:
    """Hands out parameters by name: a free symbol's expression, or the machine file's number."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._wanted = machine.estimator.parameters
        self.free: list[FreeParameter] = []
        self.symbols: list[ca.SX] = []

    def take(self, name: str, column: str, nominal: float, scale: float, lower: float, upper: float) -> ca.SX:
        """Return the expression for one parameter; `lower` and `upper` are absolute, used where no bound is given."""
        if name not in self._wanted:
            return ca.SX(nominal)
        bounds = self._machine.estimator.bounds.get(name)
        if bounds is not None:
            if nominal == 0.0:
                raise InputError(
                    self._machine.source,
                    f"estimator.bounds.{name}",
                    list(bounds),
                    "no bounds: they multiply a nominal of 0",
                )
            # Multiples of nominal; with scale = nominal they are theta itself.
            low, high = sorted((nominal * bounds[0], nominal * bounds[1]))
            lower, upper = max(lower, low), min(upper, high)
        # With scale = nominal theta is p / nominal, and 0.2 times nominal is 0.2 to the last digit.
        offset = 0.0 if scale == nominal else scale - nominal
        edges = sorted(((lower + offset) / scale, (upper + offset) / scale))
        theta = ca.SX.sym(f"theta_{column}")
        self.free.append(FreeParameter(name, column, nominal, scale, edges[0], edges[1]))
        self.symbols.append(theta)
        return nominal + scale * (theta - 1.0) if scale != nominal else nominal * theta

    def base(self, name: str, nominal: float) -> ca.SX:
        return self.take(name, name, nominal, nominal, -np.inf, np.inf)

    def array(self, name: str, nominal: tuple[float, ...]) -> list[ca.SX]:
        return [self.take(name, f"{name}_{i + 1}", p, p, -np.inf, np.inf) for i, p in enumerate(nominal)]

    def shares(self, name: str, nominal: tuple[float, ...]) -> list[ca.SX]:
        """Parameters that sum to 1: the largest takes the rest of the others, at least a share of its nominal."""
        largest = nominal.index(max(nominal))
        taken = [
            ca.SX(p) if i == largest else self.take(name, f"{name}_{i + 1}", p, p, -np.inf, np.inf)
            for i, p in enumerate(nominal)
        ]
        others = [share for i, share in enumerate(taken) if i != largest]
        if any(not share.is_constant() for share in others):
            rest = 1.0 - ca.sum1(ca.vertcat(*others))
            taken[largest] = ca.fmax(rest, LEAST_REST * nominal[largest])
        return taken


class _PhysicalParameters(_Parameters):
    """Hands out every parameter as a symbol of its column's name that stands for its value in SI units."""

    def take(self, name: str, column: str, nominal: float, scale: float, lower: float, upper: float) -> ca.SX:
        self.free.append(FreeParameter(name, column, nominal, scale, lower, upper))
        self.symbols.append(ca.SX.sym(column))
        return self.symbols[-1]

    def shares(self, name: str, nominal: tuple[float, ...]) -> list[ca.SX]:
        return self.array(name, nominal)


_GATE: Final = 35.0
"""gamma for effects that tell directions apart, where the law has none."""
_BEHIND_THE_DRIVE: Final[tuple[Stage, ...]] = ("log", "actuator")
"""Stages between the force that acts and the one that is logged."""


@dataclass(frozen=True)
class _BuiltEffect:
    """An effect of the machine file: its parameters as numbers and as expressions, by the names of results."""

    definition: EffectDefinition
    label: str
    nominal: Mapping[str, float]
    expressions: Mapping[str, ca.SX]
    source: Path

    def contribute(self, axis: SymbolicAxis) -> None:
        """Add the effect to the axis; refuses numbers the code of another distribution fails at."""
        axis.scope = self.label
        try:
            self.definition.contribute(axis, self.expressions, self.nominal)
        except Exception as error:
            if self.definition.name in EFFECT_NAMES:
                raise
            allowed = f"parameters that the effect can be built with; {type(error).__name__}: {error}"
            raise InputError(self.source, f"effect {self.label}", dict(self.nominal), allowed) from None


def _effects(machine: Machine, parameters: _Parameters) -> tuple[_BuiltEffect, ...]:
    scales, effects = scales_of(machine), []
    for entry in machine.effects:
        definition = effect_definition(entry.name)
        nominal = definition.entries(entry.parameters)
        expressions = {}
        for name in definition.names(nominal):
            p = definition.parameter(name)
            expressions[name] = parameters.take(
                f"{entry.label}.{p.name}",
                f"{entry.label}.{name}",
                nominal[name],
                p.estimation_scale(scales, nominal[name]),
                p.lower,
                p.upper,
            )
        effects.append(_BuiltEffect(definition, entry.label, nominal, expressions, machine.source))
    return tuple(effects)


def _contribute(effects: Sequence[_BuiltEffect], axis: SymbolicAxis, *stages: Stage) -> None:
    """Add the effects of these stages, one stage after the other."""
    for stage in stages:
        for effect in effects:
            if effect.definition.stage == stage:
                effect.contribute(axis)


def _sum_ahead(effects: Sequence[_BuiltEffect], axis: SymbolicAxis, read_as: ReadAs) -> ca.SX:
    """The forces of some effects [N], known before any level or force is set that hangs on them."""
    before, axis.output = axis.output, ca.SX(0.0)
    for effect in effects:
        if effect.definition.read_as == read_as:
            effect.contribute(axis)
    found, axis.output = axis.output, before
    return found


def _prompt_drive(effects: Sequence[_BuiltEffect], axis: SymbolicAxis) -> ca.SX:
    """The drive's force behind all stages, effects with states left out: these make the log late."""
    reads, logged = axis.reads_mass, axis.drive
    for effect in effects:
        if effect.definition.stage in _BEHIND_THE_DRIVE and not effect.definition.states:
            effect.contribute(axis)
    prompt, axis.drive = axis.drive, logged
    axis.reads_mass = reads  # these effects are contributed once more
    return prompt


def _bare_axis(machine: Machine, *, estimates: bool = False) -> SymbolicAxis:
    """The axis before anything contributes to it; `estimates`: with the signals an estimator has besides."""
    friction, sampling, smoothing = machine.friction, machine.sampling, machine.friction.smoothing
    return SymbolicAxis(
        machine.plant.moved,
        friction.coulomb,
        step=sampling.step,
        gate_per_velocity=(smoothing.gamma if smoothing else _GATE) / friction.stribeck_velocity,
        names=SIGNAL_NAMES + (MEAN_ACCELERATION,) * (estimates and machine.estimator.disturbance.inertia > 0.0),
    )


def build_model(machine: Machine, *, physical: bool = False) -> Model:
    """Assemble the symbolic model of a machine: the friction law and every effect of its machine file.

    Args:
        machine: the axis.
        physical: theta holds every parameter in SI units, estimated or not, and a switch is `WIDE_SWITCH` wide: for
            solvers of differential equations that know neither scales nor events.

    Raises:
        InputError: an effect cannot be built with its numbers, or not where elements switch.
    """
    friction, noise = machine.friction, machine.estimator.noise
    parameters = _PhysicalParameters(machine) if physical else _Parameters(machine)
    axis = _bare_axis(machine, estimates=not physical)
    symbols = FrictionSymbols(
        stiffness=parameters.array("stiffness", friction.stiffness),
        fraction=parameters.shares("fraction", friction.fraction),
        micro_viscous=[ca.SX(s) for s in friction.micro_viscous],
        coulomb=parameters.base("coulomb", friction.coulomb),
        viscous=parameters.base("viscous", friction.viscous),
        stribeck_ratio=parameters.base("stribeck_ratio", friction.stribeck_ratio),
        stribeck_velocity=parameters.base("stribeck_velocity", friction.stribeck_velocity),
    )
    effects = _effects(machine, parameters)
    _contribute(effects, axis, "signal")
    declare_elements(
        axis,
        friction.fraction,
        friction.stiffness,
        symbols,
        state_as=noise.state_as,
        state_noise=noise.state,
        position_noise=machine.sampling.position_step,
        initial_state=noise.initial_state,
    )
    axis.load = _sum_ahead(effects, axis, "load")
    axis.curve = _sum_ahead(effects, axis, "curve")
    # By the acceleration a curve shifts the mean velocity to the sample's own time.
    acceleration, axis.acceleration = axis.acceleration, ca.SX(0.0)
    axis.mean_curve = _sum_ahead(effects, axis, "curve")
    axis.acceleration = acceleration
    _contribute(effects, axis, "level")
    elements = add_friction(axis, symbols, friction.smoothing, WIDE_SWITCH if physical else 0.0)
    _contribute(effects, axis, "force", "motor")
    if not physical and machine.estimator.disturbance.force > 0.0:
        add_place_force(axis, machine)
    prompt = _prompt_drive(effects, axis)
    _contribute(effects, axis, *_BEHIND_THE_DRIVE)
    rates = [state.rate for state in axis.states if state.rate is not None]
    if len(rates) != len(axis.states):
        raise ValueError("an effect declared a state and gave it no rate")
    if friction.switches:
        check_switching(machine, axis, elements)
    chi, rhs = ca.vertcat(*(state.chi for state in axis.states)), ca.vertcat(*rates)
    return Model(
        machine=machine,
        states=tuple(state.spec for state in axis.states),
        parameters=tuple(parameters.free),
        chi=chi,
        x=ca.vertcat(*(state.node for state in axis.states)),
        theta=ca.vertcat(*parameters.symbols),
        w=axis.measured,
        rhs=rhs,
        to_node=ca.vertcat(*(state.to_node for state in axis.states)),
        from_node=ca.vertcat(*(state.from_node for state in axis.states)),
        output=axis.output,
        feed_forward=_rest_states(
            prompt - axis.nominal_mass * axis.measured[2], rhs, chi, axis.measured, len(friction.stiffness)
        ),
        deflection=elements.deflection,
        level=elements.level,
        rho=elements.rho,
        names=tuple(state.names for state in axis.states),
        reads_mass=axis.reads_mass,
    )


def _rest_states(force: ca.SX, rhs: ca.SX, chi: ca.SX, w: ca.SX, elements: int) -> ca.SX:
    """A force with the states that acceleration or drive force move where they come to rest while these hold.

    A force that answers the drive's own force is no friction: fed forward it would feed back. Such states obey linear
    equations; with them go the states that they read, J chi + c = 0 for all. Elements, the first states, are friction
    whatever their level hangs on.
    """
    driven = {i for i in range(elements, chi.numel()) if ca.depends_on(rhs[i], w[2:4])}
    while more := [j for j in range(chi.numel()) if j not in driven and ca.depends_on(rhs[sorted(driven)], chi[j])]:
        driven |= set(more)
    if not any(ca.depends_on(force, chi[i]) for i in driven):
        return force
    order = sorted(driven)
    moved = ca.vertcat(*(chi[i] for i in order))
    rate = ca.vertcat(*(rhs[i] for i in order))
    slope = ca.jacobian(rate, moved)
    rest = -ca.solve(slope, ca.substitute(rate, moved, ca.SX.zeros(len(order))))
    return ca.substitute(force, moved, rest)


@dataclass(frozen=True)
class PlainForce:
    """Force an effect adds to the output of a model and leaves the rest unchanged.

    Attributes:
        parameters: the free ones of the effect.
        theta: their scaled values (n).
        w: measured signals (5).
        force: [N], of (w, theta).
        read_as: quantity as which other effects may use it.
    """

    parameters: tuple[FreeParameter, ...]
    theta: ca.SX
    w: ca.SX
    force: ca.SX
    read_as: ReadAs | None


def plain_force(machine: Machine, label: str) -> PlainForce | None:
    """An effect of the machine as a force of the signals and its own parameters, if it is nothing else.

    Its inputs and outputs are found by its contribution to one that nothing is known of.
    """
    parameters, axis = _Parameters(machine), _bare_axis(machine)
    effect = next(e for e in _effects(machine, parameters) if e.label == label)
    if effect.definition.stage != "force" or effect.definition.states:
        return None
    open_ends = axis.forget()
    effect.contribute(axis)
    before = open_ends.pop("output")
    if axis.states or any(getattr(axis, name) is not symbol for name, symbol in open_ends.items()):
        return None
    force = ca.simplify(ca.substitute(axis.output, before, 0.0))
    slope = ca.jacobian(axis.output, before)
    known = ca.vertcat(axis.measured, *parameters.symbols)
    reads = {symbol.name() for symbol in ca.symvar(force)}
    if not (slope.is_constant() and float(ca.DM(slope)) == 1.0 and reads <= {s.name() for s in ca.symvar(known)}):
        return None
    own = [i for i, free in enumerate(parameters.free) if free.column.partition(".")[0] == label]
    return PlainForce(
        parameters=tuple(parameters.free[i] for i in own),
        theta=ca.vertcat(*(parameters.symbols[i] for i in own)),
        w=axis.measured,
        force=force,
        read_as=effect.definition.read_as,
    )


def logged_share(machine: Machine) -> float:
    """Logged force per force on the axis, effects that make the log late left out, mean over the signals [1]."""
    axis, parameters = _bare_axis(machine), _Parameters(machine)
    output = axis.forget()["output"]
    effects = _effects(machine, parameters)
    _contribute(effects, axis, "motor")
    share = ca.jacobian(_prompt_drive(effects, axis), output)
    share = ca.substitute(share, ca.vertcat(*parameters.symbols), np.ones(len(parameters.symbols)))
    symbols = ca.symvar(share)
    function = ca.Function("share", [ca.vertcat(*symbols)], [share])
    draws = np.random.default_rng(1).uniform(-1.0, 1.0, (200, len(symbols)))
    return float(np.mean([float(function(draw)) for draw in draws]))


def find_read(machine: Machine) -> frozenset[ReadAs]:
    """Return which sums of other effects' forces the effects of a machine read."""
    axis = _bare_axis(machine)
    open_ends = axis.forget()
    for effect in _effects(machine, _Parameters(machine)):
        effect.contribute(axis)
    sums = {name: open_ends.pop(name) for name in READ_AS}
    found = [getattr(axis, name) for name in open_ends] + [s.rate for s in axis.states if s.rate is not None]
    return frozenset(name for name in READ_AS if any(ca.depends_on(x, sums[name]) for x in found))
