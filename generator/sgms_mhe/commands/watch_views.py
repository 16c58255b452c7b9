"""Where `sgms-mhe watch` shows a run: on a terminal, in lines, as a page, in a growing file of estimates."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from sgms_mhe.commands.common import is_stream, note
from sgms_mhe.evaluation.watching import RunSummary, flags_of, status_words
from sgms_mhe.report import Watched, write_watch_page
from sgms_mhe.report.units import force, plain, quantity, use_units
from sgms_mhe.report.watch import interval_text, seconds
from sgms_mhe.report.words import relative_change
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write

Array = NDArray[np.float64]

PANEL_S: Final = 0.15
"""Between two pictures on a terminal."""
PAGE_S: Final = 2.0
"""Between two pages."""
MARKS: Final = ("▁▂▃▄▅▆▇█", "_.-=^")
"""Of a trend, the lowest first: of terminals with Unicode, and of others."""
TREND: Final = 24
"""Marks of a trend."""
WIDE: Final = 90
"""Columns of a terminal that has room for the trends of parameters."""


class WatchView(Protocol):
    """Shows a run."""

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave nothing behind that is half done."""

    def show(self, course: RunSummary) -> None:
        """Show it as it is now; called often."""


class Nothing:
    """Empty view of --quiet."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def show(self, course: RunSummary) -> None:
        """Nothing."""


class WatchLines(Nothing):
    """A line on stderr every so many seconds of the log."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._due = -np.inf

    def show(self, course: RunSummary) -> None:
        """A line, where one is due."""
        last = course.latest
        if last is None or last.time_s[0] < self._due:
            return
        time, units = float(last.time_s[0]), course.machine.plant.units
        self._due = (time // self._every_s + 1.0) * self._every_s
        parameters = [
            f"{units.named(name)} {value:.5g} +- {2.0 * std:.2g}"
            for name, value, std in zip(course.names, last.parameters[0], last.std[0], strict=True)
        ]
        friction = f"friction {float(last.friction_N[0]):.4g} {units.force}"
        ratio = f"test ratio {float(last.test_ratio[0]):.3g}"
        note(", ".join([f"{time:.2f} s: {status_words(int(last.status[0]))}", friction, ratio, *parameters]))


class Picture:
    """A panel on a terminal that is drawn over itself, and goes when the run is over."""

    def __init__(self, source: str, now: Callable[[], float]) -> None:
        self._source, self._now = source, now
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._due = -np.inf
        encoding = (self._console.encoding or "").lower()
        self._marks = MARKS[0 if encoding.startswith("utf") else 1]

    def __enter__(self) -> Self:
        self._live.__enter__()
        self._live.update(Panel("waiting for the first update", title=self._source), refresh=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.__exit__(kind, error, trace)

    def show(self, course: RunSummary) -> None:
        """A new picture, where one is due."""
        if course.latest is None or self._now() < self._due:
            return
        self._due = self._now() + PANEL_S
        with use_units(course.machine.plant.units):
            self._live.update(self._drawn(course, course.latest), refresh=True)

    def _drawn(self, course: RunSummary, last: Estimates) -> Panel:
        flags = flags_of(int(last.status[0]))
        colour = {"refused": "red", "doubt": "red", "good": "green"}.get(flags[0], "yellow")
        recent, points, n_p = course.recent, course.trend.points, len(course.names)
        greatest, at = course.greatest
        top = Table.grid(padding=(0, 2))
        top.add_row("status", Text(status_words(int(last.status[0])), style=f"bold {colour}"), "")
        friction, measured = float(last.friction_N[0]), float(last.friction_measured_N[0])
        shown = Text(f"{force(friction)}, measured {force(measured)}")
        top.add_row("friction", shown, self._trend(recent[:, 2]))
        top.add_row("innovation", force(float(last.innovation_N[0])), "")
        ratio = f"{plain(float(last.test_ratio[0]))}, greatest {plain(greatest)} at {seconds(at)}"
        top.add_row("test ratio", ratio, self._trend(np.log(np.maximum(points[:, 2 * n_p], 1e-3))))
        table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
        heads: tuple[str, ...] = ("parameter", "estimate, ± 2 sigma", "machine file", "change", "trend")
        heads = heads[: None if self._console.width >= WIDE else -1]
        for head in heads:
            table.add_column(head, justify="left" if head in ("parameter", "trend") else "right", no_wrap=True)
        for k, name in enumerate(course.names):
            value, nominal = float(last.parameters[0, k]), float(course.nominal[k])
            cells = (
                course.machine.plant.units.named(name),
                str(interval_text(name, value, float(last.std[0, k]))),
                str(quantity(name, nominal)),
                relative_change(nominal, value),
                self._trend(points[:, k]),
            )
            table.add_row(*cells[: len(heads)])
        counts = f"{course.updates} updates, faults seen: {course.faults}"
        title = f"{course.machine.name}  {self._source}  {seconds(float(last.time_s[0]))}"
        return Panel(Group(top, "", table), title=title, subtitle=counts, border_style="dim", title_align="left")

    def _trend(self, values: Array) -> str:
        """Marks from the least to the greatest of the values, the newest to the right."""
        values = values[np.isfinite(values)]
        if not len(values):
            return ""
        parts = np.array_split(values, min(TREND, len(values)))
        means = np.array([part.mean() for part in parts])
        span = float(np.ptp(means)) or 1.0
        places = (means - means.min()) / span * (len(self._marks) - 1)
        return "".join(self._marks[round(place)] for place in places)


class Page:
    """The page of a run, written anew every few seconds.

    Args:
        path: of the page.
        source: the log, as its user calls it.
        now: seconds that pass.
    """

    def __init__(self, path: Path, source: str, now: Callable[[], float]) -> None:
        self._path, self._source, self._now = path, source, now
        self._due = -np.inf

    def show(self, course: RunSummary, remarks: tuple[str, ...]) -> None:
        """A new page, where one is due."""
        if course.latest is not None and self._now() >= self._due:
            write_watch_page(self._path, Watched(course, self._source, "", remarks))
            self._due = self._now() + PAGE_S

    def end(self, course: RunSummary, ended: str, remarks: tuple[str, ...]) -> None:
        """The page that stays."""
        write_watch_page(self._path, Watched(course, self._source, ended, remarks))


class GrowingEstimates:
    """The file of estimates that `estimate` writes, of whole lines at any time.

    It takes its place with the first update; what is no regular file is written as it goes.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stream: BinaryIO | None = None
        self._size = 0

    def append(self, estimates: Estimates) -> None:
        """Write rows.

        Raises:
            InputError: the file cannot be written; what was there before stays, in whole lines.
        """
        if not len(estimates):
            return
        columns = estimates.columns
        rows = zip(*(map(repr, values.tolist()) for values in columns.values()), strict=True)
        text = "".join(",".join(row) + "\n" for row in rows).encode()
        try:
            if self._stream is None:
                header = (",".join(columns) + "\n").encode()
                self._stream, self._size = self._open(header)
                text = text if self._size else header + text
            done = 0
            while done < len(text):
                done += self._stream.write(text[done:])
            self._size += len(text)
        except BrokenPipeError:  # whoever read it has enough
            raise
        except OSError as error:
            if not is_stream(self._path) and self._stream is not None:
                os.truncate(self._path, self._size)
            raise InputError(
                self._path, "output file", None, f"a file that can be written ({error.strerror})"
            ) from None

    def close(self) -> None:
        """No more rows come."""
        if self._stream is not None:
            self._stream.close()

    def _open(self, header: bytes) -> tuple[BinaryIO, int]:
        """(where rows go, bytes that are there): a new file with its header, or a stream as it is."""
        if is_stream(self._path):
            return self._path.open("wb", buffering=0), 0
        with atomic_write(self._path) as whole:
            whole.write(header)
        return self._path.open("ab", buffering=0), len(header)


def view(source: str, every_s: float, now: Callable[[], float], *, quiet: bool) -> WatchView:
    """How a run is shown: a picture on a terminal, else lines; nothing where nothing is to be said."""
    if quiet:
        return Nothing()
    return Picture(source, now) if sys.stderr.isatty() else WatchLines(every_s)
