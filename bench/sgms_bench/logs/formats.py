"""Formats of recorders: a writer each of any channels, the first of which may be time."""

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from scipy.io import savemat

from sgms_bench.logs.dialects import PREAMBLE, START, SUMMARY, comment_rows
from sgms_bench.logs.layouts import (
    Channel,
    comma,
    control_desk,
    digits,
    events,
    long_rows,
    named_values,
    scope,
    simulink_scope,
)
from sgms_bench.logs.layouts import write_text as write_table

Channels = Sequence[Channel]
Style = Literal["brackets", "parentheses", "slash", "underscore"]
STYLES: Final[Mapping[Style, str]] = {
    "brackets": "{} [{}]",
    "parentheses": "{} ({})",
    "slash": "{}/{}",
    "underscore": "{}_{}",
}
"""How a name states its unit."""


@dataclass(frozen=True)
class Format:
    """One kind of file.

    Attributes:
        suffix: of the file's name.
        write: writes channels, whose names state their units already unless the format has a place for them.
        has_units: whether it has.
        clock: "any": of the recorder's unit; "s" or "ms": the format's; "stamps": no number.
        is_free: whether channels may be left out, doubled, or have other lengths and rows.
        library: that has to be there to write and read it.
    """

    suffix: str
    write: Callable[[Path, Channels], object]
    has_units: bool = False
    clock: Literal["any", "s", "ms", "stamps"] = "any"
    is_free: bool = True
    library: str = ""

    @property
    def is_there(self) -> bool:
        """Return True if its library is."""
        return not self.library or importlib.util.find_spec(self.library) is not None


def name_channel(channel: Channel, style: Style) -> str:
    """Name with the unit in it."""
    if not channel.unit:
        return channel.name
    unit = channel.unit.replace("/", "_") if style == "underscore" else channel.unit
    return STYLES[style].format(channel.name, unit)


def _text(separator: str, *, unit_row: bool = False, **how: Any) -> Callable[[Path, Channels], object]:
    def write(path: Path, channels: Channels) -> object:
        units = separator.join(channel.unit for channel in channels) if unit_row else ""
        names = [channel.name for channel in channels]
        return write_table(path, names, [channel.values for channel in channels], separator, units=units, **how)

    return write


def _stamps(
    form: Callable[[datetime], str], separator: str, number: Callable[[float], str] = repr
) -> Callable[[Path, Channels], object]:
    """Writer of a table whose first channel [s] is a time stamp."""

    def write(path: Path, channels: Channels) -> object:
        clock, *others = channels
        lines = [[clock.name, *(channel.name for channel in others)]]
        for k, t in enumerate(clock.values.tolist()):
            stamp = form(START + timedelta(microseconds=round(1e6 * t)))
            lines.append([stamp, *(number(float(channel.values[k])) for channel in others)])
        return path.write_text("\n".join(separator.join(line) for line in lines), encoding="utf-8")

    return write


def _arrays(channels: Channels) -> dict[str, Any]:
    return {channel.name: channel.values for channel in channels}


def _identifier(channel: Channel) -> str:
    name = "".join(letter if letter.isalnum() else "_" for letter in channel.name).strip("_")
    return f"{name}_{channel.unit.replace('/', '_')}" if channel.unit else name


def _structured(path: Path, channels: Channels) -> None:
    names = [_identifier(channel) for channel in channels]
    table = np.empty(len(channels[0].values), dtype=[(name, np.float64) for name in names])
    for name, channel in zip(names, channels, strict=True):
        table[name] = channel.values
    np.save(path, table)


def _mat(path: Path, channels: Channels) -> None:
    savemat(path, {_identifier(channel): channel.values for channel in channels}, do_compression=True)


def _hdf5(path: Path, channels: Channels) -> None:
    h5py = import_module("h5py")

    with h5py.File(path, "w") as file:
        for channel in channels:
            data = file.create_dataset(f"run/{channel.name.replace('/', ' ')}", data=channel.values)
            if channel.unit:
                data.attrs["unit"] = channel.unit


def _mat_v73(path: Path, channels: Channels) -> None:
    h5py = import_module("h5py")

    with h5py.File(path, "w", userblock_size=512) as file:
        for channel in channels:
            file.create_dataset(_identifier(channel), data=channel.values.reshape(1, -1))
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def _parquet(path: Path, channels: Channels) -> None:
    pyarrow, tables = import_module("pyarrow"), import_module("pyarrow.parquet")

    fields = [pyarrow.field(c.name, pyarrow.float64(), metadata={"unit": c.unit} if c.unit else None) for c in channels]
    columns = [pyarrow.array(channel.values) for channel in channels]
    tables.write_table(pyarrow.table(columns, schema=pyarrow.schema(fields)), path)


def _mdf(path: Path, channels: Channels) -> None:
    asammdf = import_module("asammdf")

    clock, *others = channels
    signals = [asammdf.Signal(samples=c.values, timestamps=clock.values, name=c.name, unit=c.unit) for c in others]
    with asammdf.MDF() as file:
        file.append(signals)
        file.save(path, overwrite=True)


