"""`sgms-mhe start`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.options import RangedNumber, make_command
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.options import Option
from sgms_mhe.support.statements import list_open

SCHEMA: Final = "machine.schema.json"
"""File beside the machine file by which editors complete and check it."""


@make_command(
    "start log.csv",
    "start log.csv --out my_axis.toml --mass 12",
    "start --out my_table.toml --inertia 0.02 --rate 4000 --coulomb 0.4",
    of="starting.start_text",
)
def command(
    log: tuple[Path, ...] = (),
    *,
    log_table: Mapping[str, Any],
    out: Annotated[Path | None, Option("MACHINE.toml")] = None,
    mass: Annotated[float | None, Option("KG", 1e-12, 1e9)] = None,
    inertia: Annotated[float | None, Option("KG_M2", 1e-12, 1e9)] = None,
    max_velocity: float,
    force: bool = False,
    json: bool = False,
    **friction: float,
) -> None:
    """Take a first look at LOG, or begin a machine file without one.

    Of logs it states, within seconds and on one page: sign of the force, units, mass, constant force, friction,
    noise, open questions and the next motion to record; identify then searches for the law of friction. The page is
    LOG's name and _start.html, its statements _start.json. Without a log it writes the known numbers of the axis; mass
    and rate are asked for where they are not given, if there is a terminal. Of an axis that turns all is in rad and N
    m. The first line of a machine file names the schema by which editors check it, written beside it where there is
    none.

    Args:
        out: the machine file to write; its stem is the machine's name. Without a log it must be given.
        mass: moved mass.
        inertia: the same of an axis that turns.
        force: replace a file that is there.
    """
    if out is not None:
        common.check_output_file(out, (".toml",))
        if out.exists() and not force:
            raise InputError(out, "output file", None, "a new one; --force replaces it")
    if mass is not None and inertia is not None:
        raise InputError("start", "--inertia", inertia, "none beside --mass: an axis goes or turns")
    if log:
        for name, value in friction.items():
            raise InputError("start", f"--{name.replace('_', '-')}", value, "none with a log, which says so itself")
        _look(log, out, {"mass": mass, "inertia": inertia, "table": log_table}, json=json)
        return

    from sgms_mhe.api.starting import start_text

    if out is None:
        raise InputError("start", "--out", None, "a machine file to write, where there is no log")
    given = mass if inertia is None else inertia
    moved = _ask("--mass", "Moved mass [kg]") if given is None else given
    rate = log_table.get("rate") or _ask("--rate", "Samples per second [Hz]")
    kind: Literal["linear", "rotary"] = "linear" if inertia is None else "rotary"
    text, _ = start_text(out, kind, moved, rate, max_velocity=max_velocity, **friction)
    _write(out, text)
    common.show(f"machine file: {out}\nnext: sgms-mhe check {out}", out)


def _look(logs: Sequence[Path], out: Path | None, given: Mapping[str, Any], *, json: bool) -> None:
    """Write page, statements and, where it is asked for, the machine file; raise InputError where there are none."""
    from sgms_mhe.api.identification import survey
    from sgms_mhe.api.inputs import read_logs
    from sgms_mhe.logfiles.inspection import inspect_log
    from sgms_mhe.machine import log_mapping
    from sgms_mhe.machine.writing import toml_log
    from sgms_mhe.report import write_survey_page, write_unread_page
    from sgms_mhe.support.files import write_text

    table = given["table"]
    columns = inspect_log(logs[0], None, log_mapping(table, "[log]") if table else None).as_dict()
    base = Path(logs[0].name.partition(".")[0] or "log") if out is None else out.with_suffix("")
    page, data = (base.with_name(f"{base.name}_start{suffix}") for suffix in (".html", ".json"))
    content: dict[str, Any] = {"logs": [str(log) for log in logs], "columns": columns["columns"], "page": str(page)}
    read = []
    try:
        read = read_logs(logs, table=table, note=common.note)
        with common.step_notes() as progress:
            found = survey(read, "axis" if out is None else out.stem, **given, note=common.note, progress=progress)
            toml = None if out is None else found.describe(progress).toml + toml_log(table, read[0].kind)
    except InputError as error:
        write_unread_page(page, str(error), read[0] if read else None, columns)
        write_text(data, common.json_text(content | {"refusal": str(error), "statements": []}) + "\n")
        common.note(f"page: {page}")
        raise
    planned = f"sgms-mhe plan {out or 'MACHINE.toml'} --open {data}"
    write_survey_page(page, found, columns, planned)
    content |= {"refusal": None, "statements": [statement.to_json() for statement in found.statements]}
    text = common.json_text(found.units.keyed(content))
    write_text(data, f"{text}\n")
    if out is not None and toml is not None:
        _write(out, toml)
    lines = [s.sentence for s in found.statements if s.sure == "yes"]
    lines += [f"open: {s.advice}" for s in list_open(found.statements)]
    lines += [*([f"machine file: {out}"] if out is not None else []), f"page: {page}", f"next: {planned}"]
    common.show(text if json else "\n".join(lines), page)


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
