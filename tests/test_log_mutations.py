"""Logs with something wrong, at random: understood or refused with a message; no traceback, no endless work.

    python tests/test_log_mutations.py 10000

tries so many, and prints what came of each kind.
"""

from __future__ import annotations

import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
import pytest
from scipy.io import savemat

from cli_cases import run
from log_dialects import trace
from sgms_bench.logs.dialects import DIALECTS, Dialect
from sgms_bench.logs.layouts import Channel, control_desk, events, long_rows, scope
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.machine.writing import toml_table
from sgms_mhe.signals.logs import Log
from test_dialects import library_absent

Rng = np.random.Generator
LONGEST_S: Final = 20.0
"""For a log of some hundred samples; an endless loop takes longer."""
TEXTS: Final = (".csv", ".txt", ".tsv", ".dat", ".asc")


def scope_export(path: Path, log: Log, *, paired: bool) -> None:
    at = 1e3 * log.time_s
    scope(path, [("ActPos", "mm", at, 1e3 * log.position_m), ("Force", "N", at, log.force_N)], paired=paired)


def long_text(path: Path, log: Log) -> None:
    events(path, long_rows(log.time_s, [("x [m]", log.position_m), ("F [N]", log.force_N)]), "t [s],name,value")


def struct_array(path: Path, log: Log) -> None:
    position, force = Channel("ActPos", "mm", 1e3 * log.position_m), Channel("Force", "N", log.force_N)
    savemat(path, {"rec": control_desk([(log.time_s, [position]), (log.time_s, [force])])})


FORMS: Final[dict[str, Dialect]] = DIALECTS | {
    "scope, pairs": Dialect(".csv", lambda path, log: scope_export(path, log, paired=True)),
    "scope, one time": Dialect(".csv", lambda path, log: scope_export(path, log, paired=False)),
    "long format": Dialect(".csv", long_text),
    "MAT, array of structs": Dialect(".mat", struct_array),
}


@lru_cache
def original(name: str) -> bytes:
    """A short trace in a dialect."""
    log = trace()
    short = Log(log.time_s[:400], log.position_m[:400], log.force_N[:400], log.rate)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"log{FORMS[name].suffix}"
        FORMS[name].write(path, short)
        return path.read_bytes()


def flipped(content: bytes, rng: Rng) -> bytes:
    changed = bytearray(content)
    for at in rng.integers(len(changed), size=rng.integers(1, 9)):
        changed[at] = rng.integers(256)
    return bytes(changed)


def cut(content: bytes, rng: Rng) -> bytes:
    first, last = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    return content[:first] if rng.random() < 0.5 else content[:first] + content[last:]


def in_lines(change: Callable[[list[bytes], Rng], list[bytes]]) -> Callable[[bytes, Rng], bytes]:
    return lambda content, rng: b"\n".join(change(content.split(b"\n"), rng))


def moved_lines(lines: list[bytes], rng: Rng) -> list[bytes]:
    kind = rng.integers(4)
    first, last = sorted(rng.integers(0, len(lines) + 1, 2).tolist())
    if kind == 0:
        return lines[:first] + lines[last:]
    if kind == 1:
        return lines[:last] + lines[first:]
    if kind == 2:
        return lines[:first] + lines[first:last][::-1] + lines[last:]
    return [lines[k] for k in rng.permutation(len(lines))]


ODD: Final = (
    b"nan", b"", b"inf", b"-1e308", b"1e999", b"0", b"1,5", b"1.234.567", b"text", b'"', b"#", b"99999999999999999999",
    b"1e-320", b"2026-01-01T00:00:00Z", b"25:61:61", b"\xb5m", b"[mm]", b"\x00", b"--", b"1" * 400,
)  # fmt: skip
"""What a field may hold that no sample has."""


