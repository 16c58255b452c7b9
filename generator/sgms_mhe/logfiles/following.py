"""A log in a text that grows: the samples of the whole file, from pieces of any size, as soon as they are there.

Findings on the first rows hold for the rest: encoding, dialect, columns, units, the step between samples. Where that is
told follows from the bytes alone, never from how they came.
"""

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from sgms_mhe.logfiles.decimals import Mark
from sgms_mhe.logfiles.dialect import (
    LONGEST_SUMMARY,
    UNTOLD,
    Dialect,
    find_dialect,
    is_empty,
    is_row,
    lines_of,
    note_left_out,
    told_in,
)
from sgms_mhe.logfiles.encoding import Decoder, check_text
from sgms_mhe.logfiles.quantities import Turns, check_signs, si_piece, turns_of
from sgms_mhe.logfiles.reading import LogContent, fields_of_log, log_of
from sgms_mhe.logfiles.sources import choose_sources
from sgms_mhe.logfiles.table import Table
from sgms_mhe.logfiles.text import Cells, read_plainly
from sgms_mhe.logfiles.timing import check_rising, check_steps, measure_time
from sgms_mhe.machine import QUANTITIES, LogMapping, Machine
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import AnyArray, Array, Index
from sgms_mhe.support.errors import InputError

LEAST_ROWS: Final = 60
"""Samples that the dialect is told by: more than a separator is tried on."""
FIRST_LINES: Final = 64
"""Lines that are looked at first; twice as many each time that they hold too few samples."""
MOST_LINES: Final = 4096
"""Lines in which samples have to be found."""
LONGEST_LINE: Final = 1_000_000
"""Characters; a text without line ends is none that grows."""
RECENT: Final = 5_000
"""Last samples in which a number that was recorded without its sign is looked for."""
LOOKS: Final = (100, 1000)
"""Samples between two such looks: in the first thousand, and after it."""
Row = tuple[int, str]
"""A line with its number, from 1."""


class FollowedText:
    """A log that comes in pieces.

    Args:
        path: of the text, or its name in messages.
        machine: whose axis left it; its [log] counts.
    """

    def __init__(self, path: Path, machine: Machine) -> None:
        self._path, self._machine = path, machine
        self._lines = _LineSplitter(path, machine.log)
        self._head: list[str] = []
        self._looked = FIRST_LINES
        self._rows: _Rows | None = None

    @property
    def begun(self) -> bool:
        """Return True if the first samples were found."""
        return self._rows is not None

    @property
    def left_out(self) -> tuple[str, ...]:
        """Sentences on omitted data, once the text has ended."""
        found = note_left_out([] if self._rows is None else self._rows.left_out)
        if rest := self._lines.rest.strip():
            found.append(f"the last line has no end and is left out: {rest[:80]}")
        return tuple(found)

    def feed(self, content: bytes) -> Iterator[Log]:
        """The samples that are whole with these bytes, as logs one after the other.

        Raises:
            InputError: names the first row that is none. All samples before it were yielded.
        """
        yield from self._take(self._lines.feed(content), ended=False)

    def end(self, *, whole: bool) -> Iterator[Log]:
        """The samples that were held back; `whole`: the last line was not cut off, though it has no end.

        Raises:
            InputError: as `feed`; also for a text in which no log was found.
        """
        yield from self._take(self._lines.end(whole=whole), ended=True)

    def _take(self, lines: list[str], *, ended: bool) -> Iterator[Log]:
        if self._rows is None:
            self._head += lines
            dialect = self._dialect(ended=ended)
            if dialect is None:
                return
            self._rows = _Rows(self._path, self._machine, dialect)
            lines = self._head[dialect.rows[-1][0] :]
            self._head = []
            yield self._rows.first
        yield from self._rows.take(lines)

    def _dialect(self, *, ended: bool) -> Dialect | None:
        """Understand the first lines, once there are enough."""
        while len(self._head) >= self._looked or ended:
            every = ended and self._looked >= len(self._head)
            try:
                dialect = find_dialect(self._path, "\n".join(self._head[: self._looked]), self._machine.log)
            except InputError:
                if every or self._looked >= MOST_LINES:
                    raise
            else:
                if every or len(dialect.rows) >= LEAST_ROWS:
                    return dialect
            self._looked *= 2
        return None


