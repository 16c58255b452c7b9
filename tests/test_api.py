"""The public Python API: what it gives, that it costs nothing until it is used, and that its page and scripts run."""

import ast
import inspect
import pickle
import re
import runpy
import subprocess
import sys
from contextvars import Context
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import sgms_mhe
from cli_cases import SMALL, done, read_columns
from diagnosis_cases import explained
from sgms_mhe.emission.package import emit_package
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import COLUMNS, Log
from sgms_mhe.support.errors import ImplausibleError, InputError
from sgms_mhe.support.notebooks import Presentation, Shown

pytestmark = pytest.mark.core

ROOT = Path(__file__).resolve().parents[1]
ROTARY = SMALL.replace("mass = 20.0", 'kind = "rotary"\ninertia = 20.0').replace('"small"', '"turning"')


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("machine") / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="module")
def log(small: Path) -> Log:
    return sgms_mhe.simulate(small, duration_s=3.0, scale={"stiffness": 1.2}, seed=3).log


# --- what there is ----------------------------------------------------------------------------------------------


def test_importing_the_package_imports_nothing_else() -> None:
    script = (
        "import sys\nbefore = set(sys.modules)\nimport sgms_mhe\ndir(sgms_mhe)\n"
        "roots = {name.partition('.')[0] for name in set(sys.modules) - before}\n"
        "print(sorted(roots - set(sys.stdlib_module_names)))"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stdout == "['sgms_mhe']\n"


def test_what_extras_bring_is_needed_for_no_result(small: Path, tmp_path: Path) -> None:
    calls = [
        ["simulate", small, "--out", "log.csv", "--duration", "2", "--scale", "coulomb=1.2"],
        ["inspect", "log.csv"],
        ["predict", small, "log.csv", "--out", "p.csv"],
        ["estimate", small, "log.csv", "--out", "e.csv", "--plot", "figures"],
        ["estimate", small, "log.csv", "--out", "e.csv"],
    ]
    script = (
        "import sys, sgms_mhe\nsys.modules |= dict.fromkeys(('matplotlib', 'pandas', 'h5py', 'distributed'))\n"
        "for name in sgms_mhe.__all__: getattr(sgms_mhe, name)\nimport sgms_mhe.report\n"
        "from click.testing import CliRunner\nfrom sgms_mhe.cli import cli\n"
        f"for call in {[list(map(str, call)) for call in calls]}:\n"
        "    result = CliRunner().invoke(cli, call)\n"
        "    print(result.exit_code, result.stderr if result.exit_code else '', end=';')"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, text=True, capture_output=True, check=True)
    assert re.sub(r"\s+", " ", ran.stdout) == (
        "0 ;0 ;0 ;2 Error: --plot: library = 'matplotlib': not installed, a figure needs it: "
        "pip install 'sgms-mhe[plot]' ;0 ;"
    )


def test_a_frame_without_pandas_says_what_to_install(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"pip install 'sgms-mhe\[frames\]'"):
        log.to_frame()


def test_every_function_is_there_described_and_typed() -> None:
    assert sgms_mhe.__all__ == sorted(sgms_mhe.__all__) and set(sgms_mhe.__all__) <= set(dir(sgms_mhe))
    for name in sgms_mhe.__all__:
        function = getattr(sgms_mhe, name)
        text = inspect.getdoc(function)
        assert function.__name__ == name and text is not None and "docs/" not in text
        if isinstance(function, type):
            continue
        assert "Raises:" in text or name == "effects"
        signature = inspect.signature(function)
        assert all(p.annotation is not inspect.Parameter.empty for p in signature.parameters.values())
        described = set(re.findall(r"^    (\w+(?:, \w+)*):", text, flags=re.MULTILINE))
        assert set(signature.parameters) <= {word for names in described for word in names.split(", ")} | {"InputError"}


def test_type_checkers_are_told_the_same() -> None:
    tree = ast.parse((ROOT / "generator" / "sgms_mhe" / "__init__.pyi").read_text())
    told = {node.names[0].name: node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
    assert told == {name: getattr(sgms_mhe, name).__module__ for name in sgms_mhe.__all__}
    assert f"__all__ = {sgms_mhe.__all__}".replace("'", '"') in ast.unparse(tree).replace("'", '"')


def test_what_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'identfy'"):
        sgms_mhe.identfy  # type: ignore[attr-defined]  # noqa: B018


def test_the_module_is_the_command_line() -> None:
    ran = subprocess.run([sys.executable, "-m", "sgms_mhe", "--version"], capture_output=True, text=True, check=True)
    assert ran.stdout == f"sgms-mhe, version {sgms_mhe.__version__}\n"


def test_the_citation_is_of_this_version() -> None:
    text = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {sgms_mhe.__version__}\n" in text
    assert "\n  - name: sgms-mhe contributors\n" in text
    paper = (ROOT / "docs" / "model.md").read_text().partition("The paper is ")[2].partition("Numbers")[0]
    title = re.search(r"\*(.+)\*", paper.replace("\n", " "))
    assert title is not None and f"title: {title[1]}\n" in text
    assert all(f"family-names: {name}\n" in text for name in re.findall(r"[A-Z]\. ([\w ]+),", paper))
    (year,), (doi,) = re.findall(r"Conference (\d{4})", paper), re.findall(r"doi\.org/([^)]+)", paper)
    assert f"year: {year}\n" in text and f"doi: {doi}\n" in text


# --- machines and logs ------------------------------------------------------------------------------------------


def test_a_machine_is_a_path_a_name_or_itself(small: Path) -> None:
    machine = sgms_mhe.load(small)
    assert isinstance(machine, Machine) and machine.name == "small"
    assert sgms_mhe.load(machine) is machine
    assert sgms_mhe.load("etel_xy").name == "etel_xy"


def test_a_log_is_a_path_itself_or_a_frame(small: Path, log: Log, tmp_path: Path) -> None:
    path = tmp_path / "axis.csv"
    log.to_frame().to_csv(path, index=False)
    for source in (path, str(path), log, log.to_frame(), log.to_frame().sample(frac=1.0, axis=1, random_state=1)):
        read = sgms_mhe.read_log(source, small)
        for name, values in log.columns.items():
            assert np.array_equal(read.columns[name], values), name
        assert read.rate == pytest.approx(1000.0)
    assert len(sgms_mhe.read_log(log, start_s=1.0, end_s=2.0)) == 1001


def test_a_frame_is_mapped_as_a_file_is(small: Path, log: Log, tmp_path: Path) -> None:
    mapped = tmp_path / "mapped.toml"
    mapped.write_text(SMALL + '[log]\nposition_m = { variable = "x", unit = "mm" }\n')
    frame = log.to_frame().rename(columns={"position_m": "x"})
    frame["x"] *= 1e3
    frame["time_s"] = pd.Timestamp("2024-01-01") + pd.to_timedelta(frame["time_s"], unit="s")
    read = sgms_mhe.read_log(frame, mapped)
    assert np.allclose(read.position_m, log.position_m, rtol=1e-12, atol=0.0)
    assert np.allclose(read.time_s, log.time_s, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda frame: frame.drop(columns="force_N"), "force_N"),
        (lambda frame: frame.assign(force_N="much"), "row 1, column force_N = 'much': a number"),
        (lambda frame: pd.concat([frame, frame[["force_N"]]], axis=1), "each name once"),
        (lambda frame: frame.iloc[::2], "sampling.rate of small"),
        (lambda frame: 3, "a path, a Log, a pandas.DataFrame or arrays by name"),
    ],
    ids=["no force", "text", "a name twice", "another rate", "no table"],
)
def test_frames_that_are_no_log_are_refused(change, expected: str, small: Path, log: Log) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=re.escape(expected)):
        sgms_mhe.read_log(change(log.to_frame()), small)


