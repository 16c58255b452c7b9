"""Generator of embedded friction observers: S-GMS friction model, moving horizon estimation, emitted C.

The functions in `__all__` are the public interface for Python; docs/python.md has them with an example each. Each is
imported when it is first asked for.
"""

from importlib import import_module as _import_module

__version__ = "0.2.0"

__all__ = ["diagnose", "estimate", "export", "generate", "identify", "load", "predict", "read_log", "simulate"]

_MODULES = {
    "diagnose": "diagnosis",
    "estimate": "estimation",
    "export": "exporting",
    "generate": "packages",
    "identify": "identification",
    "load": "inputs",
    "predict": "estimation",
    "read_log": "inputs",
    "simulate": "simulation",
}
"""Modules of `sgms_mhe.api` by the function that each holds; `__init__.pyi` says the same to type checkers."""


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(f"{__name__}.api.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
