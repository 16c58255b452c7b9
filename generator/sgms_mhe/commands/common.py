"""Parts that commands share: arguments, checks of outputs before the work, progress, printing of results."""

from __future__ import annotations

import json
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from sgms_mhe.support.errors import InputError
from sgms_mhe.support.json_values import finite
from sgms_mhe.support.numbers import interval
from sgms_mhe.support.tables import align_columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sgms_mhe.machine import Machine, Units
    from sgms_mhe.signals.logs import Log

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

LINE_S: Final = 30.0
"""Between two lines of progress where no terminal shows a bar."""
LONGEST_LOOK_S: Final = 2.0
"""A bar that was not looked at for longer was not running."""

# --- inputs ----------------------------------------------------------------------------------------------------------


def recorded_log(path: Path, machine: Machine, *, commanded: bool = False, driven: bool = False) -> Log:
    """Read a log an axis of this machine can have left; `commanded`, `driven`: as `inputs.recorded_log` has them.

    Raises:
        InputError: it cannot be read, or its columns contradict their names.
    """
    from sgms_mhe.api import inputs

    return inputs.recorded_log(path, machine, commanded=commanded, driven=driven, note=note)


# --- outputs, checked before the work that they are to receive -------------------------------------------------------


def check_output_file(path: Path, suffixes: Sequence[str] = ()) -> None:
    """Refuse an output file that could not be written at the end: its folder must exist and take a file.

    Raises:
        InputError: names the path and the allowed forms.
    """
    if path.is_dir():
        raise InputError(path, "output file", None, "a file; this is a folder")
    if is_stream(path):
        return
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(path, "output file", path.name, f"a name that ends in {' or '.join(suffixes)}")
    folder = path.resolve().parent
    if not folder.is_dir():
        raise InputError(path, "output file", None, f"a file in a folder that exists; {folder} does not")
    _try_folder(path, folder, "output file")


def check_output_folder(path: Path) -> None:
    """Refuse an output folder that cannot be made or written to. Makes nothing itself.

    Raises:
        InputError: names the path and the allowed forms.
    """
    folder = path.resolve()
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(path, "output folder", None, f"a folder; {folder} is a file")
    _try_folder(path, folder, "output folder")


def _try_folder(path: Path, folder: Path, where: str) -> None:
    # Permissions do not say it all (read-only file systems, the superuser): a nameless file does.
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(path, where, None, f"a place that can be written ({error.strerror}: {folder})") from None


def is_stream(path: Path) -> bool:
    """Return True if a path is written as it goes: a pipe, a terminal, /dev/stdout."""
    return path.exists() and not path.is_file() and not path.is_dir()


def make_folder(path: Path) -> None:
    """Make an output folder and those above it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(path, "output folder", None, f"a folder that can be made ({error.strerror})") from None


def save_figures(folder: Path, figures: Mapping[str, Figure]) -> None:
    """Save figures by the names of their files in an output folder, and say so."""
    from sgms_mhe.evaluation.plots import save_figure

    make_folder(folder)
    for name, figure in figures.items():
        save_figure(folder / name, figure)
        note(f"drawn: {folder / name}")


# --- results and messages --------------------------------------------------------------------------------------------


def show(text: str, *outputs: Path) -> None:
    """Print a result on stdout, or on stderr where one of the command's output files is a stream already."""
    click.echo(text, err=any(is_stream(path) for path in outputs))


def note(text: str) -> None:
    """Print a message on stderr, but where --quiet was given."""
    if not is_quiet():
        click.echo(text, err=True)


