"""Logs with something wrong at random, through the command line: understood or refused; no traceback, no endless work.

Each mutated log is inspected. One that is read is then estimated, predicted, identified, ... along.
"""

import resource
import signal
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from click.testing import CliRunner

from sgms_bench.logs.cases import Rng, draw_truth
from sgms_bench.logs.dialects import DIALECTS, Dialect
from sgms_bench.logs.formats import FORMATS
from sgms_bench.logs.layouts import Channel
from sgms_bench.verification.outcome import CheckOutcome
from sgms_mhe.cli import cli
from sgms_mhe.machine.writing import toml_table
from sgms_mhe.signals.logs import Log

LONGEST_S: Final = 60.0
"""For a log of some hundred samples; an endless loop takes longer."""
LARGEST_MB: Final = 2048.0
SAMPLES: Final = 600
TEXTS: Final = (".csv", ".txt", ".tsv", ".dat", ".asc")


def _write_as(name: str) -> Callable[[Path, Log], None]:
    """Writer of a log in a format of drawn logs that has no dialect of its own."""

    def write(path: Path, log: Log) -> None:
        clock = 1e3 * log.time_s if FORMATS[name].clock == "ms" else log.time_s
        channels = [Channel("ActPos", "mm", 1e3 * log.position_m), Channel("ActForce", "N", log.force_N)]
        FORMATS[name].write(path, [Channel("time", "", clock), *channels])

    return write


FORMS: Final[Mapping[str, Dialect]] = DIALECTS | {
    name: Dialect(FORMATS[name].suffix, _write_as(name))
    for name in ("scope, pairs", "scope, one time", "long format", "MAT, ControlDesk", "MAT, Simulink Scope")
}
"""Dialects, and layouts that are more than a table."""


@lru_cache
def trace() -> tuple[Log, str]:
    """A short log of a linear axis at 1 kHz, and the text of its machine file."""
    truths = (draw_truth(np.random.default_rng(seed)) for seed in range(1000))
    truth = next(t for t in truths if t.axis.kind == "linear" and t.log.rate == 1000.0)
    log, part = truth.log, slice(1500, 1500 + SAMPLES)
    short = Log(log.time_s[:SAMPLES], log.position_m[part], log.force_N[part], log.rate)
    return short, truth.axis.machine_file(log.rate, truth.fastest)


