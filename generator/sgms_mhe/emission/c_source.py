"""Expressions to C: single-assignment constants with names a reader can follow, as bodies of functions."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import casadi as ca
import numpy as np

from sgms_mhe.emission.graph import Graph, Node, operations, walk
from sgms_mhe.emission.structure import Group, Structure
from sgms_mhe.model import Model

_ATOM, _UNARY, _PRODUCT, _SUM = range(4)
_INFIX = {"add": ("+", _SUM), "sub": ("-", _SUM), "mul": ("*", _PRODUCT), "div": ("/", _PRODUCT)}
_LONGEST_INLINE = 72
REAL: Final = r"(?:\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)"
"""A number as `CPrinter` prints it in double precision, of a regular expression."""
_BRANCHING: Final = re.compile(r"\bsgms_(?=(?:exp|sin|cos)\()")
"""Functions that have a form for loops over lanes."""
_NUMBER: Final = re.compile(rf"(?<![\w.]){REAL}f?(?![\w.])")


class CPrinter:
    """Prints nodes as C99 of one precision.

    tables: names of the arrays used by the printed code, by content.
    """

    def __init__(self, precision: str) -> None:
        self.single = precision == "single"
        self.real = "float" if self.single else "double"
        self.tables: dict[tuple[float, ...], str] = {}

    def number(self, value: float) -> str:
        """Shortest literal that reads back as the same number in the package's precision."""
        text = repr(float(value))
        if self.single:
            text = str(np.float32(value))
            if "e" not in text and "." not in text and "inf" not in text:
                text += ".0"
        if "." not in text and "e" not in text:
            text += ".0"
        return text + ("f" if self.single else "")

    def numbers(self, values: Iterable[float]) -> str:
        """Literals, separated by commas."""
        return ", ".join(self.number(v) for v in values)

    def array(self, values: Iterable[float]) -> str:
        """Brace-enclosed initialiser."""
        return "{" + self.numbers(values) + "}"

    def series(self, coefficients: Sequence[float], x: str) -> str:
        """x^2 (c_0 - c_1 x + c_2 x^2 - ...), by Horner's scheme."""
        text = self.number(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            text = f"({self.number(c)} - {x} * {text})"
        return f"{x} * {x} * {text}"

    def statements(
        self, outputs: Sequence[tuple[str, Node]], names: Mapping[Node, str], hints: Mapping[Node, str]
    ) -> list[str]:
        """C statements that compute `outputs` (target expression, node).

        `names` are nodes already available under a C name (inputs, cut-off terms), `hints` preferred names for
        intermediate values. A value used more than once, or too long to read inline, becomes a named constant.
        """
        uses: dict[Node, int] = {}
        cut = set(names)

        def count(node: Node) -> None:
            uses[node] = uses.get(node, 0) + 1
            if uses[node] == 1 and node not in cut:
                for argument in node.args:
                    count(argument)

        for _, node in outputs:
            count(node)
        text: dict[Node, tuple[str, int]] = {node: (name, _ATOM) for node, name in names.items()}
        taken = set(names.values()) | {target for target, _ in outputs}
        ends = {node for _, node in outputs}
        lines: list[str] = []
        for node in walk(node for _, node in outputs):
            if node in text or node not in uses:
                continue
            expression, level = self._expression(node, text)
            shared = uses[node] > 1 and node.op != "const" and not (node.op == "neg" and node.args[0].op != "const")
            if node in hints or shared or (node.args and node not in ends and self._is_long(expression)):
                name = self._fresh(hints.get(node, "a"), taken, always_number=node not in hints)
                lines.append(self.declaration(name, expression))
                text[node] = (name, _ATOM)
            else:
                text[node] = (expression, level)
        lines += [f"{target} = {text[node][0]};" for target, node in outputs]
        return lines

    @staticmethod
    def _is_long(expression: str) -> bool:
        """Return True if a reader would want a name for it; digits have no say: other numbers, the same statements."""
        return len(_NUMBER.sub("0.0000", expression)) > _LONGEST_INLINE

    def declaration(self, name: str, expression: str) -> str:
        """Return the statement that gives an intermediate value its name."""
        return f"const sgms_real {name} = {expression};"

    def operation(self, node: Node, arguments: list[str]) -> str | None:
        """Return the text of an operation where it is not that of the language of packages; None where it is."""
        return None

    @staticmethod
    def _fresh(base: str, taken: set[str], *, always_number: bool) -> str:
        name, k = (f"{base}1", 1) if always_number else (base, 1)
        while name in taken:
            k += 1
            name = f"{base}{k}"
        taken.add(name)
        return name

    def _expression(self, node: Node, text: Mapping[Node, tuple[str, int]]) -> tuple[str, int]:
        def operand(k: int, level: int) -> str:
            body, own = text[node.args[k]]
            return body if own <= level else f"({body})"

        op = node.op
        other = self.operation(node, [text[a][0] for a in node.args])
        if other is not None:
            return other, _ATOM
        if op == "const":
            body = self.number(node.value)
            return (body, _ATOM) if node.value >= 0.0 else (body, _UNARY)
        if op in _INFIX:
            sign, level = _INFIX[op]
            return f"{operand(0, level)} {sign} {operand(1, level - 1)}", level
        if op == "neg":
            return f"-{operand(0, _ATOM)}", _UNARY
        if op == "sq":
            inner = operand(0, _ATOM)
            if inner.isidentifier():
                return f"{inner} * {inner}", _PRODUCT
            return f"sgms_square({text[node.args[0]][0]})", _ATOM
        if op == "twice":
            return f"{self.number(2.0)} * {operand(0, _UNARY)}", _PRODUCT
        if op == "inv":
            return f"{self.number(1.0)} / {operand(0, _UNARY)}", _PRODUCT
        if op == "lookup":
            values = dict(node.table)
            # Beyond the last of them the look-up holds an end, and the sum is zero.
            table = (*(values.get(k, 0.0) for k in range(max(values) + 1)), 0.0)
            name = self.tables.setdefault(table, f"table_{len(self.tables) + 1}")
            return f"sgms_entry({name}, {len(table) - 1}, {text[node.args[0]][0]})", _ATOM
        if op in ("lt", "le"):
            return f"(sgms_real)({operand(0, _SUM)} {'<' if op == 'lt' else '<='} {operand(1, _SUM)})", _UNARY
        arguments = ", ".join(text[a][0] for a in node.args)
        return f"sgms_{op}({arguments})", _ATOM


@dataclass(frozen=True)
class Function:
    """Body of one emitted function.

    Attributes:
        statements: C statements, in order.
        operations: how many of each, by name.
        cleared: (array, length) of those that are mostly zero: they are cleared first.
    """

    statements: tuple[str, ...]
    operations: Mapping[str, int]
    cleared: tuple[tuple[str, int], ...] = ()


Value = TypeVar("Value", ca.SX, Node)


@dataclass(frozen=True)
class Output(Generic[Value]):
    """Output of a function: values, and the C array or scalar that receives them.

    Attributes:
        name: of the array; of a scalar, the place itself.
        values: expressions of the model, or nodes of a graph.
        stride: name of the distance between entries, where it is not 1.
        sparse: mostly zero: cleared, then set where it is not.
    """

    name: str
    values: Sequence[Value]
    scalar: bool = False
    stride: str = ""
    sparse: bool = False

    def place(self, k: int) -> str:
        """C expression of entry k."""
        if self.scalar:
            return self.name
        return f"{self.name}[{k} * {self.stride}]" if self.stride else f"{self.name}[{k}]"


def scalar(name: str, value: Value) -> Output[Value]:
    """One number."""
    return Output(name, [value], scalar=True)


def entries(expression: ca.SX) -> list[ca.SX]:
    """All entries of a vector, zeros that are not stored included."""
    return list(ca.vertsplit(ca.densify(expression)))


class FunctionPrinter:
    """Prints functions of one package."""

    def __init__(self, structure: Structure, printer: CPrinter) -> None:
        self._model: Model = structure.model
        self._printer = printer
        self._terms = tuple(term.name for term in structure.sample_terms)
        self._labels = {
            "x": [f"x_{s.name}" for s in self._model.states],
            "w": list(self._model.signal_names),
            "theta": [f"theta_{p.column}" for p in self._model.parameters],
        }

    def model_function(self, inputs: Mapping[str, str], outputs: Sequence[Output[ca.SX]]) -> Function:
        """Function of the model's vectors x, w, theta; `inputs` gives the C array of each that it has."""
        graph = Graph()
        vectors = {"x": self._model.x, "w": self._model.w, "theta": self._model.theta}
        nodes = graph.read(ca.vertcat(*(e for o in outputs for e in o.values)), vectors, self._labels)
        places = [(o, o.place(k)) for o in outputs for k in range(len(o.values))]
        zero = graph.constant(0.0)
        targets = [
            (place, node)
            for (output, place), node in zip(places, nodes, strict=True)
            if not (node is zero and output.sparse)
        ]
        names = {
            graph.input(vector, label): f"{array}[{f'W_{label.upper()}' if vector == 'w' else k}]"
            for vector, array in inputs.items()
            for k, label in enumerate(self._labels[vector])
        }
        return Function(
            statements=tuple(self._printer.statements(targets, names, {})),
            operations=operations(nodes),
            cleared=tuple((o.name, len(o.values)) for o in outputs if o.sparse and o.values),
        )

    def group_function(self, group: Group, outputs: Sequence[Output[Node]]) -> Function:
        """Function of a point `at` at which a block stands: its chi, sample terms, parameter terms q and data."""
        targets = [(o.place(k), node) for o in outputs for k, node in enumerate(o.values)]
        nodes = [node for _, node in targets]
        names = {node: f"at->{self._group_input(node)}" for node in walk(nodes) if node.op == "input"}
        lines = self._printer.statements(targets, names, group.names)
        return Function(tuple(_BRANCHING.sub("sgms_lane_", line) for line in lines), operations(nodes))

    def _group_input(self, node: Node) -> str:
        """Field of a block's input: chi0 -> chi[0], term0 -> velocity, q0 -> q[0], data0 -> data[0]."""
        vector = next(iter(node.inputs))
        index = int(node.label.removeprefix("term" if vector == "terms" else vector))
        return self._terms[index] if vector == "terms" else f"{vector}[{index}]"