def test_a_log_of_another_axis_is_refused(small: Path, log: Log, tmp_path: Path) -> None:
    turning = tmp_path / "turning.toml"
    turning.write_text(ROTARY)
    with pytest.raises(InputError, match="columns of a rotary axis"):
        sgms_mhe.estimate(turning, log)
    with pytest.raises(ImplausibleError):
        sgms_mhe.predict(small, log.to_frame().assign(force_N=lambda frame: -frame["force_N"]))


# --- the same as the commands -----------------------------------------------------------------------------------


def test_functions_give_what_the_commands_write(small: Path, log: Log, tmp_path: Path) -> None:
    trace = tmp_path / "log.csv"
    done("simulate", small, "--out", trace, "--duration", "3", "--scale", "stiffness=1.2", "--seed", "3")
    assert_same(log.to_frame(), trace)

    for solver in ("c", "ekf"):
        done("estimate", small, trace, "--out", tmp_path / "e.csv", "--solver", solver)
        estimates = sgms_mhe.estimate(small, log, solver=solver)  # type: ignore[arg-type]
        assert_same(estimates.to_frame(), tmp_path / "e.csv")

    done("predict", small, trace, "--out", tmp_path / "p.csv")
    assert_same(sgms_mhe.predict(small, log).to_frame(), tmp_path / "p.csv")


