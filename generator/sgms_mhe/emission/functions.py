"""Bodies of emitted functions: expressions of the model, or of a group of blocks, as C statements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import casadi as ca

from sgms_mhe.emission.c_source import CPrinter
from sgms_mhe.emission.graph import Graph, Node, operations, walk
from sgms_mhe.emission.structure import Group, Structure
from sgms_mhe.model import SIGNAL_NAMES, Model


@dataclass(frozen=True)
class Function:
    """Body of one emitted function.

    Attributes:
        statements: C statements, in order.
        operations: (operation, how many), by name.
        unused: arguments that no statement reads.
        cleared: (array, length) of those that are mostly zero: they are cleared first.
    """

    statements: tuple[str, ...]
    operations: tuple[tuple[str, int], ...]
    unused: tuple[str, ...] = ()
    cleared: tuple[tuple[str, int], ...] = ()


Value = TypeVar("Value", ca.SX, Node)


@dataclass(frozen=True)
class Output(Generic[Value]):
    """What a function computes: values, and the C array or scalar that receives them.

    Attributes:
        name: of the array; of a scalar, the place itself (`y`, `*rho`).
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
            "w": list(SIGNAL_NAMES),
            "theta": [f"theta_{p.column}" for p in self._model.parameters],
        }

    def of_model(self, inputs: Sequence[str], outputs: Sequence[Output[ca.SX]]) -> Function:
        """Function of the model's vectors `inputs` (of x, w, theta), which are C arrays of the same names."""
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
            graph.input(vector, label): f"{vector}[{k}]"
            for vector in inputs
            for k, label in enumerate(self._labels[vector])
        }
        used = frozenset[str]().union(*(node.inputs for node in walk(nodes) if node.op == "input"))
        return Function(
            statements=tuple(self._printer.statements(targets, names, {})),
            operations=_counts(nodes),
            unused=tuple(vector for vector in inputs if vector not in used),
            cleared=tuple((o.name, len(o.values)) for o in outputs if o.sparse),
        )

    def of_group(self, group: Group, outputs: Sequence[Output[Node]], *, first_state: int = 0) -> Function:
        """Function of a block's chi from `first_state` on, its sample terms, parameter terms q and data."""
        targets = [(o.place(k), node) for o in outputs for k, node in enumerate(o.values)]
        nodes = [node for _, node in targets]
        names = {node: self._group_input(node) for node in walk(nodes) if node.op == "input"}
        used = {name.split("[")[0] for name in names.values()}
        arguments = [f"chi{i}" for i in range(first_state, group.m)] + [*self._terms, "q", "data"]
        return Function(
            statements=tuple(self._printer.statements(targets, names, group.names)),
            operations=_counts(nodes),
            unused=tuple(name for name in arguments if name not in used),
        )

    def _group_input(self, node: Node) -> str:
        """C name of a block's input: chi0 -> chi0, term0 -> velocity, q0 -> q[0], data0 -> data[0]."""
        vector = next(iter(node.inputs))
        index = int(node.label.removeprefix("term" if vector == "terms" else vector))
        return {"chi": f"chi{index}", "terms": self._terms[index] if vector == "terms" else ""}.get(
            vector, f"{vector}[{index}]"
        )


def _counts(nodes: Sequence[Node]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted(operations(nodes).items()))
