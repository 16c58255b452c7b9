"""The yardstick's table is what its program prints, and the export of a filter is the filter by hand."""

import re

import numpy as np
import pytest

from sgms_bench.target.yardstick import CORES, ENTRIES, FOLDER, Score, encode_problem, run_entry


@pytest.fixture(scope="module")
def problem() -> tuple[bytes, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    return encode_problem()


def stated() -> dict[tuple[str, str], list[float]]:
    """Numbers of the rows of the README's table by entry and core."""
    rows = re.findall(r"^\| (.+?) \| (Cortex-\w+) \| (.+) \|$", (FOLDER / "README.md").read_text(), re.MULTILINE)
    return {(title, core): [float(cell.split()[0]) for cell in rest.split("|")] for title, core, rest in rows}


@pytest.mark.needs_arm
@pytest.mark.slow
def test_the_table_is_what_the_cores_say(problem: tuple[bytes, np.ndarray[tuple[int], np.dtype[np.float64]]]) -> None:
    samples, truth = problem
    scores: dict[tuple[str, str], Score] = {}
    for name, entry in ENTRIES.items():
        for core in CORES:
            score = scores[name, core] = run_entry(name, core, samples)
            count = score.instructions
            numbers = [100.0 * score.error(truth), count.mean(), count.max(), score.flash / 1e3, score.ram / 1e3]
            assert stated()[entry.title, core] == pytest.approx(numbers, rel=0.02, abs=0.06)
    for core in CORES:
        by_hand, exported = (scores[name, core].friction for name in ("ekf", "casadi"))
        np.testing.assert_allclose(exported, by_hand, atol=2e-3)
        ours, measured = (scores[name, core].error(truth) for name in ("sgms-mhe", "none"))
        assert 5.0 * ours < scores["ekf", core].error(truth) < 0.5 * measured
    assert len(stated()) == len(scores)
