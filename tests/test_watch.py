"""`watch`: the numbers of `estimate` from a log that comes in pieces, its ends and its faults, and what is shown of it.

`python tests/test_watch.py` prints the share of one core that following a 20 kHz log takes.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from cli_cases import SCRIPT, done, files, refused, run
from log_dialects import machine, trace
from record_cases import simulate_log
from sgms_bench.logs.dialects import DIALECTS
from sgms_mhe.api.estimation import estimate
from sgms_mhe.api.watching import Followed, Replay, SampleSource, Streamed, Watch
from sgms_mhe.configuration import override_machine
from sgms_mhe.evaluation.watching import TREND_POINTS, RunSummary, Trend, flags_of
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.logfiles.encoding import Decoder
from sgms_mhe.logfiles.following import FollowedText
from sgms_mhe.logfiles.reading import TEXTS, read_log
from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import Chain, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.errors import InputError
from statement_cases import check_statements

LIMIT_S = 300.0
"""Of what must happen at some time: a host that is kept busy must not decide."""
TEXT_DIALECTS = tuple(name for name, dialect in DIALECTS.items() if dialect.suffix in TEXTS)
TELLS_LATE = "groups of thousands"
"""The dialect whose first rows do not tell what its points are."""


@lru_cache
def holed() -> Log:
    """The trace with samples missing, in one channel, in both, at the beginning and across an update."""
    position, force = trace().position_m.copy(), trace().force_N.copy()
    position[:3] = force[500:520] = position[1000:1100] = force[1050:1120] = np.nan
    return Log(trace().time_s, position, force, 1000.0)


@lru_cache
def estimator() -> CompiledEstimator:
    return CompiledEstimator(machine())


@lru_cache
def text(name: str) -> bytes:
    """The trace in a dialect."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"log{DIALECTS[name].suffix}"
        DIALECTS[name].write(path, trace())
        return path.read_bytes()


def lines_of(log: Log, folder: Path) -> bytes:
    """A log as this package writes it."""
    write_log(folder / "whole.csv", log)
    return (folder / "whole.csv").read_bytes()


def cuts(length: int) -> st.SearchStrategy[list[int]]:
    """Where to cut something: anywhere, and often in its beginning, which tells what it is."""
    early = st.lists(st.integers(0, min(length, 6000)), max_size=30)
    return st.tuples(early, st.lists(st.integers(0, length), max_size=15)).map(lambda two: sorted([*two[0], *two[1]]))


def pieces(content: bytes, at: Sequence[int]) -> list[bytes]:
    ends = [0, *at, len(content)]
    return [content[a:b] for a, b in pairwise(ends)]


def followed(content: Sequence[bytes], reader: Machine, *, whole: bool = True) -> Iterator[Log]:
    follower = FollowedText(Path("log.csv"), reader)
    for piece in content:
        yield from follower.feed(piece)
    yield from follower.end(whole=whole)


def joined(logs: Sequence[Log]) -> dict[str, Any]:
    return {name: np.concatenate([log.columns[name] for log in logs]) for name in logs[0].columns}


def same(found: Estimates, wanted: Estimates) -> None:
    """To the last bit."""
    assert list(found.columns) == list(wanted.columns)
    for name, column in wanted.columns.items():
        np.testing.assert_array_equal(found.columns[name], column, err_msg=name)


def chained(parts: Sequence[Estimates]) -> Estimates:
    arrays = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name, value in vars(parts[0]).items()
        if isinstance(value, np.ndarray)
    }
    return Estimates(**arrays, parameter_names=parts[0].parameter_names, kind=parts[0].kind)


# --- texts that come in pieces ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in TEXT_DIALECTS if name != TELLS_LATE])
def test_every_text_gives_the_same_samples_in_pieces(name: str, tmp_path: Path) -> None:
    reader = override_machine(machine(), {"log": dict(DIALECTS[name].log)}) if DIALECTS[name].log else machine()
    path, content = tmp_path / f"log{DIALECTS[name].suffix}", text(name)
    path.write_bytes(content)
    wanted = read_log(path, reader).columns

    @settings(max_examples=8)
    @given(cuts(len(content)))
    def check(at: list[int]) -> None:
        found = joined(list(followed(pieces(content, at), reader)))
        for column, values in wanted.items():
            np.testing.assert_array_equal(found[column], values)

    check()


def test_what_the_first_rows_do_not_tell_is_asked_for() -> None:
    with pytest.raises(InputError, match=r'row 2 .*decimal = ","'):
        list(followed([text(TELLS_LATE)], machine()))
    told = override_machine(machine(), {"log": {"decimal": ","}})
    np.testing.assert_array_equal(joined(list(followed([text(TELLS_LATE)], told)))["force_N"], trace().force_N)


def rows(count: int, row: Callable[[int], str], header: str = "t [s];x [m];F [N]") -> bytes:
    return "\n".join([header, *map(row, range(count)), ""]).encode()


