"""Equations of motion of an axis in the languages of other simulators, printed from its symbolic model."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
import numpy as np

from sgms_mhe.emission.c_source import CPrinter
from sgms_mhe.emission.graph import Graph, Node
from sgms_mhe.machine import Machine, ResolvedEffect
from sgms_mhe.model import SIGNAL_NAMES, Model, build_model
from sgms_mhe.model.building import plain_force
from sgms_mhe.model.effects import effect_definition

_CONTINUOUS_RATE: Final = 1e9
"""Hz; terms by which effects make up for the estimator's sampling vanish at it."""


@dataclass(frozen=True)
class Language:
    """Notation of a simulator's language where it differs from C.

    Attributes:
        condition: of (condition, value where it holds, value elsewhere).
        quiet: puts an expression that is not smooth where a solver does not search for its switch.
    """

    condition: str
    quiet: str


MODELICA: Final = Language("if {} then {} else {}", "noEvent({})")
SIMSCAPE: Final = Language("if {}, {} else {} end", "({})")
_SMOOTH: Final = ("exp", "log", "sqrt", "sin", "cos", "tanh")
_SWITCHED: Final[Mapping[str, str]] = {"fabs": "abs", "fmax": "max", "fmin": "min", "floor": "floor"}
"""Names of functions in these languages, by those of the graph."""


class EquationPrinter(CPrinter):
    """Prints nodes as equations of another language: one name per line, each set once."""

    def __init__(self, language: Language) -> None:
        super().__init__("double")
        self._language = language

    def declaration(self, name: str, expression: str) -> str:
        """Return the line that gives an intermediate value its name."""
        return f"{name} = {expression};"

    def operation(self, node: Node, arguments: list[str]) -> str | None:
        """Return the text of a node the language writes otherwise than C, in parentheses of its own; else None."""
        language, op = self._language, node.op

        def where(condition: str, value: str, other: str) -> str:
            return language.condition.format(condition, value, other)

        if op == "const" and node.value < 0.0:
            return f"({self.number(node.value)})"  # no sign stands behind an operator
        if op == "neg":
            return f"(-({arguments[0]}))"
        if op == "sq":
            return f"({arguments[0]})^2"
        if op == "sign":
            x = arguments[0]
            return language.quiet.format(where(f"{x} > 0.0", "1.0", where(f"{x} < 0.0", "-1.0", "0.0")))
        if op in ("lt", "le"):
            comparison = f"{arguments[0]} {'<' if op == 'lt' else '<='} {arguments[1]}"
            return language.quiet.format(where(comparison, "1.0", "0.0"))
        if op == "not":
            return language.quiet.format(where(f"abs({arguments[0]}) > 0.0", "0.0", "1.0"))
        if op == "lookup":
            text = "0.0"
            for place, value in reversed(node.table):
                text = where(f"abs({arguments[0]} - {self.number(place)}) < 0.5", self.number(value), text)
            return language.quiet.format(text)
        if op in _SWITCHED:
            return language.quiet.format(f"{_SWITCHED[op]}({', '.join(arguments)})")
        return f"{op}({arguments[0]})" if op in _SMOOTH else None


