"""The same trace in every dialect of a log gives the same estimate.

`python tests/test_dialects.py` prints the table: largest difference of the estimated friction, by dialect.
"""

import importlib.util
import sys
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from log_dialects import machine, trace
from sgms_bench.logs.dialects import COUNTS_PER_METRE, DIALECTS, DIGITS
from sgms_mhe.configuration import override_machine
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.signals.estimates import Estimates


@lru_cache
def estimator() -> CompiledEstimator:
    return CompiledEstimator(machine())


@lru_cache
def expected() -> Estimates:
    return estimator().estimate_log(trace(), mode="tick")


def difference(name: str, folder: Path) -> tuple[float, float]:
    """Largest differences of friction over its range, and of parameters over their nominal values."""
    dialect = DIALECTS[name]
    path = folder / f"log{dialect.suffix}"
    dialect.write(path, trace())
    reader = override_machine(machine(), {"log": dict(dialect.log)}) if dialect.log else machine()
    log = read_log(path, reader)
    check_plausible(log, reader)
    found = estimator().estimate_log(log, mode="tick")
    friction = np.abs(found.friction_N - expected().friction_N).max() / np.ptp(expected().friction_N)
    parameters = np.abs(found.parameters / expected().parameters - 1.0).max()
    np.testing.assert_array_equal(found.status, expected().status)
    return float(friction), float(parameters)


def library_absent(name: str) -> bool:
    library = DIALECTS[name].library
    return bool(library) and importlib.util.find_spec(library) is None


def test_the_trace_moves_what_is_estimated() -> None:
    ratios = expected().parameters / np.array([3e4, 1e4, 4.0])
    assert np.ptp(ratios, axis=0).max() > 0.01
    assert np.ptp(trace().position_m) > 65536 / COUNTS_PER_METRE  # so that counts of 16 bits start over
    assert len(DIALECTS) > 40


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_gives_the_same_estimate(name: str, tmp_path: Path) -> None:
    if library_absent(name):
        pytest.skip(f"library absent: {DIALECTS[name].library}")
    largest = max(difference(name, tmp_path))
    assert largest == 0.0 if DIALECTS[name].exact else largest < DIGITS


def main() -> None:
    """Print the table; exit code 1 where an estimate differs."""
    differs = False
    print(f"{'dialect':40}{'friction':>12}{'parameters':>12}")
    for name, dialect in DIALECTS.items():
        if library_absent(name):
            print(f"{name:40}{dialect.library + ' absent':>24}")
            continue
        with tempfile.TemporaryDirectory() as folder:
            friction, parameters = difference(name, Path(folder))
        differs |= max(friction, parameters) > (0.0 if dialect.exact else DIGITS)
        print(f"{name:40}{friction:12.1e}{parameters:12.1e}")
    sys.exit(1 if differs else 0)


if __name__ == "__main__":
    main()
