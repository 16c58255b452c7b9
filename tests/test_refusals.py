"""Refusals of logs: each with a log that makes it for that reason, and one that nearly makes it and is read."""

import gzip
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sgms_mhe.api.inputs import read_log
from sgms_mhe.configuration import make_machine
from sgms_mhe.identification import Wanted, identify
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

pytestmark = pytest.mark.core
RATE, ROWS = 1000.0, 600
HEADER = "time_s,position_m,force_N"


def silent(_: str) -> None:
    return None


def trace(rows: int = ROWS) -> Log:
    """A mass of 2 kg with 3 N of friction under two sines."""
    t = np.arange(rows) / RATE
    x = 0.05 * np.sin(2 * np.pi * 1.1 * t) + 0.01 * np.sin(2 * np.pi * 4.3 * t)
    v = np.gradient(x, t)
    force = 2.0 * np.gradient(v, t) + 3.0 * np.tanh(v / 1e-3) + 0.05 * np.random.default_rng(1).standard_normal(rows)
    return Log(t, x, force, RATE, source="log")


def text(
    header: str | Sequence[str] = HEADER,
    *,
    log: Log | None = None,
    columns: Mapping[int, np.ndarray[Any, np.dtype[np.float64]]] | None = None,
    change: Callable[[list[str]], list[str]] = list,
    separator: str = ",",
) -> str:
    """A log as text; `columns` in place of its own or behind them."""
    log = trace() if log is None else log
    values = {0: log.time_s, 1: log.position_m, 2: log.force_N} | dict(columns or {})
    rows = [separator.join(f"{x:.9g}" for x in row) for row in np.column_stack([values[k] for k in sorted(values)])]
    above = [header] if isinstance(header, str) else list(header)
    return "\n".join([*above, *change(rows)]) + "\n"


def row(index: int, new: str) -> Callable[[list[str]], list[str]]:
    """Put another row in the place of one."""
    return lambda rows: [*rows[:index], new, *rows[index + 1 :]]


def part(index: int, place: int, new: str) -> Callable[[list[str]], list[str]]:
    """Put another field in the place of one."""

    def change(rows: list[str]) -> list[str]:
        fields = rows[index].split(",")
        fields[place] = new
        return row(index, ",".join(fields))(rows)

    return change


def moved(time: float, index: int = 300) -> str:
    """A log whose time is later by so many seconds from a sample on."""
    t = trace().time_s
    return text(columns={0: t + time * (np.arange(ROWS) >= index)})


@dataclass(frozen=True)
class Refused:
    """A file that is refused, the reason, and one next to it that is read.

    Attributes:
        content: of the file.
        says: the reason, a pattern.
        near: of the file that is read.
        table: [log] of both.
        near_table: [log] of the one that is read, where it is another.
        suffix: of the file's name.
    """

    content: str | bytes
    says: str
    near: str | bytes
    table: Mapping[str, Any] = field(default_factory=dict)
    near_table: Mapping[str, Any] | None = None
    suffix: str = ".csv"


def thousands(numbers: Sequence[str]) -> str:
    """Rows with commas that are decimal, or between thousands."""
    rows = [f"{k};{x};{x}" for k, x in enumerate(numbers)]
    return "\n".join(["time [ms];position [mm];force [N]", *rows]) + "\n"


