"""A package's C from other languages: one file of the package's folder for each, by one template for each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final

from sgms_mhe.support.errors import InputError

BINDINGS: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {"python": ("bindings/python.py", "{name}.py"), "cpp": ("bindings/cpp.hpp", "{name}.hpp")}
)
"""Template, and name of the file, by the name of the binding."""


def binding_files(names: Iterable[str], machine: str) -> dict[str, str]:
    """Templates of the bindings asked for, by file name.

    Raises:
        InputError: a binding that there is not.
    """
    for name in names:
        if name not in BINDINGS:
            raise InputError("--bindings", "binding", name, " or ".join(BINDINGS))
    return {BINDINGS[name][1].format(name=machine): BINDINGS[name][0] for name in BINDINGS if name in names}
