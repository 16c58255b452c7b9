"""`sgms-mhe start`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.options import RangedNumber, make_command
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.options import Option

SCHEMA: Final = "machine.schema.json"
"""File beside the machine file by which editors complete and check it."""


@make_command(
    "start --out my_axis.toml --mass 12 --rate 8000",
    "start log.csv --out my_axis.toml --mass 12",
    "start --out my_table.toml --inertia 0.02 --rate 4000 --coulomb 0.4",
    of="starting.start_text",
)
def command(
    log: tuple[Path, ...] = (),
    *,
    log_table: Mapping[str, Any],
    out: Annotated[Path, Option("MACHINE.toml")],
    mass: Annotated[float | None, Option("KG", 1e-12, 1e9)] = None,
    inertia: Annotated[float | None, Option("KG_M2", 1e-12, 1e9)] = None,
    max_velocity: float,
    force: bool = False,
    **friction: float,
) -> None:
    """Write a commented machine file to begin with.

    From logs it holds what they determine, without one what is known of the axis. Mass and rate are asked for where
    they are not given, if there is a terminal. Of an axis that turns all is in rad and N m. The first line of the file
    names the schema by which editors check it, machine.schema.json, written beside it where there is none.

    Args:
        out: the machine file to write; its stem is the machine's name.
        mass: moved mass.
        inertia: the same of an axis that turns.
        force: replace a file that is there.
    """
    common.check_output_file(out, (".toml",))

    from sgms_mhe.api.identification import identify
    from sgms_mhe.api.starting import start_text

    if out.exists() and not force:
        raise InputError(out, "output file", None, "a new one; --force replaces it")
    if mass is not None and inertia is not None:
        raise InputError("start", "--inertia", inertia, "none beside --mass: an axis goes or turns")
    if log:
        for name, value in friction.items():
            raise InputError("start", f"--{name.replace('_', '-')}", value, "none with a log, which says so itself")
        with common.step_notes() as progress:
            found = identify(
                log, out.stem, mass=mass, inertia=inertia, table=log_table, note=common.note, progress=progress
            )
        _write(out, found.toml)
    else:
        given = mass if inertia is None else inertia
        moved = _ask("--mass", "Moved mass [kg]") if given is None else given
        rate = log_table.get("rate") or _ask("--rate", "Samples per second [Hz]")
        text, _ = start_text(
            out, "linear" if inertia is None else "rotary", moved, rate, max_velocity=max_velocity, **friction
        )
        _write(out, text)
    common.show(f"machine file: {out}\nnext: sgms-mhe check {out}", out)


def _write(out: Path, text: str) -> None:
    """Write the machine file, and its schema where the folder has none of that name."""
    from sgms_mhe.configuration import machine_schema
    from sgms_mhe.support.files import write_text

    schema = out.resolve().with_name(SCHEMA)
    if not schema.exists():
        write_text(schema, f"{common.json_text(machine_schema())}\n")
    write_text(out, f"#:schema ./{SCHEMA}\n{text}")


def _ask(option: str, question: str) -> float:
    """A number that was not given: from whoever sits at the terminal.

    Raises:
        InputError: nobody does.
    """
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise InputError("start", option, None, f"a number: {question[0].lower()}{question[1:]}")
    return float(click.prompt(question, type=RangedNumber(Option(least=1e-12, most=1e9)), err=True))
