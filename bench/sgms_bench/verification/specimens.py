"""Small machines whose packages, together, hold every kind of code that the generator emits."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.machine import Machine

SMALL: Final[Mapping[str, Any]] = {
    "sampling": {"update_rate": 500.0, "max_velocity": 0.02, "integrator": {"scheme": "flow", "substeps": 20}},
    "estimator": {"horizon": 4, "relinearise": "all"},
}
SINGLE: Final = {"code": {"precision": "single"}}
BELIEVING: Final = {"noise": {"self_scaling": False}}
"""Of [estimator]: every reading is believed, so that wild ones get as far as they can."""
COMPENSATED: Final = {"compensation": {"delay": 210e-6, "limit": 20.0, "hold": 5e-6, "ramp": 0.01}}

AGEING: Final = {"name": "dwell_dependence", "ratio": 0.3, "time_constant_s": 0.05}


def _merge(substeps: int, **more: Any) -> dict[str, Any]:
    return {"sampling": {"integrator": {"substeps": substeps}}, **more}


def _scheme(name: str, **settings: Any) -> dict[str, Any]:
    return {"sampling": {"integrator": {"scheme": name, **settings}}}


SPECIMENS: Final[Mapping[str, Mapping[str, Any]]] = {
    "flow": COMPENSATED,
    "merged_auto": _merge(4, estimator={"relinearise": "auto"}, **SINGLE, **COMPENSATED),
    "merged_all": _merge(4, estimator=BELIEVING),
    "newest": {"estimator": {"relinearise": "newest", **BELIEVING}, **_scheme("rk4"), **SINGLE},
    "auto": {
        "estimator": {"relinearise": "auto", "parameters": ["coulomb", "viscous"]},
        **_scheme("rk4", substeps=40),
        "code": {"accuracy": 0.01},
    },
    "fixed": {
        "estimator": {"arrival_cost": {"update": "fixed"}, "horizon": 6, **BELIEVING},
        **_scheme("rk4", substeps=4),
    },
    "ekf": {"estimator": {"kind": "ekf", "bounds": {}, **BELIEVING}, **_scheme("rk4"), **SINGLE},
    "groups": _merge(
        4,
        estimator={"relinearise": "auto"},
        effects=[
            AGEING,
            {"name": "hose_hysteresis", "stiffness_N_m": 800.0, "force_N": 0.8},
            {"name": "backlash", "gap_m": 2e-5},
        ],
    ),
    "levels": {
        "sampling": {"position_step": 5e-9},
        "effects": [AGEING, {"name": "frictional_lag", "time_constant_s": 0.01}],
        **COMPENSATED,
    },
    "signals": {
        "sampling": {"position_step": 5e-9},
        "effects": [
            {"name": "force_ripple", "amplitude_N": 0.6, "pitch_m": 0.004},
            {"name": "mass_mismatch", "mass_kg": 1.5},
            {"name": "periodic_disturbance", "amplitude_N": 0.4, "frequency_Hz": 13.0},
            {"name": "friction_drift", "ratio": 0.3, "time_constant_s": 1.0},
        ],
        **SINGLE,
    },
    "tables": {
        "effects": [
            {"name": "position_map", "pitch_m": 0.004, "order": [1, 2], "sine_N": [0.5, 0.1], "cosine_N": [0.2, -0.3]},
            {
                "name": "learned_residual",
                "place_cells": 2,
                "place_low_m": 0.0,
                "place_high_m": 0.01,
                "travel_cells": 1,
                "travel_length_m": 1e-3,
                "force_N": [0.05 * (k % 5) for k in range(20)],
            },
        ],
        **SINGLE,
        **COMPENSATED,
    },
    "switching": {"friction": {"law": "switching"}, **SINGLE, **COMPENSATED},
    "switching_merged": {"friction": {"law": "switching"}, **_merge(4, estimator=BELIEVING)},
    "switching_levels": {
        "friction": {"law": "switching"},
        "effects": [AGEING, {"name": "encoder_periodic_error", "amplitude_m": 5e-7}],
        **_merge(4, estimator={"relinearise": "auto"}),
    },
}
"""What is changed in the small machine, by name."""


def specimen(name: str) -> Machine:
    """One of them."""
    small = override_machine(load_machine("etel_xy"), SMALL)
    changes = dict(SPECIMENS[name])
    if "friction" in changes:  # whose integrator is its own
        small = override_machine(load_machine("etel_xy"), {"estimator": {"relinearise": "all"}})
        sampling = {"update_rate": 500.0, "max_velocity": 0.02, **changes.pop("sampling", {})}
        changes = {"estimator": {"horizon": 4}, **changes, "sampling": sampling}
    return override_machine(small, {"name": f"specimen_{name}", **changes})


def specimens() -> Iterator[Machine]:
    """All of them."""
    return map(specimen, SPECIMENS)
