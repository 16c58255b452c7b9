"""Expressions evaluated by numpy at many samples at once: work too small to compile for."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import casadi as ca
import numpy as np

from sgms_mhe.emission.graph import Graph, Node, walk
from sgms_mhe.support.arrays import Array

_OPERATIONS: Final[Mapping[str, Callable[..., Any]]] = {
    **{name: getattr(np, name) for name in "fmax fmin exp log sqrt sin cos tanh sign floor".split()},
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "lt": lambda a, b: np.where(np.less(a, b), 1.0, 0.0),
    "le": lambda a, b: np.where(np.less_equal(a, b), 1.0, 0.0),
    "neg": np.negative,
    "fabs": np.abs,
    "sq": np.square,
    "twice": lambda a: 2.0 * a,
    "inv": np.reciprocal,
    "not": lambda a: np.where(a == 0.0, 1.0, 0.0),
}


class Evaluation:
    """Expressions as numpy evaluates them, each distinct one once.

    Args:
        outputs: a column of expressions.
        vectors: their input vectors by name.
        labels: names of the inputs' elements.

    Raises:
        InputError: the expressions hold an operation that is not known.
    """

    def __init__(self, outputs: ca.SX, vectors: Mapping[str, ca.SX], labels: Mapping[str, Sequence[str]]) -> None:
        self._wanted = tuple(Graph().read(outputs, vectors, labels))
        self._order = walk(self._wanted)

    def at(self, known: Mapping[str, Array | float]) -> list[Array]:
        """Values of all expressions, each a number or (n); a non-finite value is no error here.

        Args:
            known: inputs by label, numbers or (n).
        """
        values: dict[Node, Any] = {}
        with np.errstate(all="ignore"):
            for node in self._order:
                if node.op == "input":
                    values[node] = known[node.label]
                elif node.op == "const":
                    values[node] = node.value
                elif node.op == "lookup":
                    place = values[node.args[0]]
                    values[node] = sum((np.where(place == k, value, 0.0) for k, value in node.table), np.float64(0.0))
                else:
                    values[node] = _OPERATIONS[node.op](*(values[a] for a in node.args))
        return [np.asarray(values[node], dtype=np.float64) for node in self._wanted]
