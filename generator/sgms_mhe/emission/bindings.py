"""A package's C from other languages and tools: files of the package's folder, by one template each."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Final

from sgms_mhe.emission.fmu import SUFFIX
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.names import did_you_mean

BINDINGS: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "python": {"{name}.py": "bindings/python.py"},
        "cpp": {"{name}.hpp": "bindings/cpp.hpp"},
        "fmu2": {
            "{name}_fmi2.fmu/modelDescription.xml": "bindings/fmi2.xml",
            "{name}_fmi2.fmu/sources/{name}_fmi2.c": "bindings/fmi2.c",
        },
        "fmu3": {
            "{name}_fmi3.fmu/modelDescription.xml": "bindings/fmi3.xml",
            "{name}_fmi3.fmu/sources/buildDescription.xml": "bindings/fmi3_build.xml",
            "{name}_fmi3.fmu/sources/{name}_fmi3.c": "bindings/fmi3.c",
        },
        "simulink": {"{name}_sfun.c": "bindings/simulink.c", "{name}_block.m": "bindings/simulink.m"},
        "iec": {"{name}.st": "bindings/iec.st", "{name}_iec.c": "bindings/iec.c", "{name}_iec.h": "bindings/iec.h"},
    }
)
"""Templates by file, by the name of the binding; files below one that ends in `.fmu` are those of that archive."""


def binding_files(names: Collection[str], machine: str) -> dict[str, str]:
    """Templates of the bindings asked for, by file name.

    Raises:
        InputError: a binding that there is not, or a machine that it cannot name.
    """
    for name in names:
        if name not in BINDINGS:
            allowed = f"one of {', '.join(BINDINGS)}"
            raise InputError("--bindings", "binding", name, allowed + did_you_mean(name, BINDINGS))
    if "iec" in names and ("__" in machine or machine.endswith("_")):
        allowed = "a name that has no two underscores in a row and none at its end, as IEC 61131-3 asks"
        raise InputError("--bindings", "iec: name", machine, allowed)
    asked = [BINDINGS[name] for name in BINDINGS if name in names]
    return {file.format(name=machine): template for files in asked for file, template in files.items()}


def bindings_among(files: Collection[str], machine: str) -> tuple[str, ...]:
    """Bindings of which a package's folder has a file or more, of all the files in it."""
    own = {
        name: {
            file.format(name=machine).partition(SUFFIX)[0] + SUFFIX.rstrip("/") * (SUFFIX in file) for file in templates
        }
        for name, templates in BINDINGS.items()
    }
    return tuple(name for name, made in own.items() if made & set(files))
