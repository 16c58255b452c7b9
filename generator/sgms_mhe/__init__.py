"""Generator of embedded friction observers: S-GMS friction model, moving horizon estimation, emitted C.

Functions, each with arguments, shapes, units and errors in its own help, as `help(sgms_mhe.estimate)`:

    load         read a machine file
    read_log     read a log of any format
    simulate     move a simulated axis and log position and force
    estimate     friction and parameters from a log, one row per update
    predict      friction along a log without estimation
    find_origin  position from which forces over place count
    diagnose     errors of a machine file along a log, named, with numbers
    identify     a machine file from logs alone
    tune         noise weights and horizon that suit a log
    plan         reference trajectory of the next experiment
    effects      catalogue of effects beyond friction
    fleet        one of these for every row of a table of machines and logs
    generate     the estimator as C99
    export       the axis for another simulator

Example:
    >>> import sgms_mhe
    >>> machine = sgms_mhe.load("etel_xy")
    >>> run = sgms_mhe.simulate(machine, "mixed", duration_s=2.0, seed=1)
    >>> estimates = sgms_mhe.estimate(machine, run.log)
    >>> print(estimates.friction_N[-1], estimates.status[-1])

A machine is a path, a name in `machines/` or a `Machine`; a log is a path, a `Log`, a DataFrame or arrays by name.
Results are frozen dataclasses; bad input is an `InputError`.
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
