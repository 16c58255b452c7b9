"""`sgms-mhe ci`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from sgms_mhe.commands.common import check_output_file, example, json_option, json_text, note, show, table_text


@click.command(
    short_help="Check machine files, their packages and compilers.",
    epilog=example("ci", "ci machines/etel_xy.toml --generated firmware --junit build/sgms.xml --target cortex_m7"),
)
@click.argument("machines", nargs=-1)
@click.option(
    "--generated",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("generated"),
    metavar="DIR",
    show_default=True,
    help="Folder of the packages, each in a folder of its machine's name.",
)
@click.option(
    "--target",
    "targets",
    type=click.Choice(("cortex_m7", "riscv32")),
    multiple=True,
    help="Emulated microcontroller that the self-test runs on as well; may be given twice.",
)
@click.option("--junit", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", help="JUnit XML.")
@json_option
def command(
    machines: tuple[str, ...], generated: Path, targets: tuple[str, ...], junit: Path | None, as_json: bool
) -> None:
    """Check MACHINES, machine files or names, as a repository's CI would: all files of machines/ by default.

    Of each: the file is valid and its work within the budget; the generated package is what the file gives, byte for
    byte; compiled C and reference agree on a simulated log; the package's self-test passes on this host with $CC and
    every warning an error, and on emulated targets.

    Exit code 1 where a check fails.
    """
    from sgms_mhe.evaluation.acceptance import accept, machines_below
    from sgms_mhe.evaluation.acceptance import junit as junit_text
    from sgms_mhe.support.files import write_text

    if junit is not None:
        check_output_file(junit)
    checks = [
        check
        for machine in machines or machines_below(Path("machines"))
        for check in accept(machine, generated, targets, note)
    ]
    if junit is not None:
        write_text(junit, junit_text(checks))
    failed = [check for check in checks if check.failure]
    if as_json:
        show(json_text({"passed": not failed, "checks": [asdict(check) for check in checks]}))
    else:
        rows = [
            (c.machine, c.name, "FAILED" if c.failure else "skipped" if c.skipped else "ok", f"{c.seconds:.1f} s")
            for c in checks
        ]
        lines = [f"{c.machine}, {c.name}: {c.failure}" for c in failed]
        show("\n".join([table_text(("machine", "check", "outcome", "time"), rows), *lines]))
    if failed:
        click.get_current_context().exit(1)
