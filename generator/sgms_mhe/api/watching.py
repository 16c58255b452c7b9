"""An estimator along a log that is replayed, or that grows: its updates one by one, and their summary."""

from __future__ import annotations

import math
import os
import select
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from sgms_mhe.api.estimation import has_own_signals
from sgms_mhe.api.inputs import Note, recorded_log
from sgms_mhe.evaluation.watching import RunSummary
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.logfiles.following import FollowedText
from sgms_mhe.logfiles.json_files import SUFFIXES
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.logfiles.reading import READERS
from sgms_mhe.logfiles.text import COMPRESSED
from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import Chain, Signals, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log, check_rate
from sgms_mhe.support.errors import InputError

Piece = Log | Signals
"""Samples that follow: of one kind throughout a run."""

STDIN: Final = Path("standard input")
"""What messages call it."""

POLL_S: Final = 0.05
"""Between two looks at a file that had nothing new."""
BLOCK: Final = 1 << 16
"""Bytes that are read at a time."""
CHECKED: Final = 64
"""Bytes before those that are read that must still be what they were."""
AT_ONCE: Final = 20
"""Updates that are replayed at a time."""
STRETCH_S: Final = 20.0
"""Length of the stretches of a log that comes in pieces whose columns are checked against those of a plausible axis."""

LEAST_STRETCH_S: Final = 5.0
"""Of the last stretch, where there were others."""


class HostClock:
    """Time as it passes on this host."""

    def now(self) -> float:
        """Seconds since some moment; they never go back."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Sleep, but not so long that an interrupt would have to wait."""
        time.sleep(min(seconds, POLL_S))


class SampleSource(ABC):
    """Where samples come from.

    Attributes:
        ended: why no more come, in words; empty while they may.
        remarks: sentences on omitted data.
    """

    def __init__(self) -> None:
        self.ended = ""
        self.remarks: list[str] = []

    @abstractmethod
    def pieces(self, stopped: Callable[[], bool]) -> Iterator[Piece | None]:
        """Samples as they come, None where there are none now.

        Args:
            stopped: whether nobody wants more.

        Raises:
            InputError: the data are no log of the machine; all samples before it were yielded.
        """


class Replay(SampleSource):
    """A log that is whole, of any format, read and checked as by every other command.

    Args:
        path: of the log.
        machine: whose axis left it.
        speed: times real time; infinite: as fast as it goes.
        clock: by which it passes.
        note: called with each sentence on how the log was read.

    Raises:
        InputError: as `read_log`.
    """

    def __init__(self, path: Path, machine: Machine, speed: float, clock: HostClock, note: Note | None = None) -> None:
        super().__init__()
        log = recorded_log(path, machine, driven=True, note=note)
        self._log = log
        self._signals = signals_from_log(log, machine) if has_own_signals(log) else None
        self._speed, self._clock = speed, clock
        self._at_once = AT_ONCE * machine.sampling.samples_per_update

    def pieces(self, stopped: Callable[[], bool]) -> Iterator[Piece | None]:
        """The log's samples, each when it is due."""
        since, started, first = self._log.time_s - self._log.time_s[0], self._clock.now(), 0
        while first < len(since) and not stopped():
            due = min(first + self._at_once, len(since))
            if math.isfinite(self._speed):
                passed = (self._clock.now() - started) * self._speed
                due = min(due, int(np.searchsorted(since, passed, side="right")))
            if due == first:
                yield None
                self._clock.wait(POLL_S)
                continue
            yield self._part(slice(first, due))
            first = due
        if first == len(since):
            self.ended = "end of the log"

    def _part(self, which: slice) -> Piece:
        if self._signals is not None:
            return self._signals.part(which)
        log = self._log
        return Log(log.time_s[which], log.position_m[which], log.force_N[which], log.rate, kind=log.kind)


class _Growing(SampleSource):
    """A text that comes in pieces: how it is read, and when nobody waits for more of it."""

    def __init__(self, path: Path, machine: Machine, idle_s: float, clock: HostClock) -> None:
        super().__init__()
        self._text, self._clock = FollowedText(path, machine), clock
        self._idle_s = idle_s

    def pieces(self, stopped: Callable[[], bool]) -> Iterator[Piece | None]:
        """The samples of the lines with their end."""
        heard, whole = self._clock.now(), False
        while not stopped():
            content = self._read()
            if content:
                lines = b"\n" in content or b"\r" in content
                heard = self._clock.now() if lines else heard
                yield from self._text.feed(content)
                continue
            whole = content is None
            if whole or self.ended:
                break
            if self._clock.now() - heard >= self._idle_s:
                self.ended = f"no new line for {self._idle_s:g} s"
                break
            yield None
            self._clock.wait(POLL_S)
        if self._text.begun or not stopped():
            yield from self._text.end(whole=whole)
        self.remarks += self._text.left_out

    @abstractmethod
    def _read(self) -> bytes | None:
        """Return the available bytes, at most a block; None where the text is over and its last line whole."""


