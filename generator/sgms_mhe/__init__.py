"""Generator of embedded friction observers: S-GMS friction model, moving horizon estimation, emitted C.

The names in `__all__` are the public interface for Python, each imported when it is first asked for: functions, the
classes of their results, errors and warnings. `help(sgms_mhe.estimate)` has arguments, shapes, units and errors of one.
"""

import os as _os
from importlib import import_module as _import_module
from pathlib import Path as _Path

if _os.name != "posix":
    raise ImportError("sgms-mhe runs on Linux and macOS; on Windows in WSL, which is Linux (wsl --install)")

__version__ = "0.2.0"

_MODULES = {
    line.split()[-1]: line.split()[1]
    for line in _Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8").splitlines()
    if line.startswith("from ")
}
"""Modules by the name that each holds, as `__init__.pyi` tells type checkers: `from MODULE import NAME as NAME`."""

__all__ = sorted(_MODULES)  # noqa: PLE0605  it is a list


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
