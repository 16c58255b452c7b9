"""Assignment of columns to quantities and units: by `[log]`, by the log's own names, by name and unit.

A name alone is never enough: `position` without a unit is refused with the line that would say it.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, get_args

from sgms_mhe.logfiles.names import is_usual, plain_name, split_name
from sgms_mhe.logfiles.table import Column, Table
from sgms_mhe.machine import (
    COUNTS,
    QUANTITIES,
    REQUIRED,
    Command,
    Kind,
    LogColumn,
    LogMapping,
    Quantity,
    Role,
    log_line,
    normal_unit,
    split_unit,
)
from sgms_mhe.support.errors import InputError

SHOWN: Final = 20
"""Names of a file that a message repeats."""


@dataclass(frozen=True)
class Source:
    """Where a quantity comes from: SI value = (scale * variable + offset) * factor + shift of the unit.

    Attributes:
        column: name in the file's table.
        row: of a matrix, from 1; None for a vector.
        unit: as this package spells it.
        because: the reason, for people.
    """

    quantity: Quantity
    column: str
    unit: str
    because: str
    row: int | None = None
    scale: float = 1.0
    offset: float = 0.0
    counts_per: float | None = None
    wrap: float | None = None
    signed: int | None = None

    @property
    def keys(self) -> dict[str, Any]:
        """Return the entry of [log] that it needs."""
        said = {"variable": self.column, "row": self.row, "unit": self.unit, "scale": self.scale, "offset": self.offset}
        said |= {"counts_per": self.counts_per, "wrap": self.wrap, "signed": self.signed}
        silent = {"scale": 1.0, "offset": 0.0}
        return {key: value for key, value in said.items() if value is not None and value != silent.get(key)}

    @property
    def period(self) -> float | None:
        """Range of a recorded number that is centred about zero; None for one taken as it is."""
        if self.signed is not None:
            return float(2.0**self.signed)
        return None if self.quantity.role == "position" else self.wrap

    @property
    def description(self) -> str:
        """Column and row, for people."""
        return self.column if self.row is None else f"{self.column}, row {self.row}"


def choose_sources(
    path: Path, table: Table, mapping: LogMapping | None, preferred: Kind | None
) -> tuple[Kind, tuple[Source, ...]]:
    """(kind of axis, sources of its quantities, the required ones first).

    `preferred` is the machine's kind, which decides where the file has the columns of both. Raises InputError for a
    quantity that is missing or found twice, and for a unit that is not stated or not one of the quantity's.
    """
    kind = _kind(path, table, mapping, preferred)
    stated = mapping.columns if mapping is not None else {}
    quantities = {quantity.role: quantity for quantity in QUANTITIES[kind]}

    lost: list[Quantity] = []

    def find(role: Role, *, by_name: bool = False, required: bool = True) -> Source | None:
        quantity = quantities[role]
        source = _source(path, table, quantity, stated.get(quantity.column), by_name=by_name)
        if source is None and required:
            lost.append(quantity)
        return source

    by_rate = mapping is not None and mapping.rate is not None
    has_clock = not table.clocks or "time_s" in stated
    time = find("time", by_name=True, required=not by_rate) if has_clock else None
    position = find("position", by_name=True, required=False)
    is_unread = position is None and bool(_usual(table, "position"))
    asked = stated.get(quantities["velocity"].column)
    velocity = find("velocity", by_name=position is None, required=False)  # without a position it is integrated
    carrier = position or velocity
    if carrier is None or (is_unread and (asked is None or asked.is_bare)):
        lost.append(quantities["position"])
    if not has_clock and carrier is not None:
        clock = table.clocks.get(carrier.column)
        time = find("time", by_name=True, required=not by_rate) if clock is None else None
        if clock is not None:
            time = _own(path, quantities["time"], table.named(clock), clock in table.stamped)
    friction = find("friction", required=False)
    commands = [find(role, by_name=True, required=False) for role in get_args(Command)]
    is_commanded = any(source is not None and source.quantity.role != "enabled" for source in commands)
    force = find("force", by_name=True, required=friction is None and not is_commanded)
    rest = (find(role, required=False) for role in ("acceleration", "temperature"))
    found = (time, position, force, velocity, friction, *rest, *commands)
    if lost:
        raise _missing(path, table, lost, None)
    return kind, tuple(source for source in found if source is not None)


def find_missing(path: Path, table: Table, mapping: LogMapping | None, preferred: Kind | None) -> tuple[str, ...]:
    """The required quantities for which no one column is found, by their columns' names."""
    try:
        kind = _kind(path, table, mapping, preferred)
    except InputError:
        kind = next(iter(_kinds_by_units(table)), "linear")
    missing = []
    for quantity in QUANTITIES[kind]:
        stated = mapping.columns.get(quantity.column) if mapping is not None else None
        try:
            is_there = (quantity.role == "time" and bool(table.clocks)) or (
                _source(path, table, quantity, stated, by_name=True) is not None
            )
        except InputError:
            is_there = False
        if quantity.role in REQUIRED and not is_there:
            missing.append(quantity.column)
    return tuple(missing)


