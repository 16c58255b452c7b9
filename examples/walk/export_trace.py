"""Writes what a drive's oscilloscope exports, of an axis nobody has parameters for.

    python examples/walk/export_trace.py trace.csv

The axis is simulated here. A trace of your own takes its place: time, position and force at one rate, over strokes at
several speeds, with reversals and small loops.
"""

from __future__ import annotations

import sys
from pathlib import Path

import sgms_mhe

UNKNOWN = """
name = "unknown"
description = "known to the simulation alone"

[plant]
mass = 12.0

[friction]
law = "switching"
stiffness = [2.5e5, 6e4, 2e4]
fraction = [0.2, 0.3, 0.5]
viscous = 35.0
coulomb = 6.5
stribeck_ratio = 0.15
stribeck_velocity = 4e-3

[sampling]
rate = 4000.0
update_rate = 100.0
velocity_cutoff = 400.0

[estimator]
parameters = ["coulomb"]
"""
SECONDS = 16.0


def main(out: Path) -> None:
    """A text with semicolons, decimal commas, millimetres and a row of units."""
    machine = out.with_suffix(".unknown.toml")
    machine.write_text(UNKNOWN, encoding="utf-8")
    try:
        log = sgms_mhe.simulate(machine, "long_mixed", duration_s=SECONDS, seed=4).log
    finally:
        machine.unlink()
    rows = zip(log.time_s, 1e3 * log.position_m, log.force_N, strict=True)
    lines = [f"{t:.5f};{x:.9f};{u:.5f}".replace(".", ",") for t, x, u in rows]
    out.write_text("\n".join(["Zeit;Position;Kraft", "s;mm;N", *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
