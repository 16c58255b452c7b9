"""Logs and estimates: files that are read, files that are refused and where, files that are written whole."""

import os
import re
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.io import savemat

from cli_cases import read_columns
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.estimates import Estimates, write_estimates
from sgms_mhe.signals.logs import COLUMNS, Log, write_log
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write, write_text

pytestmark = pytest.mark.core

Array = NDArray[Any]
ETEL = load_machine("etel_xy")
EMPS = load_machine("emps")


def a_log(n: int = 20, rate: float = 10000.0) -> Log:
    random = np.random.default_rng(4)
    return Log(np.arange(n) / np.float64(rate), random.normal(size=n), random.normal(size=n), rate)


def rows_of(log: Log) -> list[str]:
    return [",".join(map(repr, row)) for row in np.column_stack(list(log.columns.values())).tolist()]


def write_rows(path: Path, rows: list[str], header: str = "time_s,position_m,force_N") -> Path:
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def refused(path: Path, **options: object) -> InputError:
    with pytest.raises(InputError) as caught:
        read_log(path, **options)  # type: ignore[arg-type]
    assert str(caught.value).startswith(str(path))
    return caught.value


def assert_same(one: Log, other: Log) -> None:
    assert list(one.columns) == list(other.columns)
    for name, values in one.columns.items():
        np.testing.assert_array_equal(values, other.columns[name])


# --- round trips ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".CSV"])
def test_written_log_is_read_back_to_the_bit(tmp_path: Path, suffix: str) -> None:
    log = a_log()
    log.position_m[3], log.force_N[0], log.force_N[-1] = np.nan, -0.0, 5e-324
    log = replace(log, velocity_m_s=log.position_m / 3, temperature_degC=log.force_N + 20)
    path = tmp_path / f"log{suffix}"
    write_log(path, log)
    back = read_log(path, ETEL)
    assert_same(back, log)
    assert back.source == str(path)
    assert back.rate == pytest.approx(10000.0)


