"""Options by which every command that reads logs gets the keys missing in a log: a table `[log]`, or flags."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine


def log_table(
    *,
    log_file: Annotated[Path | None, Option("FILE.toml", name="--log")] = None,
    log_rate: Annotated[float | None, Option("HZ", 1e-3, 1e7, "--rate")] = None,
    log_wrap: Annotated[float | None, Option("PERIOD", 1e-15, 1e15, "--wrap")] = None,
    log_units: Annotated[Mapping[str, str] | None, Option("COLUMN=UNIT", name="--unit")] = None,
    log_scale: Annotated[float | None, Option("N", -1e15, 1e15, "--force-scale")] = None,
) -> dict[str, Any]:
    """Return the content of the table `[log]` that options make.

    Args:
        log_file: file with a table [log]: columns and units.
        log_rate: samples per second, where no column says the time.
        log_wrap: position starts over after so much, in its recorded unit.
        log_units: unit of position, torque, time, ...: position=mm. As often as needed.
        log_scale: force [N], or torque [N m], per recorded unit.

    Raises:
        InputError: the file; a name that is no quantity, a unit it does not have.
    """
    from sgms_mhe.machine import log_table as merge_tables
    from sgms_mhe.machine import read_log_table, table_of_flags

    own = {} if log_file is None else read_log_table(log_file)
    return merge_tables(own, table_of_flags(log_rate, log_wrap, log_units or {}, log_scale))


def load_for_log(machine: str, table: Mapping[str, Any]) -> Machine:
    """Load a machine, its table [log] overridden by the options on its logs. Raises InputError."""
    from sgms_mhe.configuration import load_machine, override_log

    return override_log(load_machine(machine), table)
