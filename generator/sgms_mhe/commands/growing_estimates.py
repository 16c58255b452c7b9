"""Outputs of `sgms-mhe watch`: lines, a page, a growing file of estimates."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from sgms_mhe.commands.common import is_stream, note
from sgms_mhe.evaluation.watching import RunSummary, status_words
from sgms_mhe.report import Watched, write_watch_page
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write
from sgms_mhe.support.numbers import interval

PAGE_S: Final = 2.0
"""Between two pages."""


class WatchLines:
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
            f"{units.named(name)} {interval(value, std)}"
            for name, value, std in zip(course.names, last.parameters[0], last.std[0], strict=True)
        ]
        friction = f"friction {float(last.friction_N[0]):.4g} {units.force}"
        ratio = f"test ratio {float(last.test_ratio[0]):.3g}"
        note(", ".join([f"{time:.2f} s: {status_words(int(last.status[0]))}", friction, ratio, *parameters]))


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