@dataclass(frozen=True)
class AxisModel:
    """Symbolic model of the axis itself, in continuous time and physical parameters.

    Attributes:
        model: theta is `values` [SI], by the names of `parameters`.
        left_out: labels of the effects that belong to the measurement.
    """

    model: Model
    left_out: tuple[str, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of theta, as in results."""
        return tuple(parameter.column for parameter in self.model.parameters)

    @property
    def inertia(self) -> float:
        """All that resists a slow acceleration at rest, effects that add to it included [kg, kg m^2]."""
        model = self.model
        added = ca.Function("added", [model.chi, model.w, model.theta], [ca.jacobian(model.feed_forward, model.w[2])])
        nominal = [parameter.nominal for parameter in model.parameters]
        return model.machine.plant.moved + float(added(0.0, 0.0, nominal))


def axis_model(machine: Machine) -> AxisModel:
    """Assemble the model of the moving axis: effects of the measurement and the estimator's sampling left out.

    Raises:
        InputError: an effect cannot be built with its numbers.
    """
    sampling = machine.sampling.model_copy(update={"rate": _CONTINUOUS_RATE})
    continuous = replace(machine, sampling=sampling)
    measured = tuple(effect.label for effect in machine.effects if _is_measurement(continuous, effect))
    kept = tuple(effect for effect in machine.effects if effect.label not in measured)
    return AxisModel(build_model(replace(continuous, effects=kept), physical=True), measured)


def find_place_force(machine: Machine, effect: ResolvedEffect) -> tuple[float, ...] | None:
    """Return (c, k, s, b, A, w, p) of an effect's force c + k q + s sin q + b cos q + A sin(w q + p) + m a.

    Sines without a wave number are of a joint that turns; None where the force is anything else. It is told by the
    force itself at drawn motions. The inertia m is in `AxisModel.inertia`.
    """
    plain = plain_force(replace(machine, effects=(effect,)), effect.label)
    if plain is None:
        return None
    slope = ca.jacobian(plain.force, plain.w)[0]
    bend = ca.jacobian(ca.jacobian(slope, plain.w)[0], plain.w)[0]
    force = ca.Function("force", [plain.w, plain.theta], [plain.force, slope, bend])
    w = np.random.default_rng(1).standard_normal((40, 5)) * [3.0, 1.0, 1.0, 1.0, 1.0]
    found, first, third = np.array([[float(x) for x in force(row, np.ones(plain.theta.numel()))] for row in w]).T
    q, turns = w[:, 0], machine.plant.kind == "rotary"
    wave = float(np.sqrt(max(-(first @ third), 0.0) / (first @ first or 1.0)))
    none = np.zeros(len(q))
    for ripple in ((none, none), (np.sin(wave * q), np.cos(wave * q))):
        columns = np.column_stack(
            [w[:, 2], none + 1.0, q, *((np.sin(q), np.cos(q)) if turns else (none, none)), *ripple]
        )
        sizes, *_ = np.linalg.lstsq(columns, found, rcond=None)
        least = 1e-9 * max(np.abs(found).max(), machine.friction.coulomb)  # rounding
        if np.abs(columns @ sizes - found).max() <= least:
            _, *place, sine, cosine = np.where(np.abs(sizes) < least, 0.0, sizes).tolist()
            return *place, math.hypot(sine, cosine), wave, math.atan2(cosine, sine)
    return None


def _is_measurement(machine: Machine, effect: ResolvedEffect) -> bool:
    """Return True if an effect changes the measurement, not the motion of the axis.

    Effects of the stage `log` are between the force that acts and the one that is logged; one whose states follow the
    logged force makes the drive late.
    """
    stage = effect_definition(effect.name).stage
    if stage != "log":
        return stage == "signal"
    alone = build_model(replace(machine, effects=(effect,)), physical=True)
    force = alone.w[SIGNAL_NAMES.index("force")]
    return not ca.depends_on(alone.rhs[alone.n_z :], force)


@dataclass(frozen=True)
class Equations:
    """Equations of an axis in one language.

    Attributes:
        states: name of each state, without a unit; all start at 0.
        lines: `name = expression;`, operands first.
        values: names the lines define, in their order.
        rates: name of each state's rate [1/s] among the values.
    """

    states: tuple[str, ...]
    lines: tuple[str, ...]
    values: tuple[str, ...]
    rates: tuple[str, ...]


def print_equations(axis: AxisModel, language: Language, names: Mapping[str, str]) -> Equations:
    """Print rates of the states, deflections and friction of an axis.

    Args:
        axis: its model.
        language: to print in.
        names: names there of the signals of `SIGNAL_NAMES` and of the parameters, by their columns.

    The lines also define `friction`, mass * acceleration left out, and the deflections `z_1`, `z_2`, ...
    """
    model, graph = axis.model, Graph()
    states = tuple(f"chi_{state.name}".replace(".", "_") for state in model.states)
    vectors = {"x": model.chi, "w": model.w, "theta": model.theta}
    labels = {"x": states, "w": tuple(names)[: model.w.numel()], "theta": axis.columns}
    rates = tuple(f"rate_{state.removeprefix('chi_')}" for state in states)
    targets = (*rates, *(f"z_{i + 1}" for i in range(model.n_z)), "friction")
    hinted = [(name, value) for own in model.names for name, value in own.items()]
    outputs = ca.vertcat(model.rhs, model.deflection, model.output)
    nodes = graph.read(ca.vertcat(outputs, *(value for _, value in hinted)), vectors, labels)
    hints = {node: name for (name, _), node in zip(hinted, nodes[len(targets) :], strict=True)}
    known = {graph.input("x", state): state for state in states}
    known |= {graph.input("w" if i < 5 else "theta", label): text for i, (label, text) in enumerate(names.items())}
    printer = EquationPrinter(language)
    lines = printer.statements([*zip(targets, nodes, strict=False)], known, hints)
    return Equations(states, tuple(lines), tuple(line.partition(" = ")[0] for line in lines), rates)
