"""Key rows: a row of a key and cells for each property of the columns stands above the samples, in place of a header.

    Name            ActPos  ActVel  Name            Force         or one key for all:  Name            ActPos  Force
    SampleTime[ms]  0.5     0.5     SampleTime[ms]  1                                  SampleTime[ms]  0.5     0.5
    Unit            mm      mm/s    Unit            N                                  Unit            mm      N
    0               1.25    2.5     0               3.5                                0               1.25    3.5

A key begins a group of columns, and in the samples it has the times of the group below it. Where nothing stands there,
or in every row the name of the column behind it, time is counted in the steps a line above the samples states:

    Sampling period is 1000000 nSec
    position +1.25 torque +3.5

In LabVIEW's measurement files (.lvm) X_Value is the key of the names, and the lowest of the rows.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from sgms_mhe.logfiles.decimals import Mark, is_missing, is_number, value_of
from sgms_mhe.machine import BY_COLUMN, normal_unit

_NAMES: Final = ("channelname", "signalname", "xvalue", "name", "channel", "signal")
_UNITS: Final = ("unit", "units", "channelunit", "yunitlabel", "einheit")
_SCALES: Final = ("scalefactor",)
_OFFSETS: Final = ("offset",)
_STEP: Final = re.compile(r"(?:sampl(?:e|ing)[\s_]?(?:time|period|interval)|(interval|delta_x))\b", re.IGNORECASE)
"""Beginning of a line that states the step of time; in seconds where one of the second kind states no unit."""
_NO_NAME: Final = ("", "Comment")


@dataclass(frozen=True)
class Header:
    """Properties of the columns, as key rows or a line of names above the samples have them.

    Attributes:
        line: that the names stand in; 0 where there is none.
        names: of the columns; `column 1`, ... where there are none.
        units: as many; empty where there are none.
        clocks: index of the column of times of each other column, where there are several groups.
        scales: (factor, offset) that a channel states for its values, by the index of its column.
        steps: by which time is counted, by the index of each column of times that holds none.
    """

    line: int
    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    clocks: Mapping[int, int] = field(default_factory=dict)
    scales: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    steps: Mapping[int, float] = field(default_factory=dict)


def find_key_rows(
    above: Sequence[tuple[int, Sequence[str]]], samples: Iterable[tuple[int, Sequence[str]]], decimal: Mark
) -> Header | None:
    """Understand the rows above the samples; None where they are no key rows.

    Args:
        above: (line, fields), the nearest to the samples first.
        samples: the same of the samples.
        decimal: mark of their numbers.
    """
    others = iter(samples)
    start, first = next(others)
    keyed: dict[str, tuple[int, Sequence[str]]] = {}
    for line, fields in above:
        keyed.setdefault(re.sub(r"[\s_\-:]|[\[(].*", "", fields[0]).casefold(), (line, fields))

    def row(keys: Sequence[str]) -> tuple[int, Sequence[str]]:
        return next((keyed[key] for key in keys if key in keyed), (0, ()))

    named = [keyed[key] for key in _NAMES if key in keyed]
    # Where rows end in a separator, or in a comment that LabVIEW leaves out, names are one more than values.
    cut = ((k, fields[:-1] if len(fields) > len(first) and fields[-1] in _NO_NAME else fields) for k, fields in named)
    line, names = next((found for found in cut if len(found[1]) == len(first) > 2 and all(found[1])), (0, ()))
    groups = [k for k, name in enumerate(names) if name == names[0]]
    # One key for all is the name of a first column as well: there the step of time has to be a key too.
    least = len(first) if len(groups) == 1 else 0
    step, unit = _find_step([fields for _, fields in above if len(fields) >= least], decimal)
    if dimensions := {*row(("xdimension",))[1][1:]} - {""}:  # LabVIEW's
        step, unit = (step, "s") if dimensions == {"Time"} else (None, "")
    if not names and (not above or len(above[0][1]) != len(first)) and _is_named(first, others):
        groups = counted = [*range(0, len(first) - 1, 2)]
        line, names = start, [f"column {k + 1}" if k in groups else first[k - 1] for k in range(len(first))]
    elif names and (unit or len(groups) > 1):
        counted = [k for k in groups if is_missing(first[k])]
    else:
        return None
    timed = groups if step is not None else [k for k in groups if k not in counted]

    def cell(keys: Sequence[str], index: int) -> str:
        return "".join(row(keys)[1][index : index + 1])

    def number(keys: Sequence[str], index: int, default: float) -> float:
        return value_of(cell(keys, index), decimal) if is_number(cell(keys, index)) else default

    values = [k for k in range(len(first)) if k not in groups]
    scales = {k: (number(_SCALES, k, 1.0), number(_OFFSETS, k, 0.0)) for k in values}
    return Header(
        line,
        tuple("Time" if k in timed else name for k, name in enumerate(names)),
        tuple(unit if k in groups else re.sub(r"\s*\(.*", "", cell(_UNITS, k)) for k in range(len(first))),
        {k: max(g for g in groups if g < k) for k in values} if len(groups) > 1 and timed == groups else {},
        {k: scale for k, scale in scales.items() if scale != (1.0, 0.0)},
        {} if step is None else dict.fromkeys(counted, step),
    )


def _find_step(rows: Iterable[Sequence[str]], decimal: Mark) -> tuple[float | None, str]:
    """(step of time, its unit) that a row states; no step where it states several, no unit where there is no row."""
    for fields in rows:
        text = " ".join(fields)
        if (found := _STEP.match(text)) is None:
            continue
        steps = {value_of(word, decimal) for word in text.split() if is_number(word)}
        units = (normal_unit(word.casefold()) for word in re.findall(r"[^\W\d]+", text))
        unit = next((unit for unit in units if unit in BY_COLUMN["time_s"].units), "s" if found[1] else "")
        if unit and steps:
            return (steps.pop() if len(steps) == 1 else None), unit
    return None, ""


def _is_named(first: Sequence[str], others: Iterable[tuple[int, Sequence[str]]]) -> bool:
    """Return True if each value has its name before it, in every row."""
    words, values = first[::2], first[1::2]
    return (
        not any(is_number(word) or is_missing(word) for word in words[: len(values)])
        and all(map(is_number, values))
        and all(fields[::2] == words for _, fields in others)
    )