@given(st.lists(st.floats(width=64), min_size=2, max_size=8))
def test_any_float_survives_csv(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    n = len(values)
    log = Log(
        np.arange(n) * np.float64(1e-3), np.zeros(n), np.ones(n), 1e3, temperature_degC=np.array([*values[:-1], 1.5])
    )
    write_log(path, log)
    assert_same(read_log(path), log)


def test_csv_is_plain(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", Log(np.array([0.0, 0.1]), np.array([1e-7, np.nan]), np.array([1.0, 2.5]), 10.0))
    assert (tmp_path / "log.csv").read_bytes() == b"time_s,position_m,force_N\n0.0,1e-07,1.0\n0.1,nan,2.5\n"


def test_log_longer_than_one_block_of_the_writer(tmp_path: Path) -> None:
    log = a_log(70_000)
    write_log(tmp_path / "log.csv", log)
    assert_same(read_log(tmp_path / "log.csv", ETEL), log)


@pytest.mark.parametrize("shape", [(-1,), (-1, 1), (1, -1)])
def test_mat_vectors_of_any_orientation_are_read(tmp_path: Path, shape: tuple[int, ...]) -> None:
    log = a_log()
    savemat(tmp_path / "log.mat", {name: values.reshape(shape) for name, values in log.columns.items()})
    assert_same(read_log(tmp_path / "log.mat"), log)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("dtype", "f8 f4 i1 u1 i2 u2 i4 u4 i8 u8 bool".split())
@pytest.mark.parametrize("n", [2, 3, 8, 1001])
def test_mat_of_every_numeric_type_is_read(tmp_path: Path, compressed: bool, dtype: str, n: int) -> None:
    values = np.random.default_rng(9).integers(0, 2, size=n).astype(dtype)
    values[0] = 1
    others = {"note": "text", "options": {"gain": 1.0}, "cells": np.array([1, "a"], dtype=object), "z": np.ones(3) * 1j}
    savemat(
        tmp_path / "log.mat",
        {**others, "time_s": np.arange(n) * 1.0, "position_m": values, "force_N": values * 1.5},
        do_compression=compressed,
    )
    log = read_log(tmp_path / "log.mat")
    np.testing.assert_array_equal(log.position_m, values.astype(float))
    np.testing.assert_array_equal(log.force_N, (values * 1.5).astype(float))


def test_big_endian_mat_is_read(tmp_path: Path) -> None:
    def element(kind: int, data: bytes) -> bytes:
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    content = b"MATLAB 5.0 MAT-file, big end first".ljust(124) + b"\x01\x00MI"
    for name, values in a_log(3).columns.items():
        parts = [(6, struct.pack(">II", 6, 0)), (5, struct.pack(">ii", 3, 1)), (1, name.encode())]
        content += element(14, b"".join(element(*part) for part in [*parts, (9, values.astype(">f8").tobytes())]))
    (tmp_path / "log.mat").write_bytes(content)
    assert_same(read_log(tmp_path / "log.mat"), a_log(3))


def test_integers_are_read_as_numbers(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "log.npz", time_s=np.arange(5), position_m=np.arange(5, dtype=np.int16), force_N=np.ones(5, "f4")
    )
    log = read_log(tmp_path / "log.npz")
    assert all(values.dtype == np.float64 for values in log.columns.values())
    assert log.rate == 1.0


@pytest.mark.parametrize(
    ("header", "separator", "ending"),
    [
        ("time_s;position_m;force_N", ";", "\n"),
        ("time_s\tposition_m\tforce_N", "\t", "\n"),
        (' time_s , "position_m", force_N', " , ", "\r\n"),
        ("# time_s,position_m,force_N", ",", "\n"),
        ("\ufefftime_s,position_m,force_N", ",", "\n\n"),
        ("\n\ntime_s,position_m,force_N", ",", "\n"),
    ],
)
def test_csv_dialects(tmp_path: Path, header: str, separator: str, ending: str) -> None:
    log = a_log()
    lines = [header, *(row.replace(",", separator) for row in rows_of(log))]
    (tmp_path / "log.csv").write_bytes(ending.join(lines).encode())
    assert_same(read_log(tmp_path / "log.csv"), log)


def test_empty_fields_are_missing_samples(tmp_path: Path) -> None:
    rows = ["0.0,,1.0", "0.1,0.5,", '0.2," ",3.0']
    log = read_log(write_rows(tmp_path / "log.csv", rows))
    np.testing.assert_array_equal(log.position_m, [np.nan, 0.5, np.nan])
    np.testing.assert_array_equal(log.force_N, [1.0, np.nan, 3.0])


def test_columns_that_no_log_knows_may_hold_anything(tmp_path: Path) -> None:
    header = "remark,time_s,position_m,force_N,reference"
    path = write_rows(tmp_path / "log.csv", ["a,0.0,1.0,2.0,", "b,0.1,1.5,2.5,x"], header)
    np.testing.assert_array_equal(read_log(path).force_N, [2.0, 2.5])
    columns: dict[str, Any] = {"remark": np.array(["text"]), **a_log().columns}
    np.savez(tmp_path / "log.npz", **columns)
    assert_same(read_log(tmp_path / "log.npz"), a_log())


# --- [log] ------------------------------------------------------------------------------------------------------


def test_mapping_scales_shifts_and_converts(tmp_path: Path) -> None:
    machine = override_machine(
        ETEL,
        {
            "log": {
                "time_s": {"variable": "t", "unit": "ms"},
                "position_m": {"variable": "x", "scale": 2.0, "offset": -1.0, "unit": "um"},
                "force_N": {"variable": "u", "scale": -3.0},
                "temperature_degC": {"variable": "T", "unit": "K"},
            }
        },
    )
    rows = [f"{0.1 * k},{k},{k},{300 + k}" for k in range(4)]
    log = read_log(write_rows(tmp_path / "log.csv", rows, "t,x,u,T"), machine)
    np.testing.assert_allclose(log.time_s, [0, 1e-4, 2e-4, 3e-4])
    np.testing.assert_allclose(log.position_m, [-1e-6, 1e-6, 3e-6, 5e-6])
    np.testing.assert_array_equal(log.force_N, [0, -3, -6, -9])
    assert log.temperature_degC is not None
    np.testing.assert_allclose(log.temperature_degC, [26.85, 27.85, 28.85, 29.85])


def test_simulated_log_is_read_with_the_machine_that_maps_a_measured_one(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", a_log(rate=1000.0))
    assert_same(read_log(tmp_path / "log.csv", EMPS), a_log(rate=1000.0))


def test_mapped_optional_column_must_be_there(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", a_log())
    machine = override_machine(ETEL, {"log": {"temperature_degC": "T_motor"}})
    assert "T_motor (log.temperature_degC)" in refused(tmp_path / "log.csv", machine=machine).allowed


def test_emps_record_is_read_as_it_is(measured_data: Callable[[str], Path]) -> None:
    log = read_log(measured_data("emps/DATA_EMPS.mat"), EMPS)
    assert len(log) == 24841
    assert log.rate == pytest.approx(1000.0, rel=1e-5)
    assert log.position_m.max() == pytest.approx(0.246, abs=0.002)
    signals = signals_from_log(log, EMPS)
    moving = signals.valid & (np.abs(signals.velocity) > 0.01)
    friction = EMPS.friction
    law = friction.coulomb * np.sign(signals.velocity) + friction.viscous * signals.velocity - 3.1648
    # Published: 4.08 % of the force's norm.
    assert np.std((signals.friction - law)[moving]) < 0.045 * np.std(signals.force[moving])


# --- what is refused --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".mat"])
@pytest.mark.parametrize(
    ("bad", "allowed"),
    [
        (lambda t: t[6], "duplicate"),
        (lambda t: t[6] - 1e-4, "decreases"),
        (lambda t: t[7] + 1.2e-6, "uniform time within 1 %"),
        (lambda t: t[7] - 1.2e-6, "uniform time within 1 %"),
        (lambda t: np.nan, "finite time"),
        (lambda t: np.inf, "finite time"),
    ],
)
def test_bad_time_names_its_row(tmp_path: Path, suffix: str, bad: Callable[[Array], float], allowed: str) -> None:
    log = a_log()
    log.time_s[7] = bad(log.time_s)
    path = tmp_path / f"log{suffix}"
    if suffix == ".mat":
        savemat(path, log.columns)
    else:
        write_log(path, log)
    error = refused(path)
    assert error.where == ("row 8 (line 9), column time_s" if suffix == ".csv" else "row 8, column time_s")
    assert allowed in error.allowed


def test_jitter_within_one_percent_is_allowed(tmp_path: Path) -> None:
    log = a_log()
    log.time_s[1:-1] += np.random.default_rng(5).uniform(-0.45e-6, 0.45e-6, size=18)
    write_log(tmp_path / "log.csv", log)
    assert_same(read_log(tmp_path / "log.csv", ETEL), log)


@pytest.mark.parametrize("first", [np.nan, -np.inf])
def test_bad_first_time_is_row_one(tmp_path: Path, first: float) -> None:
    log = a_log()
    log.time_s[0] = first
    write_log(tmp_path / "log.csv", log)
    assert refused(tmp_path / "log.csv").where == "row 1 (line 2), column time_s"


def test_time_that_only_decreases_or_stands_is_refused(tmp_path: Path) -> None:
    for time, allowed in (
        (np.arange(9)[::-1], "decreases"),
        (np.ones(9), "duplicate"),
        (np.full(9, np.nan), "NaN|finite"),
    ):
        write_log(tmp_path / "log.csv", Log(time.astype(float), np.ones(9), np.ones(9), 1.0))
        assert re.search(allowed, refused(tmp_path / "log.csv").allowed)


def test_dropped_row_is_not_uniform(tmp_path: Path) -> None:
    rows = rows_of(a_log())
    error = refused(write_rows(tmp_path / "log.csv", rows[:5] + rows[6:]))
    assert error.where.startswith("row 6 (line 7)")
    assert "a missing sample keeps its row" in error.allowed


def test_line_number_counts_blank_lines(tmp_path: Path) -> None:
    rows = rows_of(a_log())
    path = write_rows(tmp_path / "log.csv", ["", *rows[:3], "", rows[2], *rows[3:]])
    assert refused(path).where == "row 4 (line 7), column time_s"


@pytest.mark.parametrize(
    ("row", "where"),
    [
        ("0.0003,1.0", "row 4 (line 5)"),
        ("0.0003,1.0,2.0,3.0", "row 4 (line 5)"),
        ("0.0003,1.0,text", "row 4 (line 5), column force_N"),
        ("0.0003,1.0 m,2.0", "row 4 (line 5), column position_m"),
        ("0.0003,1.0,2.0 # late", "row 4 (line 5), column force_N"),
        ("0.0003,1_0,2.0", "row 4 (line 5), column position_m"),
        ("0.0003,1.0,\u0661", "row 4 (line 5), column force_N"),
        ("later,1.0,2.0", "row 4 (line 5), column time_s"),
        (",1.0,2.0", "row 4 (line 5), column time_s"),
    ],
)
def test_bad_row_is_named(tmp_path: Path, row: str, where: str) -> None:
    rows = rows_of(a_log())
    rows[3] = row
    assert refused(write_rows(tmp_path / "log.csv", rows)).where == where


def test_ragged_row_is_refused_even_where_its_wanted_fields_are_whole(tmp_path: Path) -> None:
    rows = [f"{row},9.0" for row in rows_of(a_log())]
    rows[-1] = rows[-1].rsplit(",", 1)[0]
    path = write_rows(tmp_path / "log.csv", rows, "time_s,position_m,force_N,remark")
    assert refused(path).where == "row 20 (line 21)"


@pytest.mark.parametrize("column", ["time_s", "position_m", "force_N"])
@pytest.mark.parametrize("suffix", [".csv", ".npz", ".mat"])
def test_missing_column_is_named_with_what_is_there(tmp_path: Path, suffix: str, column: str) -> None:
    columns: dict[str, Any] = {
        f"{name}x" if name == column else name: values for name, values in a_log().columns.items()
    }
    path = tmp_path / f"log{suffix}"
    if suffix == ".csv":
        write_rows(path, rows_of(a_log()), ",".join(columns))
    elif suffix == ".npz":
        np.savez(path, **columns)
    else:
        savemat(path, columns)
    error = refused(path)
    assert error.where == f"column {column}"
    assert f"{column}x" in error.allowed


@pytest.mark.parametrize("column", [name for name in COLUMNS if name != "time_s"])
def test_column_without_a_number_is_refused(tmp_path: Path, column: str) -> None:
    changes: dict[str, Any] = {column: np.full(20, np.nan)}
    write_log(tmp_path / "log.npz", replace(a_log(), **changes))
    error = refused(tmp_path / "log.npz")
    assert (error.where, error.value) == (f"column {column}", "NaN throughout")


@pytest.mark.parametrize("content", ["", "\n\n", "time_s,position_m,force_N\n", "time_s,position_m,force_N\n\n"])
def test_empty_csv_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "log.csv").write_text(content, encoding="utf-8")
    assert "header" in refused(tmp_path / "log.csv").allowed


def test_single_row_is_refused(tmp_path: Path) -> None:
    assert refused(write_rows(tmp_path / "log.csv", ["0.0,1.0,2.0"])).value == 1


def test_csv_without_header_is_refused(tmp_path: Path) -> None:
    error = refused(write_rows(tmp_path / "log.csv", rows_of(a_log())[1:], header="0.0,1.0,2.0"))
    assert error.where == "columns time_s, position_m, force_N"
    assert "the file has column 1, column 2, column 3" in error.allowed


def test_column_named_twice_is_refused(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "log.csv", ["0,1,2,3", "1,1,2,3"], "time_s,position_m,force_N,force_N")
    assert refused(path).value == "force_N"
    path = write_rows(tmp_path / "log.csv", ["0,1,2,3,4", "1,1,2,3,4"], "time_s,position_m,force_N,,")
    np.testing.assert_array_equal(read_log(path).force_N, [2, 2])


def calls_to_read(path: Path) -> int:
    """Python and C functions called on the way."""
    calls = 0

    def count(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        assert len(read_log(path)) == 2
    finally:
        sys.setprofile(None)
    return calls


def test_work_of_a_header_grows_with_its_names_and_no_faster(tmp_path: Path) -> None:
    calls = []
    for number in (200, 400, 1200):
        names = ["time_s", "position_m", "force_N", *(f"channel_{number}_{k}" for k in range(number))]
        rows = [",".join([str(k)] * len(names)) for k in range(2)]
        calls.append(calls_to_read(write_rows(tmp_path / "log.csv", rows, ",".join(names))))
    assert calls[2] - calls[1] < 4.2 * (calls[1] - calls[0])  # four times the names


@pytest.mark.parametrize("content", [b"time_s,position_m,force_N\n0,\xff,1\n1,2,3\n", b"\x00\x01\x02\xff" * 99])
def test_binary_csv_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "log.csv").write_bytes(content)
    refused(tmp_path / "log.csv")


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
@pytest.mark.parametrize("keep", [0, 1, 100, 130, 300, 0.5, 0.9, 0.999])
def test_truncated_archive_is_refused(tmp_path: Path, suffix: str, keep: float) -> None:
    path, log = tmp_path / f"log{suffix}", a_log(500)
    if suffix == ".mat":
        savemat(path, log.columns, do_compression=True)
    else:
        write_log(path, log)
    whole = path.read_bytes()
    path.write_bytes(whole[: keep if isinstance(keep, int) else int(keep * len(whole))])
    refused(path)


@pytest.mark.parametrize("lost", [1, 7, 100])
def test_mat_that_ends_early_says_so(tmp_path: Path, lost: int) -> None:
    savemat(tmp_path / "log.mat", a_log(500).columns)
    (tmp_path / "log.mat").write_bytes((tmp_path / "log.mat").read_bytes()[:-lost])
    assert "cut off within an element" in refused(tmp_path / "log.mat").allowed


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_noise_is_no_archive(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"log{suffix}").write_bytes(np.random.default_rng(6).bytes(5000))
    refused(tmp_path / f"log{suffix}")


def test_single_array_is_no_archive(tmp_path: Path) -> None:
    with (tmp_path / "log.npz").open("wb") as stream:
        np.save(stream, np.ones(5))
    assert "a whole NPZ archive" in refused(tmp_path / "log.npz").allowed


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".mat"])
def test_damaged_file_is_read_or_refused_but_never_trips(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"log{suffix}"
    if suffix == ".mat":
        savemat(path, a_log().columns)
    else:
        write_log(path, a_log())
    whole = path.read_bytes()
    refusals = 0
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place * 5 % 8
        path.write_bytes(damaged)
        try:
            read_log(path, ETEL)
        except InputError:
            refusals += 1
    assert refusals > 20


def test_damaged_mat_v73_is_refused(tmp_path: Path) -> None:
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x00" * 400
    (tmp_path / "log.mat").write_bytes(header)
    assert "whole HDF5 file" in refused(tmp_path / "log.mat").allowed


@pytest.mark.parametrize("bad", [np.ones((5, 4)), np.array(["a"] * 20), np.ones(20) * 1j, np.array([{}] * 20)])
@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_variable_that_is_no_real_vector_is_refused(tmp_path: Path, suffix: str, bad: NDArray[np.generic]) -> None:
    columns: dict[str, Any] = {**a_log().columns, "force_N": bad}
    if suffix == ".npz":
        np.savez(tmp_path / "log.npz", **columns)
    else:
        savemat(tmp_path / "log.mat", columns)
    refused(tmp_path / f"log{suffix}")


def test_pickled_archive_is_not_opened(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, ...]:
            return (os.mkdir, (str(tmp_path / "sprung"),))

    columns: dict[str, Any] = {**a_log().columns, "force_N": np.array([Trap()], dtype=object)}
    np.savez(tmp_path / "log.npz", **columns)
    refused(tmp_path / "log.npz")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_columns_of_unequal_length_are_refused(tmp_path: Path, suffix: str) -> None:
    columns: dict[str, Any] = {**a_log().columns, "force_N": np.ones(19)}
    if suffix == ".npz":
        np.savez(tmp_path / "log.npz", **columns)
    else:
        savemat(tmp_path / "log.mat", columns)
    error = refused(tmp_path / f"log{suffix}")
    assert (error.where, error.value) == ("column force_N", 19)


def test_rate_that_is_not_the_machine_s_is_refused(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", a_log(rate=5000.0))
    error = refused(tmp_path / "log.csv", machine=ETEL)
    assert (error.value, error.where) == ("5000 Hz", "time_s")
    assert "10000 Hz" in error.allowed
    assert read_log(tmp_path / "log.csv").rate == pytest.approx(5000.0)


@pytest.mark.parametrize(
    "name", ["absent.csv", "absent.npz", "absent.mat", "folder.csv", "folder.mat", "log.xlsx", "log"]
)
def test_files_that_cannot_be_read_are_refused(tmp_path: Path, name: str) -> None:
    if name.startswith("folder"):
        (tmp_path / name).mkdir()
    refused(tmp_path / name)


# --- writing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stop", [KeyboardInterrupt, RuntimeError])
def test_interrupted_write_leaves_what_was_there(tmp_path: Path, stop: type[BaseException]) -> None:
    target = tmp_path / "out.csv"
    write_text(target, "old")
    with pytest.raises(stop), atomic_write(target) as stream:
        stream.write(b"half a li")
        raise stop
    assert target.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_reader_never_sees_half_a_file(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    with atomic_write(target) as stream:
        stream.write(b"first")
        stream.flush()
        assert not target.exists()
    assert target.read_bytes() == b"first"


def test_written_file_has_ordinary_permissions_and_links_stay_links(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    write_text(tmp_path / "out", "x")
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "plain").stat().st_mode
    (tmp_path / "link").symlink_to(tmp_path / "out")
    write_text(tmp_path / "link", "y")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "out").read_text(encoding="utf-8") == "y"


def test_pipe_is_written_directly() -> None:
    reader, writer = os.pipe()
    write_text(f"/dev/fd/{writer}", "through")
    os.close(writer)
    with os.fdopen(reader) as stream:
        assert stream.read() == "through"


@pytest.mark.parametrize("target", ["no/folder/out.csv", "."])
def test_target_that_cannot_be_written_is_bad_input(tmp_path: Path, target: str) -> None:
    with pytest.raises(InputError, match="a file that can be written"):
        write_log(tmp_path / target, a_log())
    assert list(tmp_path.iterdir()) == []


# --- estimates --------------------------------------------------------------------------------------------------


def some_estimates(
    u: int = 5, n_z: int = 11, names: tuple[str, ...] = ("stiffness_1", "stiffness_2", "coulomb")
) -> Estimates:
    random = np.random.default_rng(7)
    vectors = random.normal(size=(3, u))
    return Estimates(
        time_s=vectors[0],
        friction_measured_N=vectors[1],
        friction_N=vectors[2],
        z_m=random.normal(size=(u, n_z)),
        parameters=random.normal(size=(u, len(names))),
        std=random.normal(size=(u, len(names))),
        status=np.arange(u) - 2,
        innovation_N=random.normal(size=u),
        test_ratio=random.random(u),
        noise_scale=1.0 + random.random(u),
        parameter_names=names,
    )


def test_estimates_have_the_stated_columns(tmp_path: Path) -> None:
    write_estimates(tmp_path / "e.csv", some_estimates(n_z=2))
    lines = (tmp_path / "e.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == (
        "time_s,friction_measured_N,friction_N,z_1_m,z_2_m,stiffness_1,stiffness_2,coulomb,"
        "std_stiffness_1,std_stiffness_2,std_coulomb,status,"
        "innovation_N,test_ratio,noise_scale"
    )
    assert len(lines) == 6
    assert lines[1].split(",")[-4] == "-2"


@pytest.mark.parametrize("n_z", [1, 4, 11])
@pytest.mark.parametrize("names", [("coulomb",), ("stiffness_1", "force_ripple.amplitude_N")])
def test_estimates_are_read_back_to_the_bit(tmp_path: Path, n_z: int, names: tuple[str, ...]) -> None:
    estimates = some_estimates(n_z=n_z, names=names)
    write_estimates(tmp_path / "e.csv", estimates)
    back = read_columns(tmp_path / "e.csv")
    for name, column in estimates.columns.items():
        np.testing.assert_array_equal(back[name], column)
    assert {*names, "z_1_m", "std_coulomb" if "coulomb" in names else f"std_{names[0]}"} <= set(back)
