"""Numbers of docs/results.md that come from recorded runs: compensation in closed loop, instructions on the target.

python tests/test_stated_results.py --update    run them again, record the numbers, and write both tables
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sgms_mhe.support.toolchain import tool_output

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results.md"
RECORDED = Path(__file__).parent / "recorded" / "results.json"
UPDATE = "python tests/test_stated_results.py --update"
CLOSED_LOOP = ("compensate", "etel_xy_compensation")
FAST = ("--cflags", "-std=c99 -O3 -ffp-contract=fast")
TARGETS: dict[str, tuple[str, ...]] = {
    "A": ("target", "etel_xy_controller"),
    "B": ("target", "etel_xy_controller", *FAST),
    "C": ("target", "etel_xy"),
    "D": ("target", "etel_xy_switching", *FAST),
}
CALLS = ("update", "feedback", "tick")
TRAJECTORIES = {
    "paper": "paper's trajectory",
    "step_and_settle": "step and settle",
    "circle, contour": "circle, contour at the quadrants",
}
LOOP_TOLERANCE = 0.03
"""Relative, of a peak: another processor's libm rounds otherwise, and a loop with an encoder's steps amplifies it."""
ANOTHER_COMPILER = 0.3
"""Relative, of instructions by another compiler than the recorded one."""


def printed(*command: str) -> Any:
    """What a command prints as JSON."""
    words = [sys.executable, "-m", "sgms_mhe", *command, "--json"]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


def peaks() -> dict[str, dict[str, float]]:
    """Mean peak of the error after reversals [nm], by trajectory and compensation."""
    found: dict[str, dict[str, float]] = {name: {} for name in TRAJECTORIES}
    for row in printed(*CLOSED_LOOP)["rows"]:
        if row["trajectory"] in found:
            found[row["trajectory"]][row["compensation"]] = float(f"{row['peak [nm]']:.4g}")
    return found


def instructions(variant: str) -> dict[str, Any]:
    """Mean and most of each call, flash and RAM [bytes]."""
    content = printed(*TARGETS[variant])
    calls = {call: content["instructions"][call] for call in CALLS}
    return {**calls, "flash": content["bytes"]["flash"], "ram": content["bytes"]["ram"]}


def recorded() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(RECORDED.read_text(encoding="utf-8"))
    return content


def compiler() -> str:
    return tool_output(["arm-none-eabi-gcc", "-dumpfullversion"], "gcc").strip()


def loop_rows(content: dict[str, Any]) -> list[str]:
    """Rows of the page's table of peaks."""
    return [
        f"| {words} | {' | '.join(f'{peak:.0f}' if peak >= 100.0 else f'{peak:.1f}' for peak in row.values())} |"
        for words, row in ((TRAJECTORIES[name], row) for name, row in content["peaks_nm"].items())
    ]


def target_rows(content: dict[str, Any]) -> list[str]:
    """Rows of the page's table of instructions: thousands, with a digit where there are few."""

    def pair(counts: dict[str, float]) -> str:
        mean, most = (f"{1e-3 * counts[key]:.{1 if counts[key] < 5e4 else 0}f} k" for key in ("mean", "max"))
        return f"{mean}, {most}"

    return [
        f"| {variant} | {' | '.join(pair(row[call]) for call in CALLS)} | "
        f"{1e-3 * row['flash']:.1f} kB | {1e-3 * row['ram']:.1f} kB |"
        for variant, row in content["target"].items()
    ]


@pytest.mark.core
def test_page_states_the_recorded_runs() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for row in (*loop_rows(recorded()), *target_rows(recorded())):
        assert row in page, f"{row}\n{UPDATE}"


@pytest.mark.core
def test_readme_and_page_have_one_experiment() -> None:
    readme, page = (path.read_text(encoding="utf-8") for path in (ROOT / "README.md", PAGE))
    rows = re.findall(r"^  (\w+(?:, \w+| \w+)) +([\d.]+) +(\d+)% +(.*)$", readme, re.MULTILINE)
    assert len(rows) == 4
    for name, rms, coverage, errors in rows:
        assert f"| {name} | {rms} | {coverage} % |" in page
        assert f"| {name} | {', '.join(errors.split())} |" in page


@pytest.mark.slow
def test_closed_loop_is_the_recorded_one() -> None:
    now = peaks()
    for name, row in recorded()["peaks_nm"].items():
        for kind, peak in row.items():
            assert now[name][kind] == pytest.approx(peak, rel=LOOP_TOLERANCE, abs=0.1), f"{name}, {kind}: {UPDATE}"


@pytest.mark.slow
@pytest.mark.needs_arm
@pytest.mark.parametrize("variant", TARGETS)
def test_instructions_are_the_recorded_ones(variant: str) -> None:
    now, before = instructions(variant), recorded()["target"][variant]
    rel = 0.0 if compiler() == recorded()["compiler"] else ANOTHER_COMPILER
    for call, counted in before.items():
        assert now[call] == pytest.approx(counted, rel=rel), f"{call}: {UPDATE}"


def update() -> None:
    """Run and record, and write both tables."""
    content = {
        "compiler": compiler(),
        "peaks_nm": peaks(),
        "target": {variant: instructions(variant) for variant in TARGETS},
    }
    RECORDED.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    write_page(content)


def write_page(content: dict[str, Any]) -> None:
    """Put the rows into the page, and print them."""
    page = PAGE.read_text(encoding="utf-8")
    for row in (*loop_rows(content), *target_rows(content)):
        name = re.escape(row.split("|")[1])
        page, count = re.subn(rf"^\|{name}\| [\d.]+.*$", row, page, flags=re.MULTILINE)
        print(row, "" if count else "has no row on the page")
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:] != ["--update"]:
        sys.exit(__doc__)
    update()
