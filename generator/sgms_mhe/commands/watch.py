"""`sgms-mhe watch`."""

from __future__ import annotations

import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Final

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.numbers import interval
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.api.watching import HostClock, SampleSource, Watch
    from sgms_mhe.commands.growing_estimates import GrowingEstimates
    from sgms_mhe.evaluation.watching import RunSummary
    from sgms_mhe.machine import Machine
    from sgms_mhe.signals.estimates import Estimates
    from sgms_mhe.support.statements import Statement

TOGETHER_S: Final = 1.0
"""Within so long signals are one: timeout(1) and some supervisors tell a process and its group."""
PAGE_S: Final = 2.0
"""Between two pages."""
SHOWN: Final = 10
"""Stretches with a fault that the text lists."""


class Interrupt:
    """The first interrupt, or termination, asks for the end; a second one, not sent along with it, is as always."""

    def __init__(self) -> None:
        self.number = 0
        self._asked_s = 0.0

    @contextmanager
    def take_signals(self) -> Iterator[None]:
        """Take signals within the block."""
        before = {number: signal.signal(number, self._ask) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def has_request(self) -> bool:
        """Return True if the end was asked for."""
        return self.number != 0

    def _ask(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self.number and now - self._asked_s > TOGETHER_S:
            raise KeyboardInterrupt(signal.Signals(number))
        if not self.number:
            self.number, self._asked_s = number, now


@make_command(
    "watch etel_xy axis.csv --speed 10 --page axis.html",
    "watch etel_xy axis.csv --follow --out estimates.csv",
    "watch etel_xy - < /dev/ttyACM0",
)
def command(
    machine: Machine,
    log: Path,
    *,
    follow: bool = False,
    speed: Annotated[float, Option("X", 1e-3, 1e6, infinite="max")] = 1.0,
    idle_s: Annotated[float | None, Option(least=0.1, most=1e6)] = None,
    every_s: Annotated[float, Option(least=1e-3, most=1e8)] = 5.0,
    page: Path | None = None,
    out: Path | None = None,
    json: bool = False,
) -> int:
    """Show an estimator live along a log that grows, or is replayed.

    Shown are friction, parameters with their bounds, test ratio and status; at the end, after Ctrl-C too, a summary.
    LOG is a log that is replayed; with --follow a text that grows; - for standard input, or a pipe. The numbers are
    those of estimate, to the last bit.

    Args:
        follow: LOG grows: go on with its new rows.
        speed: of a replay, times real time; max: as fast as it goes.
        idle_s: end after so long without a new line [s].
        every_s: a line on stderr so often [s of the log].
        page: page to write, anew every 2 s.
        out: CSV to write, as estimate does: rows are appended as they come.
    """
    for path, suffixes in ((out, ()), (page, (".html", ".htm"))):
        if path is not None:
            common.check_output_file(path, suffixes)
    growing = follow or str(log) == "-" or common.is_stream(log)
    if idle_s is not None and not growing:
        raise InputError(log, "--idle", idle_s, "a log that grows: --follow, a pipe, or - for standard input")
    given = click.get_current_context().get_parameter_source("speed")
    if growing and given is not None and given.name == "COMMANDLINE":
        raise InputError(log, "--speed", speed, "a log that is replayed; one that grows comes as fast as it is written")

    from sgms_mhe.api.watching import HostClock, Watch
    from sgms_mhe.commands.growing_estimates import GrowingEstimates
    from sgms_mhe.report import Watched, write_watch_page

    interrupt = Interrupt()
    with interrupt.take_signals():  # before anything takes time: an exception in the midst of an import may be lost
        source = _source(log, machine, math.inf if idle_s is None else idle_s, speed, HostClock(), follow=follow)
        watch, name = Watch(machine), str(log) if str(log) != "-" else "standard input"

        def show_page(remarks: Sequence[str], ended: str = "") -> None:
            if page is not None:
                write_watch_page(page, Watched(watch.course, name, ended, tuple(remarks)))

        rows = None if out is None else GrowingEstimates(out)
        error = _run(source, watch, interrupt, every_s, rows, show_page, judged=not growing)
        if rows is not None:
            rows.close()
        watch.judge()
        if watch.course.updates:
            remarks = [*watch.doubts, *source.remarks, *([str(error)] if error is not None else [])]
            ended = source.ended or ("an error" if error is not None else "interrupted")
            summary = {"log": name, "ended": ended, "remarks": remarks} | watch.course.summary()
            statements = watch.course.state(remarks)
            content = summary | {"statements": [statement.to_json() for statement in statements]}
            text = common.json_text(machine.plant.units.keyed(content)) if json else _text(machine, summary, statements)
            common.show(text, *([] if out is None else [out]))
            show_page(remarks, ended)
    return _exit_code(interrupt, watch, error, name)


def _source(
    log: Path, machine: Machine, idle_s: float, speed: float, clock: HostClock, *, follow: bool
) -> SampleSource:
    """Where the samples come from. Raises InputError for an unreadable source."""
    from sgms_mhe.api import watching

    if str(log) == "-":
        return watching.Streamed(sys.stdin.buffer, watching.STDIN, machine, idle_s, clock)
    if common.is_stream(log):
        return watching.Streamed(log.open("rb", buffering=0), log, machine, idle_s, clock)
    if follow:
        return watching.Followed(log, machine, idle_s, clock)
    return watching.Replay(log, machine, speed, clock, common.note)


def _run(
    source: SampleSource,
    watch: Watch,
    interrupt: Interrupt,
    every_s: float,
    rows: GrowingEstimates | None,
    show_page: Callable[[Sequence[str]], None],
    *,
    judged: bool,
) -> InputError | None:
    """Watch until the source ends, somebody asks for it, or something is wrong; that."""
    told, next_line, next_page = 0, -math.inf, -math.inf
    try:
        for piece in source.pieces(interrupt.has_request):
            if piece is not None:
                estimates = watch.take(piece, judged=judged)
                if rows is not None:
                    rows.append(estimates)
            for doubt in watch.doubts[told:]:
                common.note(doubt)
            told, last = len(watch.doubts), watch.course.latest
            if last is not None and last.time_s[0] >= next_line:
                next_line = (last.time_s[0] // every_s + 1.0) * every_s
                common.note(_line(watch.course, last))
            if last is not None and time.monotonic() >= next_page:
                show_page(watch.doubts)
                next_page = time.monotonic() + PAGE_S
    except InputError as error:
        return error
    return None


def _exit_code(interrupt: Interrupt, watch: Watch, error: InputError | None, name: str) -> int:
    """Return the exit code of a run.

    Raises:
        InputError: the cause that ended the run, or that there was no update.
    """
    if error is not None:
        raise error
    if interrupt.number:
        common.note(f"Interrupted after {watch.course.updates} updates.")
        return 128 + interrupt.number
    if not watch.course.updates:
        from sgms_mhe.api.estimation import check_length

        check_length(watch.course.samples, name, watch.course.machine)
    return bool(watch.doubts)


def _line(course: RunSummary, last: Estimates) -> str:
    """The newest update in a line."""
    from sgms_mhe.evaluation.watching import status_words

    units = course.machine.plant.units
    parameters = [
        f"{units.named(name)} {interval(value, std)}"
        for name, value, std in zip(course.names, last.parameters[0], last.std[0], strict=True)
    ]
    friction = f"friction {last.friction_N[0]:.4g} {units.force}, test ratio {last.test_ratio[0]:.3g}"
    still = [f"open: {' '.join(map(units.named, course.open_numbers))}"] if course.open_numbers else []
    return ", ".join([f"{last.time_s[0]:.2f} s: {status_words(int(last.status[0]))}", friction, *parameters, *still])


def _text(machine: Machine, summary: dict[str, Any], statements: Sequence[Statement]) -> str:
    """The summary for people."""
    units, greatest = machine.plant.units, summary["greatest_test_ratio"]
    shown = {kind: [s.sentence for s in statements if s.kind == kind] for kind in ("verdict", "fault", "log")}
    shown["open"] = [f"open: {s.advice}" for s in statements if s.kind == "number" and s.sure == "no"]
    more = [f"  and {summary['faults'] - SHOWN} more"] if summary["faults"] > SHOWN else []
    return "\n".join(
        [
            f"{summary['machine']}, {summary['log']}: ended, {summary['ended']}",
            f"{summary['samples']} samples, {summary['missing_samples']} missing; "
            f"{common.updates_text(units, summary)}",
            common.parameters_text(units, summary["parameters"]),
            f"greatest test ratio {greatest['value']:.4g} at {greatest['time_s']:.2f} s",
            *(*shown["verdict"], *shown["fault"][:SHOWN], *more, *shown["log"], *shown["open"]),
        ]
    )
