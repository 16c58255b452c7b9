"""Fleets: every row of a table once, failures listed, nothing done twice; bands that hold what they promise."""

import csv
import datetime
import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import diagnosis_cases
from cli_cases import SCRIPT, SMALL, done, files, read_columns, refused, run
from dask_cluster import Cluster
from sgms_mhe.api.fleet import Done, Fleet, run_fleet
from sgms_mhe.api.fleet.bands import ALARM, LEVEL, courses, find_steps
from sgms_mhe.api.fleet.table import Row, read_table
from sgms_mhe.api.fleet.work import FleetNumber, Result, machine_name, work
from sgms_mhe.api.fleet.writing import results_json, write_fleet
from sgms_mhe.commands.fleet import _text as fleet_text
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis.result import Standing
from sgms_mhe.report import FleetCourse
from sgms_mhe.support.processes import HERE, WorkerSlot
from statement_cases import check_statements


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a machine and logs of three axes."""
    folder = tmp_path_factory.mktemp("shop")
    (folder / "small.toml").write_text(SMALL)
    (folder / "logs").mkdir()
    for k in range(3):
        out = folder / "logs" / f"axis{k}.csv"
        done("simulate", folder / "small.toml", "--out", out, "--duration", "2", "--seed", k)
    (folder / "logs" / "broken.csv").write_text("time_s,position_m\n0,1\n")
    return folder


def table(shop: Path, folder: Path, *rows: str, header: str = "machine,log,axis,date") -> Path:
    """A table whose `M` and `L` stand for the shop's machine and folder of logs."""
    path = folder / "table.csv"
    lines = [row.replace("M,", f"{shop}/small.toml,").replace("L/", f"{shop}/logs/") for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


GOOD = ("M,L/axis0.csv,x,2026-01-05", "M,L/axis1.csv,x,2026-02-05", "M,L/axis2.csv,y,")


def rows_of(out: Path) -> list[dict[str, str]]:
    with (out / "results.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


# --- the table --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        ("machine,log,dat", ["M,L/axis0.csv,"], r"row 1, column = 'dat': one of machine, .*did you mean date"),
        ("machine,log,log", ["M,a,b"], "row 1, column = 'log': each column once"),
        ("machine,name", ["M,a"], "row 1, column log: missing"),
        ("log", ["a.csv"], "row 1, column machine: missing: fleet estimate needs it"),
        ("machine,log", [], "at least one row"),
        ("machine,log", ["M,L/axis0.csv,3"], "row 2 = 3: 2 fields"),
        ("machine,log", ["M,L/axis0.csv", "M,"], "row 3, column log = '': a log file"),
        ("machine,log", [",L/axis0.csv"], "row 2, column machine = '': a machine file"),
        ("machine,log,date", ["M,L/axis0.csv,5.1.2026"], r"row 2, column date = '5.1.2026': a date as 2026-03-31"),
        ("machine,log,mass", ["M,L/axis0.csv,-1"], r"row 2, column mass = '-1': a positive number"),
        ("machine,log,mass", ["M,L/axis0.csv,nan"], r"row 2, column mass = 'nan'"),
        ("machine,log", ["M,a.csv", "M,b.csv", "M,a.csv"], r"row 4, column log = .*: each machine and log once; row 2"),
    ],
)
def test_a_wrong_table_is_refused_by_row_and_column(
    header: str, rows: list[str], message: str, shop: Path, tmp_path: Path
) -> None:
    path = table(shop, tmp_path, *rows, header=header)
    said = refused("fleet", "estimate", path, "--out", tmp_path / "out")
    assert re.search(message, said), said
    assert str(path) in said
    assert not (tmp_path / "out").exists()


def test_a_table_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    assert "absent.csv: table: a CSV in UTF-8" in refused("fleet", "estimate", tmp_path / "absent.csv")
    (tmp_path / "latin.csv").write_bytes("machine,log\nh\xf6he,x\n".encode("latin-1"))
    assert "a CSV in UTF-8" in refused("fleet", "estimate", tmp_path / "latin.csv")


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_delimiters_defaults_and_paths(delimiter: str, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    lines = ["machine,log,name,axis,date", "own.toml,logs/a.csv,,,", "etel_xy,b.csv,first,X 1,2026-01-05T14:30", ""]
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).replace(",", delimiter).encode())
    first, second = read_table(path, "estimate")
    assert (first.machine, first.log) == (str(tmp_path / "own.toml"), tmp_path / "logs" / "a.csv")
    assert (first.number, first.name, first.axis, first.date) == (2, "a", "a", None)  # an axis of its own
    assert (second.machine, second.name, second.axis) == ("etel_xy", "first", "X 1")
    assert second.date == datetime.datetime(2026, 1, 5, 14, 30, tzinfo=datetime.UTC)