FORMS = ("arrays", "duration index", "time index", "named index", "text", "decimal commas", "objects")


@pytest.mark.parametrize("form", FORMS)
def test_columns_in_other_forms_are_read(form: str, log: Log) -> None:
    frame = log.to_frame()
    times = pd.to_timedelta(frame["time_s"], unit="s")
    source: object = {
        "arrays": {"position_m": log.position_m, "force_N": log.force_N},
        "duration index": frame.drop(columns="time_s").set_axis(pd.TimedeltaIndex(times, name=None)),
        "time index": frame.drop(columns="time_s").set_axis(pd.DatetimeIndex(pd.Timestamp("2026-01-01") + times)),
        "named index": frame.set_index("time_s"),
        "text": frame.astype(str),
        "decimal commas": frame.assign(force_N=frame["force_N"].map(lambda force: f"{force:.17g}".replace(".", ","))),
        "objects": frame.assign(force_N=frame["force_N"].astype(object)),
    }[form]
    read = sgms_mhe.read_log(source, rate=log.rate if form == "arrays" else None)  # type: ignore[arg-type]
    assert np.array_equal(read.position_m, log.position_m) and np.array_equal(read.force_N, log.force_N)
    assert read.rate == pytest.approx(log.rate, rel=1e-6)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"position_m": [1.0, 2.0], "force_N": [1.0]}, "as many values in each array"),
        ({"position_m": ["much", "more"], "force_N": [1.0, 2.0]}, "row 1, column position_m = 'much': a number"),
    ],
)
def test_arrays_that_are_no_log_are_refused(columns: dict[str, list[object]], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        sgms_mhe.read_log(columns, rate=1000.0)


def test_sentences_on_a_log_are_warnings_where_nobody_listens(log: Log) -> None:
    frame = log.to_frame()[["time_s", "force_N"]].assign(velocity_m_s=0.1)
    heard: list[str] = []
    sgms_mhe.read_log(frame, note=heard.append)
    with pytest.warns(sgms_mhe.LogWarning, match="no position") as caught:
        sgms_mhe.read_log(frame)
    assert [str(warning.message) for warning in caught] == heard
    assert Path(caught[0].filename) == Path(__file__)


def test_results_can_be_looked_at_kept_and_not_changed(small: Path, log: Log) -> None:
    estimates, predicted = sgms_mhe.estimate(small, log), sgms_mhe.predict(small, log)
    for result in (sgms_mhe.read_log(log.to_frame()), estimates, predicted):
        again = pickle.loads(pickle.dumps(result))
        assert type(again) is type(result)
        arrays = [value for field in fields(result) if isinstance(value := getattr(result, field.name), np.ndarray)]
        assert arrays
        for array in arrays:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
        assert len(repr(result)) < 200 and "array" not in repr(result)
        html = result._repr_html_()
        assert html.count("<") == html.count(">") > 1
        axes = result.plot()
        assert axes.get_xlabel() == "time [s]" and len(axes.lines) >= 1
        assert result.plot(axes=axes) is axes
        plt.close(axes.figure)
    axes = estimates.plot("stiffness_1")
    assert len(axes.collections) == 1  # the band
    plt.close(axes.figure)
    with pytest.raises(InputError, match="stiffness_1"):
        estimates.plot("nothing")


def test_a_diagnosis_is_looked_at(small: Path) -> None:
    found = explained(sgms_mhe.load(small))
    frame = found.to_frame()
    assert len(frame) == sum(len(cause.parameters) for cause in found.causes) > 0
    assert set(frame["cause"]) == {cause.name for cause in found.causes}
    assert found.verdict in found._repr_html_() and found.causes[0].name in found._repr_html_()
    assert repr(found).startswith("<Diagnosis explained") and len(repr(found)) < 400
    assert "statement (+-: 2 sigma)" in found._repr_html_() and "+- " in found._repr_html_().partition("<tbody>")[2]
    axes = found.plot()
    assert [line.get_label() for line in axes.lines] == ["before", "after"]
    plt.close(axes.figure)
    assert pickle.loads(pickle.dumps(found)).summary == found.summary


def test_arrays_of_the_caller_stay_writeable(log: Log) -> None:
    mine = log.position_m.copy()
    sgms_mhe.read_log({"position_m": mine, "force_N": log.force_N}, rate=log.rate)
    mine[0] = 1.0


def test_what_a_table_says_is_escaped() -> None:
    class Table(Shown):
        def _shown(self) -> Presentation:
            return "<b>", ("a & b",), (("<i>",),)

    html = Table()._repr_html_()
    assert all(escaped in html for escaped in ("&lt;b&gt;", "a &amp; b", "&lt;i&gt;"))


TIME = np.arange(2000) * 1e-3
SINE, COSINE = np.sin(TIME), np.cos(TIME)
REFUSED: dict[str, tuple[dict[str, Any], str, object, str, str]] = {
    "uneven time": (
        {"time_s": TIME**1.3, "position_m": SINE, "force_N": COSINE},
        "row 2, column time_s",
        float(TIME[1] ** 1.3),
        'read_log\'s table={"resample": True} for uneven time',
        "[log] (machine file, --log) has resample = true for uneven time",
    ),
    "two columns missing": (
        {"time_s": TIME, "a": SINE, "b": COSINE},
        "columns position_m, force_N",
        None,
        'read_log\'s table says where it is: {"force_N": {"variable": "...", "unit": "..."}}',
        '[log] (machine file, --log) says where it is: force_N = { variable = "...", unit = "..." }',
    ),
    "no time": (
        {"position_m": SINE, "force_N": COSINE},
        "column time_s",
        None,
        'where there is none it has {"rate": ...} [Hz]',
        "where there is none it has rate = ... [Hz], as --rate",
    ),
    "text": (
        {"time_s": TIME, "position_m": ["fault" if k in (3, 9) else k * 1e-4 for k in range(2000)], "force_N": COSINE},
        "row 4, column position_m",
        "fault",
        "a number, or NaN",
        "a number, or NaN",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_carries_data_and_names_what_the_caller_can_set(case: str) -> None:
    columns, where, value, in_python, on_command_line = REFUSED[case]
    with pytest.raises(InputError) as caught:
        sgms_mhe.read_log(columns)
    error = caught.value
    assert (error.source, error.where, error.value) == ("DataFrame", where, value)
    assert on_command_line in error.allowed and error.allowed in str(error)
    told = Context().run(str, error)
    assert in_python in told and "--" not in told and "machine file" not in told


@pytest.mark.parametrize("kind", [InputError, ImplausibleError])
def test_errors_come_back_from_another_process(kind: type[InputError]) -> None:
    error = kind("file", "key", 3, "another")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind and str(again) == str(error) and again.value == 3


def test_effects_and_a_plan(small: Path) -> None:
    effects = sgms_mhe.effects("linear")
    assert "force_ripple" in effects and "unbalance" not in effects and "unbalance" in sgms_mhe.effects()
    assert effects["force_ripple"].parameters and effects["force_ripple"].summary
    plan = sgms_mhe.plan(small, ("constant_offset", "asymmetric_coulomb"))
    assert plan.reason and plan.trajectory.duration_s > 1.0
    with pytest.raises(InputError, match="two of"):
        sgms_mhe.plan(small, ("constant_offset", "nothing"))


def test_one_binding_is_a_name(small: Path) -> None:
    one, listed = (sgms_mhe.generate(small, bindings=given) for given in ("cpp", ["cpp"]))
    assert one.files == listed.files


def assert_same(frame: pd.DataFrame, path: Path) -> None:
    """A frame holds what a file does, to the bit and in its order."""
    columns = read_columns(path)
    assert list(frame) == list(columns)
    for name, values in columns.items():
        assert np.array_equal(frame[name].to_numpy(), values, equal_nan=True), name


def test_generate_writes_only_where_it_is_told(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    package = sgms_mhe.generate(small)
    assert list(tmp_path.iterdir()) == []
    assert dict(package.files) == dict(emit_package(sgms_mhe.load(small)).files)
    sgms_mhe.generate(small, "package", amalgamate=True)
    assert {path.name for path in (tmp_path / "package").iterdir()} < set(package.files)


def test_a_solver_that_does_not_exist_is_refused(small: Path, log: Log) -> None:
    with pytest.raises(InputError, match="solver = 'mhe': one of c, reference, ekf, smoother"):
        sgms_mhe.estimate(small, log, solver="mhe")  # type: ignore[arg-type]


def test_frames_of_an_axis_that_turns_have_its_names(tmp_path: Path) -> None:
    path = tmp_path / "turning.toml"
    path.write_text(ROTARY)
    log = sgms_mhe.simulate(path, duration_s=2.0, scale={"inertia": 1.01}).log
    assert list(log.to_frame()) == ["time_s", "position_rad", "torque_Nm"]
    assert list(sgms_mhe.predict(path, log.to_frame()).to_frame()) == ["time_s", "friction_measured_Nm", "friction_Nm"]
    assert {"z_1_rad", "friction_Nm", "innovation_Nm"} <= set(sgms_mhe.estimate(path, log).to_frame())


def test_progress_and_notes_are_told(small: Path, log: Log) -> None:
    steps: list[tuple[int, int]] = []
    sgms_mhe.estimate(small, log, progress=lambda done, total: steps.append((done, total)))
    assert steps and steps[-1][0] == steps[-1][1]


def test_results_are_frozen(small: Path, log: Log) -> None:
    for result in (log, sgms_mhe.predict(small, log), sgms_mhe.estimate(small, log), sgms_mhe.generate(small)):
        assert is_dataclass(result)
        with pytest.raises(AttributeError):
            setattr(result, fields(result)[0].name, None)
    assert set(log.columns) <= set(COLUMNS)


# --- page and scripts -------------------------------------------------------------------------------------------


def test_code_on_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL | re.MULTILINE)
    assert len(blocks) == 7
    (tmp_path / "my_axis.toml").write_text(SMALL.replace('"small"', '"my_axis"'))
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for i, block in enumerate(blocks):
        exec(compile(block, f"docs/python.md, block {i + 1}", "exec"), names)
    said = capsys.readouterr().out
    assert "std_stiffness_1" in said and "'my_axis.c'" in said and "column force_N" in said
    assert (tmp_path / "package" / "my_axis.h").is_file()


def test_help_opens_with_the_functions_and_an_example_that_runs(capsys: pytest.CaptureFixture[str]) -> None:
    said = sgms_mhe.__doc__ or ""
    listed = re.findall(r"^    ([a-z_]+)  +\S", said.partition("Example:")[0], re.MULTILINE)
    functions = [name for name in sgms_mhe.__all__ if not isinstance(getattr(sgms_mhe, name), type)]
    assert sorted(listed) == functions
    lines = re.findall(r"^    >>> (.*)", said.partition("Example:")[2], re.MULTILINE)
    exec(compile("\n".join(lines), "help(sgms_mhe)", "exec"), {})
    friction_N, status = map(float, capsys.readouterr().out.split())
    assert 0.0 < friction_N < 30.0 and status >= 0


def test_estimators_compared(small: Path) -> None:
    script = runpy.run_path(str(ROOT / "examples" / "python" / "compare_estimators.py"))
    table = script["compare"](str(small))
    assert list(table.index) == ["MHE", "EKF"]
    # The true stiffness is 1.3 times the file's, so that a ratio of 0.77 is no estimate.
    assert (abs(table["stiffness_ratio"] - 1.0) < 0.1).all()
    log = sgms_mhe.simulate(small, "mixed", duration_s=5.0, scale={"stiffness": 1.3}).log
    for name, solver in (("MHE", "c"), ("EKF", "ekf")):
        found = sgms_mhe.estimate(small, log, solver=solver)  # type: ignore[arg-type]
        rms = np.sqrt(np.nanmean((found.friction_measured_N - found.friction_N) ** 2))
        assert table.loc[name, "residual_rms_N"] == pytest.approx(rms, rel=1e-12)
