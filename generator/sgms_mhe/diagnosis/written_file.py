"""Errors of machine files along the records of a diagnosis, run as `predict` runs them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from sgms_mhe.configuration import step_every_sample
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.free_run import measure_free_run
from sgms_mhe.signals.chain import Signals, signals_of_record
from sgms_mhe.signals.logs import Log, align_velocity
from sgms_mhe.support.statements import Rule, Statement


@dataclass(frozen=True)
class WrittenError:
    """Errors of the machine's file and of the extended one along a record, in both norms.

    Attributes:
        name: source of its log.
        before, after: RMS of measured minus simulated friction over the valid samples [N]; both are the file's where no
            other one is written.
        force: RMS of the drive force [N].
        motion: RMS error of free runs before and after [m]; NaN where there is none.
        unit: of that.
    """

    name: str
    before: float
    after: float
    force: float
    motion: tuple[float, float]
    unit: str

    @classmethod
    def measure(cls, machine: Machine, written: Machine | None, log: Log) -> Self:
        """Run the machine and the one written along a log (None: none is)."""
        before, force = _run(machine, log)
        after = before if written is None else _run(written, log)[0]
        moved = measure_free_run(machine, log)
        motion = moved, moved if written is None else measure_free_run(written, log)
        return cls(log.source or "log", before, after, force, motion, log.units.position)

    def state(self, push: str) -> Iterator[Statement]:
        """Yield the statements on both; `push`: force or torque."""
        force = self.force if self.force > 0.0 else math.nan
        numbers: dict[str, float | str] = {"before": 100.0 * self.before / force, "push": push}
        yield Statement(Rule.WRITTEN, self.name, 100.0 * self.after / force, None, "%", numbers)
        before, after = self.motion
        if math.isfinite(before) and math.isfinite(after):
            yield Statement(Rule.FREE_RUN, self.name, after, None, self.unit, {"before": before})

    def to_json(self) -> dict[str, Any]:
        """Return its entry in diagnosis.json, keys of a linear axis."""
        rms = {"before": self.before, "after": self.after}
        force = self.force if self.force > 0.0 else math.nan
        return {
            "name": self.name,
            "residual_rms_N": rms,
            "relative_error": {key: value / force for key, value in rms.items()},
            "free_run": dict(zip(("before", "after"), self.motion, strict=True)) | {"unit": self.unit},
        }


def _run(machine: Machine, log: Log) -> tuple[float, float]:
    """Return the RMS of measured minus simulated friction over a log's valid samples, and of the drive force [N]."""
    signals: Signals = signals_of_record(align_velocity(log), machine)
    residual = signals.friction - CompiledModel(step_every_sample(machine)).predict(signals)
    rows = np.column_stack((residual, signals.force))[signals.valid]
    error, force = np.sqrt(np.mean(rows**2, axis=0)).tolist()
    return error, force
