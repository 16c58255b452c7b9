"""Cost of fast moves for the integrators."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.signals.chain import Signals
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]


def speed_study(samples: int) -> CsvTable:
    """Force error of the emitted integrators over moves to growing speed, against a converged solution."""
    machine = load_machine("etel_xy")
    shape = np.concatenate([np.linspace(0.0, 1.0, samples), np.ones(samples), np.linspace(1.0, 0.0, samples)])
    shape = np.concatenate([[0.0], shape, np.zeros(samples // 3), -shape])
    flat = np.zeros(len(shape))
    forces: dict[str, list[Array]] = {}
    samplings: dict[str, dict[str, Any]] = {
        "converged": {"integrator": {"scheme": "rk4", "substeps": 400, "displacement": 0.01}},
        "flow": {"integrator": {"scheme": "flow"}},
        "rk4": {"integrator": {"scheme": "rk4"}},
        # A machine that says it never moves fast gets no more steps than that needs.
        "rk4, one step per sample": {"integrator": {"scheme": "rk4", "displacement": 10.0}, "max_velocity": 0.01},
    }
    for name, sampling in samplings.items():
        model = CompiledModel(override_machine(machine, {"sampling": sampling}))
        forces[name] = [
            model.predict(Signals(flat, flat, peak * shape, flat, flat, flat, flat == 0.0, flat != 0.0))
            for peak in SPEEDS
        ]
    columns = [f"{peak:g} m/s" for peak in SPEEDS]
    rows: list[dict[str, Any]] = []
    for name, force in forces.items():
        errors = [float(np.abs(f - c).max()) for f, c in zip(force, forces["converged"], strict=True)]
        if name != "converged":
            rows.append({"integrator": name} | dict(zip(columns, errors, strict=True)))
    return CsvTable(
        "largest force error [N] over a move there and back, etel_xy",
        {"integrator": ""} | dict.fromkeys(columns, ".1e"),
        rows,
        ("against rk4 with steps of at most 0.01 of the smallest deflection scale",),
    )


SPEEDS: Final = (0.002, 0.02, 0.1, 0.3, 1.0)