class _LineSplitter:
    """Bytes into the lines with their end."""

    def __init__(self, path: Path, hints: LogMapping | None) -> None:
        self._path = path
        self._decoder = Decoder(path, None if hints is None else hints.encoding)
        self._count = 0
        self.rest = ""

    def feed(self, content: bytes) -> list[str]:
        """The lines that end within these bytes."""
        return self._split(self._decoder.decode(content))

    def end(self, *, whole: bool) -> list[str]:
        """Return the remaining lines; `whole`: the last one too."""
        lines = self._split(self._decoder.decode(b"", ended=True, whole=whole))
        if self.rest and (whole or self.rest.endswith("\r")):
            lines.append(self.rest.removesuffix("\r"))
            self.rest = ""
        return lines

    def _split(self, text: str) -> list[str]:
        check_text(self._path, text, self._count)
        text = self.rest + text
        held = "\r" if text.endswith("\r") else ""  # a line feed may follow
        *lines, rest = lines_of(text.removesuffix("\r") if held else text)
        self.rest = rest + held
        self._count += len(lines)
        if len(self.rest) > LONGEST_LINE:
            allowed = f"a line end within {LONGEST_LINE} characters"
            raise InputError(self._path, f"line {self._count + 1}", self.rest[:80], allowed)
        return lines


@dataclass
class _Told:
    """Knowledge from the rows so far about those that follow.

    Attributes:
        cells, turns: remember time stamps, groups of thousands and numbers that start over.
        decimal: the mark; `sure`: a row told it; `pointed`: one had a point that told nothing.
        time: of the last sample (1,) [s], empty before the first.
        samples: how many there were.
        recent: the last of them as they were recorded, by column.
        lines: numbers of their lines.
    """

    cells: Cells
    turns: Mapping[str, Turns]
    decimal: Mark
    sure: bool
    pointed: bool
    time: Array
    samples: int
    recent: Mapping[str, Array]
    lines: Index