def test_a_decimal_mark_that_is_told_late_holds_where_nothing_speaks_against_it() -> None:
    reader = override_machine(machine(), {"log": {"time_s": {"variable": "t", "unit": "ms"}}})

    def row(k: int) -> str:
        return f"{k};{k};{k if k < 100 else f'{k},5'}"

    found = joined(list(followed([rows(200, row, "t;x [m];F [N]")], reader)))
    assert found["force_N"][[99, 100, 199]].tolist() == [99.0, 100.5, 199.5]
    with pytest.raises(InputError, match="line 102"):
        list(followed([rows(200, lambda k: row(k).replace(";50;", ";1.234;"), "t;x [m];F [N]")], reader))


def test_an_encoding_that_is_told_late_holds() -> None:
    def row(k: int) -> str:
        return f"{k * 1e-3:.3f};{k};{k * 0.5}" + ("\n# 5 µm" if k == 150 else "")

    content = rows(300, row)
    for encoded in (content, content.decode().encode("latin-1")):
        assert len(joined(list(followed([encoded], machine())))["force_N"]) == 300


def test_no_character_is_lost_between_two_pieces() -> None:
    content = f"{'# ' * 5000}µm\n"
    for encoded in (content.encode(), content.encode("latin-1")):
        decoder, first = Decoder(Path("log.csv"), None), encoded[:10_001]
        assert decoder.decode(first) + decoder.decode(encoded[10_001:], ended=True, whole=True) == content


@pytest.mark.parametrize(
    ("garbage", "message"),
    [
        ("0.200;1;2;3", "4 fields"),
        ("0.200;abc;2", "column x .*'abc'"),
        ("garbage", "1 fields"),
        ("0.2000;1", "2 fields"),
        ("0.300;1;2", "column time_s = 0.3: uniform time"),
        ("0.199;1;2", "duplicate time"),
        ("0.100;1;2", "time decreases"),
        (";1;2", "column time_s = nan"),
        ("0.200;1;2\x00", "text"),
    ],
)
@given(at=cuts(3000))
@settings(max_examples=8)
def test_all_before_a_row_that_is_none_is_kept(garbage: str, message: str, at: list[int]) -> None:
    def row(k: int) -> str:
        return garbage if k == 200 else f"{k * 1e-3:.3f};{0.001 * k};{0.5 * k}"

    follower, taken = FollowedText(Path("log.csv"), machine()), []
    with pytest.raises(InputError, match=message) as caught:
        for piece in pieces(rows(300, row), at):
            for log in follower.feed(piece):
                taken.append(log)  # noqa: PERF402  what came before the error counts
    assert "line 202" in str(caught.value)
    if "\x00" not in garbage:  # a text with zeros is none: the piece that they are in is refused
        assert sum(map(len, taken)) == 200


@pytest.mark.parametrize("factor", [1.0, 0.001, 2.0**-31])
def test_a_number_without_its_sign_is_refused_as_in_a_whole_log(factor: float, tmp_path: Path) -> None:
    """It was followed as a force of four thousand million."""
    true = np.round(5000.0 * np.sin(np.arange(4000) / 300.0 + 0.1)) * factor
    recorded = np.mod(true, 2.0**32 * factor).tolist()
    content = rows(4000, lambda k: f"{k * 1e-3:.3f};{0.001 * k};{recorded[k]!r}")
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(InputError) as whole:
        read_log(path, machine())
    counts = set()
    for at in ((), (700,), range(1, len(content), 997), range(1, len(content), 20000)):
        follower, taken = FollowedText(path, machine()), 0
        with pytest.raises(InputError) as caught:
            for piece in pieces(content, at):
                for log in follower.feed(piece):
                    taken += len(log)
        said, wanted = (re.sub(r", \d+ such jumps", "", str(error.value)) for error in (caught, whole))
        assert said == wanted and "signed number of 32 bits" in said
        counts.add(taken)
    assert len(counts) == 1 and 900 < counts.pop() < 2500
    for keys in ({"signed": 32}, {"wrap": 2.0**32 * factor}):
        reader = override_machine(machine(), {"log": {"force_N": keys}})
        try:
            found = joined(list(followed(pieces(content, range(1, len(content), 997)), reader)))["force_N"]
        except InputError as error:  # its first rows do not tell the period of a scaled one
            assert factor != 1.0 and "signed" in keys and "wrap = 2^32 times the step" in str(error)
        else:
            np.testing.assert_allclose(found, true, atol=1e-9 * 5000.0 * factor)


def test_a_line_without_its_end_is_no_sample_until_it_is_whole() -> None:
    content = rows(100, lambda k: f"{k * 1e-3:.3f};{k};{k * 0.5}").rstrip(b"\n")
    cut = content[:-1]  # 49.5 would read as 49.
    follower = FollowedText(Path("log.csv"), machine())
    logs = [*follower.feed(cut), *follower.end(whole=False)]
    assert len(joined(logs)["force_N"]) == 99
    assert "no end" in follower.left_out[0]
    assert joined(list(followed([content], machine(), whole=True)))["force_N"][-1] == 49.5