LOG = trace()
WRAPPED = np.mod(LOG.position_m * 40.0, 0.5)
STEP = np.where(np.arange(ROWS) < 300, 0.0, 0.5)
FILES = {
    "nothing in it": Refused("", "a header line .* at least 2 rows", text(change=lambda rows: rows[:2])),
    "no numbers": Refused("a log\nof words\n", "no row of numbers", text(["a log", "of words", HEADER])),
    "one sample": Refused(text(change=lambda rows: rows[:1]), "at least 2 rows", text(change=lambda rows: rows[:2])),
    "fewer names than fields": Refused(text("time_s,position_m"), "2 names': 3 names", text()),
    "a header that is none": Refused(
        text(), "header_line = 300: ", text(), table={"header_line": 300}, near_table={"header_line": 1}
    ),
    "commas of either kind": Refused(
        thousands([f"1,{k:03d}" for k in range(100, 300)]),
        "decimal",
        thousands([f"1,{k:03d}" for k in range(100, 299)] + ["1,2995"]),
    ),
    "a row of fewer fields": Refused(
        text(change=row(50, "0.05,0.01")), "2 fields': 3 fields", text(change=row(50, "0.05,,"))
    ),
    "a word for a number": Refused(
        text(change=part(50, 2, "high")), "column force_N = .*high", text(change=part(50, 2, "NaN"))
    ),
    "time that falls": Refused(moved(-0.1), "time decreases", text(change=lambda rows: [*rows[:300], *rows[299:]])),
    "stamps coarser than samples": Refused(
        text(columns={0: np.floor(LOG.time_s * 125.0 + 1e-9) / 125.0}),
        "coarser than the samples",
        text(columns={0: np.floor(LOG.time_s * 1e6 + 0.5) / 1e6}),
    ),
    "a time that is missing": Refused(text(change=part(0, 0, "NaN")), "a finite time", text(change=part(0, 1, "NaN"))),
    "a gap in time": Refused(moved(0.05), "uniform time within 1 %", moved(0.05), near_table={"resample": True}),
    "a late step": Refused(moved(2e-5), "uniform time within 1 %", moved(8e-6)),
    "another rate than its time's": Refused(
        text(), "rate = 500", text(), table={"rate": 500.0}, near_table={"rate": 1000.0}
    ),
    "no time": Refused(
        text("position_m,force_N", change=lambda rows: [r.split(",", 1)[1] for r in rows]),
        "rate = .* as --rate",
        text("position_m,force_N", change=lambda rows: [r.split(",", 1)[1] for r in rows]),
        near_table={"rate": 1000.0},
    ),
    "no unit": Refused(
        text("time_s,position,force_N"), "position is there without a unit", text("time_s,position [m],force_N")
    ),
    "an unknown unit": Refused(
        text("time_s,position [furlong],force_N"), "in furlong, which is none of", text("time_s,position [cm],force_N")
    ),
    "a current": Refused(
        text("time_s,position_m,force [A]"),
        r"per A; .*scale = \.\.\.",
        text("time_s,position_m,force [A]"),
        near_table={"force_N": {"variable": "force", "unit": "A", "scale": 45.0}},
    ),
    "counts": Refused(
        text("time_s,position [counts],force_N"),
        "counts_per = ",
        text("time_s,position [counts],force_N"),
        near_table={"position_m": {"variable": "position", "unit": "counts", "counts_per": 1e6}},
    ),
    "a unit against the name": Refused(
        text("time_s,position_m [mm],force_N"), "the unit m, as in its name", text("time_s,position_m [m],force_N")
    ),
    "two positions": Refused(
        text("time_s,position [m],force_N,actual position [m]", columns={3: LOG.position_m}),
        "one column; .*says which",
        text("time_s,position [m],force_N,position demand [m]", columns={3: LOG.position_m}),
    ),
    "two kinds of axis": Refused(
        text("time_s,position_m,force_N,position_rad,torque_Nm", columns={3: LOG.position_m, 4: LOG.force_N}),
        "columns of one kind of axis",
        text("time_s,position_m,force_N,angle,moment", columns={3: LOG.position_m, 4: LOG.force_N}),
    ),
    "a name that is not there": Refused(
        text("time_s,way,force_N"),
        "missing: a column path",
        text("time_s,way,force_N"),
        table={"position_m": {"variable": "path", "unit": "m"}},
        near_table={"position_m": {"variable": "way", "unit": "m"}},
    ),
    "no number in a column": Refused(
        text(columns={2: np.full(ROWS, np.nan)}),
        "NaN throughout",
        text(columns={2: np.where(np.arange(ROWS) < 590, np.nan, LOG.force_N)}),
    ),
    "a position that starts over": Refused(
        text(columns={1: WRAPPED}),
        r"jumps by .*wrap = 0\.5",
        text(columns={1: WRAPPED}),
        near_table={"position_m": {"variable": "position_m", "unit": "m", "wrap": 0.5}},
    ),
    "another format with a suffix of its own": Refused(
        b"PK\x03\x04 a sheet", "text; .*own suffix", text(), suffix=".t"
    ),
    "an encoding that it is not": Refused(
        text().encode("latin-1") + "# Ger\xe4t\n".encode("latin-1"),
        "utf-8 text",
        text().encode("latin-1") + "# Ger\xe4t\n".encode("latin-1"),
        table={"encoding": "utf-8"},
        near_table={"encoding": "latin-1"},
    ),
    "half a compressed file": Refused(
        gzip.compress(text().encode())[:2000],
        "a text that gzip compressed",
        gzip.compress(text().encode()),
        suffix=".csv.gz",
    ),
}


def read(folder: Path, content: str | bytes, table: Mapping[str, Any], suffix: str) -> Log:
    """A file of this content, read."""
    path = folder / f"log{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_log(path, table=dict(table), note=silent)


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_refused_for_its_reason_and_the_one_next_to_it_is_read(name: str, tmp_path: Path) -> None:
    case = FILES[name]
    with pytest.raises(InputError, match=case.says):
        read(tmp_path, case.content, case.table, case.suffix)
    suffix = ".txt" if case.suffix == ".xyz" else case.suffix
    table = case.table if case.near_table is None else case.near_table
    assert len(read(tmp_path, case.near, table, suffix)) >= 2


def axis() -> Machine:
    """The machine of `trace`."""
    return make_machine(
        {
            "name": "axis",
            "plant": {"mass": 2.0},
            "friction": {"law": "switching", "stiffness": [3e4], "fraction": [1.0], "coulomb": 3.0},
            "sampling": {"rate": RATE, "update_rate": 100.0, "velocity_cutoff": 80.0, "max_velocity": 1.0},
        },
        Path("axis.toml"),
    )


WHOLE = trace(4000)
NOISE = np.random.default_rng(2).standard_normal(len(WHOLE))
VELOCITY = np.gradient(WHOLE.position_m, WHOLE.time_s)


