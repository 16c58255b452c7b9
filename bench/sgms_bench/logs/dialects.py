"""Dialects that people's files have: a writer of a log each, and the [log] that reads it."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from sgms_bench.logs.layouts import comma, write_text
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]

COUNTS_PER_METRE = 1e8
"""Of the encoder of the simulated axis: its positions are whole counts."""
START = datetime(2026, 3, 28, 23, 59, 58, tzinfo=timezone(timedelta(hours=1)))
"""Two seconds before midnight."""
DIGITS = 1e-9
"""Relative to the range: beyond it no estimate differs where numbers took another unit on the way."""


@dataclass(frozen=True)
class Dialect:
    """How one file is written and read.

    Attributes:
        suffix: of the file's name.
        write: writes a log's columns.
        log: table [log] of the machine that reads it; empty where none is needed.
        exact: whether not one digit is lost on the way.
        library: that has to be there to write and read it.
    """

    suffix: str
    write: Callable[[Path, Log], None]
    log: Mapping[str, Any] = field(default_factory=dict)
    exact: bool = True
    library: str = ""


Format = Callable[[float], str]
Names = tuple[str, str, str]
OWN: Names = ("time_s", "position_m", "force_N")


def text(
    separator: str = ",",
    *,
    names: Names | None = OWN,
    number: Format = repr,
    encoding: str = "utf-8",
    end: str = "\n",
    before: Sequence[str] = (),
    units: str = "",
    after: Sequence[str] = (),
    change: Callable[[list[str]], list[str]] = list,
    scaled: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Callable[[Path, Log], None]:
    """Writer of a text."""

    def write(path: Path, log: Log) -> None:
        write_text(
            path,
            names or (),
            list(times(log, scaled).columns.values()),
            separator,
            number=number,
            encoding=encoding,
            end=end,
            before=before,
            units=units,
            after=after,
            change=change,
        )

    return write


def times(log: Log, factors: tuple[float, float, float]) -> Log:
    """The log in other units."""
    if factors == (1.0, 1.0, 1.0):
        return log
    time, position, force = factors
    return Log(log.time_s * time, log.position_m * position, log.force_N * force, log.rate)


def write_stamps(form: Callable[[datetime], str], separator: str, number: Format = repr) -> Callable[[Path, Log], None]:
    """Writer of a text whose time is a time stamp."""

    def write(path: Path, log: Log) -> None:
        lines = (
            ["Time", "Position [m]", "Force [N]"],
            *(
                (form(START + timedelta(microseconds=round(1e6 * t))), number(x), number(f))
                for t, x, f in zip(log.time_s.tolist(), log.position_m.tolist(), log.force_N.tolist(), strict=True)
            ),
        )
        path.write_text("\n".join(separator.join(line) for line in lines), encoding="utf-8")

    return write


def group_digits(value: float) -> str:
    """Whole microseconds in groups of thousands by points, everything else with a decimal comma."""
    return f"{int(value):,}".replace(",", ".") if value == int(value) and abs(value) >= 1e3 else comma(value)


def comment_rows(rows: list[str]) -> list[str]:
    """A comment after every hundredth row, a blank line after it."""
    return [line for k, row in enumerate(rows) for line in ([row, "# checked", ""] if k % 100 == 99 else [row])]


def write_counts(path: Path, log: Log) -> None:
    """Counts of 16 bits."""
    counts = np.round(log.position_m * COUNTS_PER_METRE).astype(np.int64)
    values = zip(log.time_s.tolist(), counts.tolist(), log.force_N.tolist(), strict=True)
    lines = [f"{t!r},{c % 65536},{f!r}" for t, c, f in values]
    path.write_text("\n".join(["time_s,encoder [counts],force_N", *lines]))


def matrix(log: Log) -> Array:
    """A row a signal."""
    return np.stack(list(log.columns.values()))


def npy_structured(path: Path, log: Log) -> None:
    """A structured array."""
    table = np.empty(len(log), dtype=[(name, np.float64) for name in log.columns])
    for name, column in log.columns.items():
        table[name] = column
    np.save(path, table)


def mat_struct(path: Path, log: Log) -> None:
    """A struct with a matrix."""
    inner = {"t": log.time_s, "signals": np.stack([log.force_N, 1e3 * log.position_m]), "note": "text"}
    savemat(path, {"rec": {"axis": inner, "gain": 2.0}}, do_compression=True)


def hdf5(path: Path, log: Log) -> None:
    """Data sets of a group."""
    h5py = import_module("h5py")

    with h5py.File(path, "w") as file:
        for name, column in log.columns.items():
            file.create_dataset(f"run/axis/{name}", data=column)
        file["run/axis/position_m"].attrs["unit"] = "m"


def mat_v73(path: Path, log: Log) -> None:
    """A matrix in HDF5 behind the mark of MATLAB 7.3."""
    h5py = import_module("h5py")

    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("rec/all", data=matrix(log).T)  # MATLAB writes a 3 x n matrix so
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def parquet(path: Path, log: Log) -> None:
    """Time stamps, and columns with their units."""
    pyarrow, tables = import_module("pyarrow"), import_module("pyarrow.parquet")

    fields = [
        pyarrow.field("t", pyarrow.timestamp("us")),
        pyarrow.field("pos", pyarrow.float64(), metadata={"unit": "m"}),
        pyarrow.field("force", pyarrow.float64(), metadata={"unit": "N"}),
    ]
    stamps = np.datetime64("2026-03-28") + np.round(1e6 * log.time_s).astype("timedelta64[us]")
    columns = [pyarrow.array(stamps), pyarrow.array(log.position_m), pyarrow.array(log.force_N)]
    tables.write_table(pyarrow.table(columns, schema=pyarrow.schema(fields)), path)


def feather(path: Path, log: Log) -> None:
    """Columns that say their units in their names."""
    pyarrow, tables = import_module("pyarrow"), import_module("pyarrow.feather")

    tables.write_feather(pyarrow.table({name: pyarrow.array(values) for name, values in log.columns.items()}), path)


def samples(log: Log) -> list[dict[str, Any]]:
    """An object for each sample, as messages of ROS are."""
    values = zip(log.time_s.tolist(), log.position_m.tolist(), log.force_N.tolist(), strict=True)
    return [{"header": {"time_s": t}, "state": {"position [m]": [x], "force [N]": [f]}} for t, x, f in values]


def json_lines(path: Path, log: Log) -> None:
    """A line for each sample."""
    path.write_text("\n".join(map(json.dumps, samples(log))))


def json_list(path: Path, log: Log) -> None:
    """An element for each sample."""
    path.write_text(json.dumps(samples(log), indent=1))


LABVIEW = (
    "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tOne\n***End_of_Header***\t\n"
    "\nChannels\t2\t\t\nY_Unit_Label\tm\tN\t\nX_Dimension\tTime\tTime\t\nDelta_X\t0,001\t0,001\t\n"
    "***End_of_Header***\t\t\t\nX_Value\tPosition\tForce\tComment"
).split("\n")
"""Above the samples of a measurement file."""


def mdf4(path: Path, log: Log) -> None:
    """Two channels of one group."""
    asammdf = import_module("asammdf")

    signals = [
        asammdf.Signal(samples=log.position_m, timestamps=log.time_s, name="ActPos", unit="m"),
        asammdf.Signal(samples=log.force_N, timestamps=log.time_s, name="ActForce", unit="N"),
    ]
    with asammdf.MDF() as file:
        file.append(signals)
        file.save(path, overwrite=True)


MILLI = (1e3, 1e3, 1.0)
PREAMBLE = (
    "Drive recorder V2.1",
    "Axis: X; operator: A, B",
    "",
    "kp;160.18;1/s",
    "kv;243.45;V s/m",
    "Channel;1;2;3",
    "",
)
SUMMARY = ("", "Mean;0.5;0.001;0.2", "Max;1;0.002;5", "End of file")

DIALECTS: dict[str, Dialect] = {
    "comma": Dialect(".csv", text(",")),
    "semicolon, decimal comma": Dialect(".csv", text(";", number=comma)),
    "tab": Dialect(".tsv", text("\t")),
    "tab, decimal comma": Dialect(".txt", text("\t", number=comma)),
    "bar": Dialect(".txt", text("|")),
    "spaces, aligned": Dialect(".dat", text(" ", number=lambda value: f"{value!r:>26}")),
    "spaces, names of two words": Dialect(
        ".asc", text("  ", names=("Time [s]", "Actual position [m]", "Drive force (N)"))
    ),
    "quoted decimal commas between commas": Dialect(".csv", text(",", number=lambda value: f'"{comma(value)}"')),
    "Windows lines, mark of UTF-8": Dialect(".csv", text(",", end="\r\n", encoding="utf-8-sig")),
    "UTF-16": Dialect(".csv", text(";", number=comma, encoding="utf-16", end="\r\n")),
    "UTF-16 big end first, no mark": Dialect(".txt", text("\t", encoding="utf-16-be")),
    "UTF-16 little end first, no mark": Dialect(".txt", text("\t", encoding="utf-16-le")),
    "Latin-1, micrometres": Dialect(
        ".csv", text(";", names=("t [s]", "x [µm]", "F [N]"), scaled=(1.0, 1e6, 1.0), encoding="latin-1"), exact=False
    ),
    "unit row": Dialect(
        ".csv", text(",", names=("Time", "Position", "Force"), units="ms,mm,N", scaled=MILLI), exact=False
    ),
    "units behind a slash": Dialect(".csv", text(",", names=("t/ms", "x/mm", "F/N"), scaled=MILLI), exact=False),
    "units behind a line": Dialect(
        ".csv", text(",", names=("time_us", "pos_mm", "force_kN"), scaled=(1e6, 1e3, 1e-3)), exact=False
    ),
    "inches by [log]": Dialect(
        ".csv",
        text(",", names=("t", "Travel", "u"), scaled=(1.0, 1 / 0.0254, 1.0)),
        {"time_s": "t", "position_m": {"variable": "Travel", "unit": "in"}, "force_N": "u"},
        exact=False,
    ),
    "current in ampere by [log]": Dialect(
        ".csv",
        text(",", names=("t [s]", "pos [m]", "Iq [A]"), scaled=(1.0, 1.0, 0.125)),
        {"force_N": {"variable": "Iq [A]", "unit": "A", "scale": 8.0}},
    ),
    "counts of 16 bits by [log]": Dialect(
        ".csv",
        write_counts,
        {"position_m": {"variable": "encoder", "unit": "counts", "counts_per": COUNTS_PER_METRE, "wrap": 65536.0}},
        exact=False,
    ),
    "preamble": Dialect(".csv", text(";", before=(*PREAMBLE, *("# comment",) * 40))),
    "commented header": Dialect(".csv", text(",", names=("# time_s", "position_m", "force_N"))),
    "comments between rows": Dialect(".csv", text(",", change=comment_rows)),
    "summary": Dialect(".csv", text(";", after=SUMMARY)),
    "separator behind each row": Dialect(".csv", text(";", change=lambda rows: [f"{row};" for row in rows])),
    "groups of thousands": Dialect(
        ".csv", text(";", names=("t [us]", "x [m]", "F [N]"), number=group_digits, scaled=(1e6, 1.0, 1.0)), exact=False
    ),
    "typeset minus, cells in brackets": Dialect(
        ".csv", text(",", number=lambda value: f"[{value!r}]".replace("-", "\N{MINUS SIGN}"))
    ),
    "exponents with D": Dialect(".csv", text(",", number=lambda value: f"{value:.17e}".replace("e", "D"))),
    "no header": Dialect(
        ".csv", text(",", names=None), {"time_s": "column 1", "position_m": "column 2", "force_N": "column 3"}
    ),
    "names twice": Dialect(
        ".csv",
        text(",", names=("t [s]", "value [m]", "value [m]")),
        {"position_m": "value [m] (1)", "force_N": {"variable": "value [m] (2)", "unit": "N"}},
    ),
    "ISO time with a zone": Dialect(".csv", write_stamps(lambda t: t.isoformat(timespec="microseconds"), ",")),
    "ISO time": Dialect(
        ".csv", write_stamps(lambda t: t.replace(tzinfo=None).isoformat(" ", "milliseconds"), ";", comma)
    ),
    "date with the day first": Dialect(
        ".csv", write_stamps(lambda t: f"{t:%d.%m.%Y %H:%M:%S},{t.microsecond // 1000:03d}", ";", comma)
    ),
    "date with the month first": Dialect(
        ".csv", write_stamps(lambda t: f"{t:%m/%d/%Y %I:%M:%S}.{t.microsecond // 1000:03d} {t:%p}", "\t")
    ),
    "time of day, over midnight": Dialect(".csv", write_stamps(lambda t: f"{t:%H:%M:%S.%f}", ",")),
    "NPZ": Dialect(".npz", lambda path, log: np.savez(path, **log.columns)),  # type: ignore[arg-type]
    "NPY, structured": Dialect(".npy", npy_structured),
    "NPY, a row a signal": Dialect(
        ".npy",
        lambda path, log: np.save(path, matrix(log)),
        {"time_s": {"row": 1}, "position_m": {"row": 2}, "force_N": {"row": 3}},
    ),
    "NPY, a column a signal": Dialect(
        ".npy",
        lambda path, log: np.save(path, matrix(log).T),
        {"time_s": {"row": 1}, "position_m": {"row": 2}, "force_N": {"row": 3}},
    ),
    "MAT, struct with a matrix": Dialect(
        ".mat",
        mat_struct,
        {
            "time_s": {"member": "rec.axis.t"},
            "position_m": {"variable": "rec", "member": "axis.signals", "row": 2, "unit": "mm"},
            "force_N": {"member": "rec.axis.signals", "row": 1},
        },
        exact=False,
    ),
    "HDF5": Dialect(".h5", hdf5, {name: {"member": f"run.axis.{name}"} for name in OWN}, library="h5py"),
    "MAT v7.3": Dialect(
        ".mat", mat_v73, {name: {"member": "rec.all", "row": k + 1} for k, name in enumerate(OWN)}, library="h5py"
    ),
    "JSON lines": Dialect(".jsonl", json_lines),
    "JSON, a list": Dialect(".json", json_list),
    "LabVIEW": Dialect(".lvm", text("\t", names=None, number=comma, before=LABVIEW)),
    "Feather": Dialect(".feather", feather, library="pyarrow"),
    "Parquet": Dialect(".parquet", parquet, library="pyarrow"),
    "MDF 4": Dialect(
        ".mf4", mdf4, {"time_s": "time", "position_m": "ActPos", "force_N": "ActForce"}, library="asammdf"
    ),
}