def test_a_summary_is_left_out_and_words_before_a_sample_are_not() -> None:
    content = rows(100, lambda k: f"{k * 1e-3:.3f};{k};{k * 0.5}")
    follower = FollowedText(Path("log.csv"), machine())
    logs = [*follower.feed(content + b"Mean;1;2\nEnd\n"), *follower.end(whole=True)]
    assert len(joined(logs)["force_N"]) == 100
    assert follower.left_out == ("2 lines after the last sample are left out, the first: Mean;1;2",)
    with pytest.raises(InputError, match=r"row 101 \(line 102\)"):
        list(followed([content + b"Mean;1;2\n0.1;1;2\n"], machine()))


SCALED = b"Name\tActPos\tForce\nInterval(ms)\t1\t1\nUnit\tmm\tN\nScaleFactor\t0.001\t1\n"


@pytest.mark.parametrize(
    ("content", "log", "message"),
    [
        (b"", {}, "nothing"),
        (b"no numbers here\n" * 5000, {}, "no row of numbers"),
        (rows(80, lambda k: f"{k};{k};{k}", "t;x;F"), {}, "without a unit"),
        (rows(80, lambda k: f"{k * 2e-3:.3f};{k};{k}"), {}, "500 Hz"),
        (rows(80, lambda k: f"{k * 2e-3:.3f};{k};{k}"), {"resample": True}, "500 Hz"),
        (rows(80, lambda k: f"{(k + k % 2 * 0.3) * 1e-3:.5f};{k};{k}"), {"resample": True}, "replay it without"),
        (b"x" * 1_100_000, {}, "a line end within"),
        (SCALED + rows(80, lambda k: f"{k}\t{k}\t{k}", "").lstrip(), {}, "key rows .* without --follow"),
    ],
)
def test_what_cannot_be_followed_is_refused(content: bytes, log: dict[str, Any], message: str) -> None:
    reader = override_machine(machine(), {"log": log}) if log else machine()
    with pytest.raises(InputError, match=message):
        list(followed([content], reader))


# --- the estimator, and what its updates come to ----------------------------------------------------------------


@settings(max_examples=20)
@given(cuts(4000))
def test_an_estimator_goes_on_where_it_was(at: list[int]) -> None:
    ends = [0, *at, len(holed())]
    running, aligned, signals = estimator().running(), estimator().running(), signals_from_log(holed(), machine())
    parts, past = [], []
    for a, b in pairwise(ends):
        part = Log(holed().time_s[a:b], holed().position_m[a:b], holed().force_N[a:b], 1000.0)
        parts.append(running.take(part))
        past.append(aligned.take(signals.part(slice(a, b))))
    same(chained(parts), estimator().estimate_log(holed()))
    same(chained(past), estimator().estimate(signals))


OWN = ("velocity_m_s", "acceleration_m_s2", "friction_N")
"""Columns that take the place of what is computed."""


def with_own(log: Log, columns: Sequence[str]) -> Log:
    """A log with columns of its own, with holes of theirs."""
    velocity = np.gradient(trace().position_m, trace().time_s)
    own = {"velocity_m_s": velocity, "acceleration_m_s2": np.gradient(velocity, trace().time_s)}
    own["friction_N"] = trace().force_N - 19.0 * own["acceleration_m_s2"]
    for k, values in enumerate(own.values()):
        values[700 + 20 * k : 740 + 25 * k] = np.nan
    return replace(log, **{name: own[name] for name in columns})


@pytest.mark.parametrize("columns", [c for n in range(4) for c in combinations(OWN, n)], ids="+".join)
def test_the_signal_chain_goes_on_where_it_was(columns: tuple[str, ...]) -> None:
    log = with_own(holed(), columns)
    whole = signals_from_log(log, machine())

    @settings(max_examples=15)
    @given(cuts(len(log)))
    def check(at: list[int]) -> None:
        chain, ends = Chain(machine()), sorted({0, *(k for k in at if k > 3), len(log)})  # a reading in the first piece
        cut = [
            chain.take(replace(log, **{name: values[a:b] for name, values in log.columns.items()}))
            for a, b in pairwise(ends)
        ]
        for name, values in vars(whole).items():
            if isinstance(values, np.ndarray):
                np.testing.assert_array_equal(np.concatenate([vars(part)[name] for part in cut]), values, err_msg=name)
        assert {part.delay for part in cut} == {whole.delay}

    check()


