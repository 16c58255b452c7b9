"""Axes under a given force: what the tests of exports compare."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

from package_variants import EFFECTS, GEARED
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.machine import Machine

Array = NDArray[np.float64]

SUFFIX = {
    "mujoco": ".xml",
    "urdf": ".urdf",
    "modelica": ".mo",
    "simscape": ".ssc",
    "csv": ".csv",
    "matlab": ".m",
    "twincat-table": ".lis",
    "sinamics-table": ".txt",
    "fmu2": ".fmu",
    "fmu3": ".fmu",
}
FORMS = tuple(SUFFIX)
"""Of an axis of either kind."""
BASES = ("etel_xy", "etel_xy_switching", "etel_xy_rotary")
OF_MEASUREMENT = ("encoder_periodic_error", "force_delay", "force_gain")
MOTION = ("position", "velocity", "acceleration")
AMPLITUDE, FREQUENCY = 9.0, 2.0
"""Of the force that the axes are driven by [N, Hz]: beyond break-away, with reversals and sticking at each."""


def machine_with(*effects: Mapping[str, Any], base: str = "etel_xy") -> Machine:
    return override_machine(load_machine(base), {"effects": list(effects), "estimator": {"parameters": ["coulomb"]}})


def machine_of_effect(name: str) -> Machine:
    numbers = EFFECTS.get(name) or GEARED[name]
    return machine_with({"name": name, **numbers}, base="etel_xy" if name in EFFECTS else "etel_xy_rotary")


def drive_force(machine: Machine, duration: float) -> Array:
    """Samples (n) [N] of a sine, each its value in the middle of the sample through which it is held."""
    middles = (np.arange(round(duration * machine.sampling.rate)) + 0.5) * machine.sampling.step
    return AMPLITUDE * np.sin(2.0 * np.pi * FREQUENCY * middles)


class AxisSlave:
    """An instance of an axis' FMU in FMPy, by the names of its variables."""

    def __init__(self, path: Path, folder: Path) -> None:
        self.description: Any = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), unzipdir=str(folder))
        self.version = int(self.description.fmiVersion[0])
        old = self.version == 2
        token = self.description.guid if old else self.description.instantiationToken
        self.fmi: Any = (FMU2Slave if old else FMU3Slave)(
            guid=token,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="axis",
        )
        self.fmi.instantiate()
        self.get = self.fmi.getReal if old else self.fmi.getFloat64
        self.put = self.fmi.setReal if old else self.fmi.setFloat64
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.push = next(v.name for v in self.description.modelVariables if v.causality == "input")
        self.step_s = float(self.description.defaultExperiment.stepSize)

    def start(self) -> None:
        if self.version == 2:
            self.fmi.setupExperiment(startTime=0.0)
        self.fmi.enterInitializationMode()
        self.fmi.exitInitializationMode()

    def __getitem__(self, name: str) -> float:
        return float(self.get([self.references[name]])[0])

    def __setitem__(self, name: str, value: float) -> None:
        self.put([self.references[name]], [value])

    def run(self, force: Array, names: tuple[str, ...] = MOTION, first: int = 0) -> Array:
        """Outputs (n, names) at the end of each sample."""
        wanted, rows = [self.references[name] for name in names], []
        for k, value in enumerate(force.tolist(), first):
            self[self.push] = value
            self.fmi.doStep(k * self.step_s, self.step_s)
            rows.append(self.get(wanted))
        return np.array(rows)


@contextmanager
def slave_of(path: Path, folder: Path, *, started: bool = True) -> Iterator[AxisSlave]:
    slave = AxisSlave(path, folder)
    try:
        if started:
            slave.start()
        yield slave
    finally:
        slave.fmi.freeInstance()
