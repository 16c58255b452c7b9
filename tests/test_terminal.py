"""What a person at a terminal gets beside results: completion by the shell, progress, colours and none."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from cli_cases import SCRIPT, SMALL, done, on_terminal, refused
from sgms_mhe.cli import cli, command_names
from sgms_mhe.commands import common
from sgms_mhe.commands.common import LONGEST_LOOK_S, AwakeClock, progress_bar, step_notes, steps_bar
from sgms_mhe.model.effects import CAUSE_NAMES, EFFECT_NAMES
from sgms_mhe.support.paths import machines_dir

ROOT = Path(__file__).resolve().parents[1]
COLOUR = re.compile(r"\x1b\[[0-9;]*[349][0-9;]*m")
"""Of the foreground or the background; bold and resets are none."""


def offered(*words: str) -> list[str]:
    """What bash is told for the last of the words, as `kind,value`."""
    variables = {"_SGMS_MHE_COMPLETE": "bash_complete", "COMP_WORDS": " ".join(("sgms-mhe", *words))}
    variables["COMP_CWORD"] = str(len(words))
    return CliRunner().invoke(cli, env=variables, prog_name="sgms-mhe").stdout.split()


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["esti"], ["estimate"]),
        (["effects", "force_"], [name for name in EFFECT_NAMES if name.startswith("force_")]),
        (["check", "etel_xy_c"], sorted(p.stem for p in machines_dir().glob("etel_xy_c*.toml"))),
        (["plan", "etel_xy", "--separate", "coulomb", "vis"], [n for n in CAUSE_NAMES if n.startswith("vis")]),
        (["estimate", "etel_xy", "log.csv", "--sol"], ["--solver"]),
        (["estimate", "etel_xy", "log.csv", "--solver", "e"], ["ekf"]),
    ],
    ids=["command", "effect", "machine", "cause", "option", "choice"],
)
def test_shells_complete(words: list[str], names: list[str]) -> None:
    assert names
    assert offered(*words) == [f"plain,{name}" for name in names]


def test_shells_complete_every_command_and_fall_back_to_files() -> None:
    assert offered("") == [f"plain,{name}" for name in command_names()]
    assert offered("check", "./mach") == ["file,./mach"]
    assert offered("inspect", "ax") == ["file,ax"]


def test_the_lines_on_the_page_are_what_shells_run() -> None:
    text = (ROOT / "docs" / "commands.md").read_text()
    shells = re.findall(r"_SGMS_MHE_COMPLETE=(\w+)_source sgms-mhe", text)
    assert shells == ["bash", "zsh", "fish"]
    for shell in ("zsh", "fish"):  # bash is asked for its version first, which not every host has
        ran = subprocess.run(
            [sys.executable, "-c", SCRIPT],
            env=os.environ | {"_SGMS_MHE_COMPLETE": f"{shell}_source"},
            capture_output=True,
            text=True,
            check=True,
        )
        assert f"_SGMS_MHE_COMPLETE={shell}_complete" in ran.stdout


# --- quiet ------------------------------------------------------------------------------------------------------


def test_quiet_leaves_results_and_errors(tmp_path: Path) -> None:
    machine, log = tmp_path / "small.toml", tmp_path / "axis.csv"
    machine.write_text(SMALL)
    done("simulate", machine, "--out", log, "--duration", "2")
    table = tmp_path / "table.csv"
    table.write_text("machine,log\nsmall.toml,axis.csv\n")
    arguments = ("fleet", "estimate", table, "--out", tmp_path / "out")
    loud, quiet = done(*arguments), done("--quiet", *arguments)
    assert "axis: good" in loud.stderr
    assert quiet.stderr == "" and "1 of 1 logs done" in quiet.stdout
    assert "absent.toml" in refused("-q", "check", tmp_path / "absent.toml")


@pytest.mark.parametrize("quiet", [False, True])
@pytest.mark.parametrize(
    ("progress", "told", "line"),
    [
        (steps_bar, ("refitting", 0.02), "2 %, refitting"),
        (step_notes, ("elements: 3",), "elements: 3"),
        (partial(progress_bar, "estimate axis"), (40, 100), "estimate axis, 40 %"),
    ],
)
def test_a_long_step_is_not_silent_without_a_terminal(
    progress: Callable[[], Any],
    told: tuple[Any, ...],
    line: str,
    quiet: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(common, "LINE_S", 0.05)
    monkeypatch.setattr(common, "is_quiet", lambda: quiet)
    with progress() as tell:
        tell(*told)  # and nothing more for a while
        time.sleep(0.3)
    said = capsys.readouterr().err.splitlines()
    assert said == [] if quiet else 2 <= len(said) <= 6 and all(f"s: {line}" in words for words in said)


def simulating(folder: Path) -> tuple[str | Path, ...]:
    """A command that shows a bar."""
    machine = folder / "small.toml"
    machine.write_text(SMALL)
    return "simulate", machine, "--out", folder / "x.csv", "--duration", "0.5"


# --- colours ----------------------------------------------------------------------------------------------------


def test_progress_on_a_terminal_is_coloured_unless_told(tmp_path: Path) -> None:
    coloured, plain = on_terminal(*simulating(tmp_path)), on_terminal(*simulating(tmp_path), NO_COLOR="1")
    assert "simulate small" in coloured and "simulate small" in plain
    assert COLOUR.search(coloured)
    assert not COLOUR.search(plain)


def test_a_bar_does_not_count_the_time_that_a_host_slept() -> None:
    host = iter([100.0, 100.1, 100.2, 4000.0, 4000.1, 3999.0, 3999.5])  # also a clock that goes back
    clock = AwakeClock(lambda: next(host))
    seen = [clock.now() for _ in range(6)]
    np.testing.assert_allclose(np.diff([0.0, *seen]), [0.1, 0.1, LONGEST_LOOK_S, 0.1, 0.0, 0.5], atol=1e-9)


@pytest.mark.parametrize("where", [("--quiet", 0), ("-q", 1), ("--quiet", 4)])
def test_quiet_is_quiet_before_and_behind_the_command(where: tuple[str, int], tmp_path: Path) -> None:
    arguments = [str(argument) for argument in simulating(tmp_path)]
    arguments.insert(where[1], where[0])
    assert on_terminal(*arguments) == ""


def test_quiet_behind_a_separator_is_an_argument(tmp_path: Path) -> None:
    assert "machine = '-q'" in refused("check", "--", "-q")


def test_without_a_terminal_nothing_is_coloured(tmp_path: Path) -> None:
    machine = tmp_path / "small.toml"
    machine.write_text(SMALL)
    for arguments in (
        ["simulate", str(machine), "--out", str(tmp_path / "x.csv"), "--duration", "0.5"],
        ["effects", "backlash"],
        ["check", str(tmp_path / "absent.toml")],
    ):
        ran = subprocess.run(
            [sys.executable, "-c", SCRIPT, *arguments],
            env=os.environ | {"TERM": "xterm-256color"},
            capture_output=True,
            check=False,
        )
        assert b"\x1b" not in ran.stdout + ran.stderr
        assert ran.stdout or ran.stderr
