"""Expression graph between CasADi and C: hash-consed nodes that know their inputs.

CasADi differentiates; this graph stages. Every node carries the set of inputs it depends on, so that expressions of
parameters alone or of signals alone can be found and computed once instead of in every Runge-Kutta stage.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from sgms_mhe.support.errors import InputError

_BINARY = {getattr(ca, f"OP_{op.upper()}"): op for op in ("add", "sub", "mul", "div", "fmax", "fmin", "lt", "le", "eq")}
_UNARY = {
    getattr(ca, f"OP_{op.upper()}"): op
    for op in "neg exp log sqrt sin cos tanh fabs sq twice inv sign floor not".split()
}
_CODES = {name: code for code, name in (_BINARY | _UNARY).items()}

CHEAP = ("add", "sub", "mul", "neg", "fabs", "sq", "twice", "input", "const")
"""Operations that are cheap enough to repeat; all others are divisions and elementary functions."""


@dataclass(frozen=True, eq=False)
class Node:
    """One operation. `inputs` holds the names of the input vectors it depends on; equality is identity.

    `table`: of a look-up, (place, value) where it is not 0: the sum over k of (args[0] = k) value_k.
    """

    op: str
    args: "tuple[Node, ...]"
    inputs: frozenset[str]
    value: float = 0.0
    label: str = ""
    table: tuple[tuple[int, float], ...] = ()

    @property
    def is_expensive(self) -> bool:
        """Return True if computing this node once more costs a division or an elementary function."""
        return self.op not in CHEAP or any(a.is_expensive for a in self.args)


@dataclass
class Graph:
    """Nodes, each distinct expression once."""

    _nodes: dict[tuple[object, ...], Node] = field(default_factory=dict)

    def _intern(self, key: tuple[object, ...], make: Callable[[], Node]) -> Node:
        node = self._nodes.get(key)
        if node is None:
            node = self._nodes[key] = make()
        return node

    def constant(self, value: float) -> Node:
        """The number `value`."""
        return self._intern(("const", value), lambda: Node("const", (), frozenset(), value=value))

    def input(self, vector: str, label: str) -> Node:
        """The input called `label`, an element of the input vector `vector`."""
        return self._intern(("input", label), lambda: Node("input", (), frozenset({vector}), label=label))

    def apply(self, op: str, *args: Node) -> Node:
        """The operation `op` on `args`; operands of commuting operations are put in order."""
        looked_up = self._look_up(op, args)
        if looked_up is not None:
            return looked_up
        if op == "div" and args[1].op == "const":
            return self.apply("mul", self.constant(1.0 / args[1].value), args[0])
        if op == "div" and args[1].inputs == {"w"} and not args[0].inputs <= {"w"}:
            # A signal's reciprocal is taken once per sample; in a stage it is a product.
            return self.apply("mul", args[0], self.apply("inv", args[1]))
        if op == "mul" and all(a.op == "const" for a in args):
            return self.constant(args[0].value * args[1].value)
        if op == "mul" and args[0].op == "const" and args[1].op == "mul" and args[1].args[0].op == "const":
            return self.apply("mul", self.constant(args[0].value * args[1].args[0].value), args[1].args[1])
        if op in ("add", "mul") and id(args[0]) > id(args[1]):
            ordered: tuple[Node, ...] = (args[1], args[0])
        else:
            ordered = args
        inputs = frozenset().union(*(a.inputs for a in args))
        # The printed order stays the one CasADi gave: it is what the formula's author wrote.
        return self._intern((op, *map(id, ordered)), lambda: Node(op, args, inputs))

    def _look_up(self, op: str, args: tuple[Node, ...]) -> Node | None:
        """Return a look-up for a comparison with a number, its multiples, or the sum of two at one place; else None."""
        if op == "eq":
            number, place = args if args[0].op == "const" else args[::-1]
            if number.op != "const":
                raise InputError("symbolic model", "expression", ca.OP_EQ, "equality with a number alone")
            return self._table_at(("eq", id(place), number.value), place, ((int(number.value), 1.0),))
        tables = [a for a in args if a.op == "lookup"]
        if not tables:
            return None
        first, key = tables[0], (op, *map(id, args))
        if op in ("add", "sub") and len(tables) == 2 and args[0].args == args[1].args:
            sign = 1.0 if op == "add" else -1.0
            other = args[1].table if op == "add" else tuple((k, sign * c) for k, c in args[1].table)
            return self._table_at(key, first.args[0], args[0].table + other)
        factor = {"neg": -1.0, "twice": 2.0}.get(op)
        if op == "mul" and len(tables) == 1:
            factor = next((a.value for a in args if a.op == "const"), None)
        if factor is None:
            return None
        return self._table_at(key, first.args[0], tuple((k, factor * c) for k, c in first.table))

    def _table_at(self, key: tuple[object, ...], place: Node, table: tuple[tuple[int, float], ...]) -> Node:
        return self._intern(key, lambda: Node("lookup", (place,), place.inputs, table=table))

    def read(self, outputs: ca.SX, vectors: Mapping[str, ca.SX], labels: Mapping[str, Sequence[str]]) -> list[Node]:
        """Turn the elements of a dense SX column into nodes.

        `vectors` are the input vectors by name and `labels` the names of their elements.

        Raises:
            InputError: the expression holds an operation with no C counterpart.
        """
        names = list(vectors)
        f = ca.Function("f", [vectors[n] for n in names], [ca.densify(outputs)], {"cse": True})
        registers: dict[int, Node] = {}
        result: list[Node | None] = [None] * outputs.numel()
        for k in range(f.n_instructions()):
            op = f.instruction_id(k)
            i, o = f.instruction_input(k), f.instruction_output(k)
            if op == ca.OP_INPUT:
                registers[o[0]] = self.input(names[i[0]], labels[names[i[0]]][i[1]])
            elif op == ca.OP_CONST:
                registers[o[0]] = self.constant(float(f.instruction_constant(k)))
            elif op == ca.OP_OUTPUT:
                result[o[1]] = registers[i[0]]
            elif op in _BINARY:
                registers[o[0]] = self.apply(_BINARY[op], registers[i[0]], registers[i[1]])
            elif op in _UNARY:
                registers[o[0]] = self.apply(_UNARY[op], registers[i[0]])
            else:
                raise InputError("symbolic model", "expression", op, "operation code without a C counterpart")
        zero = self.constant(0.0)
        return [zero if node is None else node for node in result]


def to_sx(nodes: Iterable[Node], known: Mapping[Node, ca.SX]) -> list[ca.SX]:
    """Turn nodes back into SX; `known` gives the symbols of inputs and of the nodes that are cut off."""
    done: dict[Node, ca.SX] = dict(known)

    def visit(node: Node) -> ca.SX:
        if node not in done:
            if node.op == "const":
                done[node] = ca.SX(node.value)
            elif node.op == "lookup":
                places, values = zip(*node.table, strict=True)
                done[node] = ca.dot(ca.SX(ca.DM(values)), visit(node.args[0]) == ca.SX(ca.DM(places)))
            elif len(node.args) == 1:
                done[node] = ca.SX.unary(_CODES[node.op], visit(node.args[0]))
            else:
                done[node] = ca.SX.binary(_CODES[node.op], visit(node.args[0]), visit(node.args[1]))
        return done[node]

    return [visit(node) for node in nodes]


def walk(nodes: Iterable[Node]) -> list[Node]:
    """All nodes that `nodes` need, operands before operations."""
    order: dict[Node, None] = {}

    def visit(node: Node) -> None:
        if node not in order:
            for argument in node.args:
                visit(argument)
            order[node] = None

    for node in nodes:
        visit(node)
    return list(order)


def frontier(nodes: Iterable[Node], keep: Callable[[Node], bool]) -> list[Node]:
    """The largest subexpressions for which `keep` holds, in order of first use."""
    found: dict[Node, None] = {}
    seen: set[Node] = set()

    def visit(node: Node) -> None:
        if node in seen:
            return
        seen.add(node)
        if keep(node):
            found[node] = None
            return
        for argument in node.args:
            visit(argument)

    for node in nodes:
        visit(node)
    return list(found)


def operations(nodes: Iterable[Node]) -> dict[str, int]:
    """Count the operations of a set of expressions, in the order of their names."""
    return dict(sorted(Counter(node.op for node in walk(nodes) if node.op not in ("input", "const")).items()))
