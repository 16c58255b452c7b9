"""Layouts of files of channels: tables of text, exports of scopes, long format, arrays of structs."""

from __future__ import annotations

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


def scope(
    path: Path,
    channels: Sequence[tuple[str, str, Array, Array]],
    *,
    paired: bool,
    separator: str = "\t",
    mark: str = ".",
    keys: Sequence[tuple[str, Sequence[str]]] = (),
) -> Path:
    """Write the export of a scope; channels are (name, unit, times [ms], values)."""
    steps = digits([float(at[1] - at[0]) for _, _, at, _ in channels], mark)
    stated = [
        ("Name", [name for name, *_ in channels]),
        ("SymbolComment", [""] * len(channels)),
        ("Data-Type", ["REAL64"] * len(channels)),
        ("SampleTime[ms]", steps),
        ("Port", ["501"] * len(channels)),
        *keys,
        ("Unit", [unit for _, unit, *_ in channels]),
    ]
    lines = [["Name", "project"], ["Start of export", "132959733843760000", "Monday, 2 May 2022", "15:56:24.376"]]
    lines += [["End of export", "132959733853750000", "Monday, 2 May 2022", "15:56:28.376"], [], []]
    for key, values in stated:
        lines.append([part for value in values for part in (key, value)] if paired else [key, *values])
    lines.append([])
    columns = [column for _, _, at, values in channels for column in (digits(at, mark), digits(values, mark))]
    if not paired:
        columns = [columns[0], *columns[1::2]]
    for k in range(max(map(len, columns))):
        row = [column[k] if k < len(column) else "" for column in columns]
        while len(columns) > 2 and not row[-1] and k % 2:  # some writers leave the last separators out
            row.pop()
        lines.append(row)
    path.write_bytes("".join(separator.join(line) + "\r\n" for line in lines).encode("utf-8"))
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