@pytest.mark.parametrize("columns", [OWN[:1], OWN[2:], (OWN[0], OWN[2]), OWN], ids="+".join)
def test_a_log_with_signals_of_its_own_is_followed(columns: tuple[str, ...], tmp_path: Path) -> None:
    log = replace(with_own(holed(), columns), position_m=np.where(np.arange(len(holed())) < 3, 0.0, holed().position_m))
    content = lines_of(log, tmp_path)
    wanted = estimate(machine(), tmp_path / "whole.csv")
    for at in ([], list(range(1, len(content), 7001))):
        watch = Watch(machine())
        same(chained([watch.take(part, judged=False) for part in followed(pieces(content, at), machine())]), wanted)
        assert watch.course.samples == len(log)
        assert watch.course.missing == np.count_nonzero(signals_from_log(log, machine()).missing)


def test_signals_of_its_own_and_no_reading_to_begin_with_are_refused(tmp_path: Path) -> None:
    content, watch = lines_of(with_own(holed(), OWN[:1]), tmp_path), Watch(machine())
    with pytest.raises(InputError, match=r"first sample, position_m = nan: .* replay it without --follow"):
        for part in followed([content], machine()):
            watch.take(part, judged=False)


@settings(max_examples=15)
@given(cuts(150_000))
def test_nothing_depends_on_the_pieces(at: list[int]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        content = lines_of(holed(), Path(folder))
        wanted = estimate(machine(), Path(folder) / "whole.csv")
    watch = Watch(machine())
    same(chained([watch.take(log, judged=False) for log in followed(pieces(content, at), machine())]), wanted)
    whole = RunSummary(machine(), estimator().model)
    whole.samples, whole.missing = len(holed()), int(np.isnan(holed().position_m + holed().force_N).sum())
    whole.add(wanted)
    assert json.dumps(watch.course.summary()) == json.dumps(whole.summary())
    np.testing.assert_array_equal(watch.course.trend.points, whole.trend.points)
    np.testing.assert_array_equal(watch.course.recent, whole.recent)


def test_a_course_says_what_the_estimates_say() -> None:
    wanted = estimator().estimate_log(holed())
    course = RunSummary(machine(), estimator().model)
    course.add(wanted)
    found = course.summary()
    taken = (wanted.status >= 0) & (wanted.status & 2 == 0)
    assert found["updates"] == len(wanted) and found["measured"] == taken.sum() < len(wanted)
    residual = (wanted.friction_measured_N - wanted.friction_N)[taken]
    assert found["residual_rms_N"] == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-12)
    top = int(np.nanargmax(wanted.test_ratio))
    assert found["greatest_test_ratio"] == {"value": wanted.test_ratio[top], "time_s": wanted.time_s[top]}
    assert found["status"]["missing"] == (~taken).sum() and found["status"]["good"] == (wanted.status == 0).sum()
    assert found["status_s"]["missing"] == pytest.approx(0.02 * (~taken).sum())
    for k, name in enumerate(wanted.parameter_names):
        assert found["parameters"][name]["estimate"] == wanted.parameters[-1, k]
        assert found["parameters"][name]["std"] == wanted.std[-1, k]
    lost = wanted.time_s[~taken & (wanted.time_s > 0.3)]  # the signal chain settles before
    stretches = [episode for episode in found["episodes"] if episode["fault"] == "missing"]
    assert stretches[0]["start_s"] == lost[0]
    assert sum(e["updates"] for e in stretches) == len(lost)


@pytest.mark.parametrize("size", [200, 25, 1])
def test_stretches_with_a_fault_that_are_near_are_one(size: int) -> None:
    wanted = estimator().estimate_log(trace())
    status = np.zeros(len(wanted), dtype=np.int64)
    status[[10, 11, 30, 120, 121]] = 64
    status[20:25] = 2
    status[150] = -2
    course = RunSummary(machine(), estimator().model)
    for k in range(0, len(wanted), size):
        part = {name: a[k : k + size] if isinstance(a, np.ndarray) else a for name, a in vars(wanted).items()}
        course.add(Estimates(**{**part, "status": status[k : k + size]}))
    seen = [(e.fault, round(e.start_s / 0.02) - 1, round(e.end_s / 0.02) - 1, e.updates) for e in course.episodes]
    doubts = [("doubt", 10, 30, 3), ("doubt", 120, 121, 2)]
    assert seen == [doubts[0], ("missing", 20, 24, 5), doubts[1], ("refused", 150, 150, 1)]
    assert course.faults == 4


