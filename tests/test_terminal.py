"""What a person at a terminal gets beside results: completion by the shell, progress, colours and none."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from cli_cases import SMALL, done, refused
from sgms_mhe.cli import COMMANDS
from sgms_mhe.model.effects import CAUSE_NAMES, EFFECT_NAMES
from sgms_mhe.support.paths import machines_dir

ROOT = Path(__file__).resolve().parents[1]
COLOUR = re.compile(rb"\x1b\[[0-9;]*[349][0-9;]*m")
"""Of the foreground or the background; bold and resets are none."""
SCRIPT = "from sgms_mhe.cli import main; main()"


def offered(*words: str) -> list[str]:
    """What bash is told for the last of the words, as `kind,value`."""
    variables = {"_SGMS_MHE_COMPLETE": "bash_complete", "COMP_WORDS": " ".join(("sgms-mhe", *words))}
    variables["COMP_CWORD"] = str(len(words))
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=os.environ | variables, capture_output=True, text=True, check=True
    )
    return ran.stdout.split()


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
    assert offered("") == [f"plain,{name}" for name in COMMANDS]
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
    assert "axis: good" in loud.stderr and quiet.stderr == ""
    assert "1 of 1 logs done" in quiet.stdout
    assert "absent.toml" in refused("-q", "check", tmp_path / "absent.toml")


def test_quiet_shows_no_bar_on_a_terminal(tmp_path: Path) -> None:
    assert b"simulate small" in on_terminal(tmp_path, {})
    assert on_terminal(tmp_path, {}, "--quiet") == b""


# --- colours ----------------------------------------------------------------------------------------------------


def on_terminal(folder: Path, variables: Mapping[str, str], *options: str) -> bytes:
    """What a command writes to stderr where that is a terminal."""
    machine = folder / "small.toml"
    machine.write_text(SMALL)
    ours, theirs = pty.openpty()
    plain = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "FORCE_COLOR")}
    command = [sys.executable, "-c", SCRIPT, *options, "simulate", str(machine), "--out", str(folder / "x.csv")]
    with subprocess.Popen(
        [*command, "--duration", "0.5"],
        env=plain | {"TERM": "xterm-256color"} | variables,
        stdout=subprocess.DEVNULL,
        stderr=theirs,
    ) as process:
        os.close(theirs)
        written = b""
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            written += part
    os.close(ours)
    assert process.returncode == 0, written
    return written


def test_progress_on_a_terminal_is_coloured_unless_told(tmp_path: Path) -> None:
    coloured, plain = on_terminal(tmp_path, {}), on_terminal(tmp_path, {"NO_COLOR": "1"})
    assert b"simulate small" in coloured and b"simulate small" in plain
    assert COLOUR.search(coloured)
    assert not COLOUR.search(plain)


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
