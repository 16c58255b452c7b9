"""The machine file: what a user writes, read into frozen, checked, resolved numbers."""

from .loading import json_schema, load_machine, override_machine
from .schema import (
    BASE_PARAMETERS,
    DISPLACEMENT,
    LOG_UNITS,
    ArrivalCost,
    Code,
    Effect,
    Estimator,
    Friction,
    Integrator,
    LogColumn,
    LogMapping,
    Machine,
    Noise,
    Plant,
    Sampling,
    Smoothing,
)

__all__ = [
    "BASE_PARAMETERS",
    "DISPLACEMENT",
    "LOG_UNITS",
    "ArrivalCost",
    "Code",
    "Effect",
    "Estimator",
    "Friction",
    "Integrator",
    "LogColumn",
    "LogMapping",
    "Machine",
    "Noise",
    "Plant",
    "Sampling",
    "Smoothing",
    "json_schema",
    "load_machine",
    "override_machine",
]
