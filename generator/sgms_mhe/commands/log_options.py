"""Options by which every command that reads logs is told what a log leaves open: a table `[log]`, or flags."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from sgms_mhe.commands.common import NumberType

if TYPE_CHECKING:
    from collections.abc import Callable

    from sgms_mhe.machine import Machine

F = TypeVar("F", bound="Callable[..., object]")


class _Unit(click.ParamType[tuple[str, str]]):
    """COLUMN=UNIT."""

    name = "unit"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        """(column, unit) of a text; refuses one without both."""
        column, _, unit = (part.strip() for part in str(value).partition("="))
        if not column or not unit:
            self.fail(f"{value!r} is not COLUMN=UNIT.", param, ctx)
        return column, unit


_OPTIONS = (
    click.option(
        "--log",
        "log_file",
        type=click.Path(path_type=Path),
        metavar="FILE.toml",
        help="File with a table [log]: columns and units.",
    ),
    click.option(
        "--rate",
        "log_rate",
        type=NumberType(1e-3, 1e7),
        metavar="HZ",
        help="Samples per second, where no column says the time.",
    ),
    click.option(
        "--wrap",
        "log_wrap",
        type=NumberType(1e-15, 1e15),
        metavar="PERIOD",
        help="Position starts over after so much, in its recorded unit.",
    ),
    click.option(
        "--unit",
        "log_units",
        type=_Unit(),
        multiple=True,
        metavar="COLUMN=UNIT",
        help="Unit of position, torque, time, ...: position=mm. As often as needed.",
    ),
    click.option(
        "--force-scale",
        "log_scale",
        type=NumberType(-1e15, 1e15),
        metavar="N",
        help="Force [N], or torque [N m], per recorded unit.",
    ),
)


def log_options(function: F) -> F:
    """Add the options to a command, which gets the content of `[log]` that they make as `table`."""

    @functools.wraps(function)
    def command(
        log_file: Path | None,
        log_rate: float | None,
        log_wrap: float | None,
        log_units: tuple[tuple[str, str], ...],
        log_scale: float | None,
        **others: object,
    ) -> object:
        from sgms_mhe.machine import log_table, read_log_table, table_of_flags

        own = {} if log_file is None else read_log_table(log_file)
        flags = table_of_flags(log_rate, log_wrap, dict(log_units), log_scale)
        return function(table=log_table(own, flags), **others)

    decorated: Any = command
    for option in reversed(_OPTIONS):
        decorated = option(decorated)
    return decorated  # type: ignore[no-any-return]


def load_for_log(machine: str, table: Mapping[str, Any]) -> Machine:
    """Load a machine, its table [log] with what options say of its logs laid over it. Raises InputError."""
    from sgms_mhe.configuration import load_machine, override_log

    return override_log(load_machine(machine), table)
