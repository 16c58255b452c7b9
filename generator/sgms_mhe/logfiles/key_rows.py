"""Scope exports: rows of a key and a value for each channel stand above the samples, in place of a header.

    Name            ActPos  Name            Force           or one key for all:   Name            ActPos  Force
    SampleTime[ms]  0.5     SampleTime[ms]  1                                     SampleTime[ms]  0.5     0.5
    Unit            mm      Unit            N                                     Unit            mm      N
    0               1.25    0               3.5                                   0               1.25    3.5

Every channel then has a column of times before its own, or the first column is the time of all.

LabVIEW's measurement files (.lvm) have a header, and such rows above it:

    Y_Unit_Label    mm      N
    X_Dimension     Time    Time
    ***End_of_Header***
    X_Value         ActPos  Force   Comment
    0.0005          1.25    3.5
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sgms_mhe.logfiles.decimals import Mark, is_number, value_of

_NAME, _UNIT, _STEP, _SCALE, _OFFSET = "name", "unit", "sampletime", "scalefactor", "offset"
_X_VALUE, _Y_UNIT, _X_DIMENSION, _END, _COMMENT = (
    "X_Value",
    "Y_Unit_Label",
    "X_Dimension",
    "***End_of_Header***",
    "Comment",
)


@dataclass(frozen=True)
class KeyRows:
    """Keys of the columns.

    Attributes:
        line: of the names.
        names, units: of every column, its clocks among them.
        clocks: index of the column of times of each other column, where channels have their own.
        scales: (factor, offset) that a channel states for its values, by the index of its column.
    """

    line: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    clocks: Mapping[int, int]
    scales: Mapping[int, tuple[float, float]]


def find_key_rows(rows: Sequence[tuple[int, Sequence[str]]], count: int, decimal: Mark) -> KeyRows | None:
    """Understand the rows above the samples, the nearest first; None where they are no key rows.

    Args:
        rows: (line, fields).
        count: of the fields that samples have.
        decimal: mark of their numbers.
    """
    if rows and rows[0][1][0] == _X_VALUE:
        return _understand_lvm(rows, count)
    keyed: dict[str, tuple[int, Sequence[str]]] = {}
    labels: dict[str, str] = {}
    for line, fields in rows:
        label = fields[0]
        if len(fields) != count or not label or is_number(label):
            break
        key = re.sub(r"[\s_\-]|\[.*", "", label).casefold()
        keyed.setdefault(key, (line, fields))
        labels.setdefault(key, label)
        if key == _NAME:  # the uppermost; what stands above is of the file
            break
    paired = count % 2 == 0 and all(set(fields[::2]) <= {fields[0], ""} for _, fields in keyed.values())
    if _NAME not in keyed or not (_STEP in keyed or (paired and count > 2)):  # a header, and rows of units and types
        return None
    values = range(1, count, 2) if paired else range(1, count)
    bracket = re.search(r"\[(.*)\]", labels.get(_STEP, ""))
    time = bracket[1] if bracket else ""

    def stated(key: str, index: int) -> str:
        return keyed[key][1][index] if key in keyed else ""

    def number(key: str, index: int, default: float) -> float:
        return value_of(stated(key, index), decimal) if is_number(stated(key, index)) else default

    names = tuple(stated(_NAME, k) if k in values else "Time" for k in range(count))
    units = tuple(re.sub(r"\s*\(.*", "", stated(_UNIT, k)) if k in values else time for k in range(count))
    scales = {k: (number(_SCALE, k, 1.0), number(_OFFSET, k, 0.0)) for k in values}
    return KeyRows(
        keyed[_NAME][0],
        names,
        units,
        {k: k - 1 for k in values} if paired else {},
        {k: scale for k, scale in scales.items() if scale != (1.0, 0.0)},
    )


def _understand_lvm(rows: Sequence[tuple[int, Sequence[str]]], count: int) -> KeyRows | None:
    """Keys of LabVIEW's columns, a header the first of the rows; None where it has not as many names as samples."""
    (line, header), *above = rows
    names = header[:-1] if len(header) == count + 1 and header[-1] == _COMMENT else header
    if len(names) != count:
        return None
    keyed: dict[str, Sequence[str]] = {}
    for _, fields in above[1:] if above and above[0][1][0] == _END else above:
        if fields[0] == _END:
            break
        keyed[fields[0]] = fields

    units = keyed.get(_Y_UNIT, ())
    is_timed = not any(list(fields[:2]) == ["X_Columns", "No"] for _, fields in above)
    clocks = [k for k, name in enumerate(names) if name == _X_VALUE and is_timed]
    time = "s" if "Time" in keyed.get(_X_DIMENSION, ()) else ""
    return KeyRows(
        line,
        tuple("Time" if k in clocks else name for k, name in enumerate(names)),
        tuple(time if k in clocks else "".join(units[k : k + 1]) for k in range(count)),
        {k: k - 1 for k in range(count) if k - 1 in clocks} if len(clocks) > 1 else {},
        {},
    )