class _Rows:
    """Rows into samples.

    Args:
        path: of the text.
        machine: whose axis left it.
        dialect: with the first rows, from which columns, units and the step of time are known.

    Attributes:
        first: the samples of the first rows.

    Raises:
        InputError: the first rows are no log of this machine.
    """

    def __init__(self, path: Path, machine: Machine, dialect: Dialect) -> None:
        hints, lines, header = machine.log, [line for _, line in dialect.rows], dialect.header
        if header.clocks or header.scales or header.steps:
            allowed = "samples of one clock; what its key rows state needs the whole log: replay it without --follow"
            raise InputError(path, f"line {header.line}", ", ".join(header.names[:8]), allowed)
        cells = Cells(path, dialect, hints)
        self._path, self._rate = path, None if hints is None else hints.rate
        self._table = Table(
            "text",
            cells.columns,
            lambda names: cells.read(dialect, names),
            dialect.row,
            dialect.description,
            cells.stamped,
        )
        kind, self._sources = choose_sources(path, self._table, hints, machine.plant.kind)
        self._names = sorted({source.column for source in self._sources})
        self._dialect, self._lead = replace(dialect, rows=(), after=()), dialect.lead
        self._line, self._pending = dialect.rows[-1][0], list[Row]()
        stated = hints is not None and hints.decimal is not None
        sure = stated or (dialect.separator == "," and not any('"' in line for line in lines))
        sure = sure or any(told_in(line, dialect.separator)[0] is not None for line in lines)
        pointed, turns = any("." in line for line in lines), turns_of(self._sources)
        told = _Told(cells, turns, dialect.decimal, sure, pointed, np.empty(0), 0, {}, np.empty(0, np.int64))
        raw = self._table.read(self._names)
        self._sources = check_signs(path, self._sources, raw, dialect.row)
        self._check_signs(told, raw, [number for number, _ in dialect.rows])
        columns = self._si(told, raw)
        for role in ("position", "force"):
            own = next(quantity.column for quantity in QUANTITIES[kind] if quantity.role == role)
            if own not in columns:
                raise InputError(path, f"column {own}", None, "missing; what stands for it needs the whole log")
        timing = measure_time(path, columns["time_s"], dialect.row)
        if hints is not None and hints.resample and not timing.uniform:
            allowed = "even time; uneven time is interpolated over a whole log: replay it without --follow"
            raise InputError(path, "[log] resample", True, allowed)
        self._step = timing.step
        self.first = log_of(LogContent(path, self._table, kind, self._sources, timing, None, columns), machine)
        told.time, told.samples = columns["time_s"][-1:], len(self.first)
        self._told = told

    @property
    def left_out(self) -> list[str]:
        """Lines that wait for a sample behind them: the text's last ones, once it has ended."""
        return [line.strip() for _, line in self._pending]

    def take(self, lines: Sequence[str]) -> Iterator[Log]:
        """The samples of the lines that follow. Raises InputError that names the first row that is none."""
        rows = [(number, line) for number, line in enumerate(lines, self._line + 1) if not is_empty(line)]
        self._line += len(lines)
        if rows:
            yield from self._read(rows)

    def _read(self, rows: list[Row]) -> Iterator[Log]:
        """Samples of rows and of those that waited; where one is none, first all before it."""
        waiting = self._pending
        told = deepcopy(self._told)
        try:
            columns = self._columns(told, rows)
        except InputError:
            self._pending = waiting
            if len(rows) == 1:
                raise
            half = len(rows) // 2
            yield from self._read(rows[:half])
            yield from self._read(rows[half:])
            return
        self._told = told
        if columns:
            yield replace(self.first, **fields_of_log(self.first.kind, columns))

    def _columns(self, told: _Told, rows: list[Row]) -> dict[str, Array]:
        """Columns (n,) in SI units of the samples that are certain; empty where there are none."""
        self._tell_decimal(told, rows)
        raw = None if self._pending else self._plain(told, rows)
        if raw is None:
            rows = self._samples(rows)
            if not rows:
                return {}
            raw = told.cells.read(self._piece(told, rows), self._names, ahead=False)
        piece = self._piece(told, rows)
        self._check_signs(told, raw, [number for number, _ in rows])
        columns = self._si(told, raw)
        before = len(told.time)
        time = np.concatenate((told.time, columns["time_s"]))

        def row(index: int) -> str:
            return piece.row(index - before)

        check_rising(self._path, time, row)
        check_steps(self._path, time, self._step, row)
        told.time, told.samples = time[-1:], told.samples + len(rows)
        return columns

    def _check_signs(self, told: _Told, raw: Mapping[str, AnyArray], lines: Sequence[int]) -> None:
        """Refuse a number recorded without its sign, as the reader of whole logs does."""
        ends = range(told.samples + 1, told.samples + len(lines) + 1)
        told.lines = np.concatenate((told.lines, lines))
        told.recent = {name: np.concatenate((told.recent.get(name, raw[name][:0]), raw[name])) for name in self._names}
        before = ends.stop - 1 - len(told.lines)
        for end in ends:
            if end % LOOKS[end > LOOKS[1]]:
                continue
            first = max(before, end - RECENT)

            def row(index: int, first: int = first) -> str:
                number = ((int(told.lines[first - before + index]), ""),)
                return replace(self._dialect, rows=number, first=first + index).row(0)

            part = slice(first - before, end - before)
            check_signs(self._path, self._sources, {name: told.recent[name][part] for name in self._names}, row)
        told.lines = told.lines[-RECENT:]
        told.recent = {name: values[-RECENT:] for name, values in told.recent.items()}

    def _si(self, told: _Told, raw: Mapping[str, AnyArray]) -> dict[str, Array]:
        columns = si_piece(self._path, self._table, self._sources, raw, told.turns)
        if "time_s" in columns or self._rate is None:
            return columns
        count = len(next(iter(columns.values())))
        return {"time_s": (told.samples + np.arange(count)) / self._rate} | columns

    def _piece(self, told: _Told, rows: Sequence[Row]) -> Dialect:
        return replace(self._dialect, rows=tuple(rows), decimal=told.decimal, first=told.samples)

    def _plain(self, told: _Told, rows: list[Row]) -> Mapping[str, Array] | None:
        """The columns, where every line is a sample of plain numbers; else None."""
        names = [*self._names, told.cells.columns[self._lead].name]
        if told.cells.stamped & set(names):
            return None
        indices = [[column.name for column in told.cells.columns].index(name) for name in names]
        try:
            plain = read_plainly(self._path, self._piece(told, rows), indices)
        except InputError:  # what line it is tells whether that is an error
            return None
        return None if plain is None else dict(zip(self._names, plain, strict=False))

    def _samples(self, rows: Sequence[Row]) -> list[Row]:
        """The rows that are to be samples: lines that begin with words wait until a sample follows them, or too many.

        Where none does they are a summary, as behind the last sample of a whole file.
        """
        taken: list[Row] = []
        waiting = list(self._pending)
        for row in rows:
            waiting.append(row)
            if len(waiting) >= LONGEST_SUMMARY or is_row(row[1], self._dialect.separator, self._lead):
                taken += waiting
                waiting = []
        self._pending = waiting
        return taken

    def _tell_decimal(self, told: _Told, rows: Sequence[Row]) -> None:
        """The decimal mark, where no row has told it yet; rows before the one that does have none."""
        for number, line in [] if told.sure else rows:
            mark, field = told_in(line, self._dialect.separator)
            if mark == "either" or (mark == "," and told.pointed):
                raise InputError(self._path, f"line {number}", field, UNTOLD)
            told.pointed = told.pointed or "." in line
            if mark is not None:
                told.decimal, told.sure = mark, True
                return
