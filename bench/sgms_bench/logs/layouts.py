"""Layouts of files of channels: tables of text, exports of scopes, long format, arrays of structs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Channel:
    """A recorded signal.

    Attributes:
        name: without its unit.
        unit: of the values; empty where none is stated.
        values: (n,), in that unit.
    """

    name: str
    unit: str
    values: Array


def comma(value: float) -> str:
    """Digits with a decimal comma."""
    return repr(value).replace(".", ",")


def digits(values: Sequence[float] | Array, mark: str = ".") -> list[str]:
    """Twelve digits of each number."""
    return [f"{value:.12g}".replace(".", mark) for value in values]


def write_text(
    path: Path,
    names: Sequence[str],
    columns: Sequence[Array],
    separator: str = ",",
    *,
    number: Callable[[float], str] = repr,
    encoding: str = "utf-8",
    end: str = "\n",
    before: Sequence[str] = (),
    units: str = "",
    after: Sequence[str] = (),
    change: Callable[[list[str]], list[str]] = list,
) -> Path:
    """Write a table: a header unless there are no names, a row of units where that is not empty, samples."""
    rows = [separator.join(row) for row in zip(*(map(number, column.tolist()) for column in columns), strict=True)]
    above = [*before, *([separator.join(names)] if names else []), *([units] if units else [])]
    path.write_bytes(end.join([*above, *change(rows), *after, ""]).encode(encoding))
    return path


ScopeChannel = tuple[str, str, Array, Array]
"""Name, unit, times [ms], values."""


def scope(
    path: Path,
    groups: Sequence[Sequence[ScopeChannel]],
    *,
    separator: str = "\t",
    mark: str = ".",
    keys: Sequence[tuple[str, Sequence[str]]] = (),
    blank: str = "",
) -> Path:
    """Write the export of a scope: the channels of a group share the times of its first; `blank` stands behind its end.

    `keys` are further rows of a key and a cell for each channel, the upper ones first.
    """
    channels = [channel for group in groups for channel in group]
    stated = [
        ("Name", [name for name, *_ in channels]),
        ("SymbolComment", [""] * len(channels)),
        ("Data-Type", ["REAL64"] * len(channels)),
        ("SampleTime[ms]", digits([float(at[1] - at[0]) for _, _, at, _ in channels], mark)),
        ("Port", ["501"] * len(channels)),
        *keys,
        ("Unit", [unit for _, unit, *_ in channels]),
        ("Unit ScaleFactor", ["1"] * len(channels)),
        ("Unit Offset", ["0"] * len(channels)),
    ]
    lines = [["Name", "project"], ["Start of export", "132959733843760000", "Monday, 2 May 2022", "15:56:24.376"]]
    lines += [["End of export", "132959733853750000", "Monday, 2 May 2022", "15:56:28.376"], [], []]
    for key, values in stated:
        cells = iter(values)
        lines.append([cell for group in groups for cell in (key, *(next(cells) for _ in group))])
    lines.append([])
    blocks = [[group[0][2], *(values for *_, values in group)] for group in groups]
    columns = [digits(column, mark) for block in blocks for column in block]
    for k in range(max(map(len, columns))):
        row = [column[k] if k < len(column) else blank for column in columns]
        while row[-1] == blank and k % 2:  # some writers leave the last separators out
            row.pop()
        lines.append(row)
    path.write_bytes("".join(separator.join(line) + "\r\n" for line in [*lines, ["EOF"]]).encode("utf-8"))
    return path


def named_values(path: Path, step_ns: float, channels: Sequence[tuple[str, Array]], mark: str = ".") -> Path:
    """Write rows of names and values below the step of time, as oscilloscopes of machine controls do."""
    cells = [[f"{name} {value} " for value in digits(values, mark)] for name, values in channels]
    lines = [f"Sampling period is {step_ns:.0f} nSec ", "", *map("".join, zip(*cells, strict=True)), ""]
    path.write_text("\n".join(lines))
    return path


def events(path: Path, rows: Sequence[Sequence[str]], header: str = "", separator: str = ",") -> Path:
    """Write a line each."""
    lines = [separator.join(row) for row in rows]
    path.write_text("\n".join([*([header] if header else []), *lines, ""]))
    return path


def long_rows(
    time_s: Array,
    channels: Sequence[tuple[str, Array]],
    order: Callable[[str, str, str], list[str]] = lambda t, n, v: [t, n, v],
    later: float = 0.0,
) -> list[list[str]]:
    """Rows of a long format: a line for each channel (name, values) at each time; each channel `later` than the last.

    `order` makes a row of time, name and value.
    """
    columns = [(name, digits(values)) for name, values in channels]
    return [
        order(f"{t + index * later:.6f}", name, values[k])
        for k, t in enumerate(time_s.tolist())
        for index, (name, values) in enumerate(columns)
    ]


def control_desk(rasters: Sequence[tuple[Array, Sequence[Channel]]]) -> dict[str, Any]:
    """X with the times [s] of each raster, Y with its channels, whose XIndex says of which raster they are."""
    x = np.zeros((1, len(rasters)), dtype=[("Name", object), ("Data", object)])
    rows: list[tuple[str, str, Array, int]] = [("Model Root/mode", "", np.ones((1, len(rasters[0][0]))), 1)]
    for k, (time_s, channels) in enumerate(rasters):
        x[0, k] = (f"raster {k}", time_s.reshape(1, -1))
        rows += [(channel.name, channel.unit, channel.values.reshape(1, -1), k + 1) for channel in channels]
    y = np.zeros((1, len(rows)), dtype=[("Name", object), ("Unit", object), ("Data", object), ("XIndex", object)])
    for k, row in enumerate(rows):
        y[0, k] = row
    return {"X": x, "Y": y, "Description": {"General": {"DateTime": "today"}}}


def simulink_scope(time_s: Array, channels: Sequence[Channel]) -> dict[str, Any]:
    """A struct with time [s] and an array of signals, as a Scope block saves it."""
    signals = np.zeros((1, len(channels)), dtype=[("values", object), ("dimensions", object), ("label", object)])
    for k, channel in enumerate(channels):
        label = f"{channel.name} [{channel.unit}]" if channel.unit else channel.name
        signals[0, k] = (channel.values.reshape(-1, 1), 1, label)
    return {"ScopeData": {"time": time_s.reshape(-1, 1), "signals": signals, "blockName": "model/Scope"}}
