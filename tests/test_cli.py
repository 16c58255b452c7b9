"""The command line: every command, what it refuses and how, and that nothing is left half-written."""

import inspect
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import sgms_mhe
import sgms_mhe.cli
from cli_cases import SMALL, done, files, read_columns, refused, run
from sgms_mhe import diagnose, estimate, fleet, generate, identify, plan, predict, simulate
from sgms_mhe.api.starting import start_text
from sgms_mhe.cli import COMMANDS, WORKBENCH, cli, command_names
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.logfiles.reading import read_log


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("machine") / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="session")
def log(small: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "axis.csv"
    done("simulate", small, "--out", path, "--duration", "5", "--scale", "stiffness=1.2")
    return path


def rows_of(log: Path) -> list[str]:
    return log.read_text().splitlines()


def changed(log: Path, folder: Path, change: Callable[[list[str]], list[str]], name: str = "changed.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(change(rows_of(log))) + "\n")
    return path


def with_field(row: int, column: int, text: str) -> Callable[[list[str]], list[str]]:
    """Replace one field; rows count from 1 after the header."""

    def change(lines: list[str]) -> list[str]:
        fields = lines[row].split(",")
        fields[column] = text
        return [*lines[:row], ",".join(fields), *lines[row + 1 :]]

    return change


# --- help -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", command_names())
def test_help_of_every_command_has_an_example(name: str) -> None:
    text = done(name, "--help").stdout
    assert f"Example:\n    sgms-mhe {name}" in text


def test_help_lists_every_command_in_the_order_of_work() -> None:
    text = done("--help").stdout
    places = [text.index(f"\n  {name} ") for name in command_names()]
    assert places == sorted(places)


def test_commands_of_the_workbench_are_refused_where_it_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    added = set(command_names()) - set(COMMANDS)
    assert added == set(WORKBENCH)
    monkeypatch.setattr(sgms_mhe.cli, "entry_points", lambda group: ())
    assert command_names() == list(COMMANDS)
    for name in added:
        assert f"'{name}' belongs to the workbench, which is in a checkout" in refused(name, "etel_xy")
        assert f"\n  {name} " not in done("--help").stdout


def test_another_distribution_adds_a_command_and_takes_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [EntryPoint(name, "sgms_mhe.commands.schema:command", "sgms_mhe.commands") for name in ("own", "check")]
    monkeypatch.setattr(sgms_mhe.cli, "entry_points", lambda group: entries)
    assert command_names() == [*COMMANDS, "own"]
    assert done("own").stdout == done("schema").stdout
    assert done("check", "--help").stdout != done("own", "--help").stdout


def test_a_command_that_cannot_be_imported_is_an_error_of_its_distribution(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("own", "no_such_module:command", "sgms_mhe.commands")
    monkeypatch.setattr(sgms_mhe.cli, "entry_points", lambda group: [entry])
    assert "command own = no_such_module:command: No module named 'no_such_module'" in refused("own", "-x", "y")
    assert "\n  own " in done("--help").stdout


def test_version() -> None:
    assert done("--version").stdout == f"sgms-mhe, version {sgms_mhe.__version__}\n"


@pytest.mark.parametrize("arguments", [["--help"], ["effects", "--help"], ["bench", "--help"]], ids=" ".join)
def test_what_computes_is_imported_late(arguments: list[str]) -> None:
    script = (
        "import sys\nfrom sgms_mhe.cli import cli\n"
        f"try: cli({arguments})\n"
        "except SystemExit: pass\n"
        "heavy = ('casadi', 'matplotlib', 'numpy', 'osqp', 'rich', 'scipy')\n"
        "print([name for name in heavy if name in sys.modules], file=sys.stderr)"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stderr == "[]\n"


FUNCTIONS = {"simulate": simulate, "estimate": estimate, "predict": predict, "identify": identify, "fleet": fleet}
FUNCTIONS |= {"diagnose": diagnose, "plan": plan, "generate": generate, "start": start_text}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_options_are_those_of_the_typed_function(name: str) -> None:
    """Their range, default and help are read from the source, which is not imported: it has to be the same."""
    options = {option.name: option for option in cli.get_command(click.Context(cli), name).params}
    texts = " ".join((inspect.getdoc(FUNCTIONS[name]) or "").split())
    marked = 0
    for parameter in inspect.signature(FUNCTIONS[name], eval_str=True).parameters.values():
        form = next((each for each in getattr(parameter.annotation, "__metadata__", ())), None)
        if form is None:
            continue
        marked += 1
        option = options[parameter.name]
        kinds = option.type.types if isinstance(option.type, click.Tuple) else [option.type]
        for kind in kinds:
            if isinstance(kind, click.IntRange | click.FloatRange):
                assert (kind.min, kind.max) == (form.least, form.most)
        if parameter.default not in (None, False):
            assert option.get_default(click.Context(cli)) == parameter.default
        words = option.help.partition("; default: ")[0].rstrip(".")
        assert f"{parameter.name}: {words[0].lower()}{words[1:]}".lower() in texts.lower()
    assert marked


def test_an_unknown_command_is_bad_input() -> None:
    assert "No such command" in refused("estimat")


# --- generate, check, schema ---------------------------------------------------------------------------------------


def test_generate_writes_the_package_and_prints_its_sizes(small: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    result = json.loads(done("generate", small, "--out", folder, "--json").stdout)
    package = emit_package(load_machine(small)).files
    assert {path.name: path.read_text() for path in folder.iterdir()} == dict(package)
    assert result["files"] == {name: (folder / name).stat().st_size for name in package}
    assert f"{folder / 'small.c'}" in done("generate", small, "--out", folder).stdout


def test_generate_without_out_goes_below_the_working_directory(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done("generate", small)
    assert (tmp_path / "generated" / "small" / "small.h").is_file()


def test_generate_leaves_a_folder_with_other_files_alone(small: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("x")
    assert "thesis.tex" in refused("generate", small, "--out", tmp_path)
    assert files(tmp_path) == {"thesis.tex"}


def test_check_prints_what_is_resolved(small: Path) -> None:
    text = done("check", small).stdout
    assert "flow, 20 steps per interval of 20 samples" in text
    assert "stiffness_2" in text
    content = json.loads(done("check", small, "--json").stdout)
    assert content["machine"]["sampling"]["integrator"]["substeps"] == 20
    assert content["machine"]["friction"]["smoothing"]["lambda"] == 35.0
    assert content["digest"] == load_machine(small).digest


@pytest.mark.parametrize("name", ["etel_xy", "etel_xy_paper", "emps"])
def test_check_passes_every_shipped_machine(name: str) -> None:
    assert done("check", name).stdout.startswith(f"{name}: ")


def test_schema_is_json_schema() -> None:
    schema = json.loads(done("schema").stdout)
    assert schema["$id"] == f"urn:sgms-mhe:machine:{sgms_mhe.__version__}"
    assert schema["additionalProperties"] is False
    assert {"plant", "friction", "extends"} <= set(schema["properties"])


# --- simulate ----------------------------------------------------------------------------------------------------


def test_simulate_writes_the_log_that_its_options_ask_for(small: Path, tmp_path: Path) -> None:
    def simulated(*options: str, name: str = "x.csv") -> dict[str, Any]:
        done("simulate", small, "--out", tmp_path / name, "--duration", "1", *options)
        return read_log(tmp_path / name).columns

    base = simulated()
    assert list(base) == ["time_s", "position_m", "force_N"]
    assert len(base["time_s"]) == 1000
    same, other = simulated("--seed", "0", name="x.npz"), simulated("--seed", "1")
    np.testing.assert_array_equal(same["force_N"], base["force_N"])
    assert np.any(other["force_N"] != base["force_N"])
    quiet = simulated("--force-noise", "0", "--encoder-resolution", "1e-6")
    np.testing.assert_allclose(quiet["position_m"] / 1e-6, np.round(quiet["position_m"] / 1e-6), atol=1e-6)
    scaled = simulated("--force-noise", "0", "--scale", "stiffness_1=1.5", "--scale", "coulomb=1.1")
    plain = simulated("--force-noise", "0")
    assert np.abs(scaled["force_N"] - plain["force_N"]).max() > 0.01
    switching = simulated("--force-noise", "0", "--law", "maxwell_slip")
    assert np.abs(switching["force_N"] - plain["force_N"]).max() > 0.001


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--trajectory", "spiral"], "trajectory: name = 'spiral': one of paper, mixed"),
        (["--duration", "-1"], "-1.0 is not in the range"),
        (["--duration", "86400"], "at most 50000 s at 1000 Hz"),
        (["--scale", "stiffness"], "'stiffness' is not NAME=FACTOR"),
        (["--scale", "stiffness=nan"], "'stiffness=nan' is not NAME=FACTOR"),
        (["--scale", "wobble=2"], "wobble"),
        (["--scale", "stiffness=1e300"], "'stiffness=1e300' is not NAME=FACTOR"),
        (["--force-noise", "-1"], "-1.0 is not in the range"),
        (["--seed", "-1"], "-1 is not in the range"),
        (["--law", "lugre"], "'lugre' is not one of"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_simulate_refuses_options(small: Path, tmp_path: Path, options: list[str], message: str) -> None:
    assert message in refused("simulate", small, "--out", tmp_path / "x.csv", *options)
    assert files(tmp_path) == set()


def test_simulate_refuses_a_suffix_that_no_log_has(small: Path, tmp_path: Path) -> None:
    assert "a name that ends in .csv or .npz" in refused("simulate", small, "--out", tmp_path / "x.mat")


def float_options() -> list[tuple[str, str, int]]:
    """(command, option, number of values) of every option that takes numbers with a fraction."""
    found = []
    for name in command_names():
        for parameter in cli.get_command(click.Context(cli), name).params:
            kind = parameter.type
            kinds = kind.types if isinstance(kind, click.Tuple) else [kind]
            if any(isinstance(kind, click.types.FloatParamType) for kind in kinds):
                found.append((name, parameter.opts[0], len(kinds)))
    return found


NO_NUMBERS = ("nan", "-nan", "inf", "-inf", "1e308", "-1", "1e400", "one")


@pytest.mark.parametrize(("name", "option", "count"), float_options())
def test_numbers_out_of_range_are_refused(name: str, option: str, count: int) -> None:
    for value in NO_NUMBERS:
        if (option, value) == ("--force-scale", "-1"):
            value = "1e300"  # a force that counts the other way is a legal scale
        message = refused(name, "etel_xy", "log.csv", option, *[value] * count)
        assert f"Invalid value for '{option}'" in message, value
        assert "is not in the range" in message or "is not a valid float" in message, value


@pytest.mark.parametrize("name", ["bench", "target"])
def test_flags_that_are_no_words_are_refused(name: str) -> None:
    assert "no closing quotation" in refused(name, "etel_xy", "--cflags", "-O2 '-DX")


def test_numbers_are_given_with_their_range_in_every_help() -> None:
    options = float_options()
    assert {option for _, option, _ in options} >= {"--duration", "--lowpass", "--from", "--window", "--held-out"}
    for name, option, count in options:
        if count == 1:
            text = done(name, "--help").stdout.split(f" {option} ", 1)[1]
            assert "<=x<=" in text.split(" --", 1)[0], option


# --- predict -----------------------------------------------------------------------------------------------------


def test_predict_writes_every_sample_and_the_rms_of_the_valid_ones(small: Path, log: Path, tmp_path: Path) -> None:
    out = tmp_path / "p.csv"
    result = json.loads(done("predict", small, log, "--out", out, "--json").stdout)
    columns = read_columns(out)
    assert list(columns) == ["time_s", "friction_measured_N", "friction_N"]
    np.testing.assert_array_equal(columns["time_s"], read_log(log).time_s)
    difference = columns["friction_measured_N"] - columns["friction_N"]
    valid = np.isfinite(difference)
    assert 0 < np.count_nonzero(~valid) < 50  # while the filters settle
    assert result["valid"] == np.count_nonzero(valid)
    assert result["residual_rms_N"] == pytest.approx(np.sqrt(np.mean(difference[valid] ** 2)), rel=1e-12)
    # The plant's stiffness is 20 % off: the model is wrong before break-away, and right beyond it.
    assert 0.02 < result["residual_rms_N"] < 0.3 < result["measured_rms_N"]
    assert "N rms over" in done("predict", small, log, "--out", out).stdout


def test_predict_takes_machines_that_merge_samples(small: Path, log: Path, tmp_path: Path) -> None:
    merging = tmp_path / "merging.toml"
    merging.write_text(f'extends = "{small}"\n[sampling]\nintegrator = {{ scheme = "rk4", substeps = 10 }}\n')
    plain, merged = tmp_path / "a.csv", tmp_path / "b.csv"
    done("predict", small, log, "--out", plain)
    done("predict", merging, log, "--out", merged)
    difference = read_columns(plain)["friction_N"] - read_columns(merged)["friction_N"]
    assert np.abs(difference).max() < 1e-2


# --- estimate ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["c", "reference", "ekf", "smoother"])
def test_estimate_finds_the_stiffness(small: Path, log: Path, tmp_path: Path, solver: str) -> None:
    out = tmp_path / "e.csv"
    summary = json.loads(done("estimate", small, log, "--out", out, "--solver", solver, "--json").stdout)
    estimates = read_columns(out)
    assert len(estimates["time_s"]) == summary["updates"] == (5000 - 1) // 20
    for name, truth in (("stiffness_1", 3.6e4), ("stiffness_2", 1.2e4), ("coulomb", 4.0)):
        assert abs(estimates[name][-1] - truth) < 3 * estimates[f"std_{name}"][-1]
    assert summary["residual_rms_N"] < 0.1
    assert summary["status"]["good"] > 100
    assert summary["parameters"]["coulomb"]["estimate"] == estimates["coulomb"][-1]


@pytest.mark.parametrize("solver", ["c", "smoother"])
def test_estimate_says_which_prior_the_data_contradict(small: Path, log: Path, tmp_path: Path, solver: str) -> None:
    """The axis has 1.2 times the stiffness: four deviations of a prior of 5 %, less than one of the default's 30 %."""
    narrow = tmp_path / "narrow.toml"
    narrow.write_text(f"{small.read_text()}[estimator.prior]\nstiffness = 0.05\n[estimator.noise]\nmeasurement = 0.1\n")
    arguments = (log, "--out", tmp_path / "e.csv", "--solver", solver)
    contradicted = [line for line in done("estimate", narrow, *arguments).stderr.splitlines() if "its prior" in line]
    assert [line.split()[0] for line in contradicted] == ["stiffness_1", "stiffness_2"]
    assert re.search(r" 3\.\d deviations of its prior \(1\.5e\+03\) from the file's 3e\+04:", contradicted[0])
    assert "its prior" not in done("estimate", small, *arguments).stderr


def test_estimate_says_what_to_do_where_it_is_in_doubt(small: Path, log: Path, tmp_path: Path) -> None:
    heavy = tmp_path / "heavy.toml"
    heavy.write_text(small.read_text().replace("mass = 20.0", "mass = 200.0"))
    assert "mass = 200.0" in heavy.read_text()
    said = [done("estimate", machine, log, "--out", tmp_path / "e.csv").stderr for machine in (small, heavy)]
    assert re.search(r"in DOUBT of \d+ % of the updates: .* diagnose", said[1])
    assert "DOUBT" not in said[0]


def test_c_and_reference_say_the_same(small: Path, log: Path, tmp_path: Path) -> None:
    ours, theirs = tmp_path / "c.csv", tmp_path / "r.csv"
    done("estimate", small, log, "--out", ours)
    done("estimate", small, log, "--out", theirs, "--solver", "reference")
    # One has its signal chain in C, the other in Python.
    ours_read, theirs_read = map(read_columns, (ours, theirs))
    for name in ("stiffness_1", "stiffness_2", "coulomb"):
        np.testing.assert_allclose(ours_read[name], theirs_read[name], rtol=1e-7)


def test_columns_that_a_log_brings_are_used(small: Path, log: Path, tmp_path: Path) -> None:
    bringing = tmp_path / "friction.csv"
    lines = rows_of(log)
    # A friction that is 1 N throughout: nothing of position and force can have led to it.
    bringing.write_text("\n".join([lines[0] + ",friction_N", *(line + ",1.0" for line in lines[1:])]))
    done("estimate", small, bringing, "--out", tmp_path / "e.csv")
    assert np.all(np.abs(read_columns(tmp_path / "e.csv")["friction_measured_N"][5:] - 1.0) < 1e-6)


def test_estimate_draws(small: Path, log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "figures" / "new"
    done("estimate", small, log, "--out", tmp_path / "e.csv", "--plot", folder)
    assert files(folder) == {"friction.png", "parameters.png"}
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in folder.iterdir())


def test_single_missing_samples_pass_with_status_missing(small: Path, log: Path, tmp_path: Path) -> None:
    holes = changed(log, tmp_path, lambda lines: with_field(2001, 2, "nan")(with_field(1001, 1, "")(lines)))
    summary = json.loads(done("estimate", small, holes, "--out", tmp_path / "e.csv", "--json").stdout)
    estimates = read_columns(tmp_path / "e.csv")
    status = estimates["status"].astype(np.int64)
    # Rows 1001 and 2001 are the nodes of updates 50 and 100.
    assert status[49] & 2 and status[99] & 2
    assert summary["status"]["missing"] == np.count_nonzero(status & 2) < 10
    assert np.all(np.isfinite([estimates[name] for name in ("stiffness_1", "stiffness_2", "coulomb")]))


def test_estimates_may_go_to_a_pipe(small: Path, log: Path) -> None:
    arguments = ["estimate", str(small), str(log), "--out", "/dev/stdout"]
    script = [sys.executable, "-c", "from sgms_mhe.cli import main; main()", *arguments]
    ran = subprocess.run(script, capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("time_s,friction_measured_N")
    assert all(line.count(",") == ran.stdout.splitlines()[0].count(",") for line in ran.stdout.splitlines())
    assert "parameter at the end" in ran.stderr


def test_emps_record(measured_data: Callable[[str], Path], tmp_path: Path) -> None:
    out = tmp_path / "e.csv"
    result = done("estimate", "emps", measured_data("emps/DATA_EMPS.mat"), "--out", out, "--plot", tmp_path, "--json")
    summary = json.loads(result.stdout)
    estimates = read_columns(out)
    coulomb, viscous = (estimates[name][estimates["time_s"] > 4.0] for name in ("coulomb", "viscous"))
    assert summary["residual_rms_N"] < 2.5  # the published inverse model leaves 3 to 4 % of 60 N
    assert np.all(np.abs(coulomb / 20.3935 - 1.0) < 0.15)
    # The published fit by direction has 166.71 and 240.42 N s/m: the estimate swings between, lap by lap.
    assert np.all((viscous > 166.71) & (viscous < 240.42))


# --- compare -----------------------------------------------------------------------------------------------------


def test_compare_agrees(small: Path, log: Path) -> None:
    result = json.loads(done("compare", small, log, "--json").stdout)
    assert result["agrees"] is True
    assert result["status_mismatches"] == 0
    assert [quantity["name"] for quantity in result["quantities"][:3]] == ["friction_N", "z_1_m", "z_2_m"]
    assert all(quantity["relative"] <= 1e-8 for quantity in result["quantities"])
    assert "generated C and reference agree" in done("compare", small, log).stdout


def test_compare_in_single_precision(small: Path, log: Path, tmp_path: Path) -> None:
    single = tmp_path / "single.toml"
    single.write_text(f'extends = "{small}"\n[code]\nprecision = "single"\n')
    result = json.loads(done("compare", single, log, "--json").stdout)
    assert result["precision"] == "single"
    assert max(quantity["relative"] for quantity in result["quantities"]) > 1e-8


def test_compare_says_no_with_exit_code_1(small: Path, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from sgms_mhe.evaluation import comparison

    monkeypatch.setitem(comparison.TOLERANCES, "double", comparison.Tolerance(0.0, 0.0, 0.0, 0.0, 0.0))
    result = run("compare", small, log)
    assert result.exit_code == 1
    assert "further apart than they may be" in result.stdout
    assert "beyond" in result.stdout


# --- bad machine files ---------------------------------------------------------------------------------------------

BAD_MACHINES = {
    "unknown key": ("mass = 20.0", "masss = 20.0", ["plant.masss = 20.0", "unknown key (did you mean mass?)"]),
    "no syntax": ("mass = 20.0", "mass = = 20.0", ["line 5", "TOML syntax"]),
    "missing table": ("[plant]\nmass = 20.0", "", ["plant", "required key is missing"]),
}


@pytest.mark.parametrize("name", BAD_MACHINES)
@pytest.mark.parametrize("command", ["check", "generate", "simulate", "estimate", "bench"])
def test_bad_machine_files_are_refused(name: str, command: str, log: Path, tmp_path: Path) -> None:
    old, new, expected = BAD_MACHINES[name]
    assert old in SMALL
    machine, out = tmp_path / "bad.toml", tmp_path / "out.csv"
    machine.write_text(SMALL.replace(old, new))
    arguments: dict[str, list[str | Path]] = {
        "generate": ["--out", out],
        "simulate": ["--out", out],
        "estimate": [log, "--out", out],
    }
    message = refused(command, machine, *arguments.get(command, []))
    assert str(machine) in message
    assert all(part in message for part in expected), message
    assert files(tmp_path) == {"bad.toml"}


def test_a_machine_that_is_not_there_is_named_with_those_that_are() -> None:
    message = refused("check", "etel_xz")
    assert "'etel_xz'" in message
    assert "etel_xy_paper" in message


# --- bad logs ----------------------------------------------------------------------------------------------------


BAD_LOGS: dict[str, tuple[Callable[[list[str]], list[str]], list[str]]] = {
    "a time twice": (with_field(500, 0, "0.498"), ["row 500", "time_s"]),
    "text": (
        with_field(77, 1, "late"),
        ["row 77", "column position_m", "'late'", "a number with a decimal point, or NaN"],
    ),
    "a column missing": (lambda lines: [line.rsplit(",", 1)[0] for line in lines], ["column force_N", "missing"]),
    "another rate": (
        lambda lines: [lines[0], *(f"{2 * float(line.split(',')[0])},{line.split(',', 1)[1]}" for line in lines[1:])],
        ["500 Hz", "sampling.rate of small, 1000 Hz"],
    ),
    "too short for an update": (lambda lines: lines[:21], ["rows = 20", "at least 21"]),
    "too short to settle": (lambda lines: lines[:6], ["rows = 5"]),
}
ALLOWED = ("predict", "too short for an update")


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (command, name)
        for command in ("predict", "estimate", "compare")
        for name in BAD_LOGS
        if (command, name) != ALLOWED
    ],
)
def test_bad_logs_are_refused(name: str, command: str, small: Path, log: Path, tmp_path: Path) -> None:
    change, expected = BAD_LOGS[name]
    bad, out = changed(log, tmp_path, change), tmp_path / "out.csv"
    arguments: list[str | Path] = [] if command == "compare" else ["--out", out]
    message = refused(command, small, bad, *arguments)
    assert str(bad) in message
    assert all(part in message for part in expected), message
    assert files(tmp_path) == {"changed.csv"}


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("x.mat", b"MATLAB 7.3 MAT-file, no more than its first words", "whole MAT file"),
        ("x.mat", bytes(200), "whole MAT file"),
        ("x.npz", b"PK\x03\x04 cut off", "NPZ"),
        ("x.csv", b"\xff\xfe\x00position_m", "utf-16 text"),
        ("x.xlsx", b"PK", ".csv"),
        ("absent.csv", None, "No such file"),
    ],
)
def test_files_that_cannot_be_read_are_refused(
    name: str, content: bytes | None, expected: str, small: Path, tmp_path: Path
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    message = refused("estimate", small, path, "--out", tmp_path / "out.csv")
    assert str(path) in message
    assert expected in message
    assert not (tmp_path / "out.csv").exists()


# --- outputs that cannot be written ----------------------------------------------------------------------------------


@pytest.mark.parametrize("place", ["absent/out.csv", "file/out.csv", "folder", "/proc/out.csv"])
@pytest.mark.parametrize("command", ["simulate", "predict", "estimate"])
def test_output_files_are_tried_before_the_work(
    command: str, place: str, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _forbid_work(monkeypatch)
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    out = tmp_path / place
    # There is no log: it is not even looked for.
    message = refused(command, small, *([] if command == "simulate" else [tmp_path / "no.csv"]), "--out", out)
    assert f"{out}: output file" in message
    assert files(tmp_path) == {"file", "folder"}


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/out"])
@pytest.mark.parametrize("command", ["generate", "experiment", "estimate"])
def test_output_folders_are_tried_before_the_work(
    command: str, place: str, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _forbid_work(monkeypatch)
    (tmp_path / "file").write_text("")
    folder = tmp_path / place
    arguments: list[str | Path] = ["--out", folder]
    if command == "estimate":
        arguments = [tmp_path / "no.csv", "--out", tmp_path / "e.csv", "--plot", folder]
    message = refused(command, small, *arguments)
    assert f"{folder}: output folder" in message
    assert files(tmp_path) == {"file"}


def _forbid_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*arguments: object, **options: object) -> None:
        raise AssertionError("work began before the output was tried")

    for name in ("api.simulation.simulate_axis", "api.inputs.understand", "api.packages.emit_package"):
        monkeypatch.setattr(f"sgms_mhe.{name}", forbidden)


def test_no_compiler_is_bad_input(small: Path, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    message = refused("estimate", small, log, "--out", tmp_path / "e.csv")
    assert "no-such-compiler" in message
    assert files(tmp_path) == set()


# --- interrupts --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["sgms_mhe.api.simulation.simulate_axis", "os.fsync"])
def test_an_interrupt_leaves_the_outputs_as_they_were(
    where: str, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "x.csv"
    out.write_text("as it was")
    monkeypatch.setattr(where, interrupt)
    result = run("simulate", small, "--out", out, "--duration", "1")
    assert result.exit_code == 130
    assert "Interrupted" in result.stderr
    assert out.read_text() == "as it was"
    assert files(tmp_path) == {"x.csv"}


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_are_interrupts(number: signal.Signals, code: int, small: Path, tmp_path: Path) -> None:
    # The signal arrives when the file is written but has not taken its place.
    script = (
        "import os, signal\n"
        f"os.fsync = lambda descriptor: os.kill(os.getpid(), {int(number)})\n"
        f"signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from sgms_mhe.cli import main\nmain()"
    )
    arguments = ["simulate", str(small), "--out", str(tmp_path / "x.csv"), "--duration", "1"]
    ran = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False)
    assert ran.returncode == code, ran.stderr
    assert files(tmp_path) == set()


def test_a_closed_pipe_ends_the_output_in_silence() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    script = [sys.executable, "-c", "from sgms_mhe.cli import main; main()", "schema"]
    ran = subprocess.run(script, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert ran.returncode == 141
    assert ran.stderr == ""