def _scope(separator: str, mark: str, *sizes: int) -> Callable[[Path, Channels], object]:
    """Writer of a scope's export; `sizes` of the first groups, the last has the rest."""

    def write(path: Path, channels: Channels) -> object:
        clock, *others = channels
        shown = [(channel.name, channel.unit, clock.values, channel.values) for channel in others]
        ends = [0, *sizes, len(shown)]
        groups = [group for k, end in enumerate(ends[1:]) if (group := shown[ends[k] : end])]
        return scope(path, groups, separator=separator, mark=mark)

    return write


def _pins(path: Path, channels: Channels) -> object:
    clock, *others = channels
    stated = [(name_channel(channel, "brackets").replace(" ", "_"), channel.values) for channel in others]
    return named_values(path, 1e9 * float(clock.values[1] - clock.values[0]), stated, ",")


def _unit_of_time(path: Path, channels: Channels) -> object:
    """A table whose first column has its unit for a name."""
    names = [channels[0].unit, *(name_channel(channel, "brackets") for channel in channels[1:])]
    return write_table(path, names, [channel.values for channel in channels])


def _long(path: Path, channels: Channels) -> object:
    clock, *others = channels
    stated = [(name_channel(channel, "brackets"), channel.values) for channel in others]
    return events(path, long_rows(clock.values, stated), "t [s],signal,value")


def _desk(path: Path, channels: Channels) -> None:
    clock, *others = channels
    savemat(path, {"rec": control_desk([(clock.values, others)])})


def _simulink(path: Path, channels: Channels) -> None:
    clock, *others = channels
    savemat(path, simulink_scope(clock.values, others))


FORMATS: Final[Mapping[str, Format]] = {
    "comma": Format(".csv", _text(",")),
    "semicolon, decimal comma": Format(".csv", _text(";", number=comma)),
    "tab": Format(".tsv", _text("\t")),
    "tab, decimal comma, twelve digits": Format(".txt", _text("\t", number=lambda v: digits([v], ",")[0])),
    "bar": Format(".txt", _text("|")),
    "quoted decimal commas": Format(".csv", _text(",", number=lambda v: f'"{comma(v)}"')),
    "Windows lines, mark of UTF-8": Format(".csv", _text(",", end="\r\n", encoding="utf-8-sig")),
    "UTF-16": Format(".csv", _text(";", number=comma, encoding="utf-16", end="\r\n")),
    "UTF-16, no mark": Format(".txt", _text("\t", encoding="utf-16-le")),
    "row of units": Format(".csv", _text(",", unit_row=True), has_units=True),
    "row of units, semicolons": Format(".csv", _text(";", unit_row=True, number=comma), has_units=True),
    "preamble": Format(".csv", _text(";", before=PREAMBLE)),
    "summary": Format(".csv", _text(";", after=SUMMARY)),
    "comments between rows": Format(".csv", _text(",", change=comment_rows)),
    "separator behind each row": Format(".csv", _text(";", change=lambda rows: [f"{row};" for row in rows])),
    "exponents with D": Format(".csv", _text(",", number=lambda v: f"{v:.17e}".replace("e", "D"))),
    "ISO time": Format(".csv", _stamps(lambda t: t.isoformat(timespec="microseconds"), ","), clock="stamps"),
    "date, decimal comma": Format(
        ".csv", _stamps(lambda t: f"{t:%d.%m.%Y %H:%M:%S},{t.microsecond:06d}", ";", comma), clock="stamps"
    ),
    "time of day": Format(".csv", _stamps(lambda t: f"{t:%H:%M:%S.%f}", "\t"), clock="stamps"),
    "NPZ": Format(".npz", lambda path, channels: np.savez(path, **_arrays(channels))),
    "NPY, structured": Format(".npy", _structured, has_units=True),
    "MAT": Format(".mat", _mat, has_units=True),
    "MAT v7.3": Format(".mat", _mat_v73, has_units=True, library="h5py"),
    "HDF5": Format(".h5", _hdf5, has_units=True, library="h5py"),
    "Parquet": Format(".parquet", _parquet, has_units=True, library="pyarrow"),
    "MDF 4": Format(".mf4", _mdf, has_units=True, clock="s", is_free=False, library="asammdf"),
    "scope, pairs": Format(".csv", _scope("\t", ",", 1, 2, 3), has_units=True, clock="ms", is_free=False),
    "scope, one time": Format(".csv", _scope(";", "."), has_units=True, clock="ms", is_free=False),
    "scope, groups": Format(".csv", _scope(",", ".", 1), has_units=True, clock="ms", is_free=False),
    "names in rows": Format(".log", _pins, has_units=True, clock="s", is_free=False),
    "unit of time for a name": Format(".csv", _unit_of_time, has_units=True, clock="ms"),
    "a suffix that says nothing": Format(".t", _text("\t")),
    "long format": Format(".csv", _long, has_units=True, clock="s", is_free=False),
    "MAT, ControlDesk": Format(".mat", _desk, has_units=True, clock="s", is_free=False),
    "MAT, Simulink Scope": Format(".mat", _simulink, has_units=True, clock="s", is_free=False),
}