def odd_fields(lines: list[bytes], rng: Rng) -> list[bytes]:
    """Fields of one column replaced: one, a stretch, or all."""
    separator = max((b",", b";", b"\t", b"|", b" "), key=lines[len(lines) // 2].count)
    column, what = int(rng.integers(4)), ODD[rng.integers(len(ODD))]
    first, last = sorted(rng.integers(0, len(lines) + 1, 2).tolist())
    chosen = [range(first, min(first + 1, len(lines))), range(first, last), range(len(lines))][rng.integers(3)]
    changed = list(lines)
    for k in chosen:
        fields = changed[k].split(separator)
        if column < len(fields):
            fields[column] = what
        changed[k] = separator.join(fields)
    return changed


def swapped_columns(lines: list[bytes], rng: Rng) -> list[bytes]:
    separator = max((b",", b";", b"\t", b"|"), key=lines[len(lines) // 2].count)
    order = rng.permutation(8)[: rng.integers(1, 9)]
    parts = [line.split(separator) for line in lines]
    return [separator.join(fields[k] for k in order if k < len(fields)) for fields in parts]


MUTATIONS: Final[dict[str, Callable[[bytes, Rng], bytes]]] = {
    "bytes": flipped,
    "cut": cut,
    "lines": in_lines(moved_lines),
    "fields": in_lines(odd_fields),
    "columns": in_lines(swapped_columns),
}
FLAGS: Final[Sequence[tuple[str, ...]]] = (
    (), ("--rate", "1000"), ("--unit", "position=deg"), ("--unit", "time=ms"), ("--wrap", "1e-3"), ("--wrap", "360"),
    ("--force-scale", "-35"), ("--unit", "position=counts"), ("--unit", "force=A", "--force-scale", "1e9"),
)  # fmt: skip


def outcome(folder: Path, seed: int) -> tuple[str, str]:
    """(mutation, what came of it) of one seed: read, refused, no log, or what must not be."""
    rng = np.random.default_rng(seed)
    names = [name for name in FORMS if name not in DIALECTS or not library_absent(name)]
    name = names[rng.integers(len(names))]
    dialect = FORMS[name]
    kinds = list(MUTATIONS) if dialect.suffix in TEXTS else ["bytes", "cut"]
    kind = kinds[rng.integers(len(kinds))]
    path = folder / f"log{dialect.suffix}"
    path.write_bytes(MUTATIONS[kind](original(name), rng))
    flags = FLAGS[rng.integers(len(FLAGS))] if rng.random() < 0.4 else ()
    started = time.monotonic()
    own = ("--log", _table(folder, name)) if dialect.log else ()
    result = run("inspect", path, *own, *flags, *(["--json"] if rng.random() < 0.5 else []))
    if time.monotonic() - started > LONGEST_S:
        return kind, f"seed {seed}: took long"
    if result.exit_code not in (0, 1, 2) or not isinstance(result.exception, SystemExit | None):
        error = result.exception
        return kind, f"seed {seed}: {''.join(traceback.format_exception(error)) if error else result.output}"
    return kind, ("read", "refused", "no log")[result.exit_code]


def _table(folder: Path, name: str) -> Path:
    path = folder / "table.toml"
    path.write_text("\n".join(toml_table("[log]", dict(FORMS[name].log))))
    return path


@pytest.mark.parametrize("part", range(6))
def test_no_log_trips_the_reader(part: int, tmp_path: Path) -> None:
    found = [outcome(tmp_path, seed) for seed in range(40 * part, 40 * (part + 1))]
    assert [came for _, came in found if came.startswith("seed")] == []
    assert {came for _, came in found} == {"read", "refused", "no log"}  # the mutations reach every end


@pytest.mark.parametrize("name", [name for name in FORMS if name not in DIALECTS])
def test_what_is_mutated_is_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"log{FORMS[name].suffix}"
    path.write_bytes(original(name))
    assert len(read_log(path)) == 400


if __name__ == "__main__":
    count, wrong = Counter[tuple[str, str]](), 0
    with TemporaryDirectory() as scratch:
        for number in range(int(sys.argv[1])):
            mutation, came = outcome(Path(scratch), number + int(sys.argv[2] if len(sys.argv) > 2 else 0))
            if came.startswith("seed"):
                wrong += 1
                print(mutation, came, flush=True)
                came = "wrong"
            count[mutation, came] += 1
    for (mutation, came), number in sorted(count.items()):
        print(f"{mutation:10}{came:10}{number:7}")
    print(f"wrong: {wrong}")
