"""An axis with a ripple that nobody told its machine file of: from its trace to C that knows it.

    python examples/python/own_axis.py OUT

The trace is simulated here; one that was exported from a drive takes its place in `trace`. OUT holds the trace, the
extended machine file and its package afterwards.
"""

from __future__ import annotations

import sys
from pathlib import Path

import sgms_mhe

AXIS = """
name = "own_axis"
description = "two elements, 5 kHz"

[plant]
mass = 20.0

[friction]
stiffness = [3e4, 1e4]
fraction = [0.25, 0.75]
viscous = 20.0
coulomb = 4.0

[sampling]
rate = 5000.0
update_rate = 50.0
velocity_cutoff = 200.0

[estimator]
horizon = 5
parameters = ["stiffness", "coulomb"]
"""
RIPPLE = ("force_ripple", {"amplitude_N": 1.5, "pitch_m": 0.02, "phase_rad": 0.6})


def main(out: Path) -> None:
    """Trace, causes, package."""
    out.mkdir(parents=True, exist_ok=True)
    machine = out / "own_axis.toml"
    machine.write_text(AXIS, encoding="utf-8")
    trace = out / "trace.csv"
    run = sgms_mhe.simulate(machine, "mixed", duration_s=8.0, hidden_effects=[RIPPLE], seed=1)
    run.log.to_frame().to_csv(trace, index=False)

    found = sgms_mhe.diagnose(machine, trace)
    print(f"{found.verdict}: {found.summary}")
    for cause in found.causes:
        numbers = [f"{name} = {value:.4g} +- {2.0 * cause.std[name]:.1g}" for name, value in cause.parameters.items()]
        print(f"  {cause.name}: {', '.join(numbers)}")
    if found.extended is None or found.extended_toml is None:
        return
    (out / "extended.toml").write_text(found.extended_toml, encoding="utf-8")
    package = sgms_mhe.generate(found.extended, out / "package")
    print(f"{len(package.files)} files in {out / 'package'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
