"""docs/walk.md: its commands as they are typed, from a trace to firmware, and what they print held together."""

import csv
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "walk.md"
LIMIT_S = 600
"""Of one step: a host that is kept busy must not decide."""


def steps() -> list[list[str]]:
    """Commands of the page by its steps."""
    block = PAGE.read_text(encoding="utf-8").partition("```sh\n")[2].partition("```")[0]
    return [[line for line in step.splitlines() if line and not line.startswith("#")] for step in block.split("\n\n")]


def assert_holds_the_truth(toml: str) -> None:
    """Each interval of the file, of two deviations, holds the simulated number within three."""
    source = (ROOT / "examples" / "walk" / "export_trace.py").read_text(encoding="utf-8")
    truth = tomllib.loads(source.partition('"""\nname')[2].partition('"""')[0].partition("\n")[2])
    stated = re.findall(r"^(\w+) = (\S+) +#.*[: ](\S+) \+- ([^\s,]+)", toml, re.MULTILINE)
    for name, written, value, interval in stated:
        number = {**truth["plant"], **truth["friction"]}[name]
        assert abs(float(value) - number) <= 1.5 * float(interval), (name, written, value, interval, number)
    assert {name for name, *_ in stated} >= {"mass", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity"}


@pytest.mark.slow
@pytest.mark.needs_arm
def test_from_a_trace_to_firmware(require_tool: Callable[[str], str], tmp_path: Path) -> None:
    require_tool("cmake")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "COLUMNS": "200"}

    def typed(line: str) -> str:
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", line],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    said = [[typed(line) for line in step] for step in steps()]
    assert len(said) == 6
    assert re.search(r"unit row +yes", said[0][1]) and re.search(r"decimal mark +comma", said[0][1])
    assert_holds_the_truth((tmp_path / "my_axis.toml").read_text(encoding="utf-8"))
    diagnosis = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text())
    assert diagnosis["verdict"] == "adequate"

    with (tmp_path / "estimates.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    names = [name for name in rows[-1] if f"std_{name}" in rows[-1]]
    printed = [float(x) for x in re.findall(r"^parameter \d+ (\S+) \+-", said[4][2], re.MULTILINE)]
    assert len(printed) == len(names) > 0
    assert printed == pytest.approx([float(rows[-1][name]) for name in names], rel=1e-6)

    assert "FAILED" not in said[5][0] and "skipped" not in said[5][0]
    assert "self-test, cortex_m7" in said[5][0]
    assert "the same as on this host to the last bit" in said[5][1]
