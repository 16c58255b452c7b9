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
_MEMORY: Final = re.compile(r"struct \{\s+\w+_settings_t settings;.*?\n\}(?= \w+_t;)", re.DOTALL)
_ESTIMATOR: Final = re.compile(
    r"static const sgms_(?:real|chain) [^;]*;|#define \w+_SAMPLES [^\n]*| *\bSAMPLES = [^\n]*\n"
    r"| *\b(?:\w+_)?(?:SLOTS|SERIES_SIZE|SERIES_ROWS|INNER\w*|SPACING|HORIZON|DRIFT_INTERVAL|STEPS|SETTLE) = [^\n]*\n"
)
"""Numbers that an estimator has besides its model's, and sizes of its memory, which follow rates and horizon."""
_NUMBERS: Final = re.compile(
    rf"(?P<most>\w+_MOST_SUBSTEPS) = (?P<substeps>\d+),|(?P<defined>#define \w+ )(?P<value>{REAL})(?![\w.])"
    r"|static const sgms_real (?P<name>\w+_constants)\[[^\]]*\](?P<row>\[[^\]]*\]) = (?P<array>[^;]*);"
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
        first, value = len(numbers), found["substeps"] or found["value"] or found["real"]
        if found["table"] or (found["real"] and float(value) in _PLAIN):
            return found[0]
        if found["array"]:
            numbers.extend(float(number) for number in re.findall(rf"-?{REAL}", found["array"]))
            return f"#define {found['name']} ((const sgms_real (*){found['row']})(sgms_numbers + {first}))"
        numbers.append(float(value))
        if found["most"]:
            return f"\n#define {found['most']} ((int)sgms_numbers[{first}])"
        return f"{found['defined'] or ''}sgms_numbers[{first}]"

    shared = {}
    for name, text in files.items():
        kind = name.removeprefix(machine)
        if kind in (".h", "_config.h", "_model.h", "_integrator.h", "_flow.h"):
            text = _UNREAD.sub("", text)
            if kind not in ("_integrator.h", "_flow.h"):
                text = _ESTIMATOR.sub("", _MEMORY.sub("void", text))
            text = _NUMBERS.sub(put, text)
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
