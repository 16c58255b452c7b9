"""`sgms-mhe generate`."""

from __future__ import annotations

from pathlib import Path

import click

from sgms_mhe.commands import common


@click.command(
    short_help="Emit MACHINE's estimator as C99.",
    epilog=common.example("generate etel_xy", "generate machines/etel_xy.toml --out firmware/etel_xy"),
)
@common.machine_argument
@common.out_option(
    "The package's folder; default generated/NAME below the working directory.", metavar="DIR", required=False
)
@click.option("--amalgamate", is_flag=True, help="All C in one source and one header.")
@click.option("--bindings", metavar="LIST", help="Also for, with commas: python, cpp, fmu2, fmu3.")
@common.json_option
def command(machine: str, out: Path | None, amalgamate: bool, bindings: str | None, as_json: bool) -> None:
    """Emit MACHINE's estimator as a folder of C99 that needs no library.

    The folder is replaced as a whole, and only if nothing but an earlier package is in it.
    """
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    folder = out or Path("generated") / resolved.name
    common.check_output_folder(folder)
    names = [name.strip() for name in bindings.split(",")] if bindings is not None else []

    from sgms_mhe.api import packages

    with common.progress_bar(f"generate {resolved.name}"):
        package = packages.generate(resolved, folder, amalgamate=amalgamate, bindings=names)
    for sentence in package.missing:
        common.note(sentence)
    sizes = {name: len(text.encode()) for name, text in package.files.items()}
    sizes |= {name: len(archive) for name, archive in package.archives.items()}
    if as_json:
        common.show(
            common.json_text(
                {"machine": resolved.name, "digest": resolved.digest, "folder": str(folder), "files": sizes}
            )
        )
        return
    rows = [(str(folder / name), f"{size} bytes") for name, size in sizes.items()]
    common.show(common.table_text(("file", "size"), [*rows, ("total", f"{sum(sizes.values())} bytes")]))
