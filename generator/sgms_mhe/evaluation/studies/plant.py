"""Coverage on the axis in closed loop, whose noise is not what the estimator assumes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.evaluation.experiment import PAPER_WEIGHTS, papers
from sgms_mhe.evaluation.studies.cases import (
    Case,
    factor_of_two,
    positive,
    simulated,
    spread,
    weighted,
)
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.support.tables import Table

Array = NDArray[np.float64]


def plant_study(seeds: int, duration_s: float = 20.0) -> Table:
    """Coverage on the closed-loop plant, and what moves it."""
    default: dict[str, Any] = {}
    cases: tuple[Case, ...] = (
        Case("default", default, spread),
        Case("stiffness within the prior, 10 %", default, lambda rng: positive(rng, 0.1, 4)),
        Case("factor 2", default, factor_of_two),
        Case("force noise 0.35 N (0.1 N of friction)", default, spread, 0.35),
        Case("force noise 1.6 N (0.46 N of friction)", default, spread, 1.6),
        Case("the same, measurement = 0.5", weighted(measurement=0.5), spread, 1.6),
        Case("prior 0.3", weighted(parameter=0.3), spread),
        Case("no drift", weighted(parameter_drift=0.0), spread),
        Case("the paper's weights", papers(PAPER_WEIGHTS), spread),
    )
    rows = []
    for case in cases:
        machine = override_machine(load_machine("etel_xy"), case.changes)
        # The filter's covariance is the MHE's to the third digit, at a twentieth of the time.
        kind = "mhe" if machine.estimator.arrival_cost.update == "fixed" else "ekf"
        machine = override_machine(machine, {"estimator": {"kind": kind}})
        estimator = CompiledEstimator(machine)
        nominal = np.array(machine.friction.stiffness)
        inside, z = [], []
        for seed in range(seeds):
            record = simulated(machine, case, seed, duration_s)
            estimates = estimator.estimate(record.signals)
            error = (estimates.parameters / nominal - record.theta) / (estimates.std / nominal)
            second_half = error[len(error) // 2 :]
            inside.append(np.mean(np.abs(second_half) <= 2.0, axis=0))
            z.append(error[-1])
        cover = np.mean(inside, axis=0)
        row: dict[str, Any] = {"configuration": case.name, "estimator": kind.upper()}
        row |= {f"cover {k + 1}": float(value) for k, value in enumerate(cover)}
        row |= {f"rms z {k + 1}": float(value) for k, value in enumerate(np.sqrt(np.mean(np.square(z), axis=0)))}
        rows.append(row)
    formats = {"configuration": "", "estimator": ""} | {f"cover {k + 1}": ".0%" for k in range(4)}
    return Table(
        f"coverage of +-2 sigma on the closed-loop axis, {seeds} seeds of {duration_s:g} s, second half of each run",
        formats | {f"rms z {k + 1}": ".2f" for k in range(4)},
        rows,
        ("rms z: error over its sigma at the end",),
    )
