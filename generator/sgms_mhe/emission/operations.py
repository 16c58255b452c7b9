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