def _find_unit(column: Column, quantity: Quantity) -> tuple[float, str]:
    """(factor, unit) that the file states for a column, beside the name or in it, as this package spells it.

    The factor is that of 0.001 deg, and 1 of a unit whose factor only [log] can say. `rad or m` is the quantity's own.
    """
    text = column.unit if normal_unit(column.unit) not in ("", "-") else split_name(column.header)[1]
    text = quantity.unit if quantity.unit in text.split(" or ") else text
    unit = normal_unit(text)
    if unit in ("nm", "NM") and quantity.unit == "N m":  # no torque is in nanometres
        return 1.0, "N m"
    factor, bare = split_unit(text)
    return (factor, bare) if factor > 0.0 and bare in quantity.units else (1.0, unit)


def _stated_unit(column: Column, quantity: Quantity) -> str:
    return _find_unit(column, quantity)[1]


def _usual(table: Table, role: Role) -> list[Column]:
    """Columns with usual names of a quantity; those of one of many axes where there are no others."""
    return [column for column in table.columns if is_usual(column.header, role)] or [
        column for column in table.columns if is_usual(column.header, role, numbered=True)
    ]


def _is_own(column: Column, quantity: Quantity) -> bool:
    """Return True for the log's own name of a quantity, behind the path of a group or struct or before a unit too."""
    return quantity.column in (re.split(r"[.:/]", name)[-1] for name in (column.header, split_name(column.header)[0]))


def _candidates(table: Table, quantity: Quantity, bare: LogColumn | None, *, by_name: bool) -> list[Column]:
    """Columns that are this quantity by the log's own name, or else `by_name`, a usual one with one of its units.

    `bare`: keys of [log] on it without its name; where that makes SI values, the unit need not be the file's.
    """
    own = [column for column in table.columns if column.header == quantity.column]
    own = own or [column for column in table.columns if _is_own(column, quantity)]
    if own or not by_name:
        return own
    named = _usual(table, quantity.role)
    stamps = [column for column in named if column.name in table.stamped] if quantity.role == "time" else []
    if bare is not None and (bare.unit is not None or bare.scale != 1.0):
        stated = [column for column in named if _stated_unit(column, quantity) == normal_unit(bare.unit or "")]
        return stamps or stated or [column for column in named if not _stated_unit(column, quantity)] or named
    sound = [column for column in named if _stated_unit(column, quantity) in quantity.units]
    return stamps or sound or [column for column in named if _stated_unit(column, quantity) in quantity.allowed]


def _kind(path: Path, table: Table, mapping: LogMapping | None, preferred: Kind | None) -> Kind:
    if mapping is not None and mapping.kind is not None:
        return mapping.kind
    found = _kinds(table, mapping, sure=True) or _kinds(table, mapping, sure=False)
    if len(found) == 2 and preferred is None:
        which = " or ".join(_position_line(table, kind) for kind in found)
        allowed = f"columns of one kind of axis; [log] (machine file, --log) says which: {which}"
        raise InputError(path, "columns", _shown(table), allowed)
    if not found and preferred is None:
        found = _kinds_by_units(table)
    return preferred if preferred is not None and (preferred in found or not found) else [*found, "linear"][0]


def _position_line(table: Table, kind: Kind) -> str:
    """The line of [log] that would say that a file is of this kind of axis."""
    quantity = next(q for q in QUANTITIES[kind] if q.role == "position")
    named = _candidates(table, quantity, None, by_name=True)
    return _line(quantity, named[0].name, _stated_unit(named[0], quantity)) if named else f"{quantity.column} = ..."