class Followed(_Growing):
    """A file that something writes to.

    Args:
        path: of the file, a delimited text.
        machine: whose axis leaves the log.
        idle_s: without a new line after which it has ended [s].
        clock: by which that is measured.

    Raises:
        InputError: the file cannot be read, or is none that grows line by line.
    """

    def __init__(self, path: Path, machine: Machine, idle_s: float, clock: HostClock) -> None:
        if path.suffix.lower() in (*READERS, *SUFFIXES, COMPRESSED):
            allowed = "a text, which grows line by line; without --follow it is replayed"
            raise InputError(path, "--follow", path.name, allowed)
        super().__init__(path, machine, idle_s, clock)
        self._path = path
        self._place = 0
        self._before = b""
        try:
            self._stream: BinaryIO = path.open("rb", buffering=0)
        except OSError as error:
            raise InputError(path, "file", None, f"a readable log ({error.strerror or error})") from None

    def pieces(self, stopped: Callable[[], bool]) -> Iterator[Piece | None]:
        """The samples of the lines with their end; the file is closed behind them."""
        with self._stream:
            yield from super().pieces(stopped)

    def _read(self) -> bytes | None:
        # What stood before is read again together with what follows: a file that was emptied, or written anew, and has
        # grown beyond this place since, is another one.
        start = self._place - len(self._before)
        try:
            content = os.pread(self._stream.fileno(), len(self._before) + BLOCK, start)
        except OSError as error:
            raise InputError(self._path, "file", None, f"a readable log ({error.strerror or error})") from None
        if not content.startswith(self._before):
            self.ended = f"the file was emptied or written anew behind byte {self._place}"
            return b""
        new = content[len(self._before) :]
        self._place += len(new)
        self._before = content[-CHECKED:]
        if not new and not self.ended and self._is_replaced():
            self.ended = "the file was replaced, or removed"
            return self._read()  # what was written to the old one before
        return new

    def _is_replaced(self) -> bool:
        own = os.fstat(self._stream.fileno())
        try:
            there = self._path.stat()
        except OSError:
            return True
        return (there.st_dev, there.st_ino) != (own.st_dev, own.st_ino)


class Streamed(_Growing):
    """A pipe, or standard input.

    Args:
        stream: to read from.
        path: name in messages.
        machine: whose axis leaves the log.
        idle_s: without a new line after which it has ended [s].
        clock: by which that is measured.
    """

    def __init__(self, stream: BinaryIO, path: Path, machine: Machine, idle_s: float, clock: HostClock) -> None:
        super().__init__(path, machine, idle_s, clock)
        self._stream = stream

    def _read(self) -> bytes | None:
        descriptor = self._stream.fileno()
        if not select.select([descriptor], [], [], 0.0)[0]:
            return b""
        content = os.read(descriptor, BLOCK)
        if content:
            return content
        self.ended = "end of the input"
        return None


class Watch:
    """The generated C of a machine along a log that comes in pieces.

    Args:
        machine: as it was loaded.

    Attributes:
        course: summary of the updates.
        doubts: sentences on stretches whose columns contradict their names; of logs that come in pieces.

    Raises:
        BuildError: the C compiler refused.
    """

    def __init__(self, machine: Machine) -> None:
        estimator = CompiledEstimator(machine)
        self._machine, self._running = machine, estimator.running()
        self.course = RunSummary(machine, estimator.model)
        self.doubts: list[str] = []
        self._stretch: list[Log] = []
        self._chain: Chain | None = None

    def take(self, piece: Piece, *, judged: bool) -> Estimates:
        """The updates of the samples that follow; `judged`: the columns were checked before.

        Raises:
            InputError: signals of its own, and no measurement to begin with.
        """
        if isinstance(piece, Log) and not judged:
            self._stretch.append(piece)
            if sum(map(len, self._stretch)) >= STRETCH_S * self._machine.sampling.rate:
                self.judge()
        if isinstance(piece, Log) and has_own_signals(piece):
            piece = self._through_chain(piece)
        if isinstance(piece, Log):
            gaps = ~(np.isfinite(piece.position_m) & np.isfinite(piece.force_N))
        else:
            gaps = piece.missing
        self.course.samples += len(piece)
        self.course.missing += int(np.count_nonzero(gaps))
        estimates = self._running.take(piece)
        self.course.add(estimates)
        return estimates

    def _through_chain(self, log: Log) -> Signals:
        """Signals of a log that brings some of its own."""
        if self._chain is None:
            check_rate(log, self._machine)
            for name in ("position_m", "force_N"):
                if not np.isfinite(log.columns[name][0]):
                    allowed = (
                        "a reading, beside columns of velocity, acceleration or friction: the first one counts as "
                        "having been there before, which takes the whole log; replay it without --follow"
                    )
                    raise InputError(log.source, f"first sample, {log.units.named(name)}", math.nan, allowed)
            self._chain = Chain(self._machine)
        return self._chain.take(log)

    def judge(self) -> None:
        """Check the newest stretch of samples for values implausible of this axis.

        One without motion tells nothing, nor does a short rest behind others.
        """
        pieces, self._stretch = self._stretch, []
        length = sum(map(len, pieces))
        if length == 0 or length < min(self.course.samples, LEAST_STRETCH_S * self._machine.sampling.rate):
            return
        time_s, position, force = (
            np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("time_s", "position_m", "force_N")
        )
        if any(len(np.unique(values[np.isfinite(values)])) < 2 for values in (position, force)):
            return
        source = f"{pieces[0].source}, {time_s[0]:g} to {time_s[-1]:g} s"
        try:
            check_plausible(
                Log(time_s, position, force, self._machine.sampling.rate, source=source, kind=pieces[0].kind),
                self._machine,
            )
        except InputError as error:
            self.doubts.append(str(error))
