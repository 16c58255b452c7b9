"""`sgms-mhe generate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine


@make_command("generate etel_xy", "generate machines/etel_xy.toml --out firmware/etel_xy", of="packages.generate")
def command(
    machine: Machine,
    *,
    out: Annotated[Path | None, Option("DIR")] = None,
    bindings: Annotated[str | None, Option("LIST")] = None,
    json: bool = False,
    **options: Any,
) -> None:
    """Emit MACHINE's estimator as C99 that needs no library.

    Args:
        out: the package's folder, replaced as a whole, and only if nothing but an earlier package is in it; None:
            generated/NAME below the working directory.
        bindings: also for, with commas: python, cpp, fmu2, fmu3.
    """
    folder = out or Path("generated") / machine.name
    common.check_output_folder(folder)
    names = [name.strip() for name in bindings.split(",")] if bindings is not None else []

    from sgms_mhe.api import packages

    with common.progress_bar(f"generate {machine.name}"):
        package = packages.generate(machine, folder, bindings=names, **options)
    for sentence in package.missing:
        common.note(sentence)
    sizes = {name: len(text.encode()) for name, text in package.files.items()}
    sizes |= {name: len(archive) for name, archive in package.archives.items()}
    if json:
        common.show(
            common.json_text({"machine": machine.name, "digest": machine.digest, "folder": str(folder), "files": sizes})
        )
        return
    rows = [(str(folder / name), f"{size} bytes") for name, size in sizes.items()]
    common.show(common.table_text(("file", "size"), [*rows, ("total", f"{sum(sizes.values())} bytes")]))