@given(st.lists(st.integers(0, 900), min_size=1, max_size=40), st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_a_trend_keeps_its_greatest_and_its_room(lengths: list[int], seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(sum(lengths), 2))
    trend, first = Trend(np.array([False, True])), 0
    for length in lengths:
        trend.add(values[first : first + length])
        first += length
    found, every = trend.points, trend.every
    assert len(found) <= TREND_POINTS and every <= max(1, 2 * len(values) // TREND_POINTS)
    blocks = [values[a : a + every] for a in range(0, len(values), every)]
    assert [tuple(row) for row in found] == [(block[-1, 0], block[:, 1].max()) for block in blocks]


def test_flags_are_named_the_gravest_first() -> None:
    assert flags_of(0) == ["good"] and flags_of(-2) == ["refused"]
    assert flags_of(64 + 4 + 1) == ["doubt", "hold", "filling"]


# --- where samples come from, by a clock of the test's own ------------------------------------------------------


class Scripted:
    """A clock on which a second passes with every wait, and something happens during it."""

    def __init__(self, *happenings: Callable[[], Any]) -> None:
        self.time = 0.0
        self._happenings = list(happenings)

    def now(self) -> float:
        return self.time

    def wait(self, seconds: float) -> None:
        self.time += 1.0
        if self._happenings:
            self._happenings.pop(0)()


def taken(source: SampleSource) -> int:
    """Samples that a source gives until it ends."""
    return sum(len(piece) for piece in source.pieces(lambda: False) if piece is not None)


def test_a_replay_is_as_fast_as_asked(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", trace())
    clock = Scripted()
    source = Replay(tmp_path / "log.csv", machine(), 0.5, clock)
    times = [(clock.time, piece) for piece in source.pieces(lambda: False) if piece is not None]
    for passed, piece in times:
        assert isinstance(piece, Log) and piece.time_s[-1] <= 0.5 * passed
    assert clock.time == 8.0 and sum(len(piece) for _, piece in times) == len(trace())
    assert source.ended == "end of the log"
    at_once = Replay(tmp_path / "log.csv", machine(), np.inf, Scripted())
    assert taken(at_once) == len(trace())


def test_a_replay_uses_the_columns_that_estimate_uses(tmp_path: Path) -> None:
    log = trace()
    velocity = np.gradient(log.position_m, log.time_s)
    own = Log(log.time_s, log.position_m, log.force_N, 1000.0, velocity_m_s=velocity)
    write_log(tmp_path / "own.csv", own)
    watch, source = Watch(machine()), Replay(tmp_path / "own.csv", machine(), np.inf, Scripted())
    parts = [watch.take(piece, judged=True) for piece in source.pieces(lambda: False) if piece is not None]
    same(chained(parts), estimate(machine(), tmp_path / "own.csv"))
    assert len(parts) > 5


def growing(tmp_path: Path) -> tuple[Path, bytes]:
    path, content = tmp_path / "log.csv", lines_of(trace(), tmp_path)
    path.write_bytes(content[:100_000])
    return path, content


def append(path: Path, content: bytes) -> Callable[[], Any]:
    def happen() -> None:
        with path.open("ab") as stream:
            stream.write(content)

    return happen


def test_a_file_that_grows_ends_when_it_rests(tmp_path: Path) -> None:
    path, content = growing(tmp_path)
    late = [append(path, content[100_000:100_007]), lambda: None, append(path, content[100_007:])]
    source = Followed(path, machine(), 10.0, Scripted(*late))
    assert taken(source) == len(trace())
    assert source.ended == "no new line for 10 s"
    source = Followed(path, machine(), 2.0, Scripted(*[append(path, b"4.0")] * 9))  # never a whole line
    assert taken(source) == len(trace())
    assert source.ended == "no new line for 2 s" and "no end" in source.remarks[0]


@pytest.mark.parametrize("removed", [False, True])
def test_a_file_that_is_replaced_ends_with_all_that_was_written_to_it(tmp_path: Path, removed: bool) -> None:
    path, content = growing(tmp_path)

    def replace() -> None:
        with path.open("ab") as stream:
            path.rename(tmp_path / "log.1.csv")
            stream.write(content[100_000:])
        if not removed:
            path.write_text("something else\n")

    source = Followed(path, machine(), np.inf, Scripted(lambda: None, replace))
    assert taken(source) == len(trace())
    assert "replaced" in source.ended


@pytest.mark.parametrize("size", [0, 50_000, 200_000], ids=["emptied", "shorter", "longer"])
def test_a_file_that_is_emptied_or_written_anew_ends(tmp_path: Path, size: int) -> None:
    path, content = growing(tmp_path)
    anew = lines_of(Log(trace().time_s, trace().force_N, trace().position_m, 1000.0), tmp_path)[:size]
    whole = content[:100_000].count(b"\n") - 1
    assert len(anew) == min(size, len(anew)) and (size < 100_000 or len(anew) > 100_000)
    source = Followed(path, machine(), np.inf, Scripted(lambda: None, lambda: path.write_bytes(anew)))
    assert taken(source) == whole
    assert "behind byte 100000" in source.ended


def test_a_pipe_ends_with_its_last_line(tmp_path: Path) -> None:
    content = lines_of(trace(), tmp_path)[:60_000].rpartition(b"\n")[0]
    ours, theirs = os.pipe()
    with open(ours, "rb", buffering=0) as stream:  # noqa: PTH123  a descriptor

        def write() -> None:
            os.write(theirs, content[:40_000])

        def end() -> None:
            os.write(theirs, content[40_000:])
            os.close(theirs)

        source = Streamed(stream, Path("pipe"), machine(), np.inf, Scripted(write, lambda: None, end))
        assert taken(source) == content.count(b"\n")
    assert source.ended == "end of the input"


# --- the command ------------------------------------------------------------------------------------------------


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    write_log(path, holed())
    return path


def test_a_replay_ends_with_the_numbers_of_estimate(small: Path, log: Path, tmp_path: Path) -> None:
    summary = json.loads(done("estimate", small, log, "--out", tmp_path / "e.csv", "--json").stdout)
    result = done("watch", small, log, "--speed", "max", "--out", tmp_path / "w.csv", "--json")
    found = json.loads(result.stdout)
    assert {entry["kind"] for entry in check_statements(found)} >= {"verdict", "number"}
    assert (tmp_path / "w.csv").read_bytes() == (tmp_path / "e.csv").read_bytes()
    for key in ("updates", "measured", "start_s", "end_s", "parameters", "status"):
        assert found[key] == summary[key], key
    assert found["ended"] == "end of the log" and found["missing_samples"] == 143
    assert re.search(r"^0\.\d\d s: .*friction .* N, test ratio .*stiffness_1 ", result.stderr)


def test_lines_come_as_often_as_asked(small: Path, log: Path) -> None:
    lines = done("watch", small, log, "--speed", "max", "--every", "1").stderr.splitlines()
    assert [int(float(line.partition(" s: ")[0])) for line in lines] == [0, 1, 2, 3]
    result = done("--quiet", "watch", small, log, "--speed", "max", "--every", "1")
    assert result.stderr == "" and "greatest test ratio" in result.stdout


def test_the_summary_tells_what_was_seen(small: Path, log: Path) -> None:
    text = done("watch", small, log, "--follow", "--idle", "0.1").stdout
    assert "ended, no new line for 0.1 s" in text
    assert "4000 samples, 143 missing; 199 updates from 0.02 to 3.98 s" in text
    assert re.search(r"^parameter at the end +nominal +estimate +\+- 2 sigma +ratio$", text, re.MULTILINE)
    assert re.search(r"^  no valid reading: 0\.\d\d to 1\.\d\d s, \d+ updates$", text, re.MULTILINE)


def test_numbers_that_the_motion_has_not_told_are_open_with_the_motion_that_would(small: Path, tmp_path: Path) -> None:
    rest = trace()
    tremble = np.arange(len(rest)) % 2
    still = Log(rest.time_s, 1e-12 * tremble, 1e-6 * np.cos(rest.time_s), rest.rate)
    for name, record in (("still", still), ("moved", rest)):
        write_log(tmp_path / f"{name}.csv", record)
    stood, moved = (
        done("watch", small, tmp_path / f"{name}.csv", "--speed", "max", "--every", "0.2")
        for name in ("still", "moved")
    )
    assert re.search(r", open: .*stiffness_1", stood.stderr.splitlines()[-1])
    assert re.search(r"^open: stiffness_1 .* Needed: reversals", stood.stdout, re.MULTILINE)
    assert ", open: " in moved.stderr.splitlines()[0] and ", open: " not in moved.stderr.splitlines()[-1]
    assert "open: stiffness_1" not in moved.stdout


def test_a_garbage_line_ends_it_with_what_was_gained(small: Path, log: Path, tmp_path: Path) -> None:
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join([*lines[:2001], "2.000,gar", *lines[2001:]]))
    (tmp_path / "whole.csv").write_text("".join(lines[:2001]))
    done("estimate", small, tmp_path / "whole.csv", "--out", tmp_path / "e.csv")
    out, page = tmp_path / "w.csv", tmp_path / "p.html"
    result = run("watch", small, log, "--follow", "--idle", "60", "--out", out, "--page", page)
    assert result.exit_code == 2
    assert f"{log}: row 2001 (line 2002)" in result.stderr and "Traceback" not in result.stderr
    assert out.read_bytes() == (tmp_path / "e.csv").read_bytes()
    assert "ended, an error" in result.stdout and "99 updates" in result.stdout
    assert f"mind: {log}: row 2001 (line 2002)" in result.stdout
    assert "row 2001" in page.read_text()


def test_other_formats_are_replayed_and_not_followed(small: Path, tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, trace().columns)
    assert "a text, which grows line by line" in refused("watch", small, path, "--follow")
    done("estimate", small, path, "--out", tmp_path / "e.csv")
    done("watch", small, path, "--speed", "max", "--out", tmp_path / "w.csv")
    assert (tmp_path / "w.csv").read_bytes() == (tmp_path / "e.csv").read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--idle", "1"], "a log that grows"),
        (["--follow", "--speed", "2"], "a log that is replayed"),
        (["--page", "page.txt"], "a name that ends in .html"),
        (["--speed", "quick"], "'quick' is not a valid float"),
        (["--out", "absent/e.csv"], "a folder that exists"),
    ],
)
def test_options_that_do_not_fit_are_refused(small: Path, log: Path, options: list[str], message: str) -> None:
    assert message in refused("watch", small, log, *options)


