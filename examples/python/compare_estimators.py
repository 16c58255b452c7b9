"""The moving horizon estimator and the extended Kalman filter on one log, side by side.

    python examples/python/compare_estimators.py MACHINE

Both are the generated C, compiled here. The stiffness of the simulated axis is 1.3 times the machine file's, so that
there is something to estimate.
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd

import sgms_mhe


def compare(machine: str) -> pd.DataFrame:
    """RMS of measured minus estimated friction [N], and the first stiffness over the true one at the end."""
    axis = sgms_mhe.load(machine)
    log = sgms_mhe.simulate(axis, "mixed", duration_s=5.0, scale={"stiffness": 1.3}).log
    rows = {}
    for name, solver in (("MHE", "c"), ("EKF", "ekf")):
        estimates = sgms_mhe.estimate(axis, log, solver=solver).to_frame()
        residual = estimates["friction_measured_N"] - estimates["friction_N"]
        rows[name] = {
            "residual_rms_N": float(np.sqrt((residual**2).mean())),
            "stiffness_ratio": estimates["stiffness_1"].iloc[-1] / (1.3 * axis.friction.stiffness[0]),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


if __name__ == "__main__":
    print(compare(sys.argv[1]).to_string())