def test_identify_needs_no_machine(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("log,mass\na.csv,12.5\n")
    (row,) = read_table(path, "identify")
    assert (row.machine, row.mass) == ("", 12.5)
    assert [machine_name(axis) for axis in ("X 1", "3/b", "ä")] == ["x_1", "axis_3_b", "axis"]


# --- running ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_row_once_failures_listed_and_nothing_done_twice(shop: Path, tmp_path: Path) -> None:
    rows = (*GOOD, "M,L/broken.csv,z,", "M,L/absent.csv,z,", "etel_xy,L/axis0.csv,w,", "absent.toml,L/axis0.csv,v,")
    path, out = table(shop, tmp_path, *rows), tmp_path / "out"
    result = run("fleet", "estimate", path, "--out", out, "--jobs", "2")
    assert result.exit_code == 1, result.output
    assert "3 of 7 logs done, 3 of them now" in result.stdout and "4 failed" in result.stdout
    assert "failed: broken: " in result.stdout
    assert "100 %" in result.stderr or "(100 %" in result.stderr or "failed" in result.stderr
    found = rows_of(out)
    assert [row["row"] for row in found] == ["2", "3", "4", "5", "6", "7", "8"]
    assert [row["outcome"] for row in found] == ["done"] * 3 + ["failed"] * 4
    said = [row["said"] for row in found[3:]]
    assert "missing: a column force_N" in said[0]
    assert "No such file" in said[1]
    assert "Hz" in said[2]  # a machine of another rate
    assert "absent.toml" in said[3]
    content = json.loads((out / "results.json").read_text())
    assert [row["outcome"] for row in content["rows"]] == [row["outcome"] for row in found]
    assert files(out) == {"results.csv", "results.json", "fleet.html", "rows"}

    before = {name: (out / name).read_bytes() for name in ("results.csv", "results.json", "fleet.html")}
    again = run("fleet", "estimate", path, "--out", out, "--json")
    assert "was there" in again.stderr
    assert json.loads(again.stdout) == content
    rows = [entry for entry in check_statements(content) if entry["kind"] == "row"]
    assert [entry["sure"] == "no" for entry in rows] == [row["outcome"] == "failed" for row in content["rows"]]
    assert before == {name: (out / name).read_bytes() for name in before}


def test_numbers_are_those_of_estimate(shop: Path, tmp_path: Path) -> None:
    done("fleet", "estimate", table(shop, tmp_path, *GOOD), "--out", tmp_path / "out")
    done("estimate", shop / "small.toml", shop / "logs" / "axis1.csv", "--out", tmp_path / "e.csv")
    alone = read_columns(tmp_path / "e.csv")
    row = rows_of(tmp_path / "out")[1]
    for name, column in (
        ("stiffness_1_N_m", "stiffness_1"),
        ("stiffness_2_N_m", "stiffness_2"),
        ("coulomb_N", "coulomb"),
    ):
        assert float(row[name]) == alone[column][-1]
        assert float(row[f"std_{name}"]) == alone[f"std_{column}"][-1]
    written = tmp_path / "out" / row["folder"] / "estimates.csv"
    assert written.read_bytes() == (tmp_path / "e.csv").read_bytes()


def test_what_changed_is_done_again_and_nothing_else(shop: Path, tmp_path: Path) -> None:
    def fresh(fleet: Fleet) -> list[str]:
        return [d.row.name for d in fleet.rows if d.seconds]

    for name in ("axis0.csv", "axis1.csv"):
        (tmp_path / name).write_bytes((shop / "logs" / name).read_bytes())
    machine = tmp_path / "m.toml"
    machine.write_text(SMALL)
    path = tmp_path / "t.csv"
    path.write_text("machine,log,axis\nm.toml,axis0.csv,a\nm.toml,axis1.csv,b\n")
    assert fresh(run_fleet("estimate", path, tmp_path / "out", HERE)) == ["axis0", "axis1"]
    path.write_text("machine,log,axis,date\nm.toml,axis0.csv,other,2026-01-01\nm.toml,axis1.csv,b,\n")
    assert fresh(run_fleet("estimate", path, tmp_path / "out", HERE)) == []  # what it is called changes no number
    lines = (tmp_path / "axis1.csv").read_text().splitlines()
    (tmp_path / "axis1.csv").write_text("\n".join(lines[:-100]) + "\n")
    assert fresh(run_fleet("estimate", path, tmp_path / "out", HERE)) == ["axis1"]
    machine.write_text(SMALL.replace("coulomb = 4.0", "coulomb = 4.1"))
    assert fresh(run_fleet("estimate", path, tmp_path / "out", HERE)) == ["axis0", "axis1"]
    machine.write_text("# a comment\n" + SMALL.replace("coulomb = 4.0", "coulomb = 4.1"))
    assert fresh(run_fleet("estimate", path, tmp_path / "out", HERE)) == []


def test_copies_of_a_log_have_one_result_and_a_row_each(shop: Path, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "log.csv").write_bytes((shop / "logs" / "axis0.csv").read_bytes())
    path = table(shop, tmp_path, "M,a/log.csv,a,", "M,b/log.csv,b,")
    fleet = run_fleet("estimate", path, tmp_path / "out", HERE)
    assert [d.row.axis for d in fleet.rows] == ["a", "b"]
    assert len(list((tmp_path / "out" / "rows").iterdir())) == 1


@pytest.mark.slow
def test_an_interrupt_loses_nothing_that_was_finished(shop: Path, tmp_path: Path) -> None:
    path, out = table(shop, tmp_path, *GOOD), tmp_path / "out"
    code = f"import sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\nimport process_tasks\n"
    code += "from sgms_mhe.api.fleet import running\nrunning.work = process_tasks.work_on_the_first\n" + SCRIPT
    command = [sys.executable, "-c", code, "fleet", "estimate", str(path), "--out", str(out), "--jobs", "1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert process.stderr.readline().startswith("axis0: good")
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=600)
    assert process.returncode == 130, said
    kept = sorted(folder.name for folder in (out / "rows").iterdir())
    assert len(kept) == 1 and not kept[0].startswith(".")
    assert "results.csv" not in files(out)
    again = done("fleet", "estimate", path, "--out", out)
    assert "3 of 3 logs done, 2 of them now" in again.stdout


def test_a_row_that_takes_too_long_has_failed(shop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import process_tasks

    monkeypatch.setattr("sgms_mhe.api.fleet.running.work", process_tasks.hung_work)
    fleet = run_fleet("estimate", table(shop, tmp_path, *GOOD), tmp_path / "out", WorkerSlot(2, limit_s=1.0))
    assert [d.failure for d in fleet.rows] == ["not done within 1 s, and stopped"] * 3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_what_this_host_gives(shop: Path, tmp_path: Path) -> None:
    path = table(shop, tmp_path, *GOOD, "M,L/broken.csv,z,")
    (tmp_path / "dask").mkdir()
    cluster = Cluster(tmp_path / "dask")
    try:
        first, _ = cluster.worker(), cluster.worker()
        killed: list[bool] = []

        def kill(said: str, share: float) -> None:
            if not killed:
                first.kill()
                killed.append(True)

        far = run_fleet("estimate", path, tmp_path / "far", WorkerSlot(scheduler=cluster.address), kill)
    finally:
        cluster.close()
    near = run_fleet("estimate", path, tmp_path / "near", WorkerSlot(2))
    assert killed
    assert [(d.row.number, d.result, d.failure) for d in far.rows] == [
        (d.row.number, d.result, d.failure) for d in near.rows
    ]


def test_an_extended_machine_of_a_row_loads_wherever_it_is_put(
    shop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = load_machine(shop / "small.toml")
    found = diagnosis_cases.explained(machine)
    monkeypatch.setattr("sgms_mhe.api.fleet.work.diagnose", lambda *_, **__: found)
    row = Row(2, str(shop / "small.toml"), shop / "logs" / "axis0.csv", "a", "a", None, None)
    written = work("diagnose", row, machine, {})
    assert found.extended is not None and found.extended_name is not None
    (tmp_path / "extended.toml").write_bytes(written[found.extended_name])
    assert load_machine(tmp_path / "extended.toml").digest == found.extended.digest


@pytest.mark.slow
def test_diagnose_and_identify_over_a_table(shop: Path, tmp_path: Path) -> None:
    out = tmp_path / "log.csv"
    done("simulate", shop / "small.toml", "--out", out, "--trajectory", "mixed", "--duration", "8", "--seed", "4")
    path = tmp_path / "t.csv"
    path.write_text(f"machine,log,axis,mass\n{shop}/small.toml,log.csv,first axis,20\n")
    done("fleet", "diagnose", path, "--out", tmp_path / "d")
    (row,) = rows_of(tmp_path / "d")
    assert row["verdict"] in ("adequate", "explained", "ambiguous")
    assert abs(float(row["coulomb_N"]) - 4.0) < 5.0 * float(row["std_coulomb_N"]) + 0.05
    assert {"report.html", "diagnosis.json", "result.json"} <= files(tmp_path / "d" / row["folder"])
    assert f'href="{row["folder"]}/report.html"' in (tmp_path / "d" / "fleet.html").read_text()
    done("fleet", "identify", path, "--out", tmp_path / "i")
    (row,) = rows_of(tmp_path / "i")
    assert abs(float(row["coulomb_N"]) - 4.0) < 0.4
    machine = tmp_path / "i" / row["folder"] / "first_axis.toml"
    done("check", machine)


# --- bands ------------------------------------------------------------------------------------------------------


def course(values: list[float], *, std: float = 0.1, machine: str = "m", axis: str = "a", step: float = 30.0) -> Any:
    """Results of one axis, dated `step` days apart; a list of (row, result)."""
    start = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
    found = []
    for k, value in enumerate(values):
        date = start + datetime.timedelta(days=step * k)
        row = Row(k + 2, machine, Path(f"{axis}{k}.csv"), f"{axis}{k}", axis, date, None)
        result = Result("good", "certain", "", "linear", machine, (FleetNumber("coulomb", value, std, 4.0),), ())
        found.append((row, result))
    return found


def only(found: tuple[FleetCourse, ...], axis: str = "a") -> FleetCourse:
    return next(c for c in found if c.axis == axis)


def test_an_unchanged_axis_stays_in_its_band_as_often_as_stated() -> None:
    rng = np.random.default_rng(1)
    scatter, std, runs = 0.3, 0.02, 1500  # what differs between logs is more than each states
    left = [
        [p.left for p in only(courses(course((4.0 + scatter * rng.standard_normal(9)).tolist(), std=std))).points]
        for _ in range(runs)
    ]
    share = np.mean(left, axis=0)
    assert not share[:3].any()  # no band yet
    expected = 1.0 - LEVEL
    # A number leaves with its whole interval: somewhat fewer than stated. Later logs share one band.
    assert np.all(share[3:] < 1.5 * expected + 3.0 * np.sqrt(expected / runs)), share
    assert share[3:].mean() > 0.3 * expected


def test_a_jump_leaves_the_band_at_once_and_stays_out() -> None:
    found = only(courses(course([4.0, 4.05, 3.95, 4.02, 3.98, 4.9, 4.9])))
    assert [p.left for p in found.points] == [False] * 5 + [True, True]
    band = found.points[-1].band
    assert band is not None and (band.origin, band.count) == ("own", 5)
    assert band == found.points[-2].band  # what came later does not move it
    # Not where the log itself knows no better.
    assert not any(p.left for p in only(courses(course([4.0, 4.05, 3.95, 4.02, 3.98, 4.9], std=0.5))).points)


def test_wear_from_the_first_log_on_is_seen_as_a_steady_move() -> None:
    rng = np.random.default_rng(2)
    worn = only(courses(course((4.0 + 0.1 * np.arange(8) + 0.02 * rng.standard_normal(8)).tolist(), std=0.02)))
    assert worn.trend is not None
    assert abs(worn.trend.change - 0.7) < 3.0 * worn.trend.std
    assert (worn.trend.days, worn.trend.count) == (210.0, 8)
    still = [only(courses(course((4.0 + 0.3 * rng.standard_normal(8)).tolist(), std=0.02))) for _ in range(1000)]
    assert np.mean([c.trend is not None for c in still]) < 0.02
    small = only(courses(course((4.0 + 0.001 * np.arange(8)).tolist(), std=0.1)))
    assert small.trend is None  # within what a log can tell


@pytest.mark.parametrize("count", [5, 8, 20])
def test_an_unchanged_number_is_called_changed_as_seldom_as_stated(count: int) -> None:
    rng, runs = np.random.default_rng(3), 4000
    share = np.mean([bool(find_steps(4.0 + 0.3 * rng.standard_normal(count), 0.0)) for _ in range(runs)])
    assert 0.0 < share < ALARM + 3.0 * np.sqrt(ALARM / runs)  # Bonferroni's limit is an upper one


@pytest.mark.parametrize(
    ("levels", "after"),
    [
        ([4.0] * 6 + [4.6] * 6, [6]),
        ([4.0] * 6 + [4.6] * 6 + [4.0] * 6, [6, 12]),  # worn, then repaired
        ([4.0] * 10 + [4.6], []),  # one log alone is for its band
    ],
)
def test_a_step_is_found_where_it_is(levels: list[float], after: list[int]) -> None:
    values = np.array(levels) + 0.05 * np.random.default_rng(4).standard_normal(len(levels))
    found = only(courses(course(values.tolist(), std=0.03)))
    assert [change.log for change in found.changes] == [f"a{k}" for k in after] and found.trend is None
    for change, k in zip(found.changes, after, strict=True):
        assert abs(change.change - (levels[k] - levels[k - 1])) < 3.0 * change.std < 0.3
    wide = only(courses(course(values.tolist(), std=1.0)))
    assert not wide.changes  # within what a log can tell


def test_a_steady_move_is_no_staircase() -> None:
    values = 4.0 + 0.1 * np.arange(30) + 0.02 * np.random.default_rng(5).standard_normal(30)
    found = only(courses(course(values.tolist(), std=0.02)))
    assert found.trend is not None and not found.changes


def test_a_fleet_that_nothing_could_be_judged_of_is_not_green(tmp_path: Path) -> None:
    rows = course([4.0] * 3)
    fleet = Fleet(tmp_path / "t.csv", "estimate", tuple(Done(*pair, "", None, 0.0) for pair in rows), courses(rows))
    text = write_fleet(fleet, tmp_path).read_text()
    assert '<span class="pill undecided">' in text and "1 of 1 axes not judged yet" in text


def test_an_axis_without_a_past_is_held_against_the_fleet() -> None:
    values = [4.0, 4.1, 3.9, 4.05, 3.95, 4.02, 12.0]
    rows = [pair for k, value in enumerate(values) for pair in course([value], axis=f"a{k}")]
    rows = [(Row(k + 2, *_rest(row)), result) for k, (row, result) in enumerate(rows)]
    found = courses(rows)
    assert [c.points[0].left for c in found] == [False] * 6 + [True]
    band = found[-1].points[0].band
    assert band is not None and (band.origin, band.count) == ("fleet", 6)
    # Others of another machine, or of none, say nothing about it.
    for machine in ("other", ""):
        mixed = [*rows[:-1], (Row(99, machine, *_rest(rows[-1][0])[1:]), rows[-1][1])]
        assert courses(mixed)[-1].points[0].band is None
    assert all(c.points[0].band is None for c in courses(rows[:5]))  # too few


@pytest.mark.parametrize(
    ("standing", "verdict", "badge", "said"),
    [
        ("certain", "good", "certain", "All 6 logs done; no axis stands out"),
        ("limited", "explained", "limited", "All 6 logs done; no axis stands out"),
        ("undecided", "doubt", "undecided", "All 6 logs done; 6 of 6 logs open: 6 doubt; no axis stands out"),
        ("failed", "unexplained", "undecided", "6 of 6 logs open: 6 unexplained"),
        ("nothing", "adequate", "undecided", "6 of 6 logs open: 6 adequate"),
    ],
)
def test_a_fleet_is_green_where_every_result_holds(
    standing: Standing, verdict: str, badge: str, said: str, tmp_path: Path
) -> None:
    rows = [(row, replace(result, verdict=verdict, standing=standing)) for row, result in course([4.0] * 6)]
    done_rows = tuple(Done(row, result, "", None, 0.0) for row, result in rows)
    fleet = Fleet(tmp_path / "table.csv", "estimate", done_rows, courses(rows))
    page = write_fleet(fleet, tmp_path)
    html = page.read_text()
    assert f'<span class="pill {badge}">' in html and said in html
    assert ("6 of 6 logs open" in fleet_text(fleet, page)) == (badge == "undecided")
    assert {row["standing"] for row in results_json(fleet, tmp_path)["rows"]} == {standing}


def _rest(row: Row) -> tuple[Any, ...]:
    return row.machine, row.log, row.name, row.axis, row.date, row.mass


# --- the page ---------------------------------------------------------------------------------------------------


def test_the_page_has_failures_first_and_needs_no_other_file(
    shop: Path, tmp_path: Path, outlier: Callable[[Path], Path]
) -> None:
    run("fleet", "estimate", outlier(tmp_path), "--out", tmp_path / "out")
    text = (tmp_path / "out" / "fleet.html").read_text()
    places = [text.index(f"<h2>{title}</h2>") for title in ("What failed", "Every log")]
    assert places == sorted(places)
    assert not re.search(r"(src|href)=\"(https?:|//|file:)", text)
    for target in re.findall(r'href="([^"]+)"', text):
        assert (tmp_path / "out" / target).is_file()
    assert "&lt;b&gt;" in text and "<b>axis" not in text  # a name is text
    assert "prefers-color-scheme: dark" in text


@pytest.fixture
def outlier(shop: Path) -> Callable[[Path], Path]:
    def made(folder: Path) -> Path:
        return table(shop, folder, *GOOD[:2], "M,L/axis2.csv,<b>axis,", "M,L/broken.csv,z,")

    return made
