"""Operations of emitted functions: the cost of one call, in arithmetic on the package's numbers.

An operation is one addition, subtraction, multiplication, division, comparison or absolute value. Functions without a
library are counted by their parts, in double precision, whose polynomials are the longer ones.
"""

from collections.abc import Mapping
from typing import Final

from sgms_mhe.emission.c_source import Function

EXP: Final = 29
EXP2: Final = 19
LOG: Final = 34
INVERSE_SQRT: Final = 20
SQRT: Final = 27

_OF: Final[Mapping[str, int]] = {
    "exp": EXP,
    "log": LOG,
    "sqrt": SQRT,
    "sin": 32,
    "cos": 32,
    "tanh": 35,
    "neg": 0,
    "sign": 0,
    "floor": 5,
    "lookup": 3,
}


def operations_of(function: Function | None) -> int:
    """Operations of one call; of none where there is no function."""
    return sum(_OF.get(name, 1) * count for name, count in function.operations.items()) if function else 0


# --- small least squares, as sgms_linalg.h does them where nothing vectorises -----------------------------------------


def reflection(rows: int, width: int, column: int) -> int:
    """One Householder reflection of a pivot row and `rows` rows below it, from `column` on."""
    return 3 * rows + 9 + SQRT + (width - column - 1) * (4 * rows + 2)


def rotation(columns: int) -> int:
    """One plane rotation of two rows over so many columns."""
    return 6 + INVERSE_SQRT + 6 * columns


def added_row(n: int) -> int:
    """A row folded into a triangular factor of n unknowns."""
    return sum(2 + rotation(n - c) for c in range(n))


def grown(n: int, count: int) -> int:
    """Growth of the variances of the last `count` of n unknowns."""
    return sum(1 + sum(2 + rotation(n + 1 - i) for i in range(k + 1)) for k in range(n - count, n))


def back_substitution(n: int) -> int:
    """A triangular system of n unknowns."""
    return n * n


def variances(n: int) -> int:
    """Variances of n unknowns from their triangular factor."""
    return sum(3 + sum(2 * (c - i) + 3 for i in range(c)) for c in range(n))


def box_least_squares(n: int) -> int:
    """A triangular least-squares problem of n unknowns in a box, to the limit of its iterations."""
    eliminated = sum(reflection(n - c - 1, n + 1, c) for c in range(n))
    iteration = eliminated + (9 * n * n + 34 * n) // 2 + 1
    return back_substitution(n) + 2 * n + (3 * n + 4) * iteration