def test_logs_that_are_none_are_refused_and_touch_nothing(small: Path, tmp_path: Path) -> None:
    out = tmp_path / "e.csv"
    out.write_text("kept")
    assert "absent.csv" in refused("watch", small, tmp_path / "absent.csv", "--follow", "--out", out)
    assert "a text" in refused("watch", small, tmp_path / "log.jsonl", "--follow", "--out", out)
    (tmp_path / "wrong.csv").write_bytes(rows(100, lambda k: f"{k};{k};{k}", "t;x;F"))
    (tmp_path / "short.csv").write_bytes(b"\n".join(lines_of(trace(), tmp_path).splitlines()[:20]))
    for name, message in (("wrong.csv", "without a unit"), ("short.csv", "at least 21")):
        assert message in refused("watch", small, tmp_path / name, "--follow", "--idle", "0.1", "--out", out)
    assert out.read_text() == "kept"
    assert files(tmp_path) == {"e.csv", "wrong.csv", "short.csv", "whole.csv"}


def test_a_force_of_the_other_sign_is_said_and_the_answer_is_no(small: Path, tmp_path: Path) -> None:
    right = simulate_log(machine(), seconds=25.0, fastest=0.5)
    write_log(tmp_path / "right.csv", right)
    write_log(tmp_path / "wrong.csv", Log(right.time_s, right.position_m, -right.force_N, 1000.0))
    assert "scale = -1" in refused("estimate", small, tmp_path / "wrong.csv", "--out", tmp_path / "e.csv")
    result = run("watch", small, tmp_path / "wrong.csv", "--follow", "--idle", "0.1")
    assert result.exit_code == 1
    assert "wrong.csv, 0 to 2" in result.stderr and "scale = -1" in result.stderr
    assert "mind: " in result.stdout and "DOUBT" in result.stdout
    assert "mind: " not in done("watch", small, tmp_path / "right.csv", "--follow", "--idle", "0.1").stdout


