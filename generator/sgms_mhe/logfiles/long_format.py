"""Long format: a line holds the time, the name and the value of one variable, as loggers of events write it."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from sgms_mhe.logfiles.decimals import is_missing
from sgms_mhe.logfiles.dialect import Dialect, fields_of, is_value
from sgms_mhe.logfiles.names import is_usual, plain_name
from sgms_mhe.logfiles.table import Column, Table
from sgms_mhe.machine import LogMapping
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError

_PROBE: Final = 1000
_OFTEN: Final = 3
"""Times that a name occurs among the first rows, on average."""
_VALUES: Final = frozenset("value values wert val data reading messwert".split())
_DATE: Final = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}")


def pivot(path: Path, table: Table, dialect: Dialect, hints: LogMapping | None) -> Table:
    """The table with a column for each name a column of names holds, or as it is where it has none.

    Where [log] states no `channel`, names are the words of a column beside which only time and one number stand.
    Raises InputError for a channel the file does not have, and one without a time or a value.
    """
    probe = [fields_of(line, dialect.separator) for _, line in dialect.rows[:_PROBE]]
    fields = [[row[k] if k < len(row) else "" for row in probe] for k in range(len(table.columns))]
    stated = None if hints is None else hints.channel
    numeric = [k for k, column in enumerate(fields) if any(map(is_value, column)) and all(map(_is_entry, column))]
    if stated is None:
        names = [k for k, column in enumerate(fields) if _are_names(column)]
        if len(names) != 1 or len(numeric) != 2:
            return table
        channel = names[0]
    else:
        channel = next((k for k, column in enumerate(table.columns) if stated in (column.name, column.header)), -1)
        if channel < 0:
            known = ", ".join(column.name for column in table.columns)
            raise InputError(path, "[log] channel", stated, f"one of the columns {known}")
    time = _time(table, numeric)
    rest = [k for k in numeric if k not in (time, channel)]
    value = next((k for k in rest if plain_name(table.columns[k].header) in _VALUES), rest[0] if rest else None)
    if time is None or value is None:
        allowed = "beside the names a column of times, as time or stamps, and one of values"
        raise InputError(path, "columns", ", ".join(column.name for column in table.columns), allowed)
    return _pivot(table, dialect, channel, time, value)


def _is_entry(field: str) -> bool:
    return is_value(field) or is_missing(field)


def _are_names(column: Sequence[str]) -> bool:
    """Return True for words of which each is there again and again."""
    if any(_is_entry(field) or _DATE.fullmatch(field) for field in column):
        return False
    return 2 <= len(set(column)) <= len(column) / _OFTEN


def _time(table: Table, numeric: Sequence[int]) -> int | None:
    """Index of the column of times: stamps, a usual name, else the first that never falls."""
    columns = table.columns
    stamps = [k for k in numeric if columns[k].name in table.stamped]
    named = [k for k in numeric if is_usual(columns[k].header, "time")]
    return next(iter([*stamps, *named, *numeric]), None)


def _pivot(table: Table, dialect: Dialect, channel: int, time: int, value: int) -> Table:
    # A row that is too short has no name; it is refused when values are read.
    words = ["".join(fields_of(line, dialect.separator)[channel : channel + 1]) for _, line in dialect.rows]
    places: dict[str, list[int]] = {}
    for k, word in enumerate(words):
        places.setdefault(word, []).append(k)
    clock, numbers = table.columns[time], table.columns[value].name
    columns = [Column(name, name) for name in places]
    clocks = [
        Column(f"time of {name}", clock.header if is_usual(clock.header, "time") else "time", clock.unit)
        for name in places
    ]
    of = dict(zip((column.name for column in clocks), places, strict=True))

    def read(wanted: Sequence[str]) -> Mapping[str, Array]:
        values = table.read([clock.name, numbers])
        return {
            name: values[clock.name][places[of[name]]] if name in of else values[numbers][places[name]]
            for name in wanted
        }

    shown = ", ".join(f"{name} {len(rows)}" for name, rows in list(places.items())[:20])
    first = min(places.values(), key=lambda rows: rows[0])

    def row(index: int) -> str:
        return table.row(first[min(index, len(first) - 1)])

    return replace(
        table,
        form="text, long format",
        columns=(*columns, *clocks),
        read=read,
        row=row,
        stamped=frozenset(of) if clock.name in table.stamped else frozenset(),
        notes=(*table.notes, f"a line holds one variable; they are (samples): {shown}"),
        clocks={name: f"time of {name}" for name in places},
    )
