"""Stack of the calls of packages that were measured: the page of a package states it, the same on any machine.

How much of the stack a function takes is decided by the compiler, so it is not computed here. `MEASURED` holds what gcc
writes down of the committed machines (evaluation/stacks.py); tests/test_stated_stack.py measures again and updates it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from sgms_mhe.emission.measured_stack import MEASURED

COMPILER: Final = "arm-none-eabi-gcc 12.2"
LEVELS: Final = ("-O2", "-O3")
"""Of optimisation, in the order of the measured numbers."""


@dataclass(frozen=True)
class Stack:
    """Bytes of the deepest call path of each public call on a Cortex-M7.

    Attributes:
        compiler, levels: that they were measured with.
        paths: (call, bytes at each level).
    """

    compiler: str
    levels: tuple[str, ...]
    paths: tuple[tuple[str, tuple[int, ...]], ...]


def measured_stack(machine_digest: str) -> Stack | None:
    """Stack of the package of a machine, by the digest of its file; None where it was not measured."""
    paths = MEASURED.get(machine_digest)
    return None if paths is None else Stack(COMPILER, LEVELS, tuple(paths.items()))