def test_an_output_that_takes_nothing_ends_it(small: Path, log: Path) -> None:
    result = run("watch", small, log, "--speed", "max", "--out", "/dev/full")
    assert result.exit_code == 2 and "/dev/full" in result.stderr


def test_a_rotary_axis_is_watched_in_its_own_units(tmp_path: Path) -> None:
    axis = tmp_path / "log.csv"
    done("simulate", "etel_xy_rotary", "--out", axis, "--duration", "1")
    found = json.loads(done("watch", "etel_xy_rotary", axis, "--follow", "--idle", "0.1", "--json").stdout)
    assert "residual_rms_Nm" in found
    result = done("watch", "etel_xy_rotary", axis, "--speed", "max", "--page", tmp_path / "p.html")
    assert " N m, test ratio" in result.stderr
    assert "torque less inertia [N m]" in (tmp_path / "p.html").read_text()


# --- the page ---------------------------------------------------------------------------------------------------


def page_data(text: str) -> dict[str, Any]:
    """What the plots of a whole page draw."""
    assert text.lstrip().startswith("<!doctype html>")
    assert text.endswith("</html>\n")
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert data
    plots: dict[str, Any] = json.loads(data[1])["plots"]
    return plots


def test_the_page_that_stays_has_all_and_does_not_reload(small: Path, log: Path, tmp_path: Path) -> None:
    done("watch", small, log, "--speed", "max", "--page", tmp_path / "p.html")
    text = (tmp_path / "p.html").read_text()
    plots = page_data(text)
    assert set(plots) == {"friction", "innovation", "test_ratio", "parameter_0", "parameter_1", "parameter_2"}
    assert set(re.findall(r'data-plot="(\w+)"', text)) == set(plots)
    assert "location.reload" not in text and 'http-equiv="refresh"' not in text
    assert not re.search(r"(?:src|href)=", text)
    assert "No valid reading" in text and "ended: end of the log" in text


# --- as a process: writers, interrupts, terminals ---------------------------------------------------------------


WRITER = """
import random, sys, time
source, target, seed = sys.argv[1:]
content, rest = open(source, "rb").read(), random.Random(int(seed))
with open(target, "ab", buffering=0) as stream:
    while content:
        size = rest.randint(1, 3000)
        stream.write(content[:size])
        content = content[size:]
        time.sleep(rest.random() * 0.01)
"""


def started(*arguments: str | Path, **options: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", SCRIPT, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def wait_for(what: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + LIMIT_S
    while not what():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.02)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["interrupted", "terminated"])
