"""A log and what options say of it: `--log`, `--rate`, `--wrap`, `--unit`, `--force-scale`, on every command."""

import json
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np
import pytest

from cli_cases import SMALL, done, run
from log_dialects import machine, trace
from sgms_mhe.cli import cli, command_names
from sgms_mhe.machine import BY_COLUMN
from sgms_mhe.signals.logs import Log, write_log

OPTIONS = ("--log", "--rate", "--wrap", "--unit", "--force-scale")
COMMANDS = "inspect start identify tune diagnose estimate predict compare watch target fleet".split()


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def columns_file(path: Path, header: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.17g")
    return path


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """No time, millimetres and amperes that nothing states, position over a period of 20 mm."""
    log = trace()
    return columns_file(
        tmp_path / "bare.csv", "Pos,Drive Force", np.mod(1e3 * log.position_m, 20.0), log.force_N / 35.0
    )


FLAGS = ("--rate", "1000", "--unit", "position=mm", "--wrap", "20", "--force-scale", "35")
TABLE = """
[log]
rate = 1000.0
position_m = { unit = "mm", wrap = 20.0 }
force_N = { variable = "Drive Force", scale = 35.0 }
"""


def test_every_command_that_reads_logs_has_the_options() -> None:
    params = {name: cli.get_command(click.Context(cli), name).params for name in command_names()}
    options = {name: {option for parameter in found for option in parameter.opts} for name, found in params.items()}
    assert {name for name, given in options.items() if set(OPTIONS) <= given} == set(COMMANDS)


@pytest.mark.parametrize("way", ["flags", "file", "both"])
def test_inspect_takes_what_the_file_leaves_open(way: str, bare: Path, tmp_path: Path) -> None:
    assert "rate = ... [Hz]" in run("inspect", bare).stdout
    (tmp_path / "log.toml").write_text(TABLE if way == "file" else TABLE.replace("1000.0", "500.0"))
    given: dict[str, Sequence[str | Path]] = {
        "flags": FLAGS,
        "file": ("--log", tmp_path / "log.toml"),
        "both": ("--log", tmp_path / "log.toml", "--rate", "1000"),  # a flag stands above the file
    }
    found = json.loads(done("inspect", bare, *given[way], "--json").stdout)
    position, force = (next(c for c in found["columns"] if c["name"] == name) for name in ("position_m", "force_N"))
    log = trace()
    assert found["time"]["rate_Hz"] == pytest.approx(1000.0)
    assert position["max"] - position["min"] == pytest.approx(np.ptp(log.position_m), rel=1e-9)
    assert (force["min"], force["max"]) == pytest.approx((log.force_N.min(), log.force_N.max()))


@pytest.mark.slow
def test_a_fleet_takes_them_for_all_its_rows(small: Path, bare: Path, tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text("machine,log\nsmall.toml,bare.csv\n")
    done("fleet", "estimate", tmp_path / "rows.csv", *FLAGS, "--out", tmp_path / "fleet")
    done("estimate", small, bare, *FLAGS, "--out", tmp_path / "estimates.csv")
    (found,) = (tmp_path / "fleet" / "rows").glob("*/estimates.csv")
    assert found.read_bytes() == (tmp_path / "estimates.csv").read_bytes()
    # Another unit is another result, not the one that is there.
    done("fleet", "estimate", tmp_path / "rows.csv", *FLAGS[:-1], "36", "--out", tmp_path / "fleet")
    assert len(list((tmp_path / "fleet" / "rows").glob("*/estimates.csv"))) == 2


@pytest.mark.parametrize("command", ["estimate", "predict", "watch"])
def test_a_machine_reads_with_options_what_it_reads_in_its_own_columns(
    command: str, bare: Path, small: Path, tmp_path: Path
) -> None:
    log = trace()
    own = tmp_path / "own.npz"
    write_log(own, Log(log.time_s, np.mod(1e3 * log.position_m, 20.0), log.force_N, 1000.0))
    speed = ("--speed", "max") if command == "watch" else ()
    done(command, small, own, "--unit", "position=mm", "--wrap", "20", *speed, "--out", tmp_path / "own.csv")
    done(command, small, bare, *FLAGS, *speed, "--out", tmp_path / "flags.csv")
    first, second = (np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1) for name in ("own", "flags"))
    assert first == pytest.approx(second, rel=1e-6, abs=1e-9, nan_ok=True)


def test_options_stand_above_the_machine_s_own_table(bare: Path, small: Path, tmp_path: Path) -> None:
    table = '[log]\nposition_m = "Pos"\nforce_N = { variable = "Drive Force", unit = "A", scale = 7.0 }\n'
    small.write_text(SMALL + table)
    found = json.loads(done("inspect", bare, "--machine", small, *FLAGS, "--json").stdout)
    by_name = {column["name"]: column for column in found["columns"]}
    assert (by_name["position_m"]["from"], by_name["position_m"]["unit"]) == ("Pos", "mm")
    assert (by_name["force_N"]["scale"], by_name["force_N"]["unit"]) == (35.0, "A")


def test_a_log_that_grows_takes_a_rate(small: Path, tmp_path: Path) -> None:
    log = trace()
    path = columns_file(tmp_path / "growing.csv", "position_m,force_N", log.position_m, log.force_N)
    follow = ("watch", small, path, "--follow", "--idle", "0.3", "--out")
    done(*follow, tmp_path / "grown.csv", "--rate", "1000")
    done("estimate", small, path, "--rate", "1000", "--out", tmp_path / "whole.csv")
    assert (tmp_path / "grown.csv").read_text() == (tmp_path / "whole.csv").read_text()


@pytest.mark.slow
def test_the_file_that_start_writes_reads_the_log_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    time = np.arange(8000) / 500.0
    angle = 2.0 * np.sin(1.3 * time) + 0.3 * np.sin(11.0 * time)
    speed = np.gradient(angle, time)
    torque = 0.02 * np.gradient(speed, time) + 0.3 * np.tanh(speed / 0.01) + 0.05 * speed
    degrees = np.rad2deg(angle)
    log = columns_file(tmp_path / "log.csv", "angle,torque_Nm", degrees, torque + rng.normal(0.0, 0.003, len(time)))
    flags = ("--rate", "500", "--unit", "position=deg")
    done("start", log, "--out", tmp_path / "axis.toml", *flags)
    assert tomllib.loads((tmp_path / "axis.toml").read_text())["log"] == {
        "rate": 500.0,
        "position_rad": {"unit": "deg"},
    }
    assert json.loads(done("inspect", log, "--machine", tmp_path / "axis.toml", "--json").stdout)["problems"] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--unit", "position=N"), "position=m or cm"),
        (("--unit", "current=A"), "a quantity out of time, position"),
        (("--unit", "position"), "is not COLUMN=UNIT"),
        (("--unit", "force=A"), "scale"),
        (("--rate", "500"), r"\[log\] rate = 500.0: 1000 Hz, as its time column says"),
        (("--force-scale", "0"), "a number other than 0"),
        (("--log", "machine.toml"), r"the table \[log\] alone"),
        (("--log", "absent.toml"), "a readable machine file"),
        (("--log", "odd.toml"), r"log.position_m.unit = 'parsec'"),
    ],
)
def test_options_that_say_what_cannot_be_are_refused(
    options: tuple[str, str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("machine.toml").write_text(SMALL)
    Path("odd.toml").write_text('[log]\nposition_m = { unit = "parsec" }\n')
    write_log("log.csv", trace())
    result = run("inspect", "log.csv", *options)
    assert result.exit_code == (1 if options == ("--rate", "500") else 2), result.output
    assert re.search(message, result.output), result.output


def test_a_rate_that_agrees_with_the_time_column_is_taken(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", trace())
    done("inspect", tmp_path / "log.csv", "--rate", "1001")


@pytest.mark.parametrize("unit", BY_COLUMN["position_rad"].units)
def test_a_unit_of_one_kind_of_axis_says_which_kind_it_is(unit: str, tmp_path: Path) -> None:
    log = trace()
    path = columns_file(tmp_path / "log.csv", "t [s],x,torque [Nm]", log.time_s, log.position_m, log.force_N)
    found = json.loads(done("inspect", path, "--unit", f"position={unit}", "--json").stdout)
    assert found["kind"] == "rotary"
    assert {c["name"]: c["unit"] for c in found["columns"]}["position_rad"] == unit


def test_python_takes_the_same_table(bare: Path) -> None:
    import sgms_mhe

    table = {"rate": 1000.0, "position_m": {"unit": "mm", "wrap": 20.0}, "force_N": {"scale": 35.0}}
    for axis in (None, machine()):
        log = sgms_mhe.read_log(bare, axis, table=table)
        assert log.rate == pytest.approx(1000.0)
        assert np.ptp(log.position_m) == pytest.approx(np.ptp(trace().position_m))
