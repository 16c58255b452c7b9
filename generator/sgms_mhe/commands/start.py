"""`sgms-mhe start`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.log_options import log_options
from sgms_mhe.support.errors import InputError

if TYPE_CHECKING:
    from sgms_mhe.machine import Kind

LARGEST: Final = 1e9
"""Of any number that is asked for."""

SCHEMA: Final = "machine.schema.json"
"""File beside the machine file by which editors complete and check it."""

_positive = common.NumberType(1e-12, LARGEST)


@click.command(
    short_help="A commented machine file to begin with.",
    epilog=common.example(
        "start --out my_axis.toml --mass 12 --rate 8000",
        "start log.csv --out my_axis.toml --mass 12",
        "start --out my_table.toml --inertia 0.02 --rate 4000 --coulomb 0.4",
    ),
)
@click.argument("logs", metavar="[LOG]...", nargs=-1, type=click.Path(path_type=Path))
@log_options
@common.out_option("The machine file to write; its stem is the machine's name.", metavar="MACHINE.toml")
@click.option("--mass", type=_positive, metavar="KG", help="Moved mass.")
@click.option("--inertia", type=_positive, metavar="KG_M2", help="The same of an axis that turns.")
@click.option("--coulomb", type=_positive, metavar="N", help="Level of sliding friction, if known.")
@click.option("--viscous", type=_positive, metavar="N_S_M", help="Its rise with speed, if known.")
@click.option("--break-away", type=_positive, metavar="M", help="Distance after a reversal until all slides, if known.")
@click.option("--max-velocity", type=_positive, metavar="M_S", default=1.0, show_default=True, help="Highest speed.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def command(
    logs: tuple[Path, ...],
    table: dict[str, Any],
    out: Path,
    mass: float | None,
    inertia: float | None,
    coulomb: float | None,
    viscous: float | None,
    break_away: float | None,
    max_velocity: float,
    force: bool,
) -> None:
    """Write a commented machine file: from logs what they determine, without one from what is known of the axis.

    Mass and rate are asked for where they are not given, if there is a terminal. Numbers that nobody gave stand at
    usual values and are marked as assumed. Of an axis that turns all is in rad and N m. Its first line names the
    schema by which editors check it, machine.schema.json, written beside it where there is none.
    """
    common.check_output_file(out, (".toml",))

    from sgms_mhe.api.starting import AxisNumbers, start_text

    if out.exists() and not force:
        raise InputError(out, "output file", None, "a new one; --force replaces it")
    if mass is not None and inertia is not None:
        raise InputError("start", "--inertia", inertia, "none beside --mass: an axis goes or turns")
    if logs:
        given = {"--coulomb": coulomb, "--viscous": viscous, "--break-away": break_away}
        for option, value in given.items():
            if value is not None:
                raise InputError("start", option, value, "none with a log, which says so itself")
        _write(out, _from_logs(logs, table, out.stem, mass, inertia))
    else:
        kind: Kind = "linear" if inertia is None else "rotary"
        given_mass = mass if inertia is None else inertia
        moved = _ask("--mass", "Moved mass [kg]") if given_mass is None else given_mass
        rate = table.get("rate")
        if rate is None:
            rate = _ask("--rate", "Samples per second [Hz]")
        known = AxisNumbers(out.stem, kind, moved, rate, coulomb, viscous, break_away, max_velocity)
        _write(out, start_text(known, out)[0])
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
    return float(click.prompt(question, type=_positive, err=True))


def _from_logs(
    logs: tuple[Path, ...], table: dict[str, Any], name: str, mass: float | None, inertia: float | None
) -> str:
    """The file that identification writes, and on stderr how the logs were read."""
    from sgms_mhe.api.identification import identify
    from sgms_mhe.api.inputs import read_log
    from sgms_mhe.machine.writing import toml_log

    read = [read_log(path, table=table, note=common.note) for path in logs]
    with common.step_notes() as progress:
        found = identify(read, name, mass=mass, inertia=inertia, note=common.note, progress=progress)
    return found.toml + toml_log(table, read[0].kind)
