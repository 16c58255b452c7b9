"""Headers of a model with its numbers in a table, so that models of one structure share compiled code.

The models of a record, of its neighbours and of a search differ in digits alone, and to compile one takes longer than
to run it. Operations and their order stay, so results do to the bit.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from sgms_mhe.emission.c_source import REAL
from sgms_mhe.support.arrays import Array

_PLAIN: Final = frozenset((0.0, 0.5, 1.0, 2.0))
"""Numbers of equations more than of a machine: compilers know what to do with them."""
_UNREAD: Final = re.compile(r" */\*.*?\*/|#define \w+_MACHINE(?:_\d)? [^\n]*", re.DOTALL)
"""Comments, and the digest of the machine file."""
_ESTIMATOR: Final = re.compile(r"static const sgms_(?:real|chain) [^;]*;")
"""Numbers that an estimator has besides those of its model."""
_NUMBERS: Final = re.compile(
    r"static const sgms_real (?P<name>\w+_constants)\[[^\]]*\](?P<row>\[[^\]]*\]) = (?P<array>[^;]*);"
    rf"|(?P<table>static const [^;]*;)|(?<![\w.])(?P<real>{REAL})(?![\w.])"
)


def share_numbers(files: Mapping[str, str], machine: str) -> tuple[dict[str, str], Array]:
    """Return the headers of a model with `sgms_numbers[i]` in place of a number, and the numbers (n).

    Args:
        files: headers by name, in double precision; `sgms_predict` takes the numbers that go with them.
        machine: its name, by which its own headers begin. Tables that they look up stay.
    """
    numbers: list[float] = []

    def put(found: re.Match[str]) -> str:
        first = len(numbers)
        if found["array"]:
            numbers.extend(float(number) for number in re.findall(rf"-?{REAL}", found["array"]))
            return f"#define {found['name']} ((const sgms_real (*){found['row']})(sgms_numbers + {first}))"
        if found["table"] or float(found[0]) in _PLAIN:
            return found[0]
        numbers.append(float(found[0]))
        return f"sgms_numbers[{first}]"

    shared = {}
    for name, text in files.items():
        kind = name.removeprefix(machine)
        if kind in (".h", "_config.h", "_model.h"):
            text = _ESTIMATOR.sub("", text)
        if kind in (".h", "_config.h", "_model.h", "_integrator.h", "_flow.h"):
            text = _NUMBERS.sub(put, _UNREAD.sub("", text))
        shared[name] = text
    return shared, np.array(numbers)


def free_numbers(files: Mapping[str, str], names: Sequence[str]) -> tuple[dict[str, str], Array]:
    """Return a package's files with `sgms_free[i]` in place of numbers that it defines, and the numbers (n).

    Args:
        files: by name; the library that -DSGMS_FREE=n makes of them has them in `double sgms_free[n]`.
        names: of the definitions.
    """
    numbers: list[float] = []

    def put(found: re.Match[str]) -> str:
        numbers.append(float(found[2]))
        return f"extern double sgms_free[];\n#define {found[1]} ((sgms_real)sgms_free[{len(numbers) - 1}])"

    pattern = re.compile(rf"#define ({'|'.join(names)}) ({REAL})f?")
    return {name: pattern.sub(put, text) for name, text in files.items()}, np.array(numbers)
