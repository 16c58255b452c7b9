"""Packages with every binding, and what their C alone makes of a log: what the tests of bindings compare with."""

import ctypes
import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from c_packages import machine, written
from sgms_bench.motions import simulated_log
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.bindings import BINDINGS
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.status import FLAGS

KINDS = ("single", "double", "ekf", "rotary")
HELD_MASS = "held mass"
"""A kind whose equations have the mass in them, so that it is no parameter; it feeds nothing forward by itself."""

PLACES = "places"
"""A kind whose force depends on the place, so that its origin can be set."""
PITCH = 0.003


@dataclass(frozen=True)
class Bound:
    """A package with every binding.

    Attributes:
        folder: it is written in.
    """

    machine: Machine
    package: Package
    folder: Path

    @property
    def name(self) -> str:
        return self.machine.name

    @property
    def log(self) -> Log:
        """Forty updates of a motion with reversals and a halt."""
        return simulated_log(self.machine, "mixed", 40)

    def run(self, log: Log) -> Estimates:
        """What the package's C makes of a log in one task."""
        return CompiledEstimator(self.machine, self.package).estimate_log(log, mode="tick")


def machine_of(kind: str) -> Machine:
    if kind == "rotary":
        return load_machine("etel_xy_rotary")
    estimator = {"kind": "ekf"} if kind == "ekf" else {"horizon": 6, "relinearise": "auto"}
    changes = {"effects": [{"name": "force_gain", "gain": 1.07}], "compensation": {"enabled": False, "delay": 210e-6}}
    precision = "single" if kind == "single" else "double"
    ripple = {"name": "force_ripple", "amplitude_N": 1.5, "pitch_m": PITCH}
    more: dict[str, dict[str, Any]] = {HELD_MASS: changes, PLACES: {"effects": [ripple]}}
    return machine(code={"precision": precision}, estimator=estimator, **more.get(kind, {}))


def bound_package(kind: str, folder: Path) -> Bound:
    """The package of a kind, written below a folder."""
    settings = machine_of(kind)
    package = emit_package(settings, selftest=False, bindings=BINDINGS)
    return Bound(settings, package, written(package, folder))


def outputs_of(expected: Estimates) -> dict[str, NDArray[Any]]:
    """What a binding puts out after every update, by name, in the order of its outputs."""
    return {
        "friction": expected.friction_N,
        "friction_measured": expected.friction_measured_N,
        "deflection": expected.z_m,
        "parameter": expected.parameters,
        "deviation": expected.std,
        "innovation": expected.innovation_N,
        "test_ratio": expected.test_ratio,
        "noise_scale": expected.noise_scale,
        "status": expected.status,
        "doubt": (expected.status > 0) & (expected.status & FLAGS["doubt"] != 0),
        "update": np.arange(1, len(expected.status) + 1),
        "age": np.zeros(len(expected.status)),
        "numeric": np.zeros(len(expected.status)),
    }


COUNTS = ("update", "age", "numeric")
"""Outputs that are whole numbers beside the status."""


def ages(package: Bound, samples: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return updates so far and samples since the last one, behind each of so many samples in one task."""
    behind = np.arange(samples)
    per_update = package.machine.sampling.samples_per_update
    updates = behind // per_update
    return updates, np.where(updates > 0, behind % per_update, behind + 1)


def module_of(folder: Path) -> ModuleType:
    """The emitted Python module, as an application imports it."""
    path = next(folder.glob("*.py"))
    name = f"{path.stem}_binding_{abs(hash(str(path)))}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def ticking(package: Bound) -> Any:
    """An estimator of the emitted Python module that has the C's `tick` besides: double precision only."""
    module = module_of(package.folder)
    assert package.package.machine.code.precision == "double"

    class Ticking(module.Estimator):  # type: ignore[misc, name-defined]
        def tick(self, position: float, push: float) -> float:
            self._declare("tick", ctypes.c_double, ctypes.c_void_p, module._Position, ctypes.c_double)
            return float(self._c_tick(self._axis, module._position(position), push))

    return Ticking()
