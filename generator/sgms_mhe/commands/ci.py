"""`sgms-mhe ci`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import click

from sgms_mhe.commands.common import check_output_file, json_text, note, show, table_text
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option


@make_command("ci", "ci machines/etel_xy.toml --generated firmware --junit build/sgms.xml --target cortex_m7")
def command(
    machines: tuple[str, ...] = (),
    *,
    generated: Annotated[Path, Option("DIR")] = Path("generated"),
    target: tuple[Literal["cortex_m7", "riscv32"], ...] = (),
    junit: Path | None = None,
    json: bool = False,
) -> bool:
    """Check machine files, their packages and compilers.

    MACHINES are files or names; by default all files of machines/. Of each: the file is valid and its work within the
    budget; the generated package equals the emission of the file, byte for byte; compiled C and reference agree on a
    simulated log; the package's self-test passes on this host with $CC and every warning an error, and on emulated
    targets.

    Exit code 1 where a check fails.

    Args:
        generated: folder of the packages, each in a folder of its machine's name.
        target: emulated microcontroller the self-test runs on as well; may be given twice.
        junit: JUnit XML.
    """
    from sgms_mhe.evaluation.acceptance import accept, machines_below
    from sgms_mhe.evaluation.acceptance import junit as junit_text
    from sgms_mhe.support.files import write_text

    if generated.is_file():
        raise click.BadParameter(f"Directory {str(generated)!r} is a file.", param_hint="'--generated'")
    if junit is not None:
        check_output_file(junit)
    checks = [
        check
        for machine in machines or machines_below(Path("machines"))
        for check in accept(machine, generated, target, note)
    ]
    if junit is not None:
        write_text(junit, junit_text(checks))
    failed = [check for check in checks if check.failure]
    if json:
        show(json_text({"passed": not failed, "checks": [asdict(check) for check in checks]}))
    else:
        rows = [
            (c.machine, c.name, "FAILED" if c.failure else "skipped" if c.skipped else "ok", f"{c.seconds:.1f} s")
            for c in checks
        ]
        lines = [f"{c.machine}, {c.name}: {c.failure}" for c in failed]
        show("\n".join([table_text(("machine", "check", "outcome", "time"), rows), *lines]))
    return bool(failed)
