"""Embedded C out of a machine."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from sgms_mhe.api.inputs import load
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.machine import Machine
from sgms_mhe.support.options import Option


def generate(
    machine: str | Path | Machine,
    out: str | Path | None = None,
    *,
    amalgamate: Annotated[bool, Option()] = False,
    bindings: str | Iterable[str] = (),
) -> Package:
    """Emit a machine's estimator as C99 that needs no library.

    Args:
        machine: file, name, or loaded.
        out: the package's folder, replaced as a whole, and only if nothing but an earlier package is in it; None: write
            nothing.
        amalgamate: all C in one source and one header.
        bindings: one or several languages and tools it is to be called from besides: "python", "cpp", "fmu2",
            "fmu3".

    Returns:
        The machine, its files, text by name, and the archives of its bindings, bytes by name.

    Raises:
        InputError: the machine file; a tick beyond its budget of operations; a folder that holds other files.
    """
    bindings = (bindings,) if isinstance(bindings, str) else bindings
    package = emit_package(load(machine), within_budget=True, amalgamate=amalgamate, bindings=bindings)
    if out is not None:
        write_package(package, Path(out))
    return package