def changed(**columns: Any) -> Log:
    """The axis's log with other columns."""
    return replace(WHOLE, **columns)


LOGS: Mapping[str, tuple[Log, str, Log]] = {
    "a position that stands": (
        changed(position_m=np.full(4000, 0.5)),
        "position_m, every row = 0.5: a position that changes",
        changed(position_m=0.5 + 1e-9 * NOISE),
    ),
    "a force that stands": (
        changed(force_N=np.full(4000, 2.0)),
        "force_N, every row = 2.0: a force that changes",
        changed(force_N=np.where(WHOLE.time_s < 2.0, 2.0, WHOLE.force_N)),
    ),
    "a force that is time": (
        changed(force_N=3.0 * WHOLE.time_s),
        "grows by 3 every second",
        changed(force_N=3.0 * WHOLE.time_s + 0.05 * NOISE),
    ),
    "a position that is time": (
        changed(position_m=WHOLE.time_s),
        "no time and no row number",
        changed(position_m=1.001 * WHOLE.time_s),
    ),
    "a force that is the position": (
        changed(force_N=40.0 * WHOLE.position_m),
        "the same signal",
        changed(force_N=-40.0 * WHOLE.position_m + 0.2 * NOISE),
    ),
    "a force of the other sign": (changed(force_N=-WHOLE.force_N), r"scale = -1\.0", WHOLE),
    "a velocity of the other sign": (changed(velocity_m_s=-VELOCITY), r"scale = -1\.0", changed(velocity_m_s=VELOCITY)),
    "a velocity in another unit": (
        changed(velocity_m_s=1e3 * VELOCITY),
        'unit = "mm/s"',
        changed(velocity_m_s=1.5 * VELOCITY),
    ),
    "a position in another unit": (
        changed(position_m=1e3 * WHOLE.position_m),
        'unit = "mm"',
        changed(position_m=2.0 * WHOLE.position_m),
    ),
    "a force in another unit": (
        changed(force_N=1e-3 * WHOLE.force_N),
        'unit = "kN"',
        changed(force_N=0.3 * WHOLE.force_N),
    ),
    "columns that are swapped": (
        changed(position_m=WHOLE.force_N, force_N=WHOLE.position_m),
        "position_m",
        changed(position_m=WHOLE.position_m + 1e-5 * NOISE),
    ),
}


@pytest.mark.parametrize("name", LOGS)
def test_a_log_is_implausible_for_its_reason_and_the_one_next_to_it_passes(name: str) -> None:
    log, says, near = LOGS[name]
    with pytest.raises(InputError, match=says):
        check_plausible(log, axis())
    check_plausible(near, axis())


def joint(log: Log) -> Log:
    """The same of an axis that turns."""
    return replace(log, kind="rotary")


IDENTIFIED: Mapping[str, tuple[list[Log], str, list[Log]]] = {
    "logs of two rates": (
        [WHOLE, replace(WHOLE, time_s=0.98 * WHOLE.time_s, rate=RATE / 0.98)],
        "logs of one call share a rate",
        [WHOLE, replace(WHOLE, time_s=0.9999 * WHOLE.time_s, rate=RATE / 0.9999)],
    ),
    "logs of two kinds": (
        [WHOLE, joint(WHOLE)],
        "of a rotary axis.: those of a linear axis",
        [joint(WHOLE), joint(WHOLE)],
    ),
    "an axis that stands": (
        [changed(position_m=1e-8 * np.round(0.6 * NOISE))],
        "a log in which the axis moves",
        [changed(position_m=1e-2 * WHOLE.position_m + 1e-8 * np.round(0.6 * NOISE))],
    ),
    "too few samples": ([trace(300)], "samples", [trace(1500)]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", IDENTIFIED)
def test_logs_are_refused_for_their_reason_and_those_next_to_them_identified(name: str) -> None:
    logs, says, near = IDENTIFIED[name]
    with pytest.raises(InputError, match=says):
        identify(logs, Wanted("axis", elements=1))
    found = identify(near, Wanted("axis", mass=2.0, elements=1))
    assert found.number("coulomb").value == pytest.approx(3.0, rel=0.1)


def test_a_refusal_says_what_was_left_out_before() -> None:
    """A force at its limits is left out first: what is left may be too little, or without friction."""
    limit = float(np.quantile(np.abs(WHOLE.force_N), 0.7))
    drive = changed(force_N=np.clip(WHOLE.force_N, -limit, limit))
    with pytest.raises(InputError, match=r"usable samples = .*\(note: .*saturated in \d+ of 600 samples"):
        prepare(axis(), replace(drive.part(0.0, 0.5995), source="log"))
    viscous = 2.0 * np.gradient(VELOCITY, WHOLE.time_s) + 20.0 * VELOCITY + 0.02 * NOISE
    limited = changed(force_N=np.minimum(viscous, np.quantile(viscous, 0.98)))
    with pytest.raises(InputError, match=r"dry friction.*\(note: .*saturated in 80 of 4000 samples"):
        identify([limited], Wanted("axis", mass=2.0, elements=1))