def test_a_file_is_followed_while_a_writer_appends_to_it(small: Path, tmp_path: Path, number: int) -> None:
    """Until Ctrl-C, which comes when all was written; the page is whole whenever it is read."""
    (tmp_path / "whole.csv").write_bytes(text("UTF-16"))
    path, out, page = tmp_path / "log.csv", tmp_path / "w.csv", tmp_path / "p.html"
    done("estimate", small, tmp_path / "whole.csv", "--out", tmp_path / "e.csv")
    wanted, seen = (tmp_path / "e.csv").read_bytes(), []
    path.touch()
    with subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path / "whole.csv"), str(path), "3"]) as writer:
        watch = started("watch", small, path, "--follow", "--out", out, "--page", page, "--every", "1")

        def all_there() -> bool:
            if page.exists():
                seen.append(page.read_text())
            return bool(seen) and out.exists() and out.read_bytes() == wanted

        def in_lines() -> bool:
            # A reader may come amid a write, of which it sees whole pages of memory: a part of a line does not stay.
            for _ in range(10):
                content = out.read_bytes() if out.exists() else b""
                if wanted.startswith(content) and content[-1:] in (b"", b"\n"):
                    return True
                time.sleep(0.02)
            return False

        wait_for(lambda: all_there() or not in_lines(), watch)
        watch.send_signal(number)
        watch.send_signal(number)  # as supervisors do, to a process and its group
        said, told = watch.communicate(timeout=LIMIT_S)
    assert writer.returncode == 0
    assert watch.returncode == 128 + number
    assert out.read_bytes() == wanted
    assert "ended, interrupted" in said and "199 updates" in said
    assert "Interrupted after 199 updates" in told and "Traceback" not in told
    for content in {*seen, page.read_text()}:
        page_data(content)
    assert "location.reload" in seen[0] and "location.reload" not in page.read_text()


def test_an_interrupt_before_the_first_sample_leaves_nothing(small: Path, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,position_m,force_N\n")
    watch = started("watch", small, path, "--follow", "--out", tmp_path / "w.csv", "--page", tmp_path / "p.html")

    def waits() -> bool:  # it has the file open, which it does after it has understood its arguments
        with suppress(OSError):  # one that is closed meanwhile
            links = Path(f"/proc/{watch.pid}/fd").iterdir()
            return any(os.path.realpath(link) == str(path.resolve()) for link in links)
        return False

    wait_for(waits, watch)
    watch.send_signal(signal.SIGINT)
    said, told = watch.communicate(timeout=LIMIT_S)
    assert watch.returncode == 130 and said == "" and "Interrupted" in told and "Traceback" not in told
    assert files(tmp_path) == {"log.csv"}


def test_standard_input_is_watched(small: Path, log: Path, tmp_path: Path) -> None:
    done("estimate", small, log, "--out", tmp_path / "e.csv")
    with (
        log.open("rb") as stream,
        started("watch", small, "-", "--out", "/dev/stdout", "--json", stdin=stream) as watch,
    ):
        rows_out, summary = watch.communicate(timeout=LIMIT_S)
    assert watch.returncode == 0
    assert rows_out == (tmp_path / "e.csv").read_text()
    assert '"ended": "end of the input"' in summary  # the rows have stdout


# --- how much of a core it takes --------------------------------------------------------------------------------


PACED = """
import sys, time
source, target, seconds = sys.argv[1:]
lines, start = open(source, "rb").read().splitlines(keepends=True), time.monotonic()
done = 0
with open(target, "ab", buffering=0) as stream:
    while done < len(lines):
        due = int(min(1.0, (time.monotonic() - start) / float(seconds)) * len(lines))
        stream.write(b"".join(lines[done:due]))
        done = due
        time.sleep(0.005)
"""
"""Writes the lines of a file to another one, evenly over so many seconds."""


def main() -> None:
    """Follow 20 kHz of `etel_xy` while they are written, with all that watch shows; print the share of one core."""
    seconds = 60
    with tempfile.TemporaryDirectory() as folder:
        fast, whole, path = (Path(folder) / name for name in ("fast.toml", "whole.csv", "log.csv"))
        fast.write_text('name = "fast"\nextends = "etel_xy"\n[sampling]\nrate = 20000.0\n')
        done("simulate", fast, "--out", whole, "--duration", str(seconds))
        for name, options in (("lines", []), ("lines, --out, --page", ["--out", "e.csv", "--page", "p.html"])):
            path.write_bytes(b"")
            # Started, and done with its first page, before the clock counts.
            arguments = ["watch", str(fast), str(path), "--follow", "--json", *options]
            with subprocess.Popen(
                [sys.executable, "-c", SCRIPT, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            ) as watch:
                time.sleep(10.0)
                before = processor_seconds(watch.pid)
                subprocess.run([sys.executable, "-c", PACED, str(whole), str(path), str(seconds)], check=True)
                time.sleep(1.0)
                used = processor_seconds(watch.pid) - before
                watch.send_signal(signal.SIGINT)
                summary = json.loads(watch.communicate()[0])
            print(f"{name}: {summary['samples']} samples of {seconds} s, {100.0 * used / seconds:.1f} % of one core")


def processor_seconds(pid: int) -> float:
    """That a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
