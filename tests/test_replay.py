"""A recorded log through the emitted C, against the estimates that git holds: a functional change shows as a diff.

    python tests/test_replay.py --update     writes the estimates anew; review the diff, commit it with its cause
    python tests/test_replay.py --record     simulates the log anew as well

The log (3 s in closed loop: presliding loops, moves at 2 mm/s and 0.3 m/s, standstill, missing samples) is kept as
whole nanometres and millinewtons.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log

pytestmark = pytest.mark.core

FOLDER = Path(__file__).parent / "replay"
LOG, ESTIMATES = FOLDER / "log.npz", FOLDER / "estimates.csv"
UPDATE = "python tests/test_replay.py --update"
DIGITS = 9
# The last digit may round either way where the machine that made the constants rounded its tangent another way.
TOLERANCE = 1.5 * 10.0 ** (1 - DIGITS)


def read_recorded() -> Log:
    """The log of the folder."""
    with np.load(LOG) as content:
        counts = [np.cumsum(content["position_steps_nm"]), np.cumsum(content["force_steps_mN"])]
        position, force = counts[0] * 1e-9, counts[1] * 1e-3
        position[content["missing_position"]] = np.nan
        force[content["missing_force"]] = np.nan
    return Log(np.arange(len(position)) / 1e4, position, force, rate=1e4)


def estimate(precision: str = "double") -> Estimates:
    """Estimates of the log by the emitted C, raw samples, one task."""
    machine = override_machine(load_machine(FOLDER / "axis.toml"), {"code": {"precision": precision}})
    return CompiledEstimator(machine, emit_package(machine, selftest=False)).estimate_log(read_recorded())


def table(estimates: Estimates) -> list[list[str]]:
    """Header and rows as text, DIGITS significant digits."""
    names = estimates.parameter_names
    elements = range(1, estimates.z_m.shape[1] + 1)
    header = ["time_s", "friction_measured_N", "friction_N", *(f"z_{i}_m" for i in elements), *names]
    header += [*(f"std_{name}" for name in names), "status"]
    numbers = np.column_stack(
        [
            estimates.time_s,
            estimates.friction_measured_N,
            estimates.friction_N,
            estimates.z_m,
            estimates.parameters,
            estimates.std,
        ]
    )
    rows = [[f"{v:.{DIGITS}g}" for v in row] for row in numbers]
    return [header, *([*row, str(status)] for row, status in zip(rows, estimates.status, strict=True))]


def stored() -> list[list[str]]:
    """The table that git holds."""
    return [line.split(",") for line in ESTIMATES.read_text(encoding="utf-8").splitlines()]


def same(a: str, b: str, scale: float) -> bool:
    return a == b or abs(float(a) - float(b)) <= TOLERANCE * scale


def test_estimates_of_the_recorded_log() -> None:
    before, after = stored(), table(estimate())
    assert before[0] == after[0], f"columns have changed; if this is meant: {UPDATE}"
    assert len(before) == len(after), f"number of updates has changed; if this is meant: {UPDATE}"
    scales = np.abs(np.array(before[1:], dtype=float)).max(axis=0)
    lines = []
    for old, new in zip(before[1:], after[1:], strict=True):
        changed = [
            f"{name} {a} -> {b}"
            for name, a, b, scale in zip(before[0], old, new, scales, strict=True)
            if not same(a, b, scale if name != "status" else 0.0)
        ]
        if changed:
            lines.append(f"t = {old[0]} s: " + ", ".join(changed))
    if lines:
        shown = [*lines[:20], *([f"... {len(lines) - 20} more updates"] if len(lines) > 20 else [])]
        pytest.fail("\n".join([*shown, "", f"if this is meant: {UPDATE}"]), pytrace=False)


def test_single_precision_follows_the_recorded_estimates() -> None:
    columns = np.array(stored()[1:], dtype=float).T
    estimates = estimate("single")
    assert np.abs(estimates.friction_N - columns[2]).max() < 1e-4 * np.ptp(columns[2])
    n = len(estimates.parameter_names)
    np.testing.assert_allclose(estimates.parameters, columns[-2 * n - 1 : -n - 1].T, rtol=1e-3)


def test_recorded_log_holds_what_it_says() -> None:
    log, rows = read_recorded(), stored()
    statuses = {int(row[-1]) for row in rows[1:]}
    for flag, name in ((1, "filling"), (2, "missing"), (4, "hold"), (8, "bound")):
        assert any(status & flag for status in statuses), name
    speed = np.abs(np.diff(log.position_m)) * 1e4
    assert np.nanmax(speed) > 0.29 and np.isnan(log.position_m).sum() > 3 and np.isnan(log.force_N).any()
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 300_000


def record() -> None:
    """Simulate the log and write it."""
    path = Motion(1e4)
    path.wait(0.1)
    path.loops((5e-6, 3e-6, 1e-6), 1e-4, 0.05, 5.0)
    path.loops((100e-6, 40e-6, 15e-6), 2e-3, 1.0, 200.0)
    path.wait(0.15)
    path.move_to(0.06, 0.3, 5.0, 500.0)
    path.wait(0.1)
    path.loops((300e-6, 80e-6, 20e-6, 6e-6), 2e-3, 1.0, 200.0)
    path.move_to(0.0, 0.3, 5.0, 500.0)
    path.wait(0.1)
    run = simulate_axis(
        load_machine(FOLDER / "axis.toml"),
        path.trajectory("replay").repeat(3.0),
        AxisConfig(seed=20),
        scale={"stiffness": [1.2, 0.8, 1.1, 0.97], "coulomb": 1.1},
        truth=False,
    )
    counts = [np.round(run.log.position_m * 1e9).astype(np.int64), np.round(run.log.force_N * 1e3).astype(np.int64)]
    steps = [np.diff(count, prepend=0).astype(np.int32) for count in counts]
    np.savez_compressed(
        LOG,
        position_steps_nm=steps[0],
        force_steps_mN=steps[1],
        missing_position=np.array([5000, 12000, 12001, 12002, 20000]),
        missing_force=np.r_[9000, 15000:15040],
    )
    print(f"{LOG}: {len(steps[0])} samples, {LOG.stat().st_size} bytes")


def update() -> None:
    """Write the estimates."""
    rows = table(estimate())
    ESTIMATES.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
    print(f"{ESTIMATES}: {len(rows) - 1} updates, {ESTIMATES.stat().st_size} bytes")


if __name__ == "__main__":
    if sys.argv[1:] not in (["--update"], ["--record"]):
        sys.exit(f"usage: {UPDATE} (or --record)")
    if sys.argv[1] == "--record":
        record()
    update()
