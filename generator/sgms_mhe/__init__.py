"""Generator of embedded friction observers: S-GMS friction model, moving horizon estimation, emitted C.

The names in `__all__` are the public interface for Python, each imported when it is first asked for: functions, the
classes of their results, errors and warnings. `help(sgms_mhe.estimate)` has arguments, shapes, units and errors of one.
"""

import os as _os
from importlib import import_module as _import_module

if _os.name != "posix":
    raise ImportError("sgms-mhe runs on Linux and macOS; on Windows in WSL, which is Linux (wsl --install)")

__version__ = "0.2.0"

_MODULES = {
    "BuildError": "support.errors",
    "Diagnosis": "diagnosis.result",
    "Estimates": "signals.estimates",
    "ExportedAxis": "api.exporting",
    "Identification": "identification.result",
    "ImplausibleError": "support.errors",
    "InputError": "support.errors",
    "Log": "signals.logs",
    "LogWarning": "support.errors",
    "Machine": "machine.resolved",
    "MachineWarning": "support.errors",
    "MotionPlan": "diagnosis.plan",
    "Origin": "diagnosis.other_record",
    "Package": "emission.package",
    "PredictedFriction": "evaluation.prediction",
    "SimulatedRun": "plant.simulation",
    "Tuned": "evaluation.tuning",
    "diagnose": "api.diagnosis",
    "effects": "api.experiments",
    "estimate": "api.estimation",
    "export": "api.exporting",
    "find_origin": "api.estimation",
    "fleet": "api.fleets",
    "generate": "api.packages",
    "identify": "api.identification",
    "load": "api.inputs",
    "plan": "api.experiments",
    "predict": "api.estimation",
    "read_log": "api.inputs",
    "simulate": "api.simulation",
    "tune": "api.tuning",
}
"""Modules by the name that each holds; `__init__.pyi` says the same to type checkers."""

__all__ = sorted(_MODULES)  # noqa: PLE0605  a list


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