@lru_cache
def original(name: str) -> bytes:
    """Content of the short log in a dialect."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"log{FORMS[name].suffix}"
        FORMS[name].write(path, trace()[0])
        return path.read_bytes()


# --- what is changed ----------------------------------------------------------------------------------------------


def _flip_bytes(content: bytes, rng: Rng) -> bytes:
    changed = bytearray(content)
    for at in rng.integers(len(changed), size=rng.integers(1, 9)):
        changed[at] = rng.integers(256)
    return bytes(changed)


def _cut(content: bytes, rng: Rng) -> bytes:
    first, last = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    return content[:first] if rng.random() < 0.5 else content[:first] + content[last:]


def _by_lines(change: Callable[[list[bytes], Rng], list[bytes]]) -> Callable[[bytes, Rng], bytes]:
    return lambda content, rng: b"\n".join(change(content.split(b"\n"), rng))


def _draw_span(lines: list[bytes], rng: Rng) -> tuple[int, int]:
    first, last = sorted(rng.integers(0, len(lines) + 1, 2).tolist())
    return first, last


def _order(lines: list[bytes], rng: Rng) -> list[bytes]:
    """Turn a stretch round, exchange two, or shuffle all."""
    first, last = _draw_span(lines, rng)
    kind = rng.integers(3)
    if kind == 0:
        return lines[:last] + lines[first:]
    if kind == 1:
        return lines[:first] + lines[first:last][::-1] + lines[last:]
    return [lines[k] for k in rng.permutation(len(lines))]


def _leave_gap(lines: list[bytes], rng: Rng) -> list[bytes]:
    first, last = _draw_span(lines, rng)
    return lines[:first] + lines[last:]


def _repeat(lines: list[bytes], rng: Rng) -> list[bytes]:
    """Repeat a line, or a stretch of them, up to a few hundred times."""
    first, last = _draw_span(lines, rng)
    last = min(last, first + int(rng.integers(1, 4)))
    return lines[:last] + lines[first:last] * int(rng.integers(1, 300)) + lines[last:]


CONSTANT: Final = (b"0", b"1", b"-3.5", b"1e-9", b"7e5")
HUGE: Final = (b"1e308", b"-1e308", b"1e999", b"99999999999999999999", b"1" * 400, b"1e-320", b"9007199254740993")
ABSENT: Final = (b"nan", b"", b"NA", b"inf", b"-inf", b"null", b"--")
ODD: Final = (
    b"1,5", b"1.234.567", b"text", b'"', b"#", b"2026-01-01T00:00:00Z", b"25:61:61", b"\xb5m", b"[mm]", b"\x00", b"-1",
)  # fmt: skip


def _put(values: Sequence[bytes]) -> Callable[[list[bytes], Rng], list[bytes]]:
    """Replace fields of one column: one, a stretch, or all."""

    def change(lines: list[bytes], rng: Rng) -> list[bytes]:
        separator = max((b",", b";", b"\t", b"|", b" "), key=lines[len(lines) // 2].count)
        column, value = int(rng.integers(4)), values[int(rng.integers(len(values)))]
        first, last = _draw_span(lines, rng)
        chosen = [range(first, min(first + 1, len(lines))), range(first, last), range(len(lines))][rng.integers(3)]
        changed = list(lines)
        for k in chosen:
            fields = changed[k].split(separator)
            if column < len(fields):
                fields[column] = value
            changed[k] = separator.join(fields)
        return changed

    return change


def _rearrange(lines: list[bytes], rng: Rng) -> list[bytes]:
    """Leave columns out, double them, put them in another order."""
    separator = max((b",", b";", b"\t", b"|"), key=lines[len(lines) // 2].count)
    order = rng.integers(0, 6, rng.integers(1, 9)) if rng.random() < 0.5 else rng.permutation(6)[: rng.integers(1, 7)]
    parts = [line.split(separator) for line in lines]
    return [separator.join(fields[k] for k in order if k < len(fields)) for fields in parts]


UNITS: Final = (b"m", b"mm", b"um", b"s", b"ms", b"us", b"N", b"kN", b"deg", b"A", b"counts", b"rpm", b"furlong", b"")


def _rename_units(content: bytes, rng: Rng) -> bytes:
    """Put another unit into the first lines."""
    head, tail = content[:400], content[400:]
    for _ in range(int(rng.integers(1, 4))):
        old, new = UNITS[rng.integers(len(UNITS) - 1)], UNITS[rng.integers(len(UNITS))]
        head = head.replace(old, new)
    return head + tail


MUTATIONS: Final[Mapping[str, Callable[[bytes, Rng], bytes]]] = {
    "bytes": _flip_bytes,
    "cut off": _cut,
    "columns": _by_lines(_rearrange),
    "units": _rename_units,
    "order": _by_lines(_order),
    "gaps": _by_lines(_leave_gap),
    "repeated": _by_lines(_repeat),
    "constant": _by_lines(_put(CONSTANT)),
    "huge": _by_lines(_put(HUGE)),
    "NaN": _by_lines(_put(ABSENT)),
    "odd fields": _by_lines(_put(ODD)),
}
"""Changes of a file's content; all but the first two are for texts."""

FLAGS: Final[Sequence[tuple[str, ...]]] = (
    ("--rate", "1000"), ("--unit", "position=deg"), ("--unit", "time=ms"), ("--wrap", "1e-3"), ("--wrap", "360"),
    ("--force-scale", "-35"), ("--unit", "position=counts"), ("--unit", "force=A", "--force-scale", "1e9"),
)  # fmt: skip

COMMANDS: Final[Mapping[str, float]] = {
    "estimate": 0.3, "predict": 0.25, "watch": 0.1, "compare": 0.05, "tune": 0.05, "identify": 0.15, "diagnose": 0.05,
    "start": 0.05,
}  # fmt: skip
"""Commands that follow where a log is read, with their shares."""
ALSO_REFUSED: Final = 0.2
"""Share of the logs that are not read, along which a command runs too."""


# --- what came ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Trial:
    """Outcome of one mutated log.

    Attributes:
        kind: of the mutation.
        came: "read", "refused", "no log".
        command: that followed; empty where none did.
        failure: a traceback, too much time or memory; empty where there is none.
    """

    kind: str
    came: str
    command: str = ""
    failure: str = ""


class _TooLongError(BaseException):
    """The time is over: no handler of errors catches it."""