def is_quiet() -> bool:
    """Return True if `sgms-mhe --quiet` runs this command."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.find_root().params.get("quiet"))


def _is_watched() -> bool:
    """Return True if progress is seen: on a terminal, without --quiet."""
    return sys.stderr.isatty() and not is_quiet()


def note_broken_effects() -> None:
    """Say which effects of other distributions are left out where all effects are asked for."""
    from sgms_mhe.model.effects import broken_effects

    for error in broken_effects():
        note(f"left out: {error}")


def json_text(content: Any) -> str:
    """JSON with every number that is not finite as null."""
    return json.dumps(finite(content), indent=2, allow_nan=False)


def parameters_text(units: Units, parameters: Mapping[str, Mapping[str, float]]) -> str:
    """A table of estimated parameters at the end: nominal, estimate and std of each."""
    rows = [
        (
            units.named(name),
            f"{p['nominal']:.6g}",
            interval(p["estimate"], p["std"]),
            f"{p['estimate'] / p['nominal']:.4f}" if p["nominal"] else "",
        )
        for name, p in parameters.items()
    ]
    return table_text(("parameter at the end", "nominal", "estimate +- 2 sigma", "ratio"), rows)


def updates_text(units: Units, summary: Mapping[str, Any]) -> str:
    """How many updates there were, when, and the residual of those with a measurement."""
    rms = summary["residual_rms_N"]
    residual = "no update had a measurement"
    if rms is not None:
        residual = f"measured minus estimated friction {rms:.4g} {units.force} rms"
    return (
        f"{summary['updates']} updates from {summary['start_s']:g} to {summary['end_s']:g} s, "
        f"{summary['measured']} with a measurement; {residual}"
    )


def table_text(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns, the first to the left, the others to the right."""
    return "\n".join(align_columns([header, *rows], [k == 0 for k in range(len(header))]))


@contextmanager
def steps_bar(elsewhere: Callable[[str], None] | None = None) -> Iterator[Callable[[str, float], None]]:
    """A bar with time left, where stderr is a terminal; yields a function of (step, share of the work before it).

    Args:
        elsewhere: called with each step where nobody watches.
    """
    with _bar() as move:

        def tell(step: str, share: float) -> None:
            move(step, share, f"{100.0 * share:.0f} %, {step}")
            if elsewhere is not None and not _is_watched():
                elsewhere(step)

        yield tell


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """A bar on stderr where that is a terminal; yields a function of (steps done, steps in all)."""
    # Even where nothing is shown, work that reports returns to the interpreter and can be interrupted.
    with _bar(label) as move:

        def tell(done: int, total: int) -> None:
            share = done / max(total, 1)
            move(label, share, f"{label}, {100.0 * share:.0f} %")

        yield tell


@contextmanager
def _bar(label: str = "") -> Iterator[Callable[[str, float, str], None]]:
    """A bar that goes when it is done; yields a function of step, share, and a line for other streams."""
    if not _is_watched():
        with _sparse_lines() as say:
            yield lambda step, share, line: say(line)
        return
    from rich import progress as rich
    from rich.console import Console

    times = (rich.TimeElapsedColumn(), rich.TextColumn("left"), rich.TimeRemainingColumn())
    columns = (rich.BarColumn(), rich.TaskProgressColumn(), *times, rich.TextColumn("{task.description}"))
    with rich.Progress(*columns, console=Console(stderr=True), transient=True, get_time=AwakeClock().now) as bar:
        task = bar.add_task(label, total=None)
        yield lambda step, share, line: bar.update(task, completed=share, total=1.0, description=step)


@contextmanager
def step_notes() -> Iterator[Callable[[str], None]]:
    """Steps of a long computation on stderr: each where that is a terminal, else a line now and then."""
    if _is_watched():
        yield note
        return
    with _sparse_lines() as say:
        yield say


@contextmanager
def _sparse_lines() -> Iterator[Callable[[str], None]]:
    """Yield a function of the present step, which is printed on stderr every `LINE_S`, but where --quiet was given."""
    began, ended, steps, quiet = time.monotonic(), threading.Event(), [""], is_quiet()

    def show_steps() -> None:
        while not ended.wait(LINE_S):
            if steps[0] and not quiet:
                click.echo(f"{time.monotonic() - began:.0f} s: {steps[0]}", err=True)

    thread = threading.Thread(target=show_steps, daemon=True)  # a step may take minutes, and reports nothing meanwhile
    thread.start()
    try:
        yield lambda step: steps.__setitem__(0, step)
    finally:
        ended.set()
        thread.join()


class AwakeClock:
    """Seconds a run has been awake, for a display polled a few times a second.

    Between two looks no more than `LONGEST_LOOK_S` have passed: a host that slept, or a process that was stopped, did
    nothing meanwhile, and the remaining time follows from the work done while they run.

    Args:
        clock: seconds since some moment.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._seen, self._awake = clock(), 0.0

    def now(self) -> float:
        """Seconds since it was made."""
        with self._lock:  # a bar is drawn by a thread of its own
            seen = self._clock()
            self._awake += min(max(seen - self._seen, 0.0), LONGEST_LOOK_S)
            self._seen = seen
            return self._awake
