"""Numbers of docs/results.md that come from recorded runs: the experiment, compensation in closed loop, the target.

python tests/test_stated_results.py --update    run them again, record the numbers, and write the pages
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from sgms_mhe.support.toolchain import tool_output

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results.md"
README = ROOT / "README.md"
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
ESTIMATOR = re.compile(
    r"^  (MHE, C|EKF, C|MHE, reference|batch smoother) +([\d.]+) +(\d+)% +(?:\d+ +)?(.*)$", re.MULTILINE
)
"""A row of the experiment: friction RMS, coverage, time but on the README, errors and changes."""
SMOOTHER = re.compile(r"(?<=parameters are )[\d., ]+(?= times smoother)")
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


def experiment(printed_table: str) -> dict[str, Any]:
    """Rows of a printed experiment, the paper's weights behind the default, and how much smoother the MHE is."""
    found = SMOOTHER.search(printed_table)
    rows = [[name, rms, f"{share} %", *rest.split()] for name, rms, share, rest in ESTIMATOR.findall(printed_table)]
    return {"rows": rows, "smoother": found[0] if found else ""}


def run_experiment() -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "sgms_mhe", "experiment", "etel_xy", "--out", folder]
        return experiment(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


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


def page_of(content: dict[str, Any], page: str) -> str:
    """The page of results with the recorded rows in the places of its own."""
    for row in (*loop_rows(content), *target_rows(content)):
        name = re.escape(row.split("|")[1])
        page, count = re.subn(rf"^\|{name}\| [\d.]+.*$", row, page, flags=re.MULTILINE)
        assert count == 1, row
    rows, tables = content["experiment"]["rows"], []
    for part in (rows[:4], rows[4:]):
        tables += [f"| {name} | {rms} | {share} |" for name, rms, share, *_ in part]
        tables += [f"| {name} | {', '.join(rest[:4])} | {', '.join(rest[4:])} |" for name, _, _, *rest in part]
    left = iter(tables)
    names = "|".join(dict.fromkeys(row[0] for row in rows))
    page = re.sub(rf"^\| (?:{names}) \| [-+\d].*$", lambda _: next(left), page, flags=re.MULTILINE)
    assert not list(left)
    return SMOOTHER.sub(content["experiment"]["smoother"], page)


def readme_of(content: dict[str, Any], page: str) -> str:
    """The README with the recorded rows."""
    left = iter(content["experiment"]["rows"][:4])

    def row(_: re.Match[str]) -> str:
        name, rms, share, *rest = next(left)
        return f"  {name:<14}{rms:>18}{share.replace(' ', ''):>10}" + "".join(f"{error:>9}" for error in rest[:4])

    return ESTIMATOR.sub(row, page)


@pytest.mark.core
def test_pages_state_the_recorded_runs() -> None:
    for path, written in ((PAGE, page_of), (README, readme_of)):
        text = path.read_text(encoding="utf-8")
        assert written(recorded(), text) == text, UPDATE


@pytest.mark.slow
def test_experiment_is_the_recorded_one() -> None:
    now, before = run_experiment(), recorded()["experiment"]
    for row, stated in zip(now["rows"], before["rows"], strict=True):
        assert row[0] == stated[0]
        for value, known in zip(row[1:], stated[1:], strict=True):
            found, said = (float(text.removesuffix(" %")) for text in (value, known))
            digit = 10.0 ** -len(known.partition(".")[2])
            assert found == pytest.approx(said, rel=LOOP_TOLERANCE, abs=1.5 * digit), f"{row[0]}: {UPDATE}"


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
    """Run and record, and write the pages."""
    content = {
        "compiler": compiler(),
        "experiment": run_experiment(),
        "peaks_nm": peaks(),
        "target": {variant: instructions(variant) for variant in TARGETS},
    }
    RECORDED.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    for path, written in ((PAGE, page_of), (README, readme_of)):
        path.write_text(written(content, path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:] != ["--update"]:
        sys.exit(__doc__)
    update()