@contextmanager
def _limit(seconds: float) -> Iterator[None]:
    def stop(*_: object) -> None:
        raise _TooLongError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _run(*arguments: str | Path) -> tuple[int, str]:
    """(exit code, failure) of a command in this process."""
    started = time.monotonic()
    words = [str(argument) for argument in arguments]
    try:
        with _limit(2.0 * LONGEST_S):
            result = CliRunner().invoke(cli, words)
    except _TooLongError:
        return 1, f"{words[0]}: no end within {2.0 * LONGEST_S:g} s"
    if time.monotonic() - started > LONGEST_S:
        return 1, f"{words[0]}: {time.monotonic() - started:.0f} s"
    if result.exit_code not in (0, 1, 2) or not isinstance(result.exception, SystemExit | None):
        error = result.exception
        shown = "".join(traceback.format_exception(error)) if error is not None else result.output
        return 1, f"{' '.join(words)}: {shown}"
    if "Usage: " in result.output:
        return 1, f"{' '.join(words)}: {result.output}"
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return result.exit_code, f"{words[0]}: {memory:.0f} MB" if memory > LARGEST_MB else ""


def try_mutation(folder: Path, seed: int) -> Trial:
    """Change a log, inspect it, and run another command along it where it is read."""
    rng = np.random.default_rng(seed)
    names = [name for name in FORMS if name not in FORMATS or FORMATS[name].is_there]
    name = names[rng.integers(len(names))]
    dialect = FORMS[name]
    kinds = list(MUTATIONS)[: None if dialect.suffix in TEXTS else 2]
    kind = kinds[rng.integers(len(kinds))]
    path, machine, table = folder / f"log{dialect.suffix}", folder / "drawn.toml", folder / "table.toml"
    path.write_bytes(MUTATIONS[kind](original(name), rng))
    machine.write_text(trace()[1])
    table.write_text("\n".join(toml_table("[log]", dict(dialect.log))))
    own = ("--log", str(table)) if dialect.log else ()
    options = (*own, *_draw_flags(rng))
    code, failure = _run("inspect", path, *options, *(("--json",) if rng.random() < 0.5 else ()))
    came = ("read", "refused", "no log")[code]
    if failure or (code and rng.random() > ALSO_REFUSED):
        return Trial(kind, came, failure=f"seed {seed}: {failure}" if failure else "")
    command = str(rng.choice(list(COMMANDS), p=list(COMMANDS.values())))
    _, failure = _run(command, *_arguments(command, path, machine, folder), *options)
    return Trial(kind, came, command, f"seed {seed}: {failure}" if failure else "")


def _draw_flags(rng: Rng) -> tuple[str, ...]:
    return FLAGS[int(rng.integers(len(FLAGS)))] if rng.random() < 0.3 else ()


def _arguments(command: str, log: Path, machine: Path, folder: Path) -> list[str | Path]:
    out = {"identify": "found.toml", "start": "found.toml", "diagnose": "diagnosis"}.get(command, "out.csv")
    owner: list[str | Path] = [] if command in ("identify", "start") else [machine]
    more: dict[str, list[str | Path]] = {"watch": ["--speed", "max"], "start": ["--mass", "3", "--rate", "1000"]}
    ends: list[str | Path] = [] if command in ("compare", "tune") else ["--out", folder / out]
    return [*owner, log, *more.get(command, []), *ends]


def check_logs(seeds: Sequence[int], progress: Callable[[str], None]) -> list[CheckOutcome]:
    """Try mutations, one after the other; an outcome for each kind."""
    trials = []
    with TemporaryDirectory() as folder:
        for count, seed in enumerate(seeds, start=1):
            trials.append(try_mutation(Path(folder), seed))
            if trials[-1].failure:
                progress(trials[-1].failure)
            if count % TOLD_EVERY == 0:
                progress(f"mutated logs: {count} of {len(seeds)}")
    return [
        CheckOutcome(f"mutated logs: {kind}", _summary(own), tuple(t.failure for t in own if t.failure))
        for kind in MUTATIONS
        if (own := [trial for trial in trials if trial.kind == kind])
    ]


def _summary(trials: Sequence[Trial]) -> str:
    came = Counter(trial.came for trial in trials)
    counts = ", ".join(f"{came[name]} {name}" for name in ("read", "refused", "no log"))
    return f"{len(trials)}: {counts}; {sum(bool(trial.command) for trial in trials)} commands along them"


TOLD_EVERY: Final = 500