def _kinds_by_units(table: Table) -> list[Kind]:
    """Kinds of axis of which alone the file states units, whatever its columns are called."""
    units = {kind: {unit for q in quantities for unit in q.units} for kind, quantities in QUANTITIES.items()}
    kinds: set[Kind] = set()
    for column in table.columns:
        stated = normal_unit(column.unit) or normal_unit(split_name(column.header)[1])
        having = [kind for kind in units if stated in units[kind]]
        kinds |= set(having) if len(having) == 1 else set()
    return list(kinds) if len(kinds) == 1 else []


def _kinds(table: Table, mapping: LogMapping | None, *, sure: bool) -> list[Kind]:
    """Kinds of axis whose position, velocity or force the file has; `sure`: in a unit no other kind has."""
    stated = {} if mapping is None else mapping.columns
    return [
        kind
        for kind, quantities in QUANTITIES.items()
        if any(
            not sure or _is_own(column, quantity) or _stated_unit(column, quantity) in quantity.units
            for quantity in quantities
            if quantity.role in ("position", "force", "velocity")
            for column in _candidates(table, quantity, stated.get(quantity.column), by_name=True)
        )
    ]


def _shown(table: Table) -> str:
    names = [column.name for column in table.columns]
    shown = ", ".join(names[:SHOWN]) + (", ..." if len(names) > SHOWN else "") or "none"
    return f"{shown} (no header was found above its rows)" if dict(table.dialect).get("header") == "none" else shown


def _source(path: Path, table: Table, quantity: Quantity, mapped: LogColumn | None, *, by_name: bool) -> Source | None:
    bare = mapped if mapped is not None and mapped.is_bare else None
    named = mapped if bare is None else None
    column = None if named is None else _mapped_column(path, table, quantity, named)
    if column is None:
        found = _candidates(table, quantity, bare, by_name=by_name)
        if named is not None:  # what [log] names is not there: only a log of this package's own takes its place
            found = [candidate for candidate in found if _is_own(candidate, quantity)]
        if len(found) > 1:
            names, headers = ", ".join(candidate.name for candidate in found), {column.header for column in found}
            said = normal_unit(bare.unit) if bare is not None and bare.unit is not None else ""
            line = _line(quantity, found[0].name, said or _stated_unit(found[0], quantity))
            allowed = f"one column; [log] (machine file, --log) says which: {line}"
            raise InputError(path, f"column {quantity.column}", names if len(headers) > 1 else found[0].header, allowed)
        if not found:
            if named is None:
                return None
            raise _missing(path, table, [quantity], named)
        column, mapped = found[0], bare
    stamped = column.name in table.stamped
    if mapped is None or (bare is not None and mapped.unit is None and mapped.scale == 1.0):
        source = _own(path, quantity, column, stamped)
    else:
        source = Source(quantity, column.name, *_mapped_unit(path, quantity, mapped, column, stamped))
        if mapped.unit is None and mapped.scale == 1.0 and not stamped:
            source = replace(source, scale=_find_unit(column, quantity)[0])
    if mapped is None:
        return source
    stated = {key: getattr(mapped, key) for key in ("row", "offset", "counts_per", "wrap", "signed")}
    return replace(source, scale=mapped.scale * source.scale, **stated)


def _line(quantity: Quantity, name: str, unit: str = "") -> str:
    """The line of [log] that a user may write, with the keys a unit needs."""
    needed = {"counts_per": ...} if unit in COUNTS else {"scale": ...} if unit in quantity.recorded else {}
    return log_line(quantity.column, variable=name, unit=unit or "...", **needed)


def _missing(path: Path, table: Table, lost: Sequence[Quantity], mapped: LogColumn | None) -> InputError:
    """The refusal of a table in which columns are missing, all of them at once; `mapped`: how [log] names one."""
    names = ", ".join(quantity.column for quantity in lost)
    wanted = " and ".join(f"a column {quantity.column}" for quantity in lost)
    if mapped is not None:
        wanted = f"a column {mapped.description} (log.{names}) or {names}"
    hints = "; ".join(_hint(table, quantity) for quantity in lost)
    allowed = f"missing: {wanted}; the file has {_shown(table)}. {hints}"
    return InputError(path, f"column{'s' if len(lost) > 1 else ''} {names}", None, allowed)


def _hint(table: Table, quantity: Quantity) -> str:
    """Return the keys [log] may have on a column not found."""
    if named := _usual(table, quantity.role):
        stated = _stated_unit(named[0], quantity)
        seen = f"in {stated}, which is none of {', '.join(quantity.allowed)}" if stated else "without a unit"
        is_one = len(named) == 1
        there = f"{named[0].name} is there" if is_one else f"{', '.join(c.name for c in named[:SHOWN])} are there"
        says = "says" if is_one else "says which"
        hint = f"{there} {seen}; [log] (machine file, --log) {says}: {_line(quantity, named[0].name)}"
        return hint + (f"; or --unit {quantity.role}=UNIT" if is_one and not stated else "")
    hint = f"[log] (machine file, --log) says where it is: {_line(quantity, '...')}"
    return hint + ("; where there is none it has rate = ... [Hz], as --rate" if quantity.role == "time" else "")


def _mapped_column(path: Path, table: Table, quantity: Quantity, mapped: LogColumn) -> Column | None:
    """The column that [log] names: exactly, else by its name without the unit; None where there is none."""
    columns = table.columns
    if not mapped.name:
        if len(columns) == 1:
            return columns[0]
        allowed = f"a variable beside the row; the file has {_shown(table)}"
        raise InputError(path, f"[log] {quantity.column}", mapped.description, allowed)
    name = mapped.name
    exact = [column for column in columns if name in (column.name, column.header)]
    found = exact or [c for c in columns if plain_name(split_name(c.header)[0]) == plain_name(name)]
    if len(found) > 1 and name not in {column.name for column in found}:
        names = " or ".join(column.name for column in found)
        allowed = f'a name that the file has once; [log] says which: variable = "{names}"'
        raise InputError(path, f"[log] {quantity.column}", name, allowed)
    return found[0] if found else None


def _mapped_unit(path: Path, quantity: Quantity, mapped: LogColumn, column: Column, stamped: bool) -> tuple[str, str]:
    """(unit, reason) of a column that [log] maps: its unit, else the file's, else the SI unit."""
    if stamped:
        return quantity.unit, "time stamps"
    if mapped.unit is not None:
        return normal_unit(mapped.unit), "[log]"
    stated = _stated_unit(column, quantity)
    if mapped.scale != 1.0 or not stated:
        return quantity.unit, "[log]"
    return _check_unit(path, quantity, column, stated), "[log], its unit by the file"


def _own(path: Path, quantity: Quantity, column: Column, stamped: bool) -> Source:
    """The source of a column no [log] maps."""
    if stamped and quantity.role == "time":
        return Source(quantity, column.name, quantity.unit, "time stamps")
    if _is_own(column, quantity):
        beside = "" if column.header.endswith(quantity.column) else split_name(column.header)[1]
        beside = normal_unit(column.unit if column.unit not in ("", "-") else beside)
        if beside not in ("", "-", quantity.unit):
            line = _line(quantity, column.name, beside if beside in quantity.allowed else quantity.unit)
            allowed = f"the unit {quantity.unit}, as in its name; which holds? [log] (machine file, --log) says: {line}"
            raise InputError(path, f"column {column.name}, unit", beside, allowed)
        return Source(quantity, column.name, quantity.unit, "its name")
    factor, stated = _find_unit(column, quantity)
    because = "name and unit" if split_name(column.header)[0] else "unit alone"
    return Source(quantity, column.name, _check_unit(path, quantity, column, stated), because, scale=factor)


def _check_unit(path: Path, quantity: Quantity, column: Column, unit: str) -> str:
    """A unit the file states, where it alone makes SI values; else refused with the key for [log]."""
    if unit in quantity.units:
        return unit
    where = f"column {column.name}, unit"
    if unit in COUNTS and unit in quantity.allowed:
        per = "revolution" if quantity.unit.startswith("rad") else "metre"
        line = _line(quantity, column.name, unit)
        raise InputError(path, where, unit, f"how many make a {per}; [log] (machine file, --log) says: {line}")
    if unit in quantity.recorded:
        line = _line(quantity, column.name, unit)
        flag = "; or --force-scale" if quantity.role == "force" else ""
        allowed = f"{quantity.unit} per {unit}; [log] (machine file, --log) says: {line}{flag}"
        raise InputError(path, where, unit, allowed)
    allowed = f"one of {', '.join(quantity.allowed)}; [log] (machine file, --log) says: {_line(quantity, column.name)}"
    raise InputError(path, where, unit, allowed)
